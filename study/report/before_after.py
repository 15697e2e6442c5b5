"""Figure: two walks of one run as poses over its ground, before and after, or on two engines.

Before is one of a run's first trials that fell, after the best that walked. Both are simulated
again, on the body and the ground of their run, to be drawn.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from study.experiment.arms import OUR_ARM, PAPER_ARM
from study.experiment.experiment import MOST_TRIALS, Experiment
from study.experiment.folder import cheapest
from study.experiment.trials import simulate_trials
from study.pictures.strip import Shown, strips_figure
from study.report.figures import save
from study.report.numbers import by_rank, label_of
from study.report.runs import Results, read_arms
from taichi_nmm.result import COMPLETED
from taichi_nmm.terrain import Terrain

FIRST_TRIALS = 3  # of which the best is "before"
RECORD_HZ = 50.0

Row = dict[str, Any]  # of the table of trials


@dataclass(frozen=True, eq=False)
class Pair:
    """Two walks of one run on its ground; the first is drawn above."""

    run: int
    terrain: Terrain
    first: Shown
    second: Shown


def before_and_after(results: Results, experiment: Experiment) -> Pair | None:
    """The two walks, simulated again; None where no run has both."""
    chosen = choose(results, experiment.names)
    if chosen is None:
        return None
    run = chosen[0]["run"]
    gains = np.array([[row[name] for name in experiment.names] for row in chosen])
    walks = simulate_trials(experiment, [run, run], gains, record=True, record_rate_hz=RECORD_HZ)
    shown = [
        Shown(when, _title(when, *rows), trajectory)
        for when, *rows, trajectory in zip(
            ("before", "after"), chosen, walks.rows, walks.trajectories, strict=True
        )
    ]
    return Pair(run, experiment.terrain(run), *shown)


def choose(results: Results, names: tuple[str, ...]) -> tuple[Row, Row] | None:
    """Rows of the table: a trial that fell and one that walked, of the first run that has both.

    After: the best trial of our arm, or else of the best arm. Before: the best of the
    first trials of the same arm, the paper's method, or any other, in this order, if it fell.
    """
    order = by_rank(results.arms)
    last = OUR_ARM if OUR_ARM in results.arms else order[0]
    firsts = dict.fromkeys([last, *(arm for arm in (PAPER_ARM,) if arm in order), *order[::-1]])
    tables = read_arms(results.folder, ("arm", "run", "trial", "cost", "walked", *names))
    for arm in firsts:
        for run in results.arms[last].runs.tolist():
            before = _cheapest(tables[arm], run, FIRST_TRIALS)
            after = _cheapest(tables[last], run)
            if before and after and after["walked"] and not before["walked"]:
                return before, after
    return None


def _cheapest(table: pa.Table, run: int, trials: int = MOST_TRIALS) -> Row | None:
    """The cheapest trial of a run, or of its first ones."""
    own = table.filter((pc.field("run") == run) & (pc.field("trial") < trials))
    return cheapest(own) if len(own) else None


def _title(when: str, chosen: Row, row: np.void) -> str:
    ended = f"{row['duration_s']:.3g} s, {row['distance_m']:.3g} m"
    walked = row["end_reason"] == COMPLETED
    ended = f"{ended} at {row['mean_speed_mps']:.2f} m/s" if walked else f"fell after {ended}"
    arm, trial = label_of(chosen["arm"]), chosen["trial"] + 1
    return f"{when.capitalize()}: {arm}, trial {trial}: {ended}"


def write_strips(folder: Path, title: str, pair: Pair) -> list[Path]:
    """Draw both walks and, below them, the profile of the ground, as strips.png and .svg."""
    return save(strips_figure((pair.first, pair.second), pair.terrain, title), folder, "strips")
