"""The mean strides of a walk, of both legs and of all muscles, beside the ranges of people."""

from typing import Any, NamedTuple

import numpy as np
from bokeh.layouts import column
from bokeh.models import Column, ColumnDataSource, Div, Span
from bokeh.plotting import figure

from study.explore.server import flow
from study.explore.walk import Walk
from study.pictures import gait_cycle, style
from study.pictures.gait_cycle import PANELS, PERCENT, Panel, Strides
from study.pictures.stick_figure import LEFT, RIGHT, finite

HEIGHT_PX, LEAST_PX = 180, 215  # of a panel of the stride
# Of a source: `y` is the left leg's mean, `low` and `high` are one sd from it.
CURVES = ("y", "low", "high", "right", "beside")
NO_CURVE = np.full(len(PERCENT), np.nan)


class Plot(NamedTuple):
    """A panel on the page.

    Attributes:
        figure: with the panel's axes and the range of people.
        source: of `CURVES`, over the stride.
        toe_off: a line where the left foot leaves the ground.
    """

    figure: Any
    source: ColumnDataSource
    toe_off: Span


class Cycle:
    """A small figure for each joint, each ground force and each muscle."""

    def __init__(self) -> None:
        self._words = Div(text="", name="cycle", sizing_mode="stretch_width")
        self.plots = {name: _plot(name, panel) for name, panel in PANELS.items()}
        figures = flow(
            *(plot.figure for plot in self.plots.values()), least_px=LEAST_PX
        )
        self.layout: Column = column(self._words, figures, sizing_mode="stretch_width")

    def show(self, walk: Walk, other: Walk | None) -> None:
        """The mean strides of a walk, if it has enough; of another walk, those of the left leg."""
        left, right = _strides(walk, LEFT), _strides(walk, RIGHT)
        beside = None if other is None else _strides(other, LEFT)
        self._words.text = (
            f"{gait_cycle.subtitle(left)} Blue: left leg, 1 sd and toe-off (dotted); orange: right "
            f"leg; black, dashed: the gait beside it. Grey: {gait_cycle.SOURCE}, number: RMSE; "
            f"sand: {gait_cycle.EMG_SOURCE}."
        )
        distances = gait_cycle.human_distances(left)
        for name, panel in PANELS.items():
            plot = self.plots[name]
            low, high = left.band(name)
            curves = {
                "y": left.mean(name),
                "low": low,
                "high": high,
                "right": right.mean(name),
                "beside": beside.mean(name) if beside else NO_CURVE,
            }
            plot.source.data = {"x": PERCENT, **curves}
            plot.toe_off.location = left.toe_off_percent
            title = panel.title.removeprefix("ground ")
            if far := distances.get(name):
                unit = name.rpartition("_")[2]
                title += f": {far.rmse:.2g} {unit}, {far.deviations:.2g} sd"
            seen = np.concatenate([*curves.values()])
            plot.figure.title.text = title
            plot.figure.y_range.start = np.nanmin([*seen, panel.low])
            plot.figure.y_range.end = np.nanmax([*seen, panel.high])


def _plot(name: str, panel: Panel) -> Plot:
    """A panel with the range of people, and with lines that `Cycle.show` moves."""
    plot = figure(
        name=f"cycle-{panel.title}",
        height=HEIGHT_PX,
        tools="",
        toolbar_location=None,
        title=panel.title,
        x_axis_label="stride (%)",
        x_range=(0, 100),
        y_axis_label=panel.unit,
        y_range=(panel.low, panel.high),
    )
    plot.title.update(text_font_size="11px", align="right")  # where it has most room
    if panel.rows:
        mean, sd = panel.at(PERCENT)
        plot.varea(
            PERCENT, mean - sd, mean + sd, fill_color=style.HUMAN, fill_alpha=0.35
        )
        plot.line(PERCENT, mean, line_color=style.FAINT, line_dash="dashed")
    if panel.on_percent:
        starts, ends = np.transpose(panel.on_percent).tolist()
        plot.quad(
            starts,
            ends,
            panel.ceiling,
            panel.floor,
            fill_color=style.EMG,
            fill_alpha=0.6,
            line_color=None,
        )
    empty = dict.fromkeys(CURVES, NO_CURVE)
    source = ColumnDataSource({"x": PERCENT, **empty}, name=f"cycle-{name}")
    plot.varea(
        "x", "low", "high", source=source, fill_color=style.MODEL, fill_alpha=0.3
    )
    looks: dict[str, dict[str, Any]] = {
        "right": {"line_color": style.OTHER_LEG},
        "beside": {"line_color": style.BLACK, "line_dash": "dashed"},
        "y": {"line_color": style.MODEL, "line_width": 2},
    }
    for curve, look in looks.items():
        plot.line("x", curve, source=source, **look)
    toe_off = Span(dimension="height", line_color=style.MODEL, line_dash="dotted")
    plot.add_layout(toe_off)
    return Plot(figure=plot, source=source, toe_off=toe_off)


def _strides(walk: Walk, side: int) -> Strides:
    return gait_cycle.strides_of(
        finite(walk.trajectory), walk.experiment.weight_n(walk.run), side
    )
