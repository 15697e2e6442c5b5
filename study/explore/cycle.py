"""The mean stride beside the published ranges of people, with the distance of each curve."""

import numpy as np
from bokeh.layouts import column, row
from bokeh.models import Column, ColumnDataSource, Div
from bokeh.plotting import figure

from study.explore.walk import Walk
from study.pictures import style
from study.pictures.gait_cycle import PANELS, subtitle
from study.pictures.human_distance import human_distances
from study.pictures.human_ranges import SOURCE
from study.pictures.strides import PERCENT, left_strides
from study.pictures.window import finite

SIZE_PX = (232, 170)
COLUMNS = 3
FULL = "deg"  # of a name: an angle


class Cycle:
    """A small figure for each joint and each ground force."""

    def __init__(self) -> None:
        """The ranges of people alone."""
        self._words = Div(text="", name="cycle", width=SIZE_PX[0] * COLUMNS)
        self._curves: dict[str, ColumnDataSource] = {}
        self._figures = {}
        for name, panel in PANELS.items():
            plot = figure(
                name=f"cycle-{panel.title}", width=SIZE_PX[0], height=SIZE_PX[1], tools="",
                toolbar_location=None, title=panel.title, y_axis_label=panel.unit,
                x_range=(0, 100), y_range=(panel.low, panel.high),
            )  # fmt: skip
            mean, sd = panel.human.at(PERCENT)
            plot.varea(PERCENT, mean - sd, mean + sd, fill_color=style.HUMAN, fill_alpha=0.35)
            plot.line(PERCENT, mean, line_color=style.FAINT, line_dash="dashed")
            empty = np.full(len(PERCENT), np.nan)
            source = ColumnDataSource({"x": PERCENT, "y": empty}, name=f"cycle-{name}")
            plot.line("x", "y", source=source, line_color=style.MODEL, line_width=2)
            plot.title.text_font_size = "10px"
            self._curves[name], self._figures[name] = source, plot
        plots = list(self._figures.values())
        self.layout: Column = column(self._words, row(*plots[:COLUMNS]), row(*plots[COLUMNS:]))

    def show(self, walk: Walk) -> None:
        """The mean stride of a walk, if it has enough of them."""
        strides = left_strides(finite(walk.trajectory), walk.weight_n)
        distances = human_distances(strides)
        self._words.text = f"{subtitle(strides)} Grey: {SOURCE}. Numbers: RMSE."
        for name, panel in PANELS.items():
            curves = getattr(strides, name)
            mean = curves.mean(axis=0) if strides.enough else np.full(len(PERCENT), np.nan)
            self._curves[name].data = {"x": PERCENT, "y": mean}
            title = panel.title.removeprefix("ground ")
            if name in distances:
                unit = "deg" if name.endswith(FULL) else "bw"
                far = distances[name]
                title += f": {far.rmse:.3g} {unit}, {far.deviations:.2g} sd"
            self._figures[name].title.text = title
