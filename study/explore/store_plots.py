"""The figures and the table of a store's page, empty; scripts/brush.mjs fills them."""

from typing import Any

import numpy as np
from bokeh.models import (
    ColumnDataSource,
    DataTable,
    NumberFormatter,
    Range1d,
    TableColumn,
)
from bokeh.models.tools import BoxSelectTool, PanTool, ResetTool, WheelZoomTool
from bokeh.plotting import figure

from study.pictures import style

ROLES = ("across", "up", "colour", "besides", "besides")  # of the five columns
WIDTH_PX = 700
CLOUD_PX = (600, 330)  # within its axes
HISTOGRAM_PX = (WIDTH_PX // len(ROLES), 105)
BINS = 40
BESIDES = "#D8DCE0"  # of bars


def cloud() -> tuple[Any, ColumnDataSource]:
    """A figure that is brushed by a box, and the one image in it, whose pixels are painted."""
    plot = figure(
        name="cloud", width=WIDTH_PX, frame_width=CLOUD_PX[0], frame_height=CLOUD_PX[1],
        tools=[PanTool(), WheelZoomTool(), ResetTool()],
        x_range=Range1d(0.0, 1.0), y_range=Range1d(0.0, 1.0), title=" ",
    )  # fmt: skip
    box = BoxSelectTool(renderers=[])
    plot.add_tools(box)
    plot.toolbar.active_drag = box
    plot.toolbar.logo = None
    image = ColumnDataSource({
        "image": [np.zeros(CLOUD_PX[::-1], np.uint32)],
        **{name: np.array([0.0]) for name in ("x", "y")},
        **{name: np.array([1.0]) for name in ("dw", "dh")},
    })  # fmt: skip
    plot.image_rgba("image", "x", "y", "dw", "dh", source=image)
    return plot, image


def histograms() -> tuple[list[Any], list[ColumnDataSource]]:
    """A small figure for each column, and its bars: of all rows, and of those selected."""
    plots, sources = [], []
    for slot in range(len(ROLES)):
        bars = ColumnDataSource(
            {name: np.zeros(BINS) for name in ("left", "right", "all", "chosen")}
        )
        plot = figure(
            name=f"histogram-{slot}", width=HISTOGRAM_PX[0], height=HISTOGRAM_PX[1], tools="",
            toolbar_location=None, title=" ", x_range=Range1d(0.0, 1.0),
        )  # fmt: skip
        plot.title.text_font_size = "9px"
        plot.yaxis.visible = False
        plot.xaxis.ticker.desired_num_ticks = 3
        plot.grid.visible = False
        plot.add_tools(BoxSelectTool(renderers=[], dimensions="width"))
        for name, colour in (("all", BESIDES), ("chosen", style.MODEL)):
            plot.quad(left="left", right="right", bottom=0, top=name, source=bars,
                      fill_color=colour, line_color=None)  # fmt: skip
        plots.append(plot)
        sources.append(bars)
    return plots, sources


def parallel() -> tuple[Any, ColumnDataSource]:
    """A figure of an axis for each column, and the lines across them."""
    source = ColumnDataSource({"xs": [], "ys": []}, name="parallel")
    axes = list(range(len(ROLES)))
    plot = figure(
        name="parallel", width=WIDTH_PX, height=150, tools="", toolbar_location=None,
        x_range=Range1d(-0.35, len(ROLES) - 0.65), y_range=Range1d(-0.04, 1.04),
    )  # fmt: skip
    plot.add_tools(BoxSelectTool(renderers=[]))
    plot.xaxis.ticker = axes
    plot.xaxis.major_label_text_font_size = "9px"
    plot.yaxis.visible = False
    plot.grid.visible = False
    plot.multi_line("xs", "ys", source=source, line_color=style.MODEL, line_alpha=0.25)
    plot.segment(axes, 0, axes, 1, line_color=style.INK)
    return plot, source


def table(source: ColumnDataSource, names: list[str]) -> DataTable:
    """The rows that the script lists. For other columns it is made anew: it keeps old titles."""
    numbers = NumberFormatter(format="0.[0000]")
    columns = [TableColumn(field="row", title="row", width=60),
               TableColumn(field="bred", title="", width=40)]  # fmt: skip
    columns += [
        TableColumn(field=f"c{slot}", title=name, formatter=numbers)
        for slot, name in enumerate(names)
    ]
    return DataTable(source=source, columns=columns, width=WIDTH_PX, height=180,
                     index_position=None)  # fmt: skip
