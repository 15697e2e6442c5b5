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
from matplotlib.axes import Axes

from study.experiment.arms import OUR_ARM, PAPER_ARM
from study.experiment.experiment import MOST_TRIALS, Experiment
from study.experiment.folder import cheapest
from study.experiment.trials import simulate_trials
from study.pictures import style
from study.pictures.stick_figure import activation_bar
from study.pictures.strip import draw_profile, last_stretch
from study.report.figures import save
from study.report.numbers import by_rank, label_of
from study.report.runs import Results, read_arms
from taichi_nmm.result import COMPLETED, Trajectory
from taichi_nmm.terrain import Terrain

FIRST_TRIALS = 3  # of which the best is "before"
RECORD_HZ = 50.0

Row = dict[str, Any]  # of the table of trials


@dataclass(frozen=True, eq=False)
class Shown:
    """A walk as it was simulated for a figure."""

    label: str  # a word for it, such as "before"
    title: str  # which walk it is, and how it ended
    trajectory: Trajectory  # 50 samples a second


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


WIDTH_M = 8.4
SHOWN_M = 6.8
SCALE_IN_PER_M = 1.05
LEFT_IN, RIGHT_IN, PROFILE_IN = 0.75, 1.0, 0.85
BELOW_GROUND_M = 0.14
COLOURS = (style.VERMILION, style.BLUE)  # of the first walk and the second


def write_strips(folder: Path, title: str, pair: Pair) -> list[Path]:
    """Draw both walks and, below them, the profile of the ground, as strips.png and .svg."""
    walks = (pair.first, pair.second)
    parts = [
        last_stretch(walk.trajectory, pair.terrain, SHOWN_M, WIDTH_M, BELOW_GROUND_M)
        for walk in walks
    ]
    heights_in = [part.size_m[1] * SCALE_IN_PER_M for part in parts]
    width = WIDTH_M * SCALE_IN_PER_M + LEFT_IN + RIGHT_IN
    height = sum(high_in + 0.62 for high_in in heights_in) + PROFILE_IN + 0.95
    figure = style.new_figure(width, height)

    def axes_at(top_in: float, high_in: float) -> Axes:
        bottom_in = height - top_in - high_in
        return style.axes_at(figure, LEFT_IN, bottom_in, WIDTH_M * SCALE_IN_PER_M, high_in)

    top = 0.35
    for walk, part, colour, high_in in zip(walks, parts, COLOURS, heights_in, strict=True):
        top += 0.3
        axes = axes_at(top, high_in)
        last = part.draw(axes, colour)
        axes.set_title(walk.title, loc="left", fontsize=style.TEXT_PT, color=style.INK)
        top += high_in + 0.32
    box = ((width - 0.75) / width, 1.0 - (0.9 + 1.6) / height, 0.12 / width, 1.6 / height)
    activation_bar(figure.add_axes(box), last)
    profile = axes_at(top + 0.1, PROFILE_IN)
    draw_profile(profile, parts, COLOURS)
    profile.set_xlabel("distance (m)", fontsize=style.TEXT_PT, color=style.INK)
    for walk, part, colour in zip(walks, parts, COLOURS, strict=True):
        profile.annotate(
            walk.label, xy=(np.mean(part.frame[:2]), 1.0), xytext=(0, 2),
            xycoords=("data", "axes fraction"), textcoords="offset points", ha="center",
            fontsize=style.SMALL_PT, color=colour,
        )  # fmt: skip
    figure.text(
        LEFT_IN / width, 1.0 - 0.25 / height, title,
        fontsize=style.TITLE_PT, color=style.INK, va="center",
    )  # fmt: skip
    return save(figure, folder, "strips")
