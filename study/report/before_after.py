"""Which two trials the strips show: one of a run's first that fell, and the best that walked.

Both are simulated again, on the body and the ground of their run, to be drawn.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from study.experiment.arms import BEST_ARM, PAPER_ARM
from study.experiment.experiment import Experiment
from study.experiment.trials import simulate_trials
from study.report.appearance import by_rank, label_of
from study.report.files import read_trials, table_files
from study.report.runs import Results
from taichi_nmm.result import Trajectory
from taichi_nmm.terrain import Terrain

FIRST_TRIALS = 3  # of which the best is "before"
RECORD_HZ = 50.0


@dataclass(frozen=True, eq=False)
class Chosen:
    """A trial of the table: its arm, its number from 0, and its row."""

    arm: str
    trial: int
    row: dict[str, Any]


@dataclass(frozen=True, eq=False)
class Shown:
    """A walk as it was simulated for a figure.

    Attributes:
        label: a word for it, such as "before".
        title: what it is, and what became of it.
        trajectory: 50 samples a second.
    """

    label: str
    title: str
    trajectory: Trajectory


@dataclass(frozen=True, eq=False)
class Pair:
    """Two walks of one run, as before and after.

    Attributes:
        run: its number.
        terrain: its ground.
        first: drawn above.
        second: drawn below.
    """

    run: int
    terrain: Terrain
    first: Shown
    second: Shown


def before_and_after(results: Results, experiment: Experiment) -> Pair | None:
    """The two walks, simulated again; None where no run has both.

    Args:
        results: of the experiment.
        experiment: its bodies, grounds and conditions.
    """
    chosen = choose(results, experiment.names)
    if chosen is None:
        return None
    run, before, after = chosen
    gains = np.array([[each.row[name] for name in experiment.names] for each in (before, after)])
    walks = simulate_trials(experiment, [run, run], gains, record=True, record_rate_hz=RECORD_HZ)
    shown = [
        Shown(when, _title(when, each, walks.rows[number]), walks.trajectories[number])
        for number, (when, each) in enumerate((("before", before), ("after", after)))
    ]
    return Pair(run, experiment.terrain(run), *shown)


def choose(results: Results, names: tuple[str, ...]) -> tuple[int, Chosen, Chosen] | None:
    """Run, a trial that fell and one that walked, of the first run that has both.

    After: the best trial of our best combination, or else of the best arm. Before: the best of the
    first trials of the same arm, the paper's method, or any other, in this order, if it fell.
    """
    order = by_rank(results.arms)
    last = BEST_ARM if BEST_ARM in results.arms else order[0]
    firsts = list(
        dict.fromkeys([last, *(arm for arm in (PAPER_ARM,) if arm in order), *order[::-1]])
    )
    tables = _trials(results, ("arm", "run", "trial", "cost", "walked", *names))
    for arm in firsts:
        for run in results.arms[last].runs.tolist():
            before = _cheapest(tables[arm], run, FIRST_TRIALS)
            after = _cheapest(tables[last], run, None)
            if before and after and after.row["walked"] and not before.row["walked"]:
                return run, before, after
    return None


def _trials(results: Results, columns: tuple[str, ...]) -> dict[str, pa.Table]:
    """The rows of each arm: of the table or its checkpoint, whichever has more."""
    found: dict[str, pa.Table] = {}
    for path in table_files(results.folder):
        table = read_trials(path, columns)
        for arm in results.arms:
            rows = table.filter(pc.equal(table["arm"], arm))
            if arm not in found or len(found[arm]) < len(rows):
                found[arm] = rows
    return found


def _cheapest(table: pa.Table, run: int, trials: int | None) -> Chosen | None:
    """The cheapest trial of a run, or of its first ones."""
    mask = pc.equal(table["run"], run)
    if trials is not None:
        mask = pc.and_(mask, pc.less(table["trial"], trials))
    own = table.filter(mask)
    if not len(own):
        return None
    row = own.slice(int(np.argmin(own["cost"].to_numpy())), 1).to_pylist()[0]
    return Chosen(row["arm"], row["trial"], row)


def _title(when: str, chosen: Chosen, row: np.void) -> str:
    reached = f"{row['duration_s']:.3g} s, {row['distance_m']:.3g} m"
    ended = f"{reached} at {row['mean_speed_mps']:.2f} m/s" if row["end_reason"] == 0 else (
        f"fell after {reached}"
    )  # fmt: skip
    return f"{when.capitalize()}: {label_of(chosen.arm)}, trial {chosen.trial + 1}: {ended}"
