"""Figure: the mean gait cycle of a walk, beside the ranges of people, and the distance from them.

A walk is cut into strides of the left leg, each stretched to 0 to 100 %.

Joint angles and ground forces of people follow the natural-cadence ensemble means and standard
deviations of Winter (1991), The Biomechanics and Motor Control of Human Gait, also in Winter
(2009). The tables are approximate: read at uneven steps, good to about 3 deg and 0.05 body weights;
enough to judge by eye or to steer a search, not to fit. Muscle phases are the electromyographic on
and off times of Perry (1992), Gait Analysis, rounded to a few percent.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import ArrayLike, NDArray

from study.pictures import style
from study.pictures.stick_figure import finite
from taichi_nmm.result import EVENT_KINDS, MUSCLES, Trajectory

SOURCE = "human ± 1 sd, approximate, after Winter (1991)"
EMG_SOURCE = "human EMG on, approximate, after Perry (1992)"


@dataclass(frozen=True)
class HumanRange:
    """Mean and standard deviation of a quantity over a stride, 0 % = heel strike."""

    rows: tuple[tuple[float, float, float], ...]  # percent (0 to 100), mean, standard deviation

    def at(self, percent: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Mean and standard deviation at these percentages, each of their shape."""
        table = np.array(self.rows)
        curves = scipy.interpolate.PchipInterpolator(table[:, 0], table[:, 1:])(percent)
        return curves[..., 0], curves[..., 1]


HIP_FLEXION_DEG = HumanRange((
    (0, 19.5, 7.0), (5, 18.5, 7.0), (10, 16.5, 6.9), (15, 13.0, 6.8), (20, 8.5, 6.7),
    (25, 4.0, 6.7), (30, 0.0, 6.6), (35, -3.7, 6.5), (40, -7.0, 6.5), (45, -9.7, 6.6),
    (50, -11.2, 6.8), (55, -10.2, 7.0), (60, -5.0, 7.2), (65, 2.8, 7.1), (70, 10.5, 6.8),
    (75, 16.5, 6.6), (80, 20.2, 6.6), (85, 22.0, 6.7), (90, 21.3, 6.9), (95, 19.8, 7.0),
    (100, 19.5, 7.0),
))  # fmt: skip

KNEE_FLEXION_DEG = HumanRange((
    (0, 4.0, 5.2), (5, 11.5, 5.7), (10, 18.0, 6.0), (15, 21.0, 6.2), (20, 19.8, 6.0),
    (25, 16.2, 5.7), (30, 12.3, 5.4), (35, 9.4, 5.3), (40, 8.0, 5.3), (45, 9.3, 5.7),
    (50, 14.3, 6.5), (55, 24.0, 7.4), (60, 38.2, 7.8), (65, 53.0, 7.0), (70, 62.3, 5.9),
    (73, 64.3, 5.4), (76, 62.8, 5.2), (80, 56.0, 5.6), (85, 42.0, 6.6), (90, 24.0, 6.8),
    (95, 8.2, 5.6), (97.5, 3.6, 5.1), (100, 4.0, 5.2),
))  # fmt: skip

DORSIFLEXION_DEG = HumanRange((
    (0, 0.0, 4.2), (3, -3.2, 4.4), (6, -4.9, 4.6), (10, -3.4, 4.4), (15, 0.8, 4.0),
    (20, 3.6, 3.8), (25, 5.5, 3.7), (30, 6.9, 3.6), (35, 8.2, 3.7), (40, 9.3, 3.8),
    (44, 9.7, 4.0), (48, 8.2, 4.5), (52, 3.3, 5.2), (56, -5.7, 6.0), (60, -15.9, 6.4),
    (63, -19.7, 6.4), (66, -17.6, 6.2), (70, -11.3, 5.6), (75, -4.4, 4.9), (80, -0.4, 4.4),
    (85, 1.4, 4.1), (89, 1.9, 4.0), (95, 0.6, 4.1), (100, 0.0, 4.2),
))  # fmt: skip

VERTICAL_FORCE_BW = HumanRange((
    (0, 0.02, 0.02), (2, 0.35, 0.12), (5, 0.66, 0.14), (8, 0.92, 0.13), (11, 1.07, 0.11),
    (14, 1.12, 0.09), (17, 1.08, 0.08), (20, 0.98, 0.08), (25, 0.82, 0.08), (30, 0.75, 0.08),
    (35, 0.80, 0.08), (40, 0.94, 0.07), (45, 1.07, 0.07), (48, 1.10, 0.08), (51, 1.02, 0.11),
    (54, 0.74, 0.14), (57, 0.36, 0.12), (60, 0.09, 0.06), (62, 0.0, 0.0), (100, 0.0, 0.0),
))  # fmt: skip

FORWARD_FORCE_BW = HumanRange((
    (0, 0.0, 0.01), (2, 0.0, 0.04), (5, -0.09, 0.04), (8, -0.15, 0.04), (11, -0.17, 0.04),
    (14, -0.15, 0.04), (20, -0.09, 0.03), (26, -0.03, 0.02), (31, 0.0, 0.02), (37, 0.06, 0.02),
    (43, 0.14, 0.03), (48, 0.20, 0.03), (51, 0.21, 0.03), (54, 0.17, 0.04), (57, 0.09, 0.03),
    (60, 0.02, 0.02), (62, 0.0, 0.0), (100, 0.0, 0.0),
))  # fmt: skip

# On and off in percent of the stride; an interval that spans the heel strike is given as two.
EMG_ON_PERCENT: dict[str, tuple[tuple[float, float], ...]] = {
    "SOL": ((7, 52),),
    "TA": ((0, 13), (56, 100)),
    "GAS": ((9, 50),),
    "VAS": ((0, 18), (90, 100)),
    "HAM": ((0, 12), (80, 100)),
    "GLU": ((0, 25), (95, 100)),
    "HFL": ((54, 76),),
}


Array = NDArray[np.float64]

PERCENT: Array = np.linspace(0.0, 100.0, 201)
SETTLING_STRIDES = 3  # the first ones still carry the initial state
FEWEST_STRIDES = 3

LEFT = 0
STRIKE, TAKE_OFF = EVENT_KINDS.index("strike"), EVENT_KINDS.index("takeoff")


@dataclass(frozen=True, eq=False)
class Strides:
    """n strides of the left leg at `PERCENT` [p], in clinical signs."""

    hip_flexion_deg: Array  # [n, p], as the other angles
    knee_flexion_deg: Array
    dorsiflexion_deg: Array
    vertical_bw: Array  # ground force on the left foot over body weight, [n, p]
    forward_bw: Array
    activation: Array  # [7, n, p] in the order of `MUSCLES`
    take_off_percent: Array  # when the foot leaves the ground, [k] of strides that have it
    duration_s: Array  # [n]

    def __len__(self) -> int:
        """Number of strides."""
        return len(self.duration_s)

    @property
    def enough(self) -> bool:
        """Whether a mean and a spread make sense."""
        return len(self) >= FEWEST_STRIDES


def left_strides(trajectory: Trajectory, body_weight_n: float) -> Strides:
    """All strides from left heel strike to left heel strike after the settling ones."""
    strikes = _times(trajectory, STRIKE)[SETTLING_STRIDES:]
    starts, ends = strikes[:-1], strikes[1:]
    joints = np.rad2deg(trajectory.joint_rad[:, :3])
    # A force is the mean over the interval that ends at its sample: it belongs to the middle.
    half_interval_s = 0.5 * np.diff(trajectory.time_s[:2]).sum()

    def cut(column: Array, lag_s: float = 0.0) -> Array:
        fractions = PERCENT / 100.0
        times = starts[:, None] + (ends - starts)[:, None] * fractions
        if not times.size:
            return np.zeros((0, len(PERCENT)))
        return np.interp(times + lag_s, trajectory.time_s, column)

    force = trajectory.ground_force_n / body_weight_n
    return Strides(
        hip_flexion_deg=-cut(joints[:, 0]),
        knee_flexion_deg=cut(joints[:, 1]),
        dorsiflexion_deg=-cut(joints[:, 2]),
        vertical_bw=cut(force[:, 1], half_interval_s),
        forward_bw=cut(force[:, 0], half_interval_s),
        activation=np.array([cut(trajectory.activation[:, m]) for m in range(len(MUSCLES))]),
        take_off_percent=_take_offs(trajectory, starts, ends),
        duration_s=ends - starts,
    )


def _times(trajectory: Trajectory, kind: int) -> Array:
    """Times of the left foot's events of a kind, in order, [k]."""
    events = trajectory.events
    wanted = (events["side"] == LEFT) & (events["kind"] == kind)
    return np.sort(events["time_s"][wanted])


def _take_offs(trajectory: Trajectory, starts: Array, ends: Array) -> Array:
    """Percent of the stride at the first take-off within each."""
    take_offs = _times(trajectory, TAKE_OFF)
    percents = []
    for start, end in zip(starts, ends, strict=True):
        within = take_offs[(take_offs > start) & (take_offs < end)]
        percents += [100.0 * (time - start) / (end - start) for time in within[:1]]
    return np.array(percents)


SIZE_IN = (8.8, 9.6)
GRID = {
    "left": 0.075, "right": 0.985, "top": 0.875, "bottom": 0.055, "hspace": 0.42, "wspace": 0.3,
}  # fmt: skip
PANEL_MUSCLES = ("HFL", "GLU", "HAM", "VAS", "GAS", "SOL", "TA")  # from the hip down
MUSCLE_WORDS = {
    "HFL": "hip flexors", "GLU": "gluteus", "HAM": "hamstrings", "VAS": "vasti",
    "GAS": "gastrocnemius", "SOL": "soleus", "TA": "tibialis anterior",
}  # fmt: skip


@dataclass(frozen=True)
class Panel:
    """A quantity over the stride: its name, its human range, and its axis.

    The axis is at least from `low` to `high`, and never beyond `floor` and `ceiling`.
    """

    title: str
    unit: str
    human: HumanRange
    low: float
    high: float
    floor: float = -math.inf
    ceiling: float = math.inf


PANELS: dict[str, Panel] = {
    "hip_flexion_deg": Panel("hip", "flexion + (deg)", HIP_FLEXION_DEG, -30, 45),
    "knee_flexion_deg": Panel("knee", "flexion + (deg)", KNEE_FLEXION_DEG, -5, 75),
    "dorsiflexion_deg": Panel("ankle", "dorsiflexion + (deg)", DORSIFLEXION_DEG, -35, 20),
    "vertical_bw": Panel("ground force, up", "body weights", VERTICAL_FORCE_BW, 0, 1.6, 0.0, 1.6),
    "forward_bw": Panel("ground force, forward +", "body weights", FORWARD_FORCE_BW, -0.4, 0.4),
}


def write_gait_cycle(
    path: str | Path, trajectory: Trajectory, body_weight_n: float, title: str = ""
) -> Path:
    """Draw the strides of the left leg, from heel strike to heel strike, mean +- 1 sd.

    Of a walk with too few whole strides, the picture has the human ranges alone, and a line on why.

    Args:
        path: of the PNG.
        trajectory: at 100 samples a second or more.
        body_weight_n: the walker's, to scale the ground forces.
        title: one line, such as the name of the gait.

    Raises:
        InputError: the file cannot be written.
    """
    strides = left_strides(finite(trajectory), body_weight_n)
    figure = style.new_figure(*SIZE_IN)
    grid = figure.subplots(4, 3, gridspec_kw=GRID)
    panels = iter(grid.flat)
    for name, panel in PANELS.items():
        axes = next(panels)
        mean, sd = panel.human.at(PERCENT)
        axes.fill_between(PERCENT, mean - sd, mean + sd, color=style.HUMAN, alpha=0.35, linewidth=0)
        axes.plot(PERCENT, mean, color=style.FAINT, linewidth=1.0, linestyle="--")
        _draw_model(axes, getattr(strides, name), strides)
        _finish(axes, panel.title, panel.unit)
        _scale(axes, panel, getattr(strides, name))
    for muscle in PANEL_MUSCLES:
        axes = next(panels)
        for start, end in EMG_ON_PERCENT[muscle]:
            axes.axvspan(start, end, color=style.EMG, alpha=0.6, linewidth=0, zorder=0.5)
        _draw_model(axes, strides.activation[MUSCLES.index(muscle)], strides)
        _finish(axes, f"{muscle}, {MUSCLE_WORDS[muscle]}", "activation (1)")
        axes.set(ylim=(0.0, 1.05), yticks=[0.0, 0.5, 1.0])
    for axes in grid[-1]:
        axes.set_xlabel("stride (%)", fontsize=style.TEXT_PT, color=style.INK)
    _caption(figure, strides, title)
    return style.save_png(figure, path)


def _draw_model(axes: Axes, curves: Array, strides: Strides) -> None:
    if not strides.enough:
        return
    mean, sd = curves.mean(axis=0), curves.std(axis=0)
    axes.fill_between(PERCENT, mean - sd, mean + sd, color=style.MODEL, alpha=0.3, linewidth=0)
    axes.plot(PERCENT, mean, color=style.MODEL, linewidth=1.6)
    if len(strides.take_off_percent):
        axes.axvline(
            strides.take_off_percent.mean(), color=style.MODEL, linewidth=0.9, linestyle=":"
        )


def _finish(axes: Axes, title: str, unit: str) -> None:
    style.tidy(axes)
    axes.set(xlim=(0.0, 100.0), xticks=[0, 20, 40, 60, 80, 100])
    axes.set_title(title, loc="left", fontsize=style.TEXT_PT, color=style.INK, weight="bold")
    axes.set_ylabel(unit, fontsize=style.SMALL_PT, color=style.INK, labelpad=2)
    axes.axhline(0.0, color=style.FAINT, linewidth=0.6, zorder=0.8)


def _scale(axes: Axes, panel: Panel, curves: Array) -> None:
    """Set the axis, alike for different gaits.

    The impact of the heel lasts a few milliseconds and would flatten all else: a peak above the
    panel's ceiling is given in words.
    """
    low, high = axes.get_ylim()
    peak = curves.mean(axis=0).max() if len(curves) else 0.0
    axes.set_ylim(max(min(low, panel.low), panel.floor), min(max(high, panel.high), panel.ceiling))
    if peak > panel.ceiling:
        axes.text(
            16.0, panel.ceiling, f"impact: to {peak:.1f}", fontsize=style.SMALL_PT,
            color=style.MODEL, va="top",
        )  # fmt: skip


def _caption(figure: Figure, strides: Strides, title: str) -> None:
    handles: list[Line2D | Patch] = [
        Patch(facecolor=style.HUMAN, alpha=0.35, label=SOURCE),
        Patch(facecolor=style.EMG, alpha=0.6, label=EMG_SOURCE),
    ]
    if strides.enough:
        handles = [
            Line2D([], [], color=style.MODEL, linewidth=1.6, label="model ± 1 sd"),
            Line2D([], [], color=style.MODEL, linewidth=0.9, linestyle=":", label="model toe-off"),
            *handles,
        ]
    figure.text(0.012, 0.978, title, fontsize=style.TITLE_PT, color=style.INK, va="top")
    figure.text(0.012, 0.953, subtitle(strides), fontsize=style.TEXT_PT, color=style.INK, va="top")
    figure.legend(
        handles=handles, loc="upper left", bbox_to_anchor=(0.004, 0.94), ncols=4,
        frameon=False, fontsize=style.SMALL_PT, columnspacing=1.4, handlelength=1.8,
    )  # fmt: skip


def subtitle(strides: Strides) -> str:
    """How many strides the curves are of, or why there are no curves."""
    if not strides.enough:
        return (
            f"{len(strides)} whole strides after settling: too few for a mean "
            f"({FEWEST_STRIDES} are needed); the human ranges alone are shown."
        )
    return (
        f"Left leg, heel strike to heel strike: {len(strides)} strides of "
        f"{strides.duration_s.mean():.2f} s."
    )


ACCURACY = {"deg": 3.0, "bw": 0.05}  # of the published tables: `study.pictures.gait_cycle`


@dataclass(frozen=True)
class Distance:
    """The distance of a walker's mean stride from the mean of people."""

    rmse: float  # root of the mean squared difference, in the curve's unit
    deviations: float  # in standard deviations of people, or the tables' accuracy if that is larger


def human_distances(strides: Strides) -> dict[str, Distance]:
    """The distance of each of `PANELS`; none where the strides are too few for a mean."""
    if not strides.enough:
        return {}
    found = {}
    for name, panel in PANELS.items():
        mean, sd = panel.human.at(PERCENT)
        difference = getattr(strides, name).mean(axis=0) - mean
        scaled = difference / np.maximum(sd, ACCURACY[name.rpartition("_")[2]])
        found[name] = Distance(_root_mean_square(difference), _root_mean_square(scaled))
    return found


def _root_mean_square(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
