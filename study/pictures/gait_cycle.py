"""Figure: the mean gait cycle of a walk, beside the ranges of people, and the distance from them.

A walk is cut into strides of the left leg, each stretched to 0 to 100 %, and into
strides of the right leg, whose mean shows how far the two differ.

Joint angles and ground forces of people follow the natural-cadence ensemble means and
standard deviations of Winter (1991), muscle phases the electromyographic on and off
times of Perry (1992): human_walking.toml, with its sources. The tables are approximate:
enough to judge by eye or to steer a search, not to fit.
"""

import math
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import scipy
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import ArrayLike, NDArray

from study.pictures import style
from study.pictures.stick_figure import LEFT, RIGHT, finite
from taichi_nmm.result import EVENT_KINDS, MUSCLES, Trajectory

SOURCE = "human ± 1 sd, approx. (Winter 1991)"
EMG_SOURCE = "human EMG on, approx. (Perry 1992)"

Array = NDArray[np.float64]

PERCENT: Array = np.linspace(0.0, 100.0, 201)
SETTLING_STRIDES = 3  # the first ones still carry the initial state
FEWEST_STRIDES = 3
STRIKE, TAKE_OFF = EVENT_KINDS.index("strike"), EVENT_KINDS.index("takeoff")


@dataclass(frozen=True, eq=False)
class Strides:
    """n strides of a leg at `PERCENT` [p], in clinical signs.

    Attributes:
        hip_flexion_deg: of the thigh against the trunk, [n, p]; 0 is standing straight.
        knee_flexion_deg: likewise; 0 is straight.
        dorsiflexion_deg: likewise; 0 is a foot square to the shank.
        vertical_bw: ground force on its foot over body weight, [n, p].
        forward_bw: likewise, positive where it drives the walker on.
        activation: of its muscles, 0 to 1, in the order of `MUSCLES`, [7, n, p].
        take_off_percent: when the foot first leaves the ground, [k] of the strides that
            have it.
        duration_s: [n].
    """

    hip_flexion_deg: Array
    knee_flexion_deg: Array
    dorsiflexion_deg: Array
    vertical_bw: Array
    forward_bw: Array
    activation: Array
    take_off_percent: Array
    duration_s: Array

    def __len__(self) -> int:
        """Number of strides."""
        return len(self.duration_s)

    @property
    def enough(self) -> bool:
        """Whether a mean and a spread make sense."""
        return len(self) >= FEWEST_STRIDES


def strides_of(
    trajectory: Trajectory, body_weight_n: float, side: int = LEFT
) -> Strides:
    """All strides of a leg from heel strike to heel strike after the settling ones.

    Args:
        trajectory: whose poses are finite, of 100 samples a second or more.
        body_weight_n: by which forces are divided.
        side: `LEFT` (0) or `RIGHT` (1).
    """
    strikes = event_times(trajectory, side, STRIKE)[SETTLING_STRIDES:]
    starts, ends = strikes[:-1], strikes[1:]
    joints = np.rad2deg(trajectory.joint_rad[:, 3 * side : 3 * side + 3])
    activation = trajectory.activation[:, len(MUSCLES) * side :]
    # A force is the mean over the interval that ends at its sample: it belongs to the
    # middle.
    half_interval_s = 0.5 * np.diff(trajectory.time_s[:2]).sum()

    def cut(column: Array, lag_s: float = 0.0) -> Array:
        fractions = PERCENT / 100.0
        times = starts[:, None] + (ends - starts)[:, None] * fractions
        if not times.size:
            return np.zeros((0, len(PERCENT)))
        return np.interp(times + lag_s, trajectory.time_s, column)

    force = trajectory.ground_force_n[:, 2 * side : 2 * side + 2] / body_weight_n
    take_offs = event_times(trajectory, side, TAKE_OFF)
    first = np.append(take_offs, np.inf)[
        np.searchsorted(take_offs, starts, side="right")
    ]
    return Strides(
        hip_flexion_deg=-cut(joints[:, 0]),
        knee_flexion_deg=cut(joints[:, 1]),
        dorsiflexion_deg=-cut(joints[:, 2]),
        vertical_bw=cut(force[:, 1], half_interval_s),
        forward_bw=cut(force[:, 0], half_interval_s),
        activation=np.array([cut(activation[:, m]) for m in range(len(MUSCLES))]),
        take_off_percent=(100.0 * (first - starts) / (ends - starts))[first < ends],
        duration_s=ends - starts,
    )


def event_times(trajectory: Trajectory, side: int, kind: int) -> Array:
    """Times of a foot's events of a kind, in order, [k].

    Args:
        trajectory: of a walk.
        side: of the foot, `LEFT` (0) or `RIGHT` (1).
        kind: of the events, `STRIKE` or `TAKE_OFF`.
    """
    events = trajectory.events
    wanted = (events["side"] == side) & (events["kind"] == kind)
    return np.sort(events["time_s"][wanted])


SIZE_IN = (8.8, 9.6)
GRID = {
    "left": 0.075,
    "right": 0.985,
    "top": 0.875,
    "bottom": 0.055,
    "hspace": 0.42,
    "wspace": 0.3,
}


@dataclass(frozen=True)
class Panel:
    """A quantity over a stride, 0 % = heel strike: its name, the range of people, and its axis.

    Attributes:
        title: over the panel.
        unit: of its axis, with the sign in words.
        rows: of people: percent (0 to 100), mean, standard deviation.
        low: the axis begins here at the latest, in the quantity's unit.
        high: the axis ends here at the earliest.
        floor: the axis never begins below.
        ceiling: the axis never ends above.
    """

    title: str
    unit: str
    rows: list[list[float]]
    low: float
    high: float
    floor: float = -math.inf
    ceiling: float = math.inf

    def at(self, percent: ArrayLike) -> tuple[Array, Array]:
        """Mean and standard deviation of people at these percentages, each of their shape."""
        table = np.array(self.rows)
        curves = scipy.interpolate.PchipInterpolator(table[:, 0], table[:, 1:])(percent)
        return curves[..., 0], curves[..., 1]


PEOPLE = tomllib.loads(
    Path(__file__).with_name("human_walking.toml").read_text(encoding="utf-8")
)
PANELS = {name: Panel(**panel) for name, panel in PEOPLE["panels"].items()}
EMG_ON_PERCENT: dict[str, list[list[float]]] = PEOPLE["emg_on_percent"]


def write_gait_cycle(
    path: str | Path, trajectory: Trajectory, body_weight_n: float, title: str = ""
) -> Path:
    """Draw the strides of the left leg, from heel strike to heel strike, mean +- 1 sd.

    A thin line is the mean of the right leg, from its own heel strike. Of a walk with
    too few whole strides, the picture has the human ranges alone, and a line on why.

    Args:
        path: of the PNG.
        trajectory: at 100 samples a second or more.
        body_weight_n: the walker's, to scale the ground forces.
        title: one line, such as the name of the gait.

    Raises:
        InputError: the file cannot be written.
    """
    whole = finite(trajectory)
    strides, right = (strides_of(whole, body_weight_n, side) for side in (LEFT, RIGHT))
    figure = style.new_figure(*SIZE_IN)
    grid = figure.subplots(4, 3, gridspec_kw=GRID)
    places = iter(grid.flat)
    for (name, panel), axes in zip(PANELS.items(), places, strict=False):
        mean, sd = panel.at(PERCENT)
        axes.fill_between(
            PERCENT, mean - sd, mean + sd, color=style.HUMAN, alpha=0.35, linewidth=0
        )
        axes.plot(PERCENT, mean, color=style.FAINT, linewidth=1.0, linestyle="--")
        _draw_right(axes, getattr(right, name), right)
        _draw_model(axes, getattr(strides, name), strides, panel.title, panel.unit)
        _scale(axes, panel, getattr(strides, name))
    for (muscle, words), axes in zip(PEOPLE["muscles"].items(), places, strict=False):
        for start, end in EMG_ON_PERCENT[muscle]:
            axes.axvspan(
                start, end, color=style.EMG, alpha=0.6, linewidth=0, zorder=0.5
            )
        number = MUSCLES.index(muscle)
        curves = strides.activation[number]
        _draw_right(axes, right.activation[number], right)
        _draw_model(axes, curves, strides, f"{muscle}, {words}", "activation (1)")
        axes.set(ylim=(0.0, 1.05), yticks=[0.0, 0.5, 1.0])
    for axes in grid[-1]:
        axes.set_xlabel("stride (%)", fontsize=style.TEXT_PT, color=style.INK)
    _caption(figure, strides, title)
    return style.save_png(figure, path)


def _draw_model(
    axes: Axes, curves: Array, strides: Strides, title: str, unit: str
) -> None:
    if strides.enough:
        mean, sd = curves.mean(axis=0), curves.std(axis=0)
        band = np.array([mean - sd, mean + sd])
        if unit.startswith("activation"):
            band = np.clip(band, 0.0, 1.0)
        axes.fill_between(PERCENT, *band, color=style.MODEL, alpha=0.3, linewidth=0)
        axes.plot(PERCENT, mean, color=style.MODEL, linewidth=1.6)
        if len(strides.take_off_percent):
            percent = strides.take_off_percent.mean()
            axes.axvline(percent, color=style.MODEL, linewidth=0.9, linestyle=":")
    style.tidy(axes)
    axes.set(xlim=(0.0, 100.0), xticks=[0, 20, 40, 60, 80, 100])
    axes.set_title(
        title, loc="left", fontsize=style.TEXT_PT, color=style.INK, weight="bold"
    )
    axes.set_ylabel(unit, fontsize=style.SMALL_PT, color=style.INK, labelpad=2)
    axes.axhline(0.0, color=style.FAINT, linewidth=0.6, zorder=0.8)


def _draw_right(axes: Axes, curves: Array, strides: Strides) -> None:
    if strides.enough:
        axes.plot(PERCENT, curves.mean(axis=0), color=style.OTHER_LEG, linewidth=1.1)


def _scale(axes: Axes, panel: Panel, curves: Array) -> None:
    """Set the axis, alike for different gaits.

    The impact of the heel lasts a few milliseconds and would flatten all else: a peak
    above the panel's ceiling is given in words.
    """
    low, high = axes.get_ylim()
    lines = axes.get_lines() if len(curves) else []
    drawn = [np.asarray(line.get_ydata(), dtype=np.float64) for line in lines]
    peaks = [float(np.max(each)) for each in drawn if len(each) == len(PERCENT)]
    spread = (curves.mean(axis=0) + curves.std(axis=0)).max() if len(curves) else 0.0
    peak = max([*peaks, spread])
    axes.set_ylim(
        max(min(low, panel.low), panel.floor), min(max(high, panel.high), panel.ceiling)
    )
    if peak > panel.ceiling:
        axes.text(
            16.0,
            panel.ceiling,
            f"cut here: to {peak:.1f}",
            fontsize=style.SMALL_PT,
            color=style.MODEL,
            va="top",
        )


def _caption(figure: Figure, strides: Strides, title: str) -> None:
    model = [
        Line2D([], [], color=style.MODEL, linewidth=1.6, label="left leg ± 1 sd"),
        Line2D([], [], color=style.OTHER_LEG, linewidth=1.1, label="right leg"),
        Line2D(
            [],
            [],
            color=style.MODEL,
            linewidth=0.9,
            linestyle=":",
            label="left toe-off",
        ),
    ]
    handles = [
        *(model if strides.enough else []),
        Patch(facecolor=style.HUMAN, alpha=0.35, label=SOURCE),
        Patch(facecolor=style.EMG, alpha=0.6, label=EMG_SOURCE),
    ]
    figure.text(0.012, 0.978, title, fontsize=style.TITLE_PT, color=style.INK, va="top")
    figure.text(
        0.012,
        0.953,
        subtitle(strides),
        fontsize=style.TEXT_PT,
        color=style.INK,
        va="top",
    )
    figure.legend(
        handles=handles,
        loc="upper left",
        bbox_to_anchor=(0.004, 0.94),
        ncols=5,
        frameon=False,
        fontsize=style.SMALL_PT,
        columnspacing=1.4,
        handlelength=1.8,
    )


def subtitle(strides: Strides) -> str:
    """How many strides the curves are of, or why there are no curves."""
    count = len(strides)
    if not strides.enough:
        needed = f"too few for a mean ({FEWEST_STRIDES} are needed)"
        return f"{count} whole strides after settling: {needed}; the human ranges alone are shown."
    mean_s = strides.duration_s.mean()
    return f"Left leg, heel strike to heel strike: {count} strides of {mean_s:.2f} s."


ACCURACY = {
    "deg": 3.0,
    "bw": 0.05,
}  # of the published tables: `study.pictures.gait_cycle`


class Distance(NamedTuple):
    """The distance of a walker's mean stride from the mean of people.

    Attributes:
        rmse: root of the mean squared difference, in the curve's unit.
        deviations: the same in standard deviations of people, or in the tables'
            accuracy where that is larger.
    """

    rmse: float
    deviations: float


def human_distances(strides: Strides) -> dict[str, Distance]:
    """The distance of each of `PANELS`; none where the strides are too few for a mean."""
    if not strides.enough:
        return {}
    found = {}
    for name, panel in PANELS.items():
        mean, sd = panel.at(PERCENT)
        difference = getattr(strides, name).mean(axis=0) - mean
        scaled = difference / np.maximum(sd, ACCURACY[name.rpartition("_")[2]])
        rms = [
            float(np.sqrt(np.mean(np.square(each)))) for each in (difference, scaled)
        ]
        found[name] = Distance(*rms)
    return found
