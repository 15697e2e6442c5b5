"""Figure: experiments in rows, arms in columns; the darker, the more runs with a walker."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from study.experiment.arms import BEST_ARM, PAPER_ARM
from study.palette import FRONT
from study.pictures import style
from study.report.appearance import label_of
from study.report.axes import headline, save
from study.report.numbers import ArmNumbers, Numbers
from study.report.overview import arms_of
from study.report.words import count_text

CELL_IN = (0.72, 0.46)
LEFT_IN, RIGHT_IN, TOP_IN, BOTTOM_IN = 1.75, 0.95, 1.95, 0.2
SHADES = "Blues"
DARKEST = 0.62  # of the map, so that words on it can be read, in a grey print too
FRONT_OF = {PAPER_ARM: FRONT["paper"], BEST_ARM: FRONT["best"]}


def write_grid(folder: Path, experiments: Sequence[Numbers]) -> list[Path]:
    """Draw overview.png and .svg.

    Args:
        folder: where to.
        experiments: their figures, one row each.
    """
    arms = arms_of(experiments)
    wide = CELL_IN[0] * len(arms) + LEFT_IN + RIGHT_IN
    high = CELL_IN[1] * len(experiments) + TOP_IN + BOTTOM_IN
    figure = style.new_figure(max(wide, 6.0), high)
    wide = figure.get_figwidth()
    axes = figure.add_axes(
        (
            LEFT_IN / wide,
            BOTTOM_IN / high,
            CELL_IN[0] * len(arms) / wide,
            CELL_IN[1] * len(experiments) / high,
        )
    )
    shares = np.full((len(experiments), len(arms)), np.nan)
    for row, experiment in enumerate(experiments):
        for arm in experiment.arms:
            column = arms.index(arm.arm)
            shares[row, column] = arm.share.value
            _write_cell(axes, row, column, arm, best=arm is experiment.arms[0])
    axes.imshow(shares, cmap=SHADES, vmin=0.0, vmax=1.0 / DARKEST, aspect="auto")
    _frame(axes, [experiment.experiment for experiment in experiments], arms)
    remark = "above: runs with a walker; below: median trial of the first; bold: first of its row"
    headline(figure, 0.15, "Walkers found", remark)
    return save(figure, folder, "overview")


def _write_cell(axes: Axes, row: int, column: int, arm: ArmNumbers, best: bool) -> None:
    words = f"{arm.share.value:.0%}".replace("%", " %")
    axes.text(
        column, row, f"{words}\n{count_text(arm.first_walker.value, arm.trials)}",
        ha="center", va="center", fontsize=style.SMALL_PT, linespacing=1.15,
        color=style.INK, fontweight="bold" if best else "normal",
    )  # fmt: skip


def _frame(axes: Axes, experiments: list[str], arms: list[str]) -> None:
    axes.set_xticks(range(len(arms)), [label_of(arm) for arm in arms])
    axes.set_yticks(range(len(experiments)), experiments)
    axes.xaxis.tick_top()
    axes.tick_params(length=0, labelsize=style.TEXT_PT, colors=style.INK, pad=4)
    for label, arm in zip(axes.get_xticklabels(), arms, strict=True):
        label.set(rotation=40, ha="left", va="bottom", rotation_mode="anchor")
        if arm in FRONT_OF:
            label.set(color=FRONT_OF[arm], fontweight="bold")
    for side in axes.spines.values():
        side.set_visible(False)
    axes.set_xticks(np.arange(len(arms) + 1) - 0.5, minor=True)
    axes.set_yticks(np.arange(len(experiments) + 1) - 0.5, minor=True)
    axes.grid(which="minor", color="white", linewidth=2.0)
    axes.tick_params(which="minor", length=0)
