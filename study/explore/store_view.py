"""A store on the page: a cloud of its rows, histograms, a selection and a table.

The selection is a text, "column low..high, column low..high". The page's script
(scripts/brush.mjs) reads the same text, and so needs no server while a person drags a
box.
"""

import html
import io
import re
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import matplotlib
import numpy as np
import pyarrow as pa
import pyarrow.parquet
from bokeh import models
from bokeh.layouts import column
from bokeh.models.text import PlainText
from bokeh.models.tools import BoxSelectTool, PanTool, ResetTool, WheelZoomTool
from bokeh.plotting import figure
from numpy.typing import NDArray

from storage.function_simulator import ENDED
from storage.inputs.errors import InputError, listed
from storage.simulator import FAILED, SURVIVED, WALKER
from storage.store import ORIGIN, SOBOL_ROW, Store, evaluated_name
from study.explore.server import SCRIPTS, Message, flow
from study.explore.trials import STATE, TRIAL
from study.explore.words import described, menu
from study.pictures import style
from taichi_nmm.result import ENERGY, NEEDED_BY, OF_MUSCLES, unknown

RANGE = re.compile(r"\s*(\w+)\s+(\S+?)\.\.(\S+)\s*")

Floats = NDArray[np.float64]
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
            raise InputError(
                "selection", part.strip(), "column low..high, column low..high, ..."
            )
        name, low, high = match.groups()
        if name not in columns:
            raise InputError("selection", name, f"one of {listed(columns, name)}")
        try:
            found[name] = (float(low), float(high))
        except ValueError:
            raise InputError(
                "selection", f"{low}..{high}", "a number at each end"
            ) from None
    return found


def selected(
    ranges: Ranges, column: Callable[[str], Floats], rows: int
) -> NDArray[np.bool_]:
    """Which rows lie within all ranges, ends included, [n]; a row with NaN there does not."""
    inside = np.ones(rows, dtype=bool)
    for name, (low, high) in ranges.items():
        values = column(name)
        inside &= (values >= low) & (values <= high)
    return inside


def numbers_of(store: Store, name: str) -> Floats:
    """The numbers of a column, [n]; NaN: unknown, as a gait's that made no step."""
    if store.simulator != WALKER:
        return _numbers_of_others(store, name)
    needed = NEEDED_BY.get(name)
    if needed is None or needed not in store.columns:
        return np.asarray(store.table([name])[name].to_numpy(), dtype=np.float64)
    both = store.numpy([*{name, needed}])
    return np.where(unknown(name, both), np.nan, both[name])


def _numbers_of_others(store: Store, name: str) -> Floats:
    """Of another simulator: NaN where a run failed, or where a family did not run the row.

    Files have zeros there, which would be the best of all that is to be small.
    """
    values = np.asarray(store.table([name])[name].to_numpy(), dtype=np.float64)
    own = [family for family in store.families if name.startswith(f"{family}_")]
    flags = [evaluated_name(family) for family in own]
    if name in flags or name in (Store.ROW, SURVIVED, *store.gain_names):
        return values
    if flags:
        return np.where(store.numpy(flags)[flags[0]], values, np.nan)
    if ENDED not in store.columns:
        return values
    return np.where(store.numpy([ENDED])[ENDED] == FAILED, np.nan, values)


def file_of_selection(store: Store, ranges: Ranges) -> tuple[str, bytes]:
    """Name and content of a Parquet file: all columns of the selected rows of a store."""
    table = store.table()
    chosen = selected(ranges, partial(numbers_of, store), len(table))
    content = io.BytesIO()
    pyarrow.parquet.write_table(
        table.filter(pa.array(chosen)), content, compression="zstd"
    )
    return "selection.parquet", content.getvalue()


ROLES = ("across", "up", "colour", "besides", "also besides")  # of the five columns
CLOUD_PX = (600, 440)  # the height lasts, with the axes; the width is that of the page
HISTOGRAM_PX = 105
BINS = 40
BESIDES = "#D8DCE0"  # of bars
CHOSEN_PX, POINTED_PX = (
    17,
    11,
)  # rings about the row that walks and the row under the pointer


def cloud() -> tuple[Any, models.ColumnDataSource, models.ColumnDataSource]:
    """A figure to drag a box over, its one image, which the script paints, and two rings."""
    box = BoxSelectTool(renderers=[])
    plot = figure(
        name="cloud",
        height=CLOUD_PX[1],
        sizing_mode="stretch_width",
        title=" ",
        tools=[PanTool(), WheelZoomTool(), ResetTool(), box],
        active_drag=box,
        x_range=models.Range1d(0.0, 1.0),
        y_range=models.Range1d(0.0, 1.0),
    )
    plot.toolbar.logo = None
    pixels = np.zeros(CLOUD_PX[::-1], np.uint32)
    corners = {"x": [0.0], "y": [0.0], "dw": [1.0], "dh": [1.0]}
    image = models.ColumnDataSource({"image": [pixels], **corners})
    plot.image_rgba("image", "x", "y", "dw", "dh", source=image)
    nowhere = {axis: np.full(2, np.nan) for axis in "xy"}
    rings = models.ColumnDataSource(
        {**nowhere, "size": [CHOSEN_PX, POINTED_PX]}, name="rings"
    )
    for width, colour in ((5, "white"), (2.5, style.VERMILION)):
        plot.scatter(
            "x",
            "y",
            size="size",
            source=rings,
            line_color=colour,
            line_width=width,
            fill_color=None,
        )
    return plot, image, rings


def histograms() -> Iterator[tuple[Any, list[models.ColumnDataSource], models.Span]]:
    """A small figure for each column; its bars, of all rows and of those selected; and a line."""
    for slot in range(len(ROLES)):
        plot = figure(
            name=f"histogram-{slot}",
            height=HISTOGRAM_PX,
            tools="",
            toolbar_location=None,
            title=" ",
            x_range=models.Range1d(0.0, 1.0),
        )
        plot.title.text_font_size = "10px"
        plot.yaxis.visible = False
        plot.xaxis.ticker.desired_num_ticks = 3
        plot.grid.visible = False
        plot.add_tools(BoxSelectTool(renderers=[], dimensions="width"))
        bars = []
        # Those selected are an overlay, which Bokeh paints anew without the axes.
        for colour, level in ((BESIDES, "glyph"), (style.MODEL, "overlay")):
            sides = {name: np.zeros(BINS) for name in ("left", "right", "count")}
            bars.append(models.ColumnDataSource(sides))
            plot.quad(
                left="left",
                right="right",
                bottom=0,
                top="count",
                source=bars[-1],
                fill_color=colour,
                line_color=None,
                level=level,
            )
        span = models.Span(dimension="height", line_color=style.VERMILION, line_width=2)
        span.update(name=f"at-{slot}", level="overlay")
        plot.add_layout(span)
        yield plot, bars, span


def table(
    source: models.ColumnDataSource, row: str, words: list[str]
) -> models.DataTable:
    """The listed rows. A DataTable keeps its first titles, so other columns need a new one."""
    numbers = models.NumberFormatter(format="0.[0000]", nan_format="-")
    columns = [
        models.TableColumn(field="row", title=row, width=60),
        models.TableColumn(field="mark", title="", width=55),
    ]
    columns += [
        models.TableColumn(
            field=f"c{slot}", title=html.escape(name), formatter=numbers
        )  # as HTML
        for slot, name in enumerate(words)
        if name != row  # as of a study's trials
    ]
    return models.DataTable(
        source=source,
        columns=columns,
        height=240,
        sizing_mode="stretch_width",
        index_position=None,
    )


FIRST = (
    "mean_speed_mps",
    "phi_printed",
    "survived_fraction",
    ENERGY,
    "step_length_mean_m",
)
PALETTE = "viridis"
MARKED = {  # by what numbers the rows: the column that decides, its usual word, a word for others
    "row": (ORIGIN, SOBOL_ROW, "bred"),
    TRIAL: (STATE, "complete", "not complete"),
}


def numeric_columns(store: Store) -> list[str]:
    """Names of the columns that can be drawn."""
    schema = next(store.tables()).schema
    drawn = pa.types.is_floating, pa.types.is_integer, pa.types.is_boolean
    return [field.name for field in schema if any(kind(field.type) for kind in drawn)]


def first_columns(store: Store) -> list[str]:
    """The first five columns of a page; the colour is the survival of the first family, if any.

    Of other simulators than the walker: the first numbers after the parameters. Of a
    study: the trial's number, its value, and its attributes.
    """
    survived = [
        name for name in store.columns if name.endswith("_survived_fraction_mean")
    ]
    known = numeric_columns(store)
    energy = (
        ENERGY if ENERGY in known else OF_MUSCLES
    )  # of a store before 0.4: as its words say
    first = [*FIRST[:2], *(survived[:1] or FIRST[2:3]), energy, FIRST[4]]
    if set(first) <= set(known):
        return first
    gains = [
        name for name in store.gain_names if name in known
    ]  # a parameter may be a word
    own = [name for name in known if name != "row" and name not in gains]
    found = [*own[1:3], *(survived or own)[:1], *own[3:], *gains, *known]
    different = list(dict.fromkeys(own + found if store.ROW == TRIAL else found))
    return (different * len(FIRST))[: len(FIRST)]


class StoreView:
    """The panels of a store's points and rows.

    It calls `pick` with the place of a clicked row among the store's rows and with its
    number, and `save` with a selection.
    """

    def __init__(
        self,
        store: Store,
        message: Message,
        pick: Callable[[int, int], None],
        save: Callable[[Ranges], None],
    ) -> None:
        self._store, self._pick = store, pick
        self._rows: NDArray[np.int64] = self._read(store.ROW).astype(np.int64)
        self._words = described(store, numeric_columns(store))
        options = menu(self._words)
        self._columns = [
            models.Select(
                title=role, value=name, options=options, name=f"column-{slot}"
            )
            for slot, (role, name) in enumerate(
                zip(ROLES, first_columns(store), strict=True)
            )
        ]
        find = models.TextInput(
            title="find in the menus", placeholder="hip mean", name="find"
        )
        search = {"columns": self._columns, "options": options}
        find.js_on_change(
            "value_input", models.CustomJS.from_file(SCRIPTS / "find.mjs", **search)
        )
        self._hidden: Ranges = {}  # of columns that are not shown
        deciding, usual, self._mark = MARKED[store.ROW]
        marked = np.zeros(len(store), np.uint8)
        if deciding in store.columns:
            marked[store.table([deciding])[deciding].to_numpy() != usual] = 1
        rows = {
            "row": self._rows,
            "marked": marked,
            "kept": np.ones(len(store), np.uint8),
        }
        self._source = models.ColumnDataSource(rows, name="rows")
        self.selection = models.TextInput(
            title="selection: column low..high, ...",
            placeholder="drag a box",
            name="selection",
        )
        self._refusal = Message("selection-message")
        # without `low` and `high`: the browser would silently replace a wrong number
        self.row = models.Spinner(
            title=f"{store.ROW} shown", step=1, mode="int", name="row"
        )
        self._cloud, self._image, self._rings = cloud()
        self._mapper = models.LinearColorMapper(palette="Viridis256", low=0.0, high=1.0)
        self._bar = models.ColorBar(color_mapper=self._mapper, height=10, padding=4)
        self._cloud.add_layout(self._bar, "below")
        self._histograms, self._bars, self._spans = map(
            list, zip(*histograms(), strict=True)
        )
        fields = ("row", "mark", *(f"c{slot}" for slot in range(len(ROLES))))
        self._listed = models.ColumnDataSource(
            {name: [] for name in fields}, name="listed"
        )
        self._count = models.Div(name="count")
        for slot in range(len(ROLES)):
            self._load(slot)
        self._rows_panel = column(
            self._table(), sizing_mode="stretch_width", name="Rows"
        )
        self._script()
        clear = models.Button(label="all rows")
        clear.on_click(lambda: self.selection.update(value=""))
        take = models.Button(label="selection as Parquet")
        take.on_click(message.safely(lambda: save(self._ranges())))
        points = [
            flow(*self._columns, find, least_px=215),
            self._cloud,
            flow(self.selection, clear, least_px=110),
            self._refusal.layout,
            flow(*self._histograms, least_px=160),
            flow(self._count, self.row, take),
        ]
        self.selection.styles = {"flex": "4 1 260px"}
        panel = column(*points, sizing_mode="stretch_width", name="Points")
        self.panels = [panel, self._rows_panel]
        self._refusal.watch(self.selection, "value", self._check)
        message.watch(self.row, "value", self._picked)
        message.watch(
            self.row, "tags", self._picked
        )  # a click on the row that is shown
        for slot, select in enumerate(self._columns):
            message.watch(select, "value", partial(self._look_at, slot))

    @property
    def _names(self) -> list[str]:
        """Of the five columns."""
        return [select.value for select in self._columns]

    def _table(self) -> models.DataTable:
        words = [self._words[name].words for name in self._names]
        return table(self._listed, self._store.ROW, words)

    def _ranges(self) -> Ranges:
        return read_selection(self.selection.value, list(self._words))

    def _check(self) -> None:
        """Refuse a selection that cannot be read; sieve by columns that the page does not have."""
        self._refusal.tell("")
        ranges: Ranges = {}
        try:
            ranges = self._ranges()
        finally:
            hidden = {
                name: ends for name, ends in ranges.items() if name not in self._names
            }
            if hidden != self._hidden:
                self._hidden = hidden
                kept = selected(hidden, self._read, len(self._rows))
                self._source.data["kept"] = kept.astype(np.uint8)

    def _picked(self) -> None:
        """Hand on the row that was clicked or typed."""
        places = np.flatnonzero(self._rows == self.row.value)
        if not len(places):
            allowed = f"0 to {self._rows.max()}, {self._store.ROW}s of the page"
            raise InputError(self._store.ROW, self.row.value, allowed)
        self._pick(int(places[0]), self.row.value)

    def _look_at(self, slot: int) -> None:
        """Draw another column; the ranges of the old one last."""
        self._load(slot)
        self._rows_panel.children = [self._table()]
        self._refusal.safely(self._check)()

    def _read(self, name: str) -> Floats:
        return numbers_of(self._store, name)

    def _load(self, slot: int) -> None:
        """Put a column into a slot; the script finds its bounds."""
        name = self._columns[slot].value
        words = self._words[name].words
        self._columns[slot].description = f"{name}: {self._words[name].meaning}"
        # A name between dollars would be drawn as TeX.
        self._histograms[slot].title.text = PlainText(words)
        if slot < 2:
            (self._cloud.xaxis, self._cloud.yaxis)[slot].axis_label = PlainText(words)
        if slot == 2:
            self._bar.title = PlainText(words)
        self._source.data[f"c{slot}"] = self._read(
            name
        )  # last: it makes the script paint

    def _script(self) -> None:
        rgba = matplotlib.colormaps[PALETTE](np.arange(256), bytes=True)
        script = models.CustomJS.from_file(
            SCRIPTS / "brush.mjs",
            source=self._source,
            columns=self._columns,
            selection=self.selection,
            image=self._image,
            plot=self._cloud,
            histograms=self._histograms,
            bars=self._bars,
            mapper=self._mapper,
            table=self._listed,
            count=self._count,
            row=self.row,
            rings=self._rings,
            spans=self._spans,
            listing=self._rows_panel,
            mark=self._mark,
            word=self._store.ROW,
            palette=rgba.view("<u4").ravel().tolist(),
        )
        for plot in (self._cloud, *self._histograms):
            plot.js_on_event("selectiongeometry", script)
        for event in ("tap", "mousemove", "mouseleave"):
            self._cloud.js_on_event(event, script)
        self._cloud.js_on_change("inner_width", script)  # it has been laid out
        self.row.js_on_change("value", script)
        self._source.js_on_change("data", script)
        self.selection.js_on_change("value", script)
        self._listed.selected.js_on_change("indices", script)
        for span in (self._cloud.x_range, self._cloud.y_range):
            span.js_on_change("start", script)
            span.js_on_change("end", script)
