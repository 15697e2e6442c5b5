"""Strips of stick figures over the ground they walk on, to scale; one or several walks."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from numpy.typing import NDArray

from study.pictures import stick_figure as stick
from study.pictures import style
from taichi_nmm.result import Trajectory
from taichi_nmm.terrain import Terrain

Array = NDArray[np.float64]

SHOWN_M = 6.6
POSE_SPACING_M = 0.66  # not a whole number of steps: the poses run through the stride
GHOST_INTERVAL_S = 0.04
MARGIN_M = 0.7
COMPARED_M = SHOWN_M + 2.0 * MARGIN_M  # width of the strips of several walks
NARROWEST_M = 4.0
ABOVE_HIP_M = 0.95
BELOW_GROUND_M = 0.16
SCALE_IN_PER_M = 1.12
LEFT_IN, RIGHT_IN, TITLE_IN, AXIS_IN, PROFILE_IN = 0.75, 1.0, 0.35, 0.45, 0.7
GAP_IN = 0.15  # beside and below what is drawn
COLOURS = (style.VERMILION, style.BLUE)  # of two walks
KEY = f"Left leg in front. Thin: left leg every {1e3 * GHOST_INTERVAL_S:.0f} ms. Blue: hip."
DEVICE_KEY = " Green: an exoskeleton; arrows: its torque, half a turn at 80 N m."
FOOT_KEY = " Dark green: a prosthesis."
# What comes once: its words, its colour, and the edge beside which these stand.
EVENTS = {
    "push": ("push of {:g} N {}", style.BLACK, "top"),
    "slip": ("slip, friction {:g}", style.VERMILION, "bottom"),
}
GROUND_LAYER = 100.0  # over the soles: half the drawn width of a foot is below them
BEYOND_M = 1.0  # of ground, in the profile, ahead of where the walker came to
LEVEL_M = 0.01  # ground that varies by less is level


class AxesSurface:
    """Takes the shapes of a walker on axes whose limits are set, alike in both directions."""

    def __init__(self, axes: Axes, layer: float) -> None:
        """The first shape lies on this layer, and the later ones less than one above it."""
        self._axes, self._layer = axes, layer
        pixels = axes.transData.transform([(0.0, 0.0), (1.0, 0.0)])
        self._points_per_m = float(np.ptp(pixels[:, 0]) * 72.0 / axes.figure.dpi)

    def _next_layer(self) -> float:
        self._layer += 0.1
        return self._layer

    def bones(self, parts: Sequence[stick.Bone], colour: str) -> None:
        """Thick lines with round ends."""
        drawn = LineCollection(
            [np.array([start, end]) for start, end, _ in parts],
            colors=colour,
            capstyle="round",
            linewidths=[self._points_per_m * width_m for *_, width_m in parts],
            zorder=self._next_layer(),
        )
        self._axes.add_collection(drawn, autolim=False)

    def muscles(self, outlines: Sequence[Array], activation: Array, edge: str) -> None:
        """Filled outlines [k, 2], coloured by activation, with a hair line round each."""
        drawn = PolyCollection(
            outlines,
            facecolors=stick.COLOURS(activation),
            edgecolors=edge,
            linewidths=0.4,
            zorder=self._next_layer(),
        )
        self._axes.add_collection(drawn, autolim=False)

    def disc(self, centre_m: Array, radius_m: float, colour: str) -> None:
        """A filled circle."""
        x, z = centre_m
        layer = self._next_layer()
        circle = Circle((x, z), radius_m, facecolor=colour, zorder=layer)
        self._axes.add_patch(circle)

    def joints(self, points_m: Array) -> None:
        """Small dots [k, 2]."""
        self._axes.plot(
            *points_m.T, "o", color=style.INK, ms=2.0, zorder=self._next_layer()
        )


@dataclass(frozen=True, eq=False)
class Shown:
    """A walk as it was simulated for a picture.

    Attributes:
        label: a word for it, such as "before".
        title: which walk it is, and how it ended.
        trajectory: of about 50 samples a second or more.
    """

    label: str
    title: str
    trajectory: Trajectory


class Frame(NamedTuple):
    """Limits of a picture, m."""

    left: float
    right: float
    bottom: float
    top: float


class Event(NamedTuple):
    """A push or a slip in a walk.

    Attributes:
        time_s: when it began.
        end_s: when it ended, with the walk at the latest.
        push_n: forwards; 0 of a slip.
        words: what came, and when.
        colour: of its marks.
        edge: of the picture, beside which its words stand.
    """

    time_s: float
    end_s: float
    push_n: float
    words: str
    colour: str
    edge: str


def events_of(walk: Trajectory) -> list[Event]:
    """What began before the walk ended."""
    found = []
    for name, (words, colour, edge) in EVENTS.items():
        time_s, lasts_s, size = getattr(walk, name).tolist()
        if lasts_s > 0.0 and time_s < walk.time_s[-1]:
            way = "forwards" if size > 0.0 else "backwards"
            event = Event(
                time_s=time_s,
                end_s=min(time_s + lasts_s, walk.time_s[-1]),
                push_n=size if name == "push" else 0.0,
                words=f"{words.format(abs(size), way)}, {time_s:.2f} s",
                colour=colour,
                edge=edge,
            )
            found.append(event)
    return found


@dataclass(frozen=True, eq=False)
class Stretch:
    """The last metres of a walk, as they are drawn.

    Attributes:
        shown: the walk.
        colour: of its hip and its marks.
        terrain: the ground below.
        trajectory: the whole walk, as far as its pose is finite.
        poses_s: times of the poses, [n].
        frame: what the picture shows.
    """

    shown: Shown
    colour: str
    terrain: Terrain
    trajectory: Trajectory
    poses_s: Array
    frame: Frame

    @property
    def wide_in(self) -> float:
        """Width of the picture, inches."""
        return (self.frame.right - self.frame.left) * SCALE_IN_PER_M

    @property
    def high_in(self) -> float:
        """Height of the picture, inches."""
        return (self.frame.top - self.frame.bottom) * SCALE_IN_PER_M

    def draw(self, axes: Axes) -> None:
        """Draw poses, ghosts and ground to the frame."""
        style.tidy(axes)
        axes.grid(False)
        left, right, bottom, top = self.frame
        # Before the bones, which are as wide as the scale has it.
        axes.set(xlim=(left, right), ylim=(bottom, top))
        walk = self.trajectory
        walker = stick.Walker(
            stick.at_times(walk, walk.q, self.poses_s),
            stick.at_times(walk, walk.activation, self.poses_s),
            stick.device_at(walk, self.poses_s),
            walk.prosthesis.tolist(),
        )
        for number in range(len(self.poses_s)):
            walker.draw(AxesSurface(axes, layer=3.0 + number), number)
        times_s = np.arange(self.poses_s[0], self.poses_s[-1], GHOST_INTERVAL_S)
        if len(times_s):  # the left leg and the hip's path, as in a chronophotograph
            near = stick.leg(stick.at_times(walk, walk.q, times_s), stick.LEFT)
            lines = np.stack([near.hip, near.knee, near.ankle, near.ball], axis=1)
            thin = LineCollection(
                list(lines), colors=style.FAINT, linewidths=0.4, alpha=0.55, zorder=1.5
            )
            axes.add_collection(thin, autolim=False)
            axes.plot(*near.hip.T, color=self.colour, linewidth=0.8, zorder=1.6)
        x = np.linspace(left, right, 2000)
        _draw_ground(axes, x, self.terrain.height(x), bottom)
        words = [self.shown.title]
        for event in events_of(walk):
            if event.time_s < self.poses_s[0]:
                words.append(f"Before: {event.words}.")
            else:
                self._draw_event(axes, event)
        title = axes.set_title(" ".join(words), loc="left", **style.TEXT)
        style.fit(title, axes.get_window_extent().width / axes.figure.dpi)
        axes.set_xlabel("distance (m)", **style.TEXT)
        axes.set_ylabel("height (m)", **style.TEXT)

    def _draw_event(self, axes: Axes, event: Event) -> None:
        """Where it began and how far it lasted; of a push, an arrow to where it hit."""
        walk, colour = self.trajectory, event.colour
        q = stick.at_times(walk, walk.q, np.linspace(event.time_s, event.end_s, 50))
        x, layer = q[:, 0], GROUND_LAYER + 1.0
        ground = self.terrain.height(x)
        axes.plot(x, ground, color=colour, linewidth=3.0, zorder=layer)
        axes.axvline(x[0], color=colour, linewidth=0.8, linestyle=":", zorder=2.0)
        axes.text(
            x[0],
            float(event.edge == "top"),
            f" {event.words} ",
            transform=axes.get_xaxis_transform(),
            ha="left" if 2.0 * x[0] < self.frame.left + self.frame.right else "right",
            va=event.edge,
            fontsize=style.SMALL_PT,
            color=colour,
            zorder=layer,
        )
        ((tail, tip),) = stick.push_arrows(q[:1], np.array([event.push_n]))
        if event.push_n:
            look = {
                "arrowstyle": "-|>",
                "color": colour,
                "linewidth": 2.0,
                "shrinkB": 0,
            }
            axes.annotate("", tip, tail, arrowprops=look, zorder=layer)


def last_stretch(
    shown: Shown,
    terrain: Terrain,
    colour: str,
    width_m: float | None = None,
    shown_m: float = SHOWN_M,
) -> Stretch:
    """The last metres of the hip's way; poses are about `POSE_SPACING_M` apart, evenly.

    Args:
        shown: a walk of at least one finite sample.
        terrain: the ground it walked on.
        colour: of its hip.
        width_m: of the frame; None: as wide as the poses.
        shown_m: how many metres.
    """
    trajectory = stick.finite(shown.trajectory)
    way = np.abs(trajectory.q[-1, 0] - trajectory.q[:, 0])  # still to come
    first = max(np.flatnonzero(way > shown_m), default=0)
    count = max(round(way[first] / POSE_SPACING_M), 1) + 1
    poses_s = np.linspace(trajectory.time_s[first], trajectory.time_s[-1], count)
    for event in events_of(trajectory):  # the pose that is nearest shows its instant
        nearest = np.abs(poses_s - event.time_s).argmin()
        if 0 < nearest < count - 1:
            poses_s[nearest] = event.time_s
    x, z, *_ = stick.at_times(trajectory, trajectory.q, poses_s).T
    width = width_m or max(np.ptp(x) + 2.0 * MARGIN_M, NARROWEST_M)
    left = 0.5 * (x.min() + x.max() - width)
    ground = terrain.height(np.linspace(left, left + width, 200))
    frame = Frame(
        left=left,
        right=left + width,
        bottom=ground.min() - BELOW_GROUND_M,
        top=z.max() + ABOVE_HIP_M,
    )
    return Stretch(
        shown=shown,
        colour=colour,
        terrain=terrain,
        trajectory=trajectory,
        poses_s=poses_s,
        frame=frame,
    )


def write_strip(
    path: str | Path,
    trajectory: Trajectory,
    terrain: Terrain,
    title: str = "",
    dpi: int = style.PNG_DPI,
) -> Path:
    """Draw the last metres of a walk as poses at their places, muscles coloured by activation.

    Below, where the ground is not level, its profile from the first sample on. A walker
    that fell is shown falling.

    Args:
        path: of the PNG.
        trajectory: of at least one sample; about 50 samples a second or more.
        terrain: the ground it walked on.
        title: one line, such as the name of the gait and how it ended.
        dpi: pixels an inch; half of them take half the time.

    Raises:
        InputError: the file cannot be written.
    """
    worn = np.nan_to_num(trajectory.device_torque_nm).any()
    title_of_key = KEY + DEVICE_KEY if worn else KEY
    if trajectory.prosthesis.any():
        title_of_key += FOOT_KEY
    shown = Shown(label="", title=title_of_key, trajectory=trajectory)
    figure = strips_figure([shown], terrain, title, dpi)
    return style.save_png(figure, path)


def strips_figure(
    walks: Sequence[Shown], terrain: Terrain, title: str, dpi: int = style.PNG_DPI
) -> Figure:
    """Walks on one ground below each other; then, where it is not level, the ground's profile."""
    if len(walks) > 1:
        coloured = zip(walks, COLOURS, strict=True)
        parts = [
            last_stretch(walk, terrain, colour, COMPARED_M) for walk, colour in coloured
        ]
    else:
        parts = [last_stretch(walks[0], terrain, style.MODEL)]
    starts_m = [part.trajectory.q[:, 0].min() for part in parts]
    ends_m = [part.trajectory.q[:, 0].max() + BEYOND_M for part in parts]
    ground = terrain.height(np.linspace(min(starts_m), max(ends_m), 4000))
    with_profile = np.ptp(ground) > LEVEL_M
    strips_in = sum(part.high_in for part in parts)
    wide_in = parts[0].wide_in
    width = LEFT_IN + wide_in + RIGHT_IN
    height = TITLE_IN + strips_in + len(parts) * (TITLE_IN + AXIS_IN)
    if with_profile:
        height += PROFILE_IN + AXIS_IN + 0.1
    figure = style.new_figure(width, height, dpi)
    _head(figure, title)
    top = height - TITLE_IN
    for part in parts:
        bottom = top - (TITLE_IN + part.high_in)
        part.draw(style.axes_at(figure, LEFT_IN, bottom, wide_in, part.high_in))
        top = bottom - AXIS_IN
    first_in = parts[0].high_in
    bar_bottom = height - 2.0 * TITLE_IN - first_in
    bar = style.axes_at(figure, width - 0.85, bar_bottom, 0.13, min(1.6, first_in))
    stick.activation_bar(bar)
    if with_profile:
        axes = style.axes_at(figure, LEFT_IN, AXIS_IN, wide_in, PROFILE_IN)
        _draw_profile(axes, parts)
    return figure


def _head(figure: Figure, title: str) -> None:
    """The title of a figure: one line, as wide as the figure at most."""
    width, height = figure.get_size_inches()
    place = (LEFT_IN / width, 1.0 - 0.2 / height)
    style.fit(
        figure.text(*place, title, va="center", **style.TITLE), width - LEFT_IN - GAP_IN
    )


PANEL_M = 2.6  # of a walk, of many that are drawn side by side
PANEL_SCALE = 0.62  # of the scale of a strip
PANELS_ABREAST = 3
PANELS_DPI = 120  # many walks in a picture of a megabyte and less


def gallery_figure(walks: Sequence[tuple[Shown, Terrain]], title: str) -> Figure:
    """The last metres of many walks, each on its ground, `PANELS_ABREAST` in a row."""
    width_m = PANEL_M + 2.0 * MARGIN_M
    parts = [
        last_stretch(shown, terrain, style.MODEL, width_m, shown_m=PANEL_M)
        for shown, terrain in walks
    ]
    wide_in = PANEL_SCALE * parts[0].wide_in
    high_m = max(part.frame.top - part.frame.bottom for part in parts)
    high_in = PANEL_SCALE * SCALE_IN_PER_M * high_m
    abreast = min(PANELS_ABREAST, len(parts))
    rows = -(-len(parts) // abreast)
    width = LEFT_IN + abreast * (wide_in + GAP_IN) - GAP_IN + RIGHT_IN
    height = TITLE_IN + rows * (TITLE_IN + high_in) + GAP_IN
    figure = style.new_figure(width, height, PANELS_DPI)
    _head(figure, title)
    for number, part in enumerate(parts):
        row, column = divmod(number, abreast)
        left = LEFT_IN + column * (wide_in + GAP_IN)
        bottom = height - TITLE_IN - (row + 1) * (TITLE_IN + high_in)
        axes = style.axes_at(figure, left, bottom, wide_in, high_in)
        frame = part.frame._replace(top=part.frame.bottom + high_m)
        replace(part, frame=frame).draw(axes)
        axes.set(xlabel="", xticks=[])
        if column:
            axes.set(ylabel="", yticks=[])
    bar_bottom = height - 2.0 * TITLE_IN - high_in
    bar = style.axes_at(figure, width - 0.85, bar_bottom, 0.13, min(1.6, high_in))
    stick.activation_bar(bar)
    return figure


def _draw_profile(axes: Axes, parts: Sequence[Stretch]) -> None:
    """The ground as far as walks on it came, small, with the stretches marked in their colours."""
    low = min(min(part.trajectory.q[0, 0], part.frame.left) for part in parts)
    high = max(
        max(part.trajectory.q[:, 0].max() + BEYOND_M, part.frame.right)
        for part in parts
    )
    x = np.linspace(low, high, 4000)
    height = parts[0].terrain.height(x)
    margin = 0.1 * max(float(np.ptp(height)), 0.5)
    bottom = height.min() - margin
    style.tidy(axes)
    _draw_ground(axes, x, height, bottom)
    axes.set(xlim=(low, high), ylim=(bottom, height.max() + margin))
    axes.set_xlabel("from the start: distance (m)", **style.TEXT)
    axes.text(
        0.005,
        0.97,
        "ground (m)",
        transform=axes.transAxes,
        va="top",
        **style.SMALL,
        zorder=GROUND_LAYER + 1.0,
    )
    for part in parts:
        left, right, *_ = part.frame
        axes.axvspan(left, right, color=part.colour, alpha=0.25, linewidth=0, zorder=3)
        axes.annotate(
            part.shown.label,
            xy=(np.mean([left, right]), 1.0),
            xytext=(0, 2),
            xycoords=("data", "axes fraction"),
            textcoords="offset points",
            ha="center",
            fontsize=style.SMALL_PT,
            color=part.colour,
        )


def _draw_ground(axes: Axes, x_m: Array, height_m: Array, bottom_m: float) -> None:
    """The ground's profile, filled down to `bottom_m`."""
    axes.fill_between(
        x_m, height_m, bottom_m, color=style.GROUND, linewidth=0, zorder=GROUND_LAYER
    )
    axes.plot(x_m, height_m, color=style.INK, linewidth=1.0, zorder=GROUND_LAYER)
