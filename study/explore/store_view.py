"""A store on the page: a cloud of its rows, histograms, a selection and a table.

The selection is a text, "column low..high, column low..high". The page's script (scripts/brush.mjs)
reads the same text, and so needs no server while a person drags a box.
"""

import html
import io
import re
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pyarrow as pa
import pyarrow.parquet
from bokeh.layouts import column, row
from bokeh.models import (
    Button,
    ColumnDataSource,
    CustomJS,
    DataTable,
    Div,
    NumberFormatter,
    Range1d,
    Select,
    Spinner,
    TableColumn,
    TextInput,
)
from bokeh.models.text import PlainText
from bokeh.models.tools import BoxSelectTool, PanTool, ResetTool, WheelZoomTool
from bokeh.plotting import figure
from numpy.typing import NDArray

from storage.store import EVOLVED_ROW, ORIGIN, Store, open_store
from study.explore.server import SCRIPTS, Message
from study.pictures import style
from taichi_nmm.errors import InputError

RANGE = re.compile(r"\s*(\w+)\s+(\S+?)\.\.(\S+)\s*")

Ranges = dict[str, tuple[float, float]]


def read_selection(text: str, columns: Sequence[str]) -> Ranges:
    """The ranges of a text, by column; the last one counts where a column is named twice.

    Raises:
        InputError: another form, or another column than these.
    """
    found = {}
    for part in filter(str.strip, text.split(",")):
        match = RANGE.fullmatch(part)
        if match is None:
            raise InputError("selection", part.strip(), "column low..high, column low..high, ...")
        name, *ends = match.groups()
        if name not in columns:
            raise InputError("selection", name, f"one of {', '.join(columns)}")
        found[name] = (_number(ends[0]), _number(ends[1]))
    return found


def selected(
    ranges: Ranges, column: Callable[[str], NDArray[np.float64]], rows: int
) -> NDArray[np.bool_]:
    """Which rows lie within all ranges, ends included, [n]; a row with NaN there does not."""
    inside = np.ones(rows, dtype=bool)
    for name, (low, high) in ranges.items():
        values = column(name)
        inside &= (values >= low) & (values <= high)
    return inside


def selection_text(ranges: Ranges) -> str:
    """The text that reads as these ranges."""
    return ", ".join(f"{name} {low:g}..{high:g}" for name, (low, high) in ranges.items())


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InputError("selection", text, "a number") from None


def file_of_selection(store: Path, ranges: Ranges) -> tuple[str, bytes]:
    """Name and content of a Parquet file: all columns of the selected rows of a store."""
    table = open_store(store, unfinished=True).table()
    chosen = selected(ranges, lambda name: table[name].to_numpy(), len(table))
    content = io.BytesIO()
    pyarrow.parquet.write_table(table.filter(pa.array(chosen)), content, compression="zstd")
    return "selection.parquet", content.getvalue()


ROLES = ("across", "up", "colour", "besides", "besides")  # of the five columns
WIDTH_PX = 700
CLOUD_PX = (600, 330)  # within its axes
HISTOGRAM_PX = (WIDTH_PX // len(ROLES), 105)
BINS = 40
BESIDES = "#D8DCE0"  # of bars


def cloud() -> tuple[Any, ColumnDataSource]:
    """A figure to drag a box over, and its one image, whose pixels the script paints."""
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
    sides = ("left", "right", "all", "chosen")
    for slot in range(len(ROLES)):
        bars = ColumnDataSource({name: np.zeros(BINS) for name in sides})
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


def table(source: ColumnDataSource, names: list[str]) -> DataTable:
    """The listed rows. A DataTable keeps its first titles, so other columns need a new one."""
    numbers = NumberFormatter(format="0.[0000]")
    columns = [TableColumn(field="row", title="row", width=60),
               TableColumn(field="bred", title="", width=40)]  # fmt: skip
    columns += [
        TableColumn(field=f"c{slot}", title=html.escape(name), formatter=numbers)  # as HTML
        for slot, name in enumerate(names)
    ]
    return DataTable(source=source, columns=columns, width=WIDTH_PX, height=180,
                     index_position=None)  # fmt: skip


Floats = NDArray[np.float64]

FIRST = ("mean_speed_mps", "phi_printed", "survived_fraction", "cost_of_transport_jpkgpm",
         "step_length_mean_m")  # fmt: skip
PALETTE = "viridis"
SHOWN_PERCENT = (0.5, 99.5)  # of the numbers of a column, in all views; zoom out to see the rest
MARGIN = 0.02  # around all points, of the axes


def numeric_columns(store: Store) -> list[str]:
    """Names of the columns that can be drawn."""
    schema = next(store.tables()).schema
    drawn = pa.types.is_floating, pa.types.is_integer, pa.types.is_boolean
    return [field.name for field in schema if any(kind(field.type) for kind in drawn)]


def first_columns(store: Store) -> list[str]:
    """The first five columns of a page; the colour is the survival of the first family, if any.

    Of other simulators than the walker: the first numbers after the parameters.
    """
    survived = [name for name in store.columns if name.endswith("_survived_fraction_mean")]
    first = [*FIRST[:2], *(survived[:1] or FIRST[2:3]), *FIRST[3:]]
    known = numeric_columns(store)
    if set(first) <= set(known):
        return first
    own = [name for name in known if name != "row" and name not in store.gain_names]
    found = [*own[1:3], *(survived or own)[:1], *own[3:], *store.gain_names, *known]
    return list(dict.fromkeys(found))[: len(FIRST)]


class StoreView:
    """The left half of a store's page.

    It calls `pick` with the place of a clicked row among the store's rows and with its number, and
    `save` with a selection.
    """

    def __init__(
        self,
        store: Store,
        message: Message,
        pick: Callable[[int, int], None],
        save: Callable[[Ranges], None],
    ) -> None:
        self._store, self._message, self._pick = store, message, pick
        self._rows: NDArray[np.int64] = self._read("row").astype(np.int64)
        names = numeric_columns(store)
        self._columns = [
            Select(title=role, value=name, options=names, width=WIDTH_PX // len(ROLES) - 8,
                   name=f"column-{slot}")
            for slot, (role, name) in enumerate(zip(ROLES, first_columns(store), strict=True))
        ]  # fmt: skip
        evolved = np.zeros(len(store), np.uint8)
        if ORIGIN in store.columns:
            evolved[store.table([ORIGIN])[ORIGIN].to_numpy() == EVOLVED_ROW] = 1
        self._source = ColumnDataSource({"row": self._rows, "evolved": evolved}, name="rows")
        self._bounds = ColumnDataSource({"low": np.zeros(len(ROLES)), "high": np.ones(len(ROLES))})
        self.selection = TextInput(
            title="selection: column low..high, ...; drag a box over any of the views",
            width=WIDTH_PX - 90, name="selection",
        )  # fmt: skip
        # without `low` and `high`: the browser would silently replace a wrong number
        self.row = Spinner(title="row that walks", step=1, mode="int", width=120, name="row")
        self._cloud, self._image = cloud()
        self._histograms, self._bars = histograms()
        fields = ("row", "bred", *(f"c{slot}" for slot in range(len(ROLES))))
        self._listed = ColumnDataSource({name: [] for name in fields}, name="listed")
        self._count = Div(name="count", width=220)
        for slot in range(len(ROLES)):
            self._load(slot)
        self._script()
        clear = Button(label="all rows", width=70)
        clear.on_click(lambda: self.selection.update(value=""))
        take = Button(label="selection as Parquet", width=150)
        take.on_click(message.safely(lambda: save(self._ranges())))
        self._above = [
            row(*self._columns), self._cloud, row(self.selection, clear), row(*self._histograms),
            row(self._count, self.row, take),
        ]  # fmt: skip
        self.layout = column(*self._above, table(self._listed, self._names))
        message.watch(self.selection, "value", self._check)
        message.watch(self.row, "value", self._picked)
        for slot, select in enumerate(self._columns):
            message.watch(select, "value", partial(self._look_at, slot))

    @property
    def _names(self) -> list[str]:
        """Of the five columns."""
        return [select.value for select in self._columns]

    def _ranges(self) -> Ranges:
        return read_selection(self.selection.value, self._names)

    def _check(self) -> None:
        """Refuse a selection that cannot be read."""
        self._message.tell("")
        self._ranges()

    def _picked(self) -> None:
        """Hand on the row that was clicked or typed."""
        places = np.flatnonzero(self._rows == self.row.value)
        if not len(places):
            raise InputError("row", self.row.value, f"0 to {self._rows.max()}, rows of the store")
        self._pick(int(places[0]), self.row.value)

    def _look_at(self, slot: int) -> None:
        """Draw another column; the selection forgets the old one."""
        kept = read_selection(self.selection.value, self._store.columns)
        known = {name: ends for name, ends in kept.items() if name in self._names}
        self.selection.value = selection_text(known)
        self._load(slot)
        self.layout.children = [*self._above, table(self._listed, self._names)]

    def _read(self, name: str) -> Floats:
        return np.asarray(self._store.table([name])[name].to_numpy(), dtype=np.float64)

    def _load(self, slot: int) -> None:
        name = self._columns[slot].value
        values = self._read(name)
        low, high = _ends(values)
        edges = np.linspace(low, high, BINS + 1)
        counts, _ = np.histogram(np.clip(values[np.isfinite(values)], low, high), edges)
        bounds = {key: np.array(ends) for key, ends in self._bounds.data.items()}
        bounds["low"][slot], bounds["high"][slot] = low, high
        self._bounds.data = bounds
        self._bars[slot].data = {
            "left": edges[:-1], "right": edges[1:], "all": counts.astype(np.float64),
            "chosen": np.zeros(BINS),
        }  # fmt: skip
        plot = self._histograms[slot]
        plot.title.text = PlainText(name)  # a name between dollars would be drawn as TeX
        plot.x_range.start, plot.x_range.end = low, high
        if slot < 2:
            axis = (self._cloud.xaxis, self._cloud.yaxis)[slot]
            axis.axis_label = PlainText(name)
            span = (self._cloud.x_range, self._cloud.y_range)[slot]
            margin = MARGIN * (high - low)
            start, end = low - margin, high + margin
            span.update(start=start, end=end, reset_start=start, reset_end=end)
        if slot == 2:
            title = f"colour: {name}, {low:.3g} (dark) to {high:.3g} (light)"
            self._cloud.title.text = PlainText(title)
        self._source.data[f"c{slot}"] = values  # last: it makes the script paint

    def _script(self) -> None:
        rgba = matplotlib.colormaps[PALETTE](np.arange(256), bytes=True)
        script = CustomJS.from_file(
            SCRIPTS / "brush.mjs",
            source=self._source, columns=self._columns, selection=self.selection, image=self._image,
            plot=self._cloud, histograms=self._histograms, bars=self._bars, bounds=self._bounds,
            table=self._listed, count=self._count, row=self.row,
            palette=rgba.view("<u4").ravel().tolist(),
        )  # fmt: skip
        for plot in (self._cloud, *self._histograms):
            plot.js_on_event("selectiongeometry", script)
        self._cloud.js_on_event("tap", script)
        self._cloud.js_on_change("inner_width", script)  # it has been laid out
        self._source.js_on_change("data", script)
        self.selection.js_on_change("value", script)
        self._listed.selected.js_on_change("indices", script)
        for span in (self._cloud.x_range, self._cloud.y_range):
            span.js_on_change("start", script)
            span.js_on_change("end", script)


def _ends(values: Floats) -> tuple[float, float]:
    """Bounds of most numbers: a few outliers would press all others together."""
    finite = values[np.isfinite(values)]
    low, high = map(float, np.percentile(finite, SHOWN_PERCENT)) if len(finite) else (0.0, 1.0)
    return (low, high) if high > low else (low - 0.5, low + 0.5)
