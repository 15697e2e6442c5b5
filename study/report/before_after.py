"""Figure: two walks of one run as poses over its ground, before and after, or on two engines.

Before is one of a run's first trials that fell, after the best that walked. Both are simulated
again, on the body and the ground of their run, to be drawn.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from matplotlib.axes import Axes
from numpy.typing import NDArray

from study.experiment.arms import BEST_ARM, PAPER_ARM
from study.experiment.experiment import Experiment
from study.experiment.trials import simulate_trials
from study.palette import BLUE, VERMILION
from study.pictures import style
from study.pictures.stick_figure import (
    StickFigure,
    activation_bar,
    at_times,
    draw_ground,
    draw_profile,
    finite,
)
from study.pictures.strip import draw_ghosts, draw_poses, pose_times
from study.report.axes import by_rank, label_of, save
from study.report.runs import Results, read_trials, table_files
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


Floats = NDArray[np.float64]

WIDTH_M = 8.4
SHOWN_M = 6.8
SCALE_IN_PER_M = 1.05
LEFT_IN, RIGHT_IN, PROFILE_IN = 0.75, 1.0, 0.85
ABOVE_HIP_M, BELOW_GROUND_M = 0.95, 0.14
COLOURS = (VERMILION, BLUE)  # of the first walk and the second


@dataclass(frozen=True, eq=False)
class Panel:
    """One of the two walks: what is drawn of it, and where.

    Attributes:
        shown: which it is.
        colour: of its mark in the profile.
        trajectory: of it, as far as its pose is finite.
        poses_s: times of the poses.
        frame: x from, to; z from, to, in m.
    """

    shown: Shown
    colour: str
    trajectory: Trajectory
    poses_s: Floats
    frame: tuple[float, float, float, float]

    @property
    def height_in(self) -> float:
        """Height of its axes on the page."""
        return (self.frame[3] - self.frame[2]) * SCALE_IN_PER_M


def write_strips(folder: Path, title: str, pair: Pair) -> list[Path]:
    """Draw both walks and, below them, the profile of the ground, as strips.png and .svg.

    Args:
        folder: where to.
        title: of the figure.
        pair: the walks and their ground.
    """
    panels = [
        _panel(shown, colour, pair.terrain)
        for shown, colour in zip((pair.first, pair.second), COLOURS, strict=True)
    ]
    width = WIDTH_M * SCALE_IN_PER_M + LEFT_IN + RIGHT_IN
    height = sum(panel.height_in + 0.62 for panel in panels) + PROFILE_IN + 0.95
    figure = style.new_figure(width, height)

    def axes_at(top_in: float, high_in: float) -> Axes:
        box = (LEFT_IN, height - top_in - high_in, WIDTH_M * SCALE_IN_PER_M, high_in)
        return figure.add_axes((box[0] / width, box[1] / height, box[2] / width, box[3] / height))

    top = 0.35
    for panel in panels:
        top += 0.3
        axes = axes_at(top, panel.height_in)
        figure_of = _draw_panel(axes, panel, pair.terrain)
        top += panel.height_in + 0.32
    bar = figure.add_axes(
        ((width - 0.75) / width, 1.0 - (0.9 + 1.6) / height, 0.12 / width, 1.6 / height)
    )
    activation_bar(bar, figure_of)
    _draw_profile(axes_at(top + 0.1, PROFILE_IN), panels, pair.terrain)
    figure.text(
        LEFT_IN / width, 1.0 - 0.25 / height, title,
        fontsize=style.TITLE_PT, color=style.INK, va="center",
    )  # fmt: skip
    return save(figure, folder, "strips")


def _panel(shown: Shown, colour: str, terrain: Terrain) -> Panel:
    trajectory = finite(shown.trajectory)
    poses_s = pose_times(trajectory, SHOWN_M)
    q = at_times(trajectory, trajectory.q, poses_s)
    low_x = 0.5 * (q[:, 0].min() + q[:, 0].max() - WIDTH_M)
    ground = terrain.height(np.linspace(low_x, low_x + WIDTH_M, 200))
    frame = (low_x, low_x + WIDTH_M, ground.min() - BELOW_GROUND_M, q[:, 1].max() + ABOVE_HIP_M)
    return Panel(shown, colour, trajectory, poses_s, frame)


def _draw_panel(axes: Axes, panel: Panel, terrain: Terrain) -> StickFigure:
    """A walk on its ground; the last of its poses is returned."""
    low_x, high_x, low_z, high_z = panel.frame
    style.tidy(axes)
    axes.grid(False)
    axes.set(xlim=(low_x, high_x), ylim=(low_z, high_z))
    last = draw_poses(axes, panel.trajectory, panel.poses_s)
    draw_ghosts(axes, panel.trajectory, panel.poses_s, panel.colour)
    x = np.linspace(low_x, high_x, 2000)
    draw_ground(axes, x, terrain.height(x), low_z)
    axes.set_title(panel.shown.title, loc="left", fontsize=style.TEXT_PT, color=style.INK)
    axes.set_ylabel("height (m)", fontsize=style.TEXT_PT, color=style.INK)
    return last


def _draw_profile(axes: Axes, panels: Sequence[Panel], terrain: Terrain) -> None:
    """The ground as far as either came, with the parts above marked."""
    end = max(float(panel.trajectory.q[:, 0].max()) for panel in panels) + 2.0
    x = np.linspace(min(0.0, *(panel.frame[0] for panel in panels)), max(end, WIDTH_M), 4000)
    height = terrain.height(x)
    draw_profile(axes, x, height, margin_m=0.1 * max(float(np.ptp(height)), 0.5))
    for panel in panels:
        axes.axvspan(*panel.frame[:2], color=panel.colour, alpha=0.25, linewidth=0, zorder=3)
        axes.annotate(
            panel.shown.label, xy=(np.mean(panel.frame[:2]), 1.0), xytext=(0, 2),
            xycoords=("data", "axes fraction"), textcoords="offset points", ha="center",
            fontsize=style.SMALL_PT, color=panel.colour,
        )  # fmt: skip
    axes.set_xlabel("distance (m)", fontsize=style.TEXT_PT, color=style.INK)
