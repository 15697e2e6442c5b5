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
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import scipy
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import ArrayLike, NDArray

from study.pictures import style
from study.pictures.stick_figure import LEFT, RIGHT, finite, of_side
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
    """n strides of a leg at `PERCENT` [p].

    Attributes:
        curves: by the names of `PANELS`, [n, p]: joint angles in clinical signs, 0 is
            standing straight; ground forces over body weight, forward positive where
            they drive the walker on; activations of muscles, 0 to 1.
        take_off_percent: when the foot first leaves the ground, [k] of the strides that
            have it.
        duration_s: [n].
    """

    curves: dict[str, Array]
    take_off_percent: Array
    duration_s: Array

    def __len__(self) -> int:
        """Number of strides."""
        return len(self.duration_s)

    @property
    def enough(self) -> bool:
        """Whether a mean and a spread make sense."""
        return len(self) >= FEWEST_STRIDES

    def mean(self, name: str) -> Array:
        """The mean of a curve, [p]; NaN where strides are too few."""
        if not self.enough:
            return np.full(len(PERCENT), np.nan)
        return np.asarray(self.curves[name].mean(axis=0))

    def band(self, name: str) -> Array:
        """One standard deviation below and above the mean, an activation within 0 to 1, [2, p]."""
        mean = self.mean(name)
        sd = self.curves[name].std(axis=0) if self.enough else mean
        limits = (0.0, 1.0) if name in MUSCLES else (-np.inf, np.inf)
        return np.clip([mean - sd, mean + sd], *limits)

    @property
    def toe_off_percent(self) -> float | None:
        """Mean of the times at which the foot leaves the ground; None: unknown."""
        if self.enough and len(self.take_off_percent):
            return float(self.take_off_percent.mean())
        return None


def strides_of(
    trajectory: Trajectory, body_weight_n: float, side: int = LEFT
) -> Strides:
    """All strides of a leg from heel strike to heel strike after the settling ones.

    Args:
        trajectory: whose poses are finite, of 100 samples a second or more.
        body_weight_n: by which forces are divided.
        side: `LEFT` (0) or `RIGHT` (1).
    """
    times_s = stride_times(trajectory, side)
    starts, ends = times_s[:, 0], times_s[:, -1]
    # A force is the mean over the interval that ends at its sample: it belongs to the
    # middle.
    half_interval_s = 0.5 * np.diff(trajectory.time_s[:2]).sum()

    def cut(column: Array, lag_s: float = 0.0) -> Array:
        return np.interp(times_s + lag_s, trajectory.time_s, column)

    hip, knee, ankle = np.rad2deg(of_side(trajectory.joint_rad, side)).T
    forward, up = (of_side(trajectory.ground_force_n, side) / body_weight_n).T
    activation = of_side(trajectory.activation, side).T
    curves = {
        "hip_flexion_deg": -cut(hip),
        "knee_flexion_deg": cut(knee),
        "dorsiflexion_deg": -cut(ankle),
        "vertical_bw": cut(up, half_interval_s),
        "forward_bw": cut(forward, half_interval_s),
    }
    curves |= {
        muscle: cut(column) for muscle, column in zip(MUSCLES, activation, strict=True)
    }
    take_offs = event_times(trajectory, side, TAKE_OFF)
    following = np.searchsorted(take_offs, starts, side="right")
    first = np.append(take_offs, np.inf)[following]
    return Strides(
        curves=curves,
        take_off_percent=(100.0 * (first - starts) / (ends - starts))[first < ends],
        duration_s=ends - starts,
    )


def stride_times(trajectory: Trajectory, side: int) -> Array:
    """When the strides of a leg are at `PERCENT`, after the settling ones, s, [n, p]."""
    strikes = event_times(trajectory, side, STRIKE)[SETTLING_STRIDES:]
    share = PERCENT / 100.0
    return strikes[:-1, None] * (1.0 - share) + strikes[1:, None] * share


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
    """A quantity over a stride, 0 % = heel strike: its name, what people do, and its axis.

    Attributes:
        title: over the panel.
        unit: of its axis, with the sign in words.
        low: the axis begins here at the latest, in the quantity's unit.
        high: the axis ends here at the earliest.
        floor: the axis never begins below.
        ceiling: the axis never ends above.
        rows: of people: percent (0 to 100), mean, standard deviation; none of a muscle.
        on_percent: when the muscle of people is on, and until when.
    """

    title: str
    unit: str
    low: float
    high: float
    floor: float = -math.inf
    ceiling: float = math.inf
    rows: list[list[float]] = field(default_factory=list)
    on_percent: list[list[float]] = field(default_factory=list)

    def at(self, percent: ArrayLike) -> tuple[Array, Array]:
        """Mean and standard deviation of people at these percentages, each of their shape."""
        table = np.array(self.rows)
        curves = scipy.interpolate.PchipInterpolator(table[:, 0], table[:, 1:])(percent)
        return curves[..., 0], curves[..., 1]


PEOPLE = tomllib.loads(
    Path(__file__).with_name("human_walking.toml").read_text(encoding="utf-8")
)
OF_PEOPLE = {name: Panel(**panel) for name, panel in PEOPLE["panels"].items()}
"""Joints and ground forces."""

PANELS = OF_PEOPLE | {
    muscle: Panel(
        title=f"{muscle}, {words}",
        unit="activation (1)",
        low=0.0,
        high=1.05,
        floor=0.0,
        ceiling=1.05,
        on_percent=PEOPLE["emg_on_percent"][muscle],
    )
    for muscle, words in PEOPLE["muscles"].items()
}
"""All panels of the picture, in their order."""


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
    left, right = (strides_of(whole, body_weight_n, side) for side in (LEFT, RIGHT))
    figure = style.new_figure(*SIZE_IN)
    grid = figure.subplots(4, 3, gridspec_kw=GRID)
    for (name, panel), axes in zip(PANELS.items(), grid.flat, strict=True):
        _draw_people(axes, panel)
        axes.plot(PERCENT, right.mean(name), color=style.OTHER_LEG, linewidth=1.1)
        low, high = left.band(name)
        axes.fill_between(PERCENT, low, high, color=style.MODEL, alpha=0.3, linewidth=0)
        axes.plot(PERCENT, left.mean(name), color=style.MODEL, linewidth=1.6)
        if (percent := left.toe_off_percent) is not None:
            axes.axvline(percent, color=style.MODEL, linewidth=0.9, linestyle=":")
        _label(axes, panel)
        _scale(axes, panel, peak=np.fmax(high, right.mean(name)).max())
    for axes in grid[-1]:
        axes.set_xlabel("stride (%)", **style.TEXT)
    _caption(figure, left, title)
    return style.save_png(figure, path)


def _draw_people(axes: Axes, panel: Panel) -> None:
    if panel.rows:
        mean, sd = panel.at(PERCENT)
        axes.fill_between(
            PERCENT, mean - sd, mean + sd, color=style.HUMAN, alpha=0.35, linewidth=0
        )
        axes.plot(PERCENT, mean, color=style.FAINT, linewidth=1.0, linestyle="--")
    for start, end in panel.on_percent:
        axes.axvspan(start, end, color=style.EMG, alpha=0.6, linewidth=0, zorder=0.5)


def _label(axes: Axes, panel: Panel) -> None:
    style.tidy(axes)
    axes.set(xlim=(0.0, 100.0), xticks=[0, 20, 40, 60, 80, 100])
    axes.set_title(panel.title, loc="left", weight="bold", **style.TEXT)
    axes.set_ylabel(panel.unit, **style.SMALL, labelpad=2)
    axes.axhline(0.0, color=style.FAINT, linewidth=0.6, zorder=0.8)
    if panel.on_percent:
        axes.set_yticks([0.0, 0.5, 1.0])


def _scale(axes: Axes, panel: Panel, peak: float) -> None:
    """Set the axis, alike for different gaits.

    The impact of the heel lasts a few milliseconds and would flatten all else: a peak
    above the panel's ceiling is given in words.
    """
    low, high = axes.get_ylim()
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
    blue = partial(Line2D, [], [], color=style.MODEL)
    handles: list[Artist] = [
        Patch(facecolor=style.HUMAN, alpha=0.35, label=SOURCE),
        Patch(facecolor=style.EMG, alpha=0.6, label=EMG_SOURCE),
    ]
    if strides.enough:
        handles = [
            blue(linewidth=1.6, label="left leg ± 1 sd"),
            Line2D([], [], color=style.OTHER_LEG, linewidth=1.1, label="right leg"),
            blue(linewidth=0.9, linestyle=":", label="left toe-off"),
            *handles,
        ]
    above = ((0.978, title, style.TITLE), (0.953, subtitle(strides), style.TEXT))
    for top, text, look in above:
        line = figure.text(0.012, top, text, va="top", **look)
        style.fit(line, 0.976 * SIZE_IN[0])
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


ACCURACY = {"deg": 3.0, "bw": 0.05}  # of the published tables, by a curve's unit


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
    """The distance of each of `OF_PEOPLE`; none where the strides are too few for a mean."""
    if not strides.enough:
        return {}
    found = {}
    for name, panel in OF_PEOPLE.items():
        people, sd = panel.at(PERCENT)
        difference = strides.mean(name) - people
        scaled = difference / np.maximum(sd, ACCURACY[name.rpartition("_")[2]])
        found[name] = Distance(rmse=_rms(difference), deviations=_rms(scaled))
    return found


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
