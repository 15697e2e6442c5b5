"""A picture of the best trial of each study, where the dashboard looks for it.

The trials are simulated once more, recorded, many at a time; processes draw them. Equal trials of
several arms share their file. A file that is there is whole, and is not made again.
"""

import json
import uuid
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import pyarrow as pa
from numpy.typing import NDArray
from optuna.storages import RDBStorage

from storage.commit import TEMPORARY_SUFFIX, writable
from storage.databases.bulk import attach
from storage.databases.studies import read_errors
from storage.folder import remove
from storage.pool import IN_PROCESS, Pool
from study.experiment.database import opened
from study.experiment.experiment import Experiment, study_name
from study.experiment.folder import ARTIFACTS_NAME, by_study, cheapest, live_artifacts
from study.experiment.identity import fingerprint
from study.experiment.trials import outcome_text, simulate_trials
from study.pictures import write_strip
from taichi_nmm.result import Trajectory
from taichi_nmm.terrain import Terrain

STRIP_DPI = 100
RECORDED_S = 12.0  # from the start of the trial
RECORD_RATE_HZ = 50.0
WALKS_PER_BATCH = 64  # 1.5 MB each while they are recorded
NAMESPACE = uuid.UUID("6f1d2b3c-5d0e-4b57-9a52-0f4a7f6f3b11")
STRIP = {"filename": "strip.png", "mimetype": "image/png"}

Drawn = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class Walk:
    """A body, a ground and gains; the best trial of one study or of several."""

    run: int  # whose body and ground
    gains: NDArray[np.float64]  # the searched parameters, [16 + k]
    title: str  # how the walk ended
    trials: tuple[tuple[str, int], ...]  # name of the study and number of the trial, of each
    file: str  # its name; the same walk has the same one in all calls

    @classmethod
    def of(
        cls,
        experiment: Experiment,
        run: int,
        gains: NDArray[np.float64],
        trials: tuple[tuple[str, int], ...],
        outcome: Mapping[str, Any],
    ) -> "Walk":
        """The walk of trials of an experiment, with the outcome that they share."""
        walk = f"{fingerprint(experiment)}/{run}/{gains.tobytes().hex()}"
        file = str(uuid.uuid5(NAMESPACE, f"{walk}/strip"))
        title = f"{experiment.name}, run {run}: {outcome_text(outcome)}"
        return cls(run, gains, title, trials, file)


@dataclass(frozen=True, eq=False)
class Drawing:
    """A unit of work for any pool: a walk as it was simulated, and its folder."""

    walk: Walk
    trajectory: Trajectory
    terrain: Terrain
    folder: Path


def draw(drawing: Drawing) -> bool:
    """Draw the picture.

    Returns:
        Whether there was anything to draw: a walk that diverged before its first sample has none.

    Raises:
        InputError: the file cannot be written.
    """
    walk, trajectory = drawing.walk, drawing.trajectory
    if not np.isfinite(trajectory.q).all(axis=1).any():
        return False
    write_strip(drawing.folder / walk.file, trajectory, drawing.terrain, walk.title, STRIP_DPI)
    return True


def make_artifacts(
    experiment: Experiment,
    trials: pa.Table,
    url: str,
    out: Path,
    pool: Pool = IN_PROCESS,
    drawn: Drawn | None = None,
) -> None:
    """Draw the best trial of each study and attach the picture to it.

    The trials are rows of the results table, exported to the database before; the files go to the
    folder artifacts in `out`. `drawn` is called with the number of walks that are done, and of all.

    Raises:
        InputError: no place to write.
    """
    walks = best_walks(experiment, trials)
    _draw_walks(experiment, walks, url, out / ARTIFACTS_NAME, pool, drawn)


def draw_best(experiment: Experiment, run: int, study: optuna.Study, url: str, out: Path) -> None:
    """Draw the best trial of a live study of the database, and attach the picture.

    The picture goes to `live_artifacts`; `out` is the folder of the study.

    Raises:
        InputError: no place to write.
    """
    best = study.best_trial
    gains = np.array([best.params[name] for name in experiment.names])
    trials = ((study.study_name, best.number),)
    walk = Walk.of(experiment, run, gains, trials, best.user_attrs)
    _draw_walks(experiment, [walk], url, live_artifacts(url, out))


def _draw_walks(
    experiment: Experiment,
    walks: Sequence[Walk],
    url: str,
    folder: Path,
    pool: Pool = IN_PROCESS,
    drawn: Drawn | None = None,
) -> None:
    """Draw walks that are not drawn yet, and attach them to their trials."""
    with writable(folder):
        folder.mkdir(parents=True, exist_ok=True)
    remove(folder, f".*{TEMPORARY_SUFFIX}")
    done = [walk for walk in walks if (folder / walk.file).exists()]
    missing = [walk for walk in walks if walk not in done]
    _attach(done, url)
    finished = len(done)
    tell = drawn or (lambda finished, of: None)
    tell(finished, len(walks))
    for first in range(0, len(missing), WALKS_PER_BATCH):
        batch = missing[first : first + WALKS_PER_BATCH]
        result = simulate_trials(
            experiment,
            [walk.run for walk in batch],
            np.array([walk.gains for walk in batch]),
            record=True,
            duration_s=min(RECORDED_S, experiment.conditions.duration_s),
            record_rate_hz=RECORD_RATE_HZ,
        )
        drawings = deque(
            Drawing(walk, trajectory, experiment.terrain(walk.run), folder)
            for walk, trajectory in zip(batch, result.trajectories, strict=True)
        )
        drawn_now = []
        for drawing, is_drawn in pool.results(draw, drawings):
            drawn_now += [drawing.walk] * is_drawn
            finished += 1
            tell(finished, len(walks))
        _attach(drawn_now, url)


def best_walks(experiment: Experiment, trials: pa.Table) -> list[Walk]:
    """The best trial of each study, the first of equals; equal ones of several arms once."""
    found: dict[tuple[int, bytes], Walk] = {}
    for arm, run, rows in by_study(trials):
        row = cheapest(rows)
        gains = np.array([row[name] for name in experiment.names])
        trial = (study_name(experiment.name, arm, run), row["trial"])
        key = (run, gains.tobytes())
        same = (*found[key].trials, trial) if key in found else (trial,)
        found[key] = Walk.of(experiment, run, gains, same, row)
    return list(found.values())


def _attach(walks: Sequence[Walk], url: str) -> None:
    """Register the files with the trials, as `optuna.artifacts.upload_artifact` would."""
    attributes = []
    for walk in walks:
        value = json.dumps({"artifact_id": walk.file, **STRIP, "encoding": None})
        attributes += [(*trial, f"artifacts:{walk.file}", value) for trial in walk.trials]
    if not attributes:
        return
    with opened(url) as storage, read_errors(url):
        attach(storage, attributes)
        for walk in walks:
            for trial in walk.trials:  # all: one that was killed may have attached files alone
                _note(storage, *trial, walk.title, walk.file)


def _note(storage: RDBStorage, study_name: str, number: int, title: str, strip: str) -> None:
    """Write the note of the trial's page: how the walk ended, and the picture in full width."""
    from optuna_dashboard import get_note, save_note  # a second, which processes that draw spare
    from optuna_dashboard.artifact import get_artifact_path

    study = optuna.load_study(study_name=study_name, storage=storage)
    trial_id = storage.get_trial_id_from_study_id_trial_number(study._study_id, number)
    trial = optuna.trial.Trial(study, trial_id)
    if not get_note(trial):  # of the user's
        picture = f"![strip of stick figures]({get_artifact_path(trial, strip)})"
        save_note(trial, f"{title}\n\n{picture}")
