"""Writes a report, or the overview of several, into its folder: the words, and figures.

They are best cost against trials, a dot a run at its first walker and, of two goals, the
front. An arm has its
colour and marker in every figure, apart for colour-blind readers; three arms stand in
front. In a grey print width and marker show the lines in front, and the label at its
end names every line.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, LogLocator, NullLocator
from numpy.typing import ArrayLike, NDArray

from storage.commit import commit_json, commit_text, together
from study.experiment.arms import ARMS, OUR_ARM, PAPER_ARM
from study.experiment.objective import FRONT
from study.pictures import style
from study.report.markdown import (
    condensed_table,
    count_text,
    overview_text,
    report_text,
)
from study.report.numbers import (
    Interval,
    Numbers,
    best_peer,
    by_rank,
    curve,
    label_of,
    median,
    numbers,
)
from study.report.runs import ArmRuns, Results

Floats = NDArray[np.float64]

REPORT_NAME = "report"


def write_report(results: Results, stores: Mapping[str, Path]) -> Numbers:
    """Write report.md, summary.json and the figures of one experiment, all of them or none.

    They go to `report` in the experiment's own folder; `stores` as `saw` takes them.

    Raises:
        InputError: the folder cannot be written.
    """
    found = numbers(results)
    document = {
        "complete": results.complete,
        "trials_found": results.found,
        "trials_planned": results.planned,
        "cost": results.cost,
        **found.as_dict(),
    }
    with together(results.folder / REPORT_NAME) as new:
        write_best_cost(new / "best-cost.png", results)
        write_first_walker(new / "first-walker.png", results)
        if results.goals:
            write_front(new / "front.png", results)
        commit_json(new / "summary.json", document)
        commit_text(new / "report.md", report_text(results, found, stores))
    return found


def write_overview(folder: Path, experiments: Sequence[Numbers]) -> None:
    """Write overview.md and overview.json of several experiments, both or none.

    Raises:
        InputError: the folder cannot be written.
    """
    parts = [
        f"## {each.experiment}\n\n{condensed_table(each)}\n" for each in experiments
    ]
    text = "\n".join(
        [f"# {len(experiments)} experiments\n", overview_text(experiments), *parts]
    )
    with together(folder) as new:
        document = {"experiments": [each.as_dict() for each in experiments]}
        commit_json(new / "overview.json", document)
        commit_text(new / "overview.md", text)


# Of an arm in every figure: the paper's and ours have a colour of their own, the others
# follow.
COLOURS = {PAPER_ARM: style.BLUE, OUR_ARM: style.VERMILION}
DASHES: tuple[Any, ...] = ("solid", (0, (4, 2)), (0, (1, 1.5)))
MARKERS = "osD^vPX<>ph*dH8"


@dataclass(frozen=True)
class Look:
    """How one arm is drawn.

    Attributes:
        label: of the arm, for readers.
        colour: of the line.
        dash: of the line, in Matplotlib's form.
        marker: in Matplotlib's form.
        front: whether it is one of the three in front, which have a band.
    """

    label: str
    colour: str
    dash: Any
    marker: str
    front: bool

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
    """The look of each arm, in the order given; the same whichever arms stand beside it.

    Of all `ARMS` each has a colour of its own.
    """
    front = {PAPER_ARM, OUR_ARM, best_peer(arms.values())}
    others = [name for name in (*ARMS, *arms) if name not in COLOURS]
    found: dict[str, Look] = {}
    for arm in arms:
        place = others.index(arm) if arm in others else 0
        colour = COLOURS.get(arm, style.OTHERS[place % len(style.OTHERS)])
        dash = DASHES[0 if arm in COLOURS else 1 + place % 2]
        marker = MARKERS[
            list(COLOURS).index(arm) if arm in COLOURS else place % len(MARKERS)
        ]
        found[arm] = Look(label_of(arm), colour, dash, marker, front=arm in front)
    return found


LABEL_SPACING_PT = 10.0
POINTS_AN_INCH = 72.0
LABEL_OFFSET_PT = 27.0
MARGIN_IN = 0.1  # right of a title
TICKS = (1, 3, 10, 30, 100, 300, 1000)


def trial_axis(axes: Axes, trials: int) -> None:
    """A logarithmic axis of trials from 1: the first ten matter most."""
    axes.set_xscale("log")
    axes.set_xlim(1.0 / 1.06, trials * 1.04)
    axes.xaxis.set_major_locator(FixedLocator(trial_ticks(trials)))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set_xlabel("trials", fontsize=style.TEXT_PT, color=style.INK)


def log_costs(axes: Axes) -> None:
    """A logarithmic axis of costs, all above zero."""
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_locator(NullLocator())


def headline(figure: Figure, left_in: float, title: str, remark: str) -> None:
    """A title, and below it a line on how to read the figure."""
    wide, high = figure.get_figwidth(), figure.get_figheight()
    for text, down_in, size in (
        (title, 0.24, style.TITLE_PT),
        (remark, 0.45, style.SMALL_PT),
    ):
        line = figure.text(
            left_in / wide,
            1.0 - down_in / high,
            text,
            fontsize=size,
            color=style.INK,
            va="center",
        )
        style.fit(line, wide - left_in - MARGIN_IN)


def trial_ticks(trials: int) -> list[float]:
    """1, 3, 10, ..., and the last trial, less those too near to it."""
    return [float(tick) for tick in TICKS if tick * 1.3 < trials] + [float(trials)]


def marked(trials: int, place: int) -> list[int]:
    """Trials, from 0, at which a line has its marker: spread on the axis, apart for each arm."""
    spread = np.geomspace(1.0, trials, 6) * 1.13 ** (place % 4)
    return sorted({round(float(at)) - 1 for at in spread if at <= trials})


def label_ends(axes: Axes, ends: Sequence[tuple[float, Look]], x: float) -> None:
    """Write the labels right of the lines that end at `x`, moved apart where they would overlap.

    The ends are ascending; of equal ones the later is written above.
    """
    axes.figure.canvas.draw()
    point = axes.figure.dpi / POINTS_AN_INCH
    pixels = np.array([axes.transData.transform((x, y))[1] for y, _ in ends])
    low, high = axes.get_window_extent().intervaly
    places = spread_out(np.clip(pixels, low, high), LABEL_SPACING_PT * point, low, high)
    for (y, look), own, place in zip(ends, pixels, places, strict=True):
        axes.annotate(
            f"{look.label} {y:.3g}",
            xy=(x, y),
            xytext=(LABEL_OFFSET_PT, (place - own) / point),
            textcoords="offset points",
            va="center",
            fontsize=style.SMALL_PT,
            color=style.INK,
            fontweight="bold" if look.front else "normal",
            annotation_clip=False,
        )
        # the arm's line beside its name, as a key
        height = [(place - low) / (high - low)] * 2
        key = look.line() | {"markevery": [1], "transform": axes.transAxes}
        axes.plot([1.015, 1.04], height, clip_on=False, **key)


def spread_out(
    places: Sequence[float], apart: float, low: float, high: float
) -> list[float]:
    """Ascending places, moved as little as needed to be `apart`; within [low, high] if they fit.

    Places that push each other form a group about the mean of their own places.
    """
    from scipy.optimize import isotonic_regression  # 0.3 s

    steps = apart * np.arange(len(places))
    spread = isotonic_regression(np.asarray(places) - steps).x + steps
    high = max(high, low + steps[-1])
    spread = np.minimum(np.maximum(spread, low + steps), high - steps[::-1])
    return [float(place) for place in spread]


PANEL_IN = 5.6
LABELS_IN = 2.3
LEFT_IN = 0.75
HEIGHT_IN = 4.6  # of up to 20 arms: more labels need more
MARGINS_IN = 1.3
WALKS_BELOW = 100.0  # the walking cost of a walker that goes on to the end
IN_FRONT = "bold: the paper's method, our best, the best peer; bands: 95 %, by bootstrap over runs"


def write_best_cost(path: Path, results: Results) -> Path:
    """Best cost so far against trials, median over runs; the arms in front have bands."""
    # Room for a label an arm on the right, at a fixed size whatever the labels.
    labels_in = len(results.arms) * LABEL_SPACING_PT / POINTS_AN_INCH
    height_in = max(HEIGHT_IN, MARGINS_IN + labels_in)
    figure = style.new_figure(LEFT_IN + PANEL_IN + LABELS_IN, height_in)
    axes = style.axes_at(figure, LEFT_IN, 0.5, PANEL_IN, height_in - MARGINS_IN)
    style.tidy(axes)
    trial_axis(axes, results.trials)
    area = ": minus the area dominated" if results.cost == FRONT else ""
    label = f"best {results.cost} cost so far{area}"
    axes.set_ylabel(label, fontsize=style.TEXT_PT, color=style.INK)
    is_walking = results.cost == "walking"
    if (
        not is_walking
        and min(float(arm.best.min()) for arm in results.arms.values()) > 0.0
    ):
        log_costs(axes)
    elif is_walking:
        axes.set_ylim(0.0, 315.0)
        axes.axhline(
            WALKS_BELOW, color=style.INK, linewidth=0.8, linestyle="--", zorder=2.0
        )
        axes.annotate(
            "below: walks to the end",
            xy=(0.0, WALKS_BELOW),
            xycoords=("axes fraction", "data"),
            xytext=(4, -2),
            textcoords="offset points",
            va="top",
            fontsize=style.SMALL_PT,
            color=style.INK,
            zorder=2.0,
        )
    # Worst first; of lines that end at one place, the best label is lowest.
    styles, order, last = looks(results.arms), by_rank(results.arms), dict[str, float]()
    for arm in sorted(order[::-1], key=lambda name: styles[name].front):
        values, low, high = curve(results.arms[arm].best)
        look, rank = styles[arm], order.index(arm)
        trials = np.arange(1, len(values) + 1)
        axes.plot(trials, values, markevery=marked(len(values), rank), **look.line())
        if look.front:
            axes.fill_between(
                trials, low, high, color=look.colour, alpha=0.15, linewidth=0
            )
        last[arm] = float(values[-1])
    ends = [(last[arm], styles[arm]) for arm in sorted(order, key=last.__getitem__)]
    label_ends(axes, ends, results.trials)
    title = f"Best {results.cost} cost so far, median over runs"
    headline(figure, LEFT_IN, title, f"{results.name}; {IN_FRONT}")
    return style.save_png(figure, path)


PLACES = 200  # of a front, at most


def write_front(path: Path, results: Results) -> Path:
    """Both costs of walks: what half of an arm's runs reach, each with its front."""
    figure = style.new_figure(LEFT_IN + PANEL_IN + LABELS_IN, HEIGHT_IN)
    axes = style.axes_at(figure, LEFT_IN, 0.5, PANEL_IN, HEIGHT_IN - MARGINS_IN)
    style.tidy(axes)
    styles = looks(results.arms)
    for name in by_rank(results.arms):
        look = styles[name].line() | {"marker": ""}
        axes.step(
            *median_front(results.arms[name]),
            where="post",
            label=styles[name].label,
            **look,
        )
    across, up = (f"{goal} ({columns})" for goal, columns in results.goals.items())
    # Names are of a configuration: a dollar begins no formula.
    axes.set_xlabel(across, parse_math=False, **style.TEXT)
    axes.set_ylabel(up, parse_math=False, **style.TEXT)
    axes.legend(
        loc="upper left",
        bbox_to_anchor=(1.0, 1.0),
        frameon=False,
        fontsize=style.SMALL_PT,
    )
    title = "What half of the runs reach in both goals: the lower left is best"
    headline(figure, LEFT_IN, title, f"{results.name}, {results.trials} trials")
    return style.save_png(figure, path)


def median_front(arm: ArmRuns) -> tuple[Floats, Floats]:
    """Costs by the first goal, ascending, and what half of the runs reach by the second, [k] each.

    Trials that did not walk do not count.
    """
    assert arm.goals is not None
    first, second = np.where(arm.walks, np.moveaxis(arm.goals, -1, 0), np.inf)
    known = first[np.isfinite(first)]
    if not len(known):
        return known, known
    shares = np.linspace(0.0, 1.0, PLACES)
    across = np.unique(np.quantile(known, shares, method="lower"))
    reached = np.array(
        [
            np.median(np.where(first <= place, second, np.inf).min(axis=1))
            for place in across
        ]
    )
    half = np.isfinite(reached)
    return across[half], reached[half]


ROW_IN = 0.38
WIDTH_IN = 9.0
DOTS_LEFT_IN, DOTS_RIGHT_IN, DOTS_TOP_IN, DOTS_BOTTOM_IN = 1.7, 1.25, 0.85, 0.55

# Along the axis trials go from 0 (the first) to 1 (the last).
FROM, NONE_FROM, TO = -0.08, 1.035, 1.2
MEDIAN_AT, RUNS_AT = TO + 0.065, TO + 0.175
DOT_PT = 3.4
STEP = 0.0115  # between columns of dots
BINS = 62  # dots of one bin would overlap

# Across it a row is 1 high, downward.
PILE = 5  # dots on each other
PITCH = 0.14
DOTS_AT, MEDIAN_BELOW = -0.08, 0.35


def write_first_walker(path: Path, results: Results) -> Path:
    """Dots, median with its interval, runs with a walker: a row an arm, best first."""
    order, styles = by_rank(results.arms), looks(results.arms)
    height = ROW_IN * len(order) + DOTS_TOP_IN + DOTS_BOTTOM_IN
    figure = style.new_figure(WIDTH_IN, height)
    wide, high = WIDTH_IN - DOTS_LEFT_IN - DOTS_RIGHT_IN, ROW_IN * len(order)
    axes = style.axes_at(figure, DOTS_LEFT_IN, DOTS_BOTTOM_IN, wide, high)
    _frame_dots(axes, results.trials, len(order))
    for row, arm in enumerate(order):
        _draw_row(axes, results.trials, row, results.arms[arm], styles[arm])
    title = "Trials to the first walker, a dot a run"
    remark = "diamond: median with its 95 % bootstrap interval; open dots: runs without a walker"
    headline(figure, 0.15, title, f"{results.name}; {remark}")
    return style.save_png(figure, path)


def trial_places(which: ArrayLike, trials: int) -> Floats:
    """Where trials, counted from 1, lie on a logarithmic axis of so many, from 0 to 1, [n]."""
    return np.asarray(np.log(which) / np.log(max(trials, 2)))


def piles(places: Floats) -> tuple[Floats, Floats]:
    """Places of dots, apart: in columns of `PILE` about their places on the axis, [n], ascending.

    Returns x on the axis and y in rows, each [n].
    """
    x, y = places.copy(), np.empty(len(places))
    bins = np.round(places * BINS).astype(int)
    for number in np.unique(bins):
        inside = np.flatnonzero(bins == number)
        columns = -(-len(inside) // PILE)
        tall = -(-len(inside) // columns)
        index = np.arange(len(inside))
        y[inside] = DOTS_AT + PITCH * (index % tall - 0.5 * (tall - 1))
        if columns > 1:
            x[inside] = places[inside].mean() + STEP * (
                index // tall - 0.5 * (columns - 1)
            )
    return x, y


def _draw_row(axes: Axes, trials: int, row: int, arm: ArmRuns, look: Look) -> None:
    """The dots of an arm, with its label, median and count."""
    found = np.sort(arm.first_walker[np.isfinite(arm.first_walker)])
    x, y = piles(trial_places(found, trials))
    axes.plot(
        x, row + y, "o", ms=DOT_PT, color=look.colour, markeredgewidth=0.0, zorder=3
    )
    # of runs without a walker: dots in columns
    index = np.arange(len(arm.runs) - len(found))
    step = min(STEP, (TO - NONE_FROM - 2.0 * STEP) / max(-(-len(index) // PILE), 1))
    right = NONE_FROM + STEP + step * (index // PILE)
    down = row + DOTS_AT + PITCH * (index % PILE - 0.5 * (PILE - 1))
    axes.plot(
        right,
        down,
        "o",
        ms=DOT_PT - 0.6,
        markerfacecolor="none",
        markeredgecolor=look.colour,
        markeredgewidth=0.7,
        zorder=3,
    )
    interval = median(arm.first_walker)
    _draw_median(axes, trials, row, interval)
    weight = "bold" if look.front else "normal"
    for place, words, side in (
        (FROM - 0.02, look.label, "right"),
        (MEDIAN_AT, count_text(interval.value, arm.trials), "center"),
        (RUNS_AT, f"{len(found)}/{len(arm.runs)}", "center"),
    ):
        axes.text(
            place,
            row,
            words,
            ha=side,
            va="center",
            fontsize=style.TEXT_PT,
            color=style.INK,
            fontweight=weight,
        )


def _draw_median(axes: Axes, trials: int, row: int, interval: Interval) -> None:
    """Below the dots; with an arrow if the interval has no upper end, none without a lower end."""
    if not np.isfinite(interval.low):
        return
    y, closed = row + MEDIAN_BELOW, bool(np.isfinite(interval.high))
    low, middle, high = trial_places(
        [interval.low, interval.value, interval.high], trials
    )
    high = high if closed else NONE_FROM - 0.01
    axes.plot(
        [low, high],
        [y, y],
        color=style.INK,
        linewidth=1.1,
        zorder=4,
        solid_capstyle="butt",
    )
    axes.plot([low], [y], "|", color=style.INK, ms=4, zorder=4)
    axes.plot(
        [high],
        [y],
        "|" if closed else ">",
        color=style.INK,
        ms=4 if closed else 3,
        zorder=4,
    )
    if np.isfinite(interval.value):
        axes.plot([middle], [y], "D", color=style.INK, ms=4, zorder=5)


def _frame_dots(axes: Axes, trials: int, rows: int) -> None:
    style.tidy(axes)
    axes.grid(axis="y", visible=False)
    axes.set(xlim=(FROM, TO), ylim=(rows - 0.5, -0.5))
    ticks = trial_ticks(trials)
    none = 0.5 * (NONE_FROM + TO)
    axes.xaxis.set_major_locator(FixedLocator([*trial_places(ticks, trials), none]))
    axes.set_xticklabels([*(f"{tick:g}" for tick in ticks), "none"])
    axes.yaxis.set_major_locator(NullLocator())
    axes.spines["left"].set_visible(False)
    axes.axvspan(NONE_FROM, TO, color=style.GRID, alpha=0.55, linewidth=0, zorder=1)
    for row in range(1, rows):
        axes.axhline(row - 0.5, color=style.GRID, linewidth=0.6, zorder=1)
    axes.set_xlabel(
        "trials to the first walker", fontsize=style.TEXT_PT, color=style.INK
    )
    for place, words in ((MEDIAN_AT, "median"), (RUNS_AT, "runs")):
        axes.text(
            place,
            -0.6,
            words,
            ha="center",
            va="bottom",
            fontsize=style.SMALL_PT,
            color=style.INK,
        )
