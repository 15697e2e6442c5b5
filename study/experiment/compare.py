"""A comparison from its configuration to its tables, as `taichi-nmm compare` runs it."""

import math
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import pyarrow as pa

from storage.cluster import open_pool
from storage.databases.urls import file_url
from storage.pool import Cluster, Pool
from study.experiment.arms import check_arms
from study.experiment.block import Advanced, Block, advance
from study.experiment.database import Summarise, check_database, export, note_worths
from study.experiment.experiment import Experiment, store_path
from study.experiment.folder import (
    DATABASE_NAME,
    ExperimentFolder,
    Key,
    by_study,
    document,
    in_order,
    machine,
    results_of,
    walkers,
)

CHECKPOINT_S = 20.0
EXPORT_S = 60.0  # between two renewals of the study database

# How studies are cut into units of work, of some 20 s each: what a kill loses. Walkers
# of a block share the simulator's packs; no result depends on either number.
BLOCK_STUDIES = 64
STRETCH_TRIALS = 5


@dataclass(frozen=True)
class Progress:
    """How far a comparison is.

    Attributes:
        trials: finished ones, those of earlier sessions included.
        total: of the trials that there are to be.
        studies: that there are.
        walkers: studies with a trial that walked.
    """

    trials: int
    total: int
    studies: int
    walkers: int


class FinishedTrials:
    """Finished trials by study; each `commit` writes all trials of the arms that have new ones.

    The studies, by arm and run, are those of this call; others of their arms are kept
    too. With `until_walker` a study ends with its first walker.
    """

    def __init__(
        self,
        folder: ExperimentFolder,
        studies: Iterable[Key],
        until_walker: bool = False,
    ) -> None:
        self.studies = tuple(studies)
        self._until_walker = until_walker
        self._walkers: set[Key] = set()
        self._folder = folder
        self._tables: dict[Key, list[pa.Table]] = {key: [] for key in self.studies}
        self._uncommitted: set[str] = set()
        for arm in dict.fromkeys(arm for arm, _ in self.studies):
            self._take(folder.read_arm(arm))

    def add(self, table: pa.Table) -> None:
        """Keep trials that have just been finished, `state_schema`."""
        self._take(table)
        self._uncommitted |= set(table["arm"].to_pylist())

    def known(self, studies: Iterable[Key]) -> pa.Table:
        """The trials of some studies, sorted, `state_schema`."""
        tables = [table for key in studies for table in self._tables[key]]
        return in_order([self._folder.schema.empty_table(), *tables])

    def done(self, key: Key) -> int:
        """How many trials a study has."""
        return sum(len(table) for table in self._tables[key])

    def lacks(self, key: Key, trials: int) -> bool:
        """Whether a study has not yet come to its end, if each is to have so many trials."""
        return self.done(key) < trials and not (
            self._until_walker and key in self._walkers
        )

    @property
    def count(self) -> int:
        """Trials of the studies of this call."""
        return sum(map(self.done, self.studies))

    def progress(self, trials: int) -> Progress:
        """How far they are, if each is to have so many trials."""
        found = sum(key in self._walkers for key in self.studies)
        total = sum(
            trials if self.lacks(key, trials) else self.done(key)
            for key in self.studies
        )
        return Progress(self.count, total, len(self.studies), found)

    def results(self) -> pa.Table:
        """All trials of the arms of this call, without how they came about."""
        return results_of(self.known(self._tables))

    def commit(self) -> None:
        """Write the arms that have new trials."""
        for arm in sorted(self._uncommitted):
            table = self.known(key for key in self._tables if key[0] == arm)
            self._folder.write_arm(arm, table)
        self._uncommitted.clear()

    def _take(self, table: pa.Table) -> None:
        self._walkers |= walkers(table)
        for arm, run, rows in by_study(table):
            self._tables.setdefault((arm, run), []).append(rows)


@dataclass(frozen=True)
class Request:
    """A user's request; where it is None, the configuration's value counts.

    Attributes:
        out: folder of the experiment.
        storage: URL of the study database; None: a file in the folder.
        arms: by name.
        runs: at least 1.
        trials: of each arm in each run, in total, at least 1.
        workers: processes of this machine that try trials.
        cluster: that tries trials in place of the workers; None: there is none.
        pool: of processes that are there, which tries trials in place of both; None:
            new ones are started.
    """

    out: Path
    storage: str | None = None
    arms: tuple[str, ...] | None = None
    runs: int | None = None
    trials: int | None = None
    workers: int = 1
    cluster: Cluster | None = None
    pool: Pool | None = None


@dataclass(frozen=True, eq=False)
class Outcome:
    """The results of a comparison.

    Attributes:
        trials: the table of results, all arms of the folder.
        storage: URL of the study database.
        computed: trials of this session.
        wall_s: of this session.
    """

    trials: pa.Table
    storage: str
    computed: int
    wall_s: float


def compare(
    experiment: Experiment,
    request: Request,
    report: Callable[[Progress], None],
    summarise: Summarise | None = None,
) -> Outcome:
    """Run an experiment, or what is missing of it, and write its tables.

    `report` is called whenever a stretch of trials is finished. Without `summarise` the
    database has no summary study.

    Raises:
        InputError: before anything is written: see `check_arms`,
            `ExperimentFolder.check` and `check_database`; later: see `advance`.
        KeyboardInterrupt: finished trials are kept.
    """
    runs = range(request.runs or experiment.runs)
    trials = request.trials or experiment.trials
    arms = check_arms(experiment, request.arms or experiment.arms, trials)
    identity = document(experiment, arms)
    url = request.storage or file_url(request.out / DATABASE_NAME)
    ExperimentFolder.check(request.out, identity)
    check_database(experiment, url, arms, runs)
    read = sorted({arm.store for arm in arms if arm.store})
    opened = (
        nullcontext(request.pool)
        if request.pool
        else open_pool(
            request.workers,
            request.cluster,
            request.out,
            experiment.on_one_thread().robot,
            experiment.packages,
            [store_path(experiment, key) for key in read],
        )
    )
    with opened as pool, ExperimentFolder.claim(request.out, identity) as folder:
        pool.agree(folder.path)
        studies = [(arm.name, run) for run in runs for arm in arms]
        finished = FinishedTrials(folder, studies, experiment.until_walker)
        before, began_s = finished.count, time.monotonic()
        started = datetime.now(UTC).isoformat(timespec="milliseconds")
        exported_s = began_s

        def note_session() -> None:
            """A line of run.json; a session that computed nothing leaves none."""
            if computed := finished.count - before:
                session = {
                    "started": started,
                    "trials": computed,
                    "wall_s": round(time.monotonic() - began_s, 1),
                    "machine": machine(),
                    "stores": {
                        key: str(path) for key, path in experiment.stores.items()
                    },
                }
                folder.note_session(
                    session | ({"cluster": pool.kinds} if pool.kinds else {})
                )

        def commit(goes_on: bool) -> None:
            nonlocal exported_s
            finished.commit()
            note_session()
            if goes_on and time.monotonic() - exported_s >= EXPORT_S:
                export(experiment, finished.results(), url, summarise, final=False)
                exported_s = time.monotonic()

        report(finished.progress(trials))
        _go_on(experiment, finished, trials, pool, report, commit)
        results = folder.write_results()
        export(experiment, results, url, summarise, final=True)
        computed = finished.count - before
        note_worths(experiment, arms, runs, url, renew=computed > 0)
        note_session()
        return Outcome(results, url, computed, time.monotonic() - began_s)


def _go_on(
    experiment: Experiment,
    finished: FinishedTrials,
    trials: int,
    pool: Pool,
    report: Callable[[Progress], None],
    commit: Callable[[bool], None],
) -> None:
    """Work until every study has its trials.

    `commit` writes all that was taken, every `CHECKPOINT_S` and at the end, however
    this ends; it is told whether the work goes on.
    """
    experiment = experiment.on_one_thread() if pool.shares_machine else experiment
    stores = {key: pool.there(path) for key, path in experiment.stores.items()}
    experiment = replace(experiment, stores=stores)

    def first_stretch(studies: tuple[Key, ...]) -> Block:
        target = min(map(finished.done, studies)) + STRETCH_TRIALS
        return Block(
            experiment=experiment,
            studies=studies,
            known=finished.known(studies),
            trials=min(target, trials),
        )

    def next_stretch(block: Block, advanced: Advanced) -> Block | None:
        """What is left to do of a block that was advanced; None where all have their trials."""
        going_on = [
            (key, study)
            for key, study in zip(block.studies, advanced.studies, strict=True)
            if finished.lacks(key, trials)
        ]
        if not going_on:
            return None
        studies, handed_on = zip(*going_on, strict=True)
        return Block(
            experiment=experiment,
            studies=studies,
            known=finished.known(()),  # nothing: the studies are handed on whole
            trials=min(block.trials + STRETCH_TRIALS, trials),
            handed_on=handed_on,
            walks=advanced.walks,
        )

    unfinished = [key for key in finished.studies if finished.lacks(key, trials)]
    blocks = deque(map(first_stretch, cut(unfinished, pool.slots)))
    written_s = time.monotonic()
    try:
        for block, advanced in pool.results(advance, blocks):
            finished.add(advanced.table)
            left = next_stretch(block, advanced)
            if left is not None:
                blocks.append(left)  # `results` takes what is put there while it runs
            report(finished.progress(trials))
            if time.monotonic() - written_s >= CHECKPOINT_S:
                commit(True)
                written_s = time.monotonic()
    finally:
        commit(False)


def cut(studies: Sequence[Key], slots: int) -> list[tuple[Key, ...]]:
    """Studies as blocks of equal size, as many in each slot, none too large."""
    if not studies:
        return []
    rounds = math.ceil(len(studies) / (slots * BLOCK_STUDIES))
    size = math.ceil(len(studies) / (slots * rounds))
    return [
        tuple(studies[first : first + size]) for first in range(0, len(studies), size)
    ]
