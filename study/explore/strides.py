"""The mean strides of a walk, of both legs and of all muscles, beside the ranges of people."""

from typing import Any

import numpy as np
from bokeh.layouts import column
from bokeh.models import Column, ColumnDataSource, Div, Span
from bokeh.plotting import figure
from numpy.typing import NDArray

from study.explore.server import flow
from study.explore.walk import Walk
from study.pictures import gait_cycle, style
from study.pictures.gait_cycle import EMG_ON_PERCENT, PANELS, PEOPLE, PERCENT, Strides
from study.pictures.stick_figure import LEFT, RIGHT, finite
from taichi_nmm.result import MUSCLES

Floats = NDArray[np.float64]

HEIGHT_PX, LEAST_PX = 180, 215  # of a panel of the stride
CURVES = (
    "y",
    "low",
    "high",
    "right",
    "beside",
)  # y is the left leg's, low and high one sd from it
NO_CURVE = np.full(len(PERCENT), np.nan)


class Cycle:
    """A small figure for each joint, each ground force and each muscle."""

    def __init__(self) -> None:
        self._words = Div(text="", name="cycle", sizing_mode="stretch_width")
        self._panels: dict[str, tuple[Any, ColumnDataSource, Span]] = {}
        muscles = PEOPLE["muscles"]
        for name in (*PANELS, *muscles):
            panel = PANELS.get(name)
            title = panel.title if panel else f"{name}, {muscles[name]}"
            plot = figure(
                name=f"cycle-{title}",
                height=HEIGHT_PX,
                tools="",
                toolbar_location=None,
                title=title,
                x_axis_label="stride (%)",
                x_range=(0, 100),
                y_axis_label=panel.unit if panel else "activation (1)",
                y_range=(panel.low, panel.high) if panel else (0.0, 1.05),
            )
            if panel:
                mean, sd = panel.at(PERCENT)
                plot.varea(
                    PERCENT,
                    mean - sd,
                    mean + sd,
                    fill_color=style.HUMAN,
                    fill_alpha=0.35,
                )
                plot.line(PERCENT, mean, line_color=style.FAINT, line_dash="dashed")
            else:
                starts, ends = zip(*EMG_ON_PERCENT[name], strict=True)
                plot.quad(
                    starts,
                    ends,
                    1.05,
                    0.0,
                    fill_color=style.EMG,
                    fill_alpha=0.6,
                    line_color=None,
                )
            empty = dict.fromkeys(CURVES, NO_CURVE)
            source = ColumnDataSource({"x": PERCENT, **empty}, name=f"cycle-{name}")
            plot.varea(
                "x",
                "low",
                "high",
                source=source,
                fill_color=style.MODEL,
                fill_alpha=0.3,
            )
            plot.line("x", "right", source=source, line_color=style.OTHER_LEG)
            plot.line(
                "x", "beside", source=source, line_color=style.BLACK, line_dash="dashed"
            )
            plot.line("x", "y", source=source, line_color=style.MODEL, line_width=2)
            toe_off = Span(
                dimension="height", line_color=style.MODEL, line_dash="dotted"
            )
            plot.add_layout(toe_off)
            plot.title.text_font_size = "11px"
            self._panels[name] = plot, source, toe_off
        figures = flow(
            *(plot for plot, _, _ in self._panels.values()), least_px=LEAST_PX
        )
        self.layout: Column = column(self._words, figures, sizing_mode="stretch_width")

    def show(self, walk: Walk, other: Walk | None) -> None:
        """The mean strides of a walk, if it has enough; of another walk, those of the left leg."""
        left, right = (_strides(walk, side) for side in (LEFT, RIGHT))
        beside = None if other is None else _strides(other, LEFT)
        offs = left.take_off_percent
        for name, (_, source, toe_off) in self._panels.items():
            mean, sd = _mean(left, name)
            means = (_mean(strides, name)[0] for strides in (right, beside))
            curves = zip(CURVES, (mean, mean - sd, mean + sd, *means), strict=True)
            source.data = {"x": PERCENT, **dict(curves)}
            toe_off.location = float(offs.mean()) if left.enough and len(offs) else None
        self._words.text = (
            f"{gait_cycle.subtitle(left)} Blue: left leg, 1 sd and toe-off (dotted); orange: right "
            f"leg; black, dashed: the gait beside it. Grey: {gait_cycle.SOURCE}, number: RMSE; "
            f"sand: {gait_cycle.EMG_SOURCE}."
        )
        distances = gait_cycle.human_distances(left)
        for name, panel in PANELS.items():
            plot, source, _ = self._panels[name]
            title = panel.title.removeprefix("ground ")
            if far := distances.get(name):
                unit = "deg" if name.endswith("deg") else "bw"
                title += f": {far.rmse:.3g} {unit}, {far.deviations:.2g} sd"
            seen = np.concatenate([source.data[curve] for curve in CURVES])
            highest = float(np.nanmax([*seen, panel.low]))
            if highest > panel.ceiling:
                title += f"; cut at {panel.ceiling:g}: to {highest:.1f}"
            plot.title.text = title
            plot.y_range.start = float(max(np.nanmin([*seen, panel.low]), panel.floor))
            plot.y_range.end = float(min(np.nanmax([*seen, panel.high]), panel.ceiling))


def _strides(walk: Walk, side: int) -> Strides:
    return gait_cycle.strides_of(
        finite(walk.trajectory), walk.experiment.weight_n(walk.run), side
    )


def _mean(strides: Strides | None, name: str) -> tuple[Floats, Floats]:
    """Mean and standard deviation of a panel's curve, by the panel's name or that of a muscle."""
    if strides is None or not strides.enough:
        return NO_CURVE, NO_CURVE
    muscle = name in MUSCLES
    curves = (
        strides.activation[MUSCLES.index(name)] if muscle else getattr(strides, name)
    )
    return curves.mean(axis=0), curves.std(axis=0)
