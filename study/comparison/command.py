"""A comparison from its configuration to its table, as the command `tools/compare.py` runs it."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import pyarrow as pa

from storage.shard import read_columns
from storage.studies import URL_PREFIX
from study.command import require_arch
from study.comparison.artifacts import make_artifacts
from study.comparison.check import check_arms
from study.comparison.database import check_database, export
from study.comparison.experiment import Experiment
from study.comparison.folder import DATABASE_NAME, TIMES_NAME, ExperimentFolder
from study.comparison.identity import document, machine
from study.comparison.lockstep import Lockstep, Progress
from study.comparison.summary import ArmSummary, summaries
from study.pictures import find_ffmpeg
from taichi_nmm.errors import InputError

EXPORT_S = 60.0  # between two renewals of the study database


@dataclass(frozen=True)
class Request:
    """What a user asks for; None is what the configuration says.

    Attributes:
        out: folder of the experiment.
        storage: URL of the study database; None is a file in the folder.
        arms: names.
        runs: at least 1.
        trials: at least 1, of each arm in each run, in total.
        workers: processes that hold the studies.
        artifacts: whether the best trial of each study gets its picture and film.
    """

    out: Path
    storage: str | None
    arms: tuple[str, ...] | None
    runs: int | None
    trials: int | None
    workers: int
    artifacts: bool


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a comparison has to say at its end.

    Attributes:
        trials: the table of results: all arms of the folder.
        storage: URL of the study database.
        arms: a summary each.
        computed: trials of this session.
        wall_s: of this session.
    """

    trials: pa.Table
    storage: str
    arms: list[ArmSummary]
    computed: int
    wall_s: float


def compare(
    experiment: Experiment,
    request: Request,
    report: Callable[[Progress], None],
    drawn: Callable[[int, int], None] | None = None,
) -> Outcome:
    """Run an experiment, or what is missing of it, and write its tables.

    Args:
        experiment: what is compared on what.
        request: how much of it, and where to.
        report: called after each round of trials.
        drawn: called with the number of walks that have their pictures, and of all.

    Raises:
        InputError: see `check_arms`, `ExperimentFolder.claim` and `Lockstep.run`; or there is no
            ffmpeg for the artifacts.
        KeyboardInterrupt: finished trials are kept.
    """
    runs = _positive("runs", request.runs, experiment.runs)
    trials = _positive("trials", request.trials, experiment.trials)
    _positive("workers", request.workers, 1)
    arms = check_arms(experiment, request.arms or experiment.arms, trials)
    require_arch(experiment.settings)
    if request.artifacts:
        find_ffmpeg()
    identity = document(experiment, arms)
    with ExperimentFolder.claim(request.out, identity) as folder:
        url = request.storage or f"{URL_PREFIX}{folder.path / DATABASE_NAME}"
        check_database(experiment, url)
        studies = [(arm.name, run) for run in range(runs) for arm in arms]
        lockstep = Lockstep(experiment, studies, folder)
        session = _Session(experiment, folder, url, lockstep)
        lockstep.checkpointed = session.checkpointed
        try:
            lockstep.run(trials, request.workers, session.watched(report))
        finally:
            session.note()
        results = folder.write_results()
        export(experiment, results, url, final=True)
        session.note()
        if request.artifacts:
            make_artifacts(experiment, results, url, folder.path, drawn, request.workers)
        times = read_columns(folder.path / TIMES_NAME)
        found = summaries(results, times, experiment.stores)
        return Outcome(results, url, found, session.computed, session.wall_s)


class _Session:
    """What this process does beside the trials: a line of run.json, and the study database."""

    def __init__(
        self, experiment: Experiment, folder: ExperimentFolder, url: str, lockstep: Lockstep
    ) -> None:
        self._experiment = experiment
        self._folder = folder
        self._url = url
        self._lockstep = lockstep
        self._started = datetime.now(UTC).isoformat(timespec="milliseconds")
        self._began_s = self._exported_s = time.monotonic()
        self._before = self._now = lockstep.finished

    @property
    def computed(self) -> int:
        """Trials of this session."""
        return self._now - self._before

    @property
    def wall_s(self) -> float:
        """Since it began."""
        return time.monotonic() - self._began_s

    def watched(self, report: Callable[[Progress], None]) -> Callable[[Progress], None]:
        """`report`, and count what it is told."""

        def both(progress: Progress) -> None:
            self._now = progress.trials
            report(progress)

        return both

    def checkpointed(self) -> None:
        """Called after each checkpoint: the database follows, less often."""
        self.note()
        if time.monotonic() - self._exported_s >= EXPORT_S:
            export(self._experiment, self._lockstep.results(), self._url, final=False)
            self._exported_s = time.monotonic()

    def note(self) -> None:
        """Write the line; a session that computed nothing leaves none."""
        if self.computed:
            self._folder.note_session(
                {
                    "started": self._started,
                    "trials": self.computed,
                    "wall_s": round(self.wall_s, 1),
                    "machine": machine(),
                }
            )


def _positive(name: str, value: int | None, default: int) -> int:
    chosen = default if value is None else value
    if chosen < 1:
        raise InputError(name, chosen, "1 or more")
    return chosen
