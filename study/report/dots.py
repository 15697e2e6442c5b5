"""Figure: trials to the first walker, a dot a run, and the runs that never found one."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator, NullLocator
from numpy.typing import NDArray

from study.pictures import style
from study.report.appearance import Look, by_rank, looks
from study.report.axes import headline, save, trial_ticks
from study.report.runs import ArmRuns, Results
from study.report.statistics import Interval, median

Floats = NDArray[np.float64]

ROW_IN = 0.38
WIDTH_IN = 9.0
LEFT_IN, RIGHT_IN, TOP_IN, BOTTOM_IN = 1.7, 1.25, 0.85, 0.55

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


def write_first_walker(folder: Path, results: Results) -> list[Path]:
    """A row an arm, best first: dots, median with its interval, runs with a walker.

    Args:
        folder: for first-walker.png and .svg.
        results: of one experiment.
    """
    order, styles = by_rank(results.arms), looks(results.arms)
    height = ROW_IN * len(order) + TOP_IN + BOTTOM_IN
    figure = style.new_figure(WIDTH_IN, height)
    box = (LEFT_IN / WIDTH_IN, BOTTOM_IN / height, 1.0 - (LEFT_IN + RIGHT_IN) / WIDTH_IN,
           1.0 - (TOP_IN + BOTTOM_IN) / height)  # fmt: skip
    axes = figure.add_axes(box)
    scale = Scale(results.trials)
    _frame(axes, scale, len(order))
    for row, arm in enumerate(order):
        _draw_row(axes, scale, row, results.arms[arm], styles[arm])
    title = f"{results.name}: trials to the first walker, a dot a run"
    remark = "diamond: median with its 95 % bootstrap interval; open dots: runs without a walker"
    headline(figure, 0.15, title, remark)
    return save(figure, folder, "first-walker")


class Scale:
    """Places on the axis: trials on a logarithmic scale, from 0 to 1."""

    def __init__(self, trials: int) -> None:
        self.trials = trials

    def place(self, trial: float) -> float:
        """Where a trial lies, counted from 1."""
        return float(np.log(trial) / np.log(max(self.trials, 2)))


def piles(places: Floats) -> tuple[Floats, Floats]:
    """Where dots lie that would lie on each other: in columns of `PILE` about their place.

    Args:
        places: on the axis, [n], ascending.

    Returns:
        x on the axis and y in rows, each [n].
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
            x[inside] = places[inside].mean() + STEP * (index // tall - 0.5 * (columns - 1))
    return x, y


def _draw_row(axes: Axes, scale: Scale, row: int, arm: ArmRuns, look: Look) -> None:
    found = np.sort(arm.first_walker[np.isfinite(arm.first_walker)])
    x, y = piles(np.array([scale.place(trial) for trial in found]))
    axes.plot(x, row + y, "o", ms=DOT_PT, color=look.colour, markeredgewidth=0.0, zorder=3)
    _draw_none(axes, row, len(arm.runs) - len(found), look)
    interval = median(arm.first_walker)
    _draw_median(axes, scale, row, interval)
    middle = f"{interval.value:g}" if np.isfinite(interval.value) else f"> {arm.trials}"
    weight = "bold" if look.front else "normal"
    for place, words, side in (
        (FROM - 0.02, look.label, "right"),
        (MEDIAN_AT, middle, "center"),
        (RUNS_AT, f"{len(found)}/{len(arm.runs)}", "center"),
    ):
        axes.text(place, row, words, ha=side, va="center", fontsize=style.TEXT_PT,
                  color=look.text, fontweight=weight)  # fmt: skip


def _draw_none(axes: Axes, row: int, count: int, look: Look) -> None:
    """Runs without a walker, as open dots in columns."""
    index = np.arange(count)
    columns = int(np.ceil(count / PILE))
    step = min(STEP, (TO - NONE_FROM - 2.0 * STEP) / max(columns, 1))
    x = NONE_FROM + STEP + step * (index // PILE)
    axes.plot(x, row + DOTS_AT + PITCH * (index % PILE - 0.5 * (PILE - 1)), "o", ms=DOT_PT - 0.6,
              markerfacecolor="none", markeredgecolor=look.colour, markeredgewidth=0.7,
              zorder=3)  # fmt: skip


def _draw_median(axes: Axes, scale: Scale, row: int, interval: Interval) -> None:
    """Below the dots; an arrow where the interval has no upper end, nothing where it has none."""
    if not np.isfinite(interval.low):
        return
    y, closed = row + MEDIAN_BELOW, bool(np.isfinite(interval.high))
    low = scale.place(interval.low)
    high = scale.place(interval.high) if closed else NONE_FROM - 0.01
    axes.plot([low, high], [y, y], color=style.INK, linewidth=1.1, zorder=4, solid_capstyle="butt")
    axes.plot([low], [y], "|", color=style.INK, ms=4, zorder=4)
    axes.plot([high], [y], "|" if closed else ">", color=style.INK, ms=4 if closed else 3, zorder=4)
    if np.isfinite(interval.value):
        axes.plot([scale.place(interval.value)], [y], "D", color=style.INK, ms=4, zorder=5)


def _frame(axes: Axes, scale: Scale, rows: int) -> None:
    style.tidy(axes)
    axes.grid(axis="y", visible=False)
    axes.set(xlim=(FROM, TO), ylim=(rows - 0.5, -0.5))
    ticks = trial_ticks(scale.trials)
    none = 0.5 * (NONE_FROM + TO)
    axes.xaxis.set_major_locator(FixedLocator([*(scale.place(tick) for tick in ticks), none]))
    axes.set_xticklabels([*(f"{tick:g}" for tick in ticks), "none"])
    axes.yaxis.set_major_locator(NullLocator())
    axes.spines["left"].set_visible(False)
    axes.axvspan(NONE_FROM, TO, color=style.GRID, alpha=0.55, linewidth=0, zorder=1)
    for row in range(1, rows):
        axes.axhline(row - 0.5, color=style.GRID, linewidth=0.6, zorder=1)
    axes.set_xlabel("trials to the first walker", fontsize=style.TEXT_PT, color=style.INK)
    for place, words in ((MEDIAN_AT, "median"), (RUNS_AT, "runs")):
        axes.text(place, -0.6, words, ha="center", va="bottom", fontsize=style.SMALL_PT,
                  color=style.INK)  # fmt: skip
