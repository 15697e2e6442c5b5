"""How figures of a report look: arms by colour, dash and marker; trial axes; labels; PNG and SVG.

Colour shows the kind of an arm, marker and dash the arm; three arms stand in front. In a grey print
width and dash show the lines in front, and the label at its end names every line.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from storage.commit import commit
from study.experiment.arms import OUR_ARM, PAPER_ARM
from study.pictures import style
from study.report.numbers import best_peer, kind_of, label_of
from study.report.runs import ArmRuns

# Of arms: three in front, by their role; all others by their kind, their labels in a darker shade.
FRONT = {"paper": style.BLUE, "best": style.VERMILION, "peer": style.BLACK}
FRONT_DASH: dict[str, Any] = {"paper": (0, (6, 1.6)), "best": "solid", "peer": (0, (2.2, 1.4))}
BACK = {"ours": "#6F9FC6", "peer": style.FAINT, "control": "#C69250"}
BACK_TEXT = {"ours": "#35658C", "peer": "#5A616A", "control": "#85591C"}
BACK_DASH: dict[str, Any] = {"ours": "solid", "peer": (0, (4, 2)), "control": (0, (1, 1.5))}
MARKERS = "osD^vPX<>ph*dH8"


@dataclass(frozen=True)
class Look:
    """How one arm is drawn."""

    label: str
    colour: str  # of the line
    text: str  # colour of the label
    dash: Any  # in Matplotlib's form, and so is the marker
    marker: str
    front: bool  # whether it is one of the three in front, with a band

    def line(self) -> dict[str, Any]:
        """Keyword arguments of `Axes.plot`."""
        return {
            "color": self.colour,
            "linestyle": self.dash,
            "linewidth": 2.0 if self.front else 1.0,
            "marker": self.marker,
            "markersize": 5.0 if self.front else 3.2,
            "markeredgewidth": 0.0,
            "zorder": 4.0 if self.front else 3.0,
        }


def looks(arms: Mapping[str, ArmRuns]) -> dict[str, Look]:
    """The look of each arm, in the order given."""
    front = {PAPER_ARM: "paper", OUR_ARM: "best", best_peer(arms.values()): "peer"}
    found: dict[str, Look] = {}
    members = dict.fromkeys(BACK, 0)  # arms of a kind so far: each has another marker
    for arm in arms:
        role, kind = front.get(arm), kind_of(arm)
        if role is not None:
            drawn = FRONT[role], FRONT[role], FRONT_DASH[role]
        else:
            drawn = BACK[kind], BACK_TEXT[kind], BACK_DASH[kind]
        marker = MARKERS[members[kind] % len(MARKERS)]
        found[arm] = Look(label_of(arm), *drawn, marker, front=role is not None)
        members[kind] += 1
    return found


LABEL_SPACING_PT = 10.0
POINTS_AN_INCH = 72.0
LABEL_OFFSET_PT = 16.0
TICKS = (1, 3, 10, 30, 100, 300, 1000)
SVG: dict[Any, Any] = {"svg.hashsalt": "taichi-nmm", "svg.fonttype": "path"}  # the same file again


@dataclass(frozen=True)
class End:
    """The end of a line, and its label."""

    y: float
    look: Look  # of the arm
    text: str
    rank: int  # of lines that end at one place, the higher is written above


def trial_axis(axes: Axes, trials: int) -> None:
    """A logarithmic axis of trials from 1: the first ten matter most."""
    axes.set_xscale("log")
    axes.set_xlim(1.0 / 1.06, trials * 1.04)
    axes.xaxis.set_major_locator(FixedLocator(trial_ticks(trials)))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.set_xlabel("trials", fontsize=style.TEXT_PT, color=style.INK)


def headline(figure: Figure, left_in: float, title: str, remark: str) -> None:
    """A title, and below it a line on how to read the figure."""
    wide, high = figure.get_figwidth(), figure.get_figheight()
    for text, down_in, size in ((title, 0.24, style.TITLE_PT), (remark, 0.45, style.SMALL_PT)):
        figure.text(
            left_in / wide, 1.0 - down_in / high, text, fontsize=size, color=style.INK, va="center"
        )


def trial_ticks(trials: int) -> list[float]:
    """1, 3, 10, ..., and the last trial, less those too near to it."""
    return [float(tick) for tick in TICKS if tick * 1.3 < trials] + [float(trials)]


def marked(trials: int, place: int) -> list[int]:
    """Trials, from 0, at which a line has its marker: spread on the axis, apart for each arm."""
    spread = np.geomspace(1.0, trials, 6) * 1.13 ** (place % 4)
    return sorted({round(float(at)) - 1 for at in spread if at <= trials})


def label_ends(axes: Axes, ends: Sequence[End], x: float) -> None:
    """Write the labels right of the lines that end at `x`, moved apart where they would overlap."""
    figure = axes.get_figure(root=True)
    assert figure is not None
    figure.canvas.draw()
    point = figure.dpi / POINTS_AN_INCH
    ends = sorted(ends, key=lambda end: (end.y, end.rank))
    pixels = np.array([axes.transData.transform((x, end.y))[1] for end in ends])
    low, high = axes.get_window_extent().y0, axes.get_window_extent().y1
    places = spread_out(np.clip(pixels, low, high), LABEL_SPACING_PT * point, low, high)
    for end, own, place in zip(ends, pixels, places, strict=True):
        axes.annotate(
            end.text,
            xy=(x, end.y),
            xytext=(LABEL_OFFSET_PT, (place - own) / point),
            textcoords="offset points",
            fontsize=style.SMALL_PT,
            fontweight="bold" if end.look.front else "normal",
            color=end.look.text,
            va="center",
            annotation_clip=False,
            arrowprops={
                "arrowstyle": "-", "color": end.look.colour, "linewidth": 0.6,
                "shrinkA": 0.0, "shrinkB": 2.0, "relpos": (0.0, 0.5),
            },
        )  # fmt: skip


def spread_out(places: Sequence[float], apart: float, low: float, high: float) -> list[float]:
    """Ascending places, moved as little as needed to be `apart`; within [low, high] if they fit.

    Places that push each other form a group about the mean of their own places.
    """
    if not len(places):
        return []
    from scipy.optimize import isotonic_regression  # 0.3 s

    steps = apart * np.arange(len(places))
    spread = isotonic_regression(np.asarray(places) - steps).x + steps
    high = max(high, low + steps[-1])
    spread = np.minimum(np.maximum(spread, low + steps), high - steps[::-1])
    return [float(place) for place in spread]


def save(figure: Figure, folder: Path, name: str) -> list[Path]:
    """Write the figure as NAME.png and NAME.svg, each whole or not at all."""
    png, svg = folder / f"{name}.png", folder / f"{name}.svg"

    def write(temporary: Path) -> None:
        with mpl.rc_context(SVG):
            figure.savefig(temporary, format="svg", metadata={"Date": None})

    def check(temporary: Path) -> None:
        if not temporary.read_text(encoding="utf-8").rstrip().endswith("</svg>"):
            raise OSError("the picture was not written whole")

    style.save_png(figure, png)
    commit(svg, write, check)
    return [png, svg]
