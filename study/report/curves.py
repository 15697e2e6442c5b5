"""Figures against trials: the best cost so far, and the share of runs with a walker."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator, PercentFormatter
from numpy.typing import NDArray

from study.pictures import style
from study.report.appearance import Look, by_rank, looks
from study.report.axes import (
    LABEL_SPACING_PT,
    POINTS_AN_INCH,
    End,
    headline,
    label_ends,
    marked,
    save,
    trial_axis,
)
from study.report.runs import ArmRuns, Results
from study.report.statistics import Curve, Statistic, curve, wilson

Floats = NDArray[np.float64]

PANEL_IN = 3.9
WIDE_PANEL_IN = 5.6
LABELS_IN = 2.3
LEFT_IN = 0.75
HEIGHT_IN = 4.6  # of up to 20 arms: more labels need more
MARGINS_IN = 1.3
STATISTICS: tuple[tuple[str, Statistic], ...] = (
    ("median over runs", np.median),
    ("mean over runs", np.mean),
)
WALKS_BELOW = 100.0  # the walking cost of a walker that goes on to the end
IN_FRONT = "bold: the paper's method, our best, the best peer; their bands are 95 %"


def write_best_cost(folder: Path, results: Results, optimum: float | None) -> list[Path]:
    """Best cost so far against trials, median beside mean, bands of the arms in front.

    Args:
        folder: for best-cost.png and .svg.
        results: of one experiment.
        optimum: the estimated optimum of this cost, drawn as a line.
    """
    figure = style.new_figure(2.0 * (PANEL_IN + LABELS_IN) + LEFT_IN, _height_in(results))
    for panel, (title, statistic) in enumerate(STATISTICS):
        axes = _panel(figure, panel)
        _cost_axis(axes, results, optimum)
        if panel:
            axes.set_ylabel("")
        ends = _draw_arms(axes, results, _best_cost(statistic), "{:.3g}", up=1)
        axes.set_title(title, fontsize=style.TEXT_PT, loc="left", color=style.INK)
        label_ends(axes, ends, results.trials)
    title = f"{results.name}: best {results.cost} cost so far"
    headline(figure, LEFT_IN, title, f"{IN_FRONT} bootstrap bands over runs")
    return save(figure, folder, "best-cost")


def write_walkers(folder: Path, results: Results) -> list[Path]:
    """Share of runs with a walker against trials, with Wilson's intervals, as walkers.png, .svg."""
    figure = style.new_figure(WIDE_PANEL_IN + LABELS_IN + LEFT_IN, _height_in(results))
    axes = _panel(figure, 0, WIDE_PANEL_IN)
    trial_axis(axes, results.trials)
    axes.set_ylim(-0.02, 1.02)
    axes.yaxis.set_major_formatter(PercentFormatter(1.0, symbol=" %"))
    axes.set_ylabel("runs with a walker", fontsize=style.TEXT_PT, color=style.INK)
    ends = _draw_arms(axes, results, _walker_share, "{:.0%}", up=-1)
    label_ends(axes, ends, results.trials)
    title = f"{results.name}: runs that have found a walker"
    headline(figure, LEFT_IN, title, f"{IN_FRONT} Wilson intervals")
    return save(figure, folder, "walkers")


def _best_cost(statistic: Statistic) -> Callable[[ArmRuns], Curve]:
    return lambda arm: curve(arm.best, statistic)


def _walker_share(arm: ArmRuns) -> Curve:
    counts = arm.has_walker.sum(axis=0)
    intervals = [wilson(int(count), len(arm.runs)) for count in counts]
    rows = np.array([[each.value, each.low, each.high] for each in intervals])
    return rows[:, 0], rows[:, 1], rows[:, 2]


def _draw_arms(
    axes: Axes, results: Results, curve_of: Callable[[ArmRuns], Curve], number: str, up: int
) -> list[End]:
    """The line of each arm, worst first, with bands for those in front; their ends.

    Of lines with one end, the best label is lowest (`up` 1) or highest (-1).
    """
    styles, ends = looks(results.arms), []
    order = by_rank(results.arms)
    for arm in sorted(order[::-1], key=lambda name: styles[name].front):
        values, low, high = curve_of(results.arms[arm])
        _draw_line(axes, styles[arm], values, order.index(arm))
        if styles[arm].front:
            trials = np.arange(1, len(values) + 1)
            axes.fill_between(trials, low, high, color=styles[arm].colour, alpha=0.15, linewidth=0)
        text = f"{styles[arm].label} {number.format(values[-1])}".replace("%", " %")
        ends.append(End(float(values[-1]), styles[arm], text, up * order.index(arm)))
    return ends


def _draw_line(axes: Axes, look: Look, values: Floats, place: int) -> None:
    trials = np.arange(1, len(values) + 1)
    axes.plot(trials, values, markevery=marked(len(values), place), **look.line())


def _cost_axis(axes: Axes, results: Results, optimum: float | None) -> None:
    trial_axis(axes, results.trials)
    axes.set_ylabel(f"best {results.cost} cost so far", fontsize=style.TEXT_PT, color=style.INK)
    if results.cost == "smooth":
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.yaxis.set_minor_locator(NullLocator())
    else:
        axes.set_ylim(0.0, 315.0)
        _level(axes, WALKS_BELOW, "below: walks to the end", "--")
    if optimum is not None:
        _level(axes, optimum, f"estimated optimum {optimum:.3g}", (0, (8, 2, 1, 2)))


def _level(axes: Axes, y: float, text: str, dash: Any) -> None:
    axes.axhline(y, color=style.INK, linewidth=0.8, linestyle=dash, zorder=2.0)
    axes.annotate(
        text, xy=(0.0, y), xycoords=("axes fraction", "data"), xytext=(4, -2), va="top",
        textcoords="offset points", fontsize=style.SMALL_PT, color=style.INK, zorder=2.0,
    )  # fmt: skip


def _height_in(results: Results) -> float:
    """High enough for a label an arm."""
    return max(HEIGHT_IN, MARGINS_IN + len(results.arms) * LABEL_SPACING_PT / POINTS_AN_INCH)


def _panel(figure: Figure, number: int, width_in: float = PANEL_IN) -> Axes:
    """Axes with room for labels on their right, at a fixed size whatever the labels."""
    wide, high = figure.get_figwidth(), figure.get_figheight()
    left = LEFT_IN + number * (PANEL_IN + LABELS_IN)
    axes = figure.add_axes((left / wide, 0.5 / high, width_in / wide, (high - MARGINS_IN) / high))
    style.tidy(axes)
    return axes
