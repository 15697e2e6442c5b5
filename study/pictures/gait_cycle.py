"""One stride of the left leg, mean and spread, beside the published ranges of people."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from study.pictures import human_ranges, style
from study.pictures.human_ranges import EMG_ON_PERCENT, HumanRange
from study.pictures.strides import FEWEST_STRIDES, PERCENT, Strides, left_strides
from study.pictures.window import finite
from taichi_nmm.result import MUSCLES, Trajectory

Array = NDArray[np.float64]

SIZE_IN = (8.8, 9.6)
PANEL_MUSCLES = ("HFL", "GLU", "HAM", "VAS", "GAS", "SOL", "TA")  # from the hip down
MUSCLE_WORDS = {
    "HFL": "hip flexors", "GLU": "gluteus", "HAM": "hamstrings", "VAS": "vasti",
    "GAS": "gastrocnemius", "SOL": "soleus", "TA": "tibialis anterior",
}  # fmt: skip


@dataclass(frozen=True)
class Panel:
    """A quantity over the stride: what it is called, whose range it has, and its smallest axis.

    The axis never reaches beyond `floor` and `ceiling`.
    """

    title: str
    unit: str
    human: HumanRange
    low: float
    high: float
    floor: float = -math.inf
    ceiling: float = math.inf


PANELS: dict[str, Panel] = {
    "hip_flexion_deg": Panel("hip", "flexion + (deg)", human_ranges.HIP_FLEXION_DEG, -30, 45),
    "knee_flexion_deg": Panel("knee", "flexion + (deg)", human_ranges.KNEE_FLEXION_DEG, -5, 75),
    "dorsiflexion_deg": Panel(
        "ankle", "dorsiflexion + (deg)", human_ranges.DORSIFLEXION_DEG, -35, 20
    ),
    "vertical_bw": Panel(
        "ground force, up", "body weights", human_ranges.VERTICAL_FORCE_BW, 0, 1.6, 0.0, 1.6
    ),
    "forward_bw": Panel(
        "ground force, forward +", "body weights", human_ranges.FORWARD_FORCE_BW, -0.4, 0.4
    ),
}


def write_gait_cycle(
    path: str | Path, trajectory: Trajectory, body_weight_n: float, title: str = ""
) -> Path:
    """Draw the strides of the left leg, from heel strike to heel strike, mean +- 1 sd.

    Where the walk has too few whole strides, the picture says so and shows the human ranges alone.

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
    panels = _panels(figure)
    for name, panel in PANELS.items():
        axes = next(panels)
        _draw_human(axes, panel)
        _draw_model(axes, getattr(strides, name), strides)
        _finish(axes, panel.title, panel.unit)
        _scale(axes, panel, getattr(strides, name))
    for muscle in PANEL_MUSCLES:
        axes = next(panels)
        _draw_emg(axes, muscle)
        _draw_model(axes, strides.activation[MUSCLES.index(muscle)], strides)
        _finish(axes, f"{muscle}, {MUSCLE_WORDS[muscle]}", "activation (1)")
        axes.set(ylim=(0.0, 1.05), yticks=[0.0, 0.5, 1.0])
    _caption(figure, strides, title)
    return style.save_png(figure, path)


def _panels(figure: Figure) -> Iterator[Axes]:
    grid = figure.add_gridspec(
        4, 3, left=0.075, right=0.985, top=0.875, bottom=0.055, hspace=0.42, wspace=0.3
    )
    for row in range(4):
        for column in range(3):
            axes = figure.add_subplot(grid[row, column])
            if row == 3:
                axes.set_xlabel("stride (%)", fontsize=style.TEXT_PT, color=style.INK)
            yield axes


def _draw_human(axes: Axes, panel: Panel) -> None:
    mean, sd = panel.human.at(PERCENT)
    axes.fill_between(PERCENT, mean - sd, mean + sd, color=style.HUMAN, alpha=0.35, linewidth=0)
    axes.plot(PERCENT, mean, color=style.FAINT, linewidth=1.0, linestyle="--")


def _draw_emg(axes: Axes, muscle: str) -> None:
    for start, end in EMG_ON_PERCENT[muscle]:
        axes.axvspan(start, end, color=style.EMG, alpha=0.6, linewidth=0, zorder=0.5)


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
    """At least the panel's usual axis, so that pictures of different gaits compare.

    The impact of the heel lasts a few milliseconds and would flatten all else: where the panel has
    a ceiling, what goes beyond it is told in words.
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
    figure.text(0.012, 0.978, title, fontsize=style.TITLE_PT, color=style.INK, va="top")
    figure.text(0.012, 0.953, subtitle(strides), fontsize=style.TEXT_PT, color=style.INK, va="top")
    figure.legend(
        handles=_legend_handles(strides), loc="upper left", bbox_to_anchor=(0.004, 0.94), ncols=4,
        frameon=False, fontsize=style.SMALL_PT, columnspacing=1.4, handlelength=1.8,
    )  # fmt: skip


def subtitle(strides: Strides) -> str:
    """What the curves are made of, or why there are none."""
    if not strides.enough:
        return (
            f"{len(strides)} whole strides after settling: too few for a mean "
            f"({FEWEST_STRIDES} are needed); the human ranges alone are shown."
        )
    return (
        f"Left leg, heel strike to heel strike: {len(strides)} strides of "
        f"{strides.duration_s.mean():.2f} s."
    )


def _legend_handles(strides: Strides) -> list[Line2D | Patch]:
    human: list[Line2D | Patch] = [
        Patch(facecolor=style.HUMAN, alpha=0.35, label=human_ranges.SOURCE),
        Patch(facecolor=style.EMG, alpha=0.6, label=human_ranges.EMG_SOURCE),
    ]
    if not strides.enough:
        return human
    return [
        Line2D([], [], color=style.MODEL, linewidth=1.6, label="model ± 1 sd"),
        Line2D([], [], color=style.MODEL, linewidth=0.9, linestyle=":", label="model toe-off"),
        *human,
    ]
