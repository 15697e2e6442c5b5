"""A store on the page: a cloud of its rows, histograms, a selection and a table.

The selection is a text, "column low..high, column low..high". The page's script
(scripts/brush.mjs) reads the same text, and so needs no server while a person drags a
box.
"""

import html
import io
import re
from collections.abc import Callable, Sequence
from functools import partial
from itertools import cycle, islice
from typing import Any

import matplotlib
import numpy as np
import pyarrow as pa
import pyarrow.parquet
from bokeh.models import (
    BoxSelectTool,
    ColorBar,
    Column,
    ColumnDataSource,
    CustomJS,
    DataTable,
    Div,
    LinearColorMapper,
    NumberFormatter,
    Select,
    Span,
    Spinner,
    TableColumn,
    TextInput,
)
from bokeh.models.text import PlainText
from bokeh.plotting import figure
from numpy.typing import NDArray

from storage.function_simulator import ENDED
from storage.inputs.errors import InputError, listed
from storage.simulator import FAILED, SURVIVED, WALKER
from storage.store import ORIGIN, SOBOL_ROW, Store, evaluated_name
from study.explore.server import SCRIPTS, Message, flow
from study.explore.trials import STATE, TRIAL, Trials
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
            allowed = "column low..high, column low..high, ..."
            raise InputError("selection", part.strip(), allowed)
        name, low, high = match.groups()
        if name not in columns:
            raise InputError("selection", name, f"one of {listed(columns, name)}")
        try:
            found[name] = (float(low), float(high))
        except ValueError:
            allowed = "a number at each end"
            raise InputError("selection", f"{low}..{high}", allowed) from None
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


def numbers_of(store: Store, name: str, at_hand: pa.Table | None = None) -> Floats:
    """The numbers of a column, [n]; NaN: unknown. Read are those that are not at hand.

    As of the walker a gait's that made no step; of another simulator where a run
    failed, or where a family did not run the row. Files have zeros there, which would
    be the best of all that is to be small.
    """

    def read(wanted: str) -> NDArray[Any]:
        table = at_hand
        if table is None or wanted not in table.column_names:
            table = store.table([wanted])
        return np.asarray(table[wanted].to_numpy())

    values = read(name).astype(np.float64)
    if store.simulator == WALKER:
        needed = NEEDED_BY.get(name, "")
        if needed in store.columns:
            values[unknown(name, {name: values, needed: read(needed)})] = np.nan
        return values
    families = [family for family in store.families if name.startswith(f"{family}_")]
    flags = [evaluated_name(family) for family in families]
    if name in (*flags, Store.ROW, SURVIVED, *store.parameter_names):
        return values
    if flags:
        values[read(flags[0]) == 0] = np.nan
    elif ENDED in store.columns:
        values[read(ENDED) == FAILED] = np.nan
    return values


def file_of_selection(store: Store, ranges: Ranges) -> tuple[str, bytes]:
    """Name and content of a Parquet file: all columns of the selected rows of a store."""
    chosen = selected(ranges, partial(numbers_of, store), len(store))
    content = io.BytesIO()
    table = store.table().filter(pa.array(chosen))
    pyarrow.parquet.write_table(table, content, compression="zstd")
    return "selection.parquet", content.getvalue()


ROLES = ("across", "up", "colour", "besides", "also besides")  # of the five columns
CLOUD_PX = (600, 440)  # the height lasts, with the axes; the width is that of the page
HISTOGRAM_PX = 105
BINS = 40
BESIDES = "#D8DCE0"  # of bars
RINGS_PX = (17, 11)  # about the row that walks, and about the row under the pointer


def cloud() -> Any:
    """A figure to drag a box over, and what the script moves on it.

    That is its one image, which the script paints, two rings, and the colours' bar; the
    last renderers are a front of two goals.
    """
    plot = figure(
        name="cloud",
        height=CLOUD_PX[1],
        title=" ",
        tools="pan,wheel_zoom,reset,box_select",
        active_drag="box_select",
        x_range=(0.0, 1.0),
        y_range=(0.0, 1.0),
    )
    plot.select_one(BoxSelectTool).renderers = []
    plot.toolbar.logo = None
    pixels = np.zeros(CLOUD_PX[::-1], np.uint32)
    plot.image_rgba([pixels], [0.0], [0.0], [1.0], [1.0])
    nowhere = np.full(2, np.nan)
    rings = ColumnDataSource(
        {"x": nowhere, "y": nowhere, "size": RINGS_PX}, name="rings"
    )
    look = {"source": rings, "size": "size", "fill_color": None}
    plot.scatter("x", "y", **look, line_color="white", line_width=5)
    plot.scatter("x", "y", **look, line_color=style.VERMILION, line_width=2.5)
    front = ColumnDataSource({"x": [], "y": []}, name="front")
    plot.line("x", "y", source=front, line_color=style.INK, line_dash="dashed")
    plot.scatter("x", "y", source=front, size=9, line_color=style.INK, fill_color=None)
    mapper = LinearColorMapper(palette="Viridis256", low=0.0, high=1.0)
    plot.add_layout(ColorBar(color_mapper=mapper, height=10, padding=4), "below")
    return plot


def histogram(slot: int) -> Any:
    """A small figure of the column in this slot: all rows, those selected, and that shown."""
    plot = figure(
        name=f"histogram-{slot}",
        height=HISTOGRAM_PX,
        tools="",
        toolbar_location=None,
        title=" ",
        x_range=(0.0, 1.0),
    )
    plot.title.text_font_size = "10px"
    plot.yaxis.visible = plot.grid.visible = False
    plot.xaxis.ticker.desired_num_ticks = 3
    plot.add_tools(BoxSelectTool(renderers=[], dimensions="width"))
    # Those selected are an overlay, which Bokeh paints anew without the axes.
    for colour, level in ((BESIDES, "glyph"), (style.MODEL, "overlay")):
        left, right, top = np.zeros((3, BINS))
        plot.quad(left, right, top, 0, color=colour, line_color=None, level=level)
    shown = {"line_color": style.VERMILION, "line_width": 2, "level": "overlay"}
    plot.add_layout(Span(dimension="height", **shown))
    return plot


def table(source: ColumnDataSource, row: str, words: list[str]) -> DataTable:
    """The listed rows. A DataTable keeps its first titles, so other columns need a new one."""
    numbers = NumberFormatter(format="0.[0000]", nan_format="-")
    columns = [
        TableColumn(field="row", title=row, width=60),
        TableColumn(field="mark", title="", width=55),
    ]
    for slot, name in enumerate(words):
        if name != row:  # as of a study's trials
            title = html.escape(name)
            columns.append(
                TableColumn(field=f"c{slot}", title=title, formatter=numbers)
            )
    return DataTable(source=source, columns=columns, height=240, index_position=None)


PALETTE = "viridis"


# By what numbers the rows: a column, its word of a row that is not marked, and the page's
# word of one that is.
MARKED = {
    "row": (ORIGIN, SOBOL_ROW, "bred"),
    TRIAL: (STATE, "complete", "not complete"),
}


def marked(store: Store, at_hand: pa.Table) -> NDArray[np.uint8]:
    """Of each row whether it is marked, 1 or 0, [n]; the column that tells is at hand."""
    column, usual, _ = MARKED[store.ROW]
    if column not in store.columns:
        return np.zeros(len(store), np.uint8)
    return np.asarray(at_hand[column].to_numpy() != usual, np.uint8)


def numeric_columns(store: Store) -> list[str]:
    """Names of the columns that can be drawn."""
    schema = next(store.tables()).schema
    drawn = pa.types.is_floating, pa.types.is_integer, pa.types.is_boolean
    return [field.name for field in schema if any(kind(field.type) for kind in drawn)]


def first_columns(store: Store, known: list[str]) -> list[str]:
    """The first five columns of a page; the colour is the survival of the first family, if any.

    Of other simulators than the walker: the first numbers after the parameters. Of a
    study: the trial's number, its value, and its attributes.
    """
    end = "_survived_fraction_mean"
    survived = [name for name in store.columns if name.endswith(end)]
    # The second of a store before 0.4: as its words say.
    energy = ENERGY if ENERGY in known else OF_MUSCLES
    survival = (survived or [SURVIVED])[0]
    first = ["mean_speed_mps", "phi_printed", survival, energy, "step_length_mean_m"]
    if set(first) <= set(known):
        return first
    # A parameter may be a word, and so not among the numbers.
    gains = [name for name in store.parameter_names if name in known]
    own = [name for name in known if name != "row" and name not in gains]
    found = [*own[1:3], *(survived or own)[:1], *own[3:], *gains, *known]
    if isinstance(store, Trials):
        found = [*store.goals, *own, *found]
    return list(islice(cycle(dict.fromkeys(found)), len(ROLES)))


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
        self._store = store
        self._pick = pick
        known = numeric_columns(store)
        first = first_columns(store, known)
        # Read at once: to open the files takes longer than to read a column.
        needed = (NEEDED_BY.get(name, name) for name in first)
        wanted = {store.ROW, MARKED[store.ROW][0], *first, *needed}
        self._at_hand: pa.Table = store.table(wanted & {*store.columns})
        self._rows: NDArray[np.int64] = self._read(store.ROW).astype(np.int64)
        self._words = described(store, known)
        if isinstance(store, Trials):
            for name, words in store.goals.items():
                self._words[name] = self._words[name]._replace(words=words)
        options = menu(self._words)
        self._columns = [
            Select(title=role, value=name, options=options, name=f"column-{slot}")
            for slot, (role, name) in enumerate(zip(ROLES, first, strict=True))
        ]
        self._hidden: Ranges = {}  # of columns that are not shown
        rows = {
            "row": self._rows,
            "marked": marked(store, self._at_hand),
            "kept": np.ones(len(store), np.uint8),
        }
        self._source = ColumnDataSource(rows, name="rows")
        self.selection = TextInput(
            title="selection: column low..high, ...",
            placeholder="drag a box",
            name="selection",
        )
        self._refusal = Message("selection-message")
        self._row_refusal = Message("row-message")
        # without `low` and `high`: the browser would silently replace a wrong number
        self.row = Spinner(title=f"{store.ROW} shown", step=1, mode="int", name="row")
        self._cloud = cloud()
        self._histograms = [histogram(slot) for slot in range(len(ROLES))]
        fields = ("row", "mark", *(f"c{slot}" for slot in range(len(ROLES))))
        self._listed = ColumnDataSource({name: [] for name in fields}, name="listed")
        for slot in range(len(ROLES)):
            self._load(slot)
        self._rows_panel = Column(self._table(), name="Rows")
        count = Div(name="count")
        self._connect(count)
        clear = message.button("all rows", lambda: self.selection.update(value=""))
        take = message.button("selection as Parquet", lambda: save(self._ranges()))
        # Its words leave in the menus what has them.
        find = TextInput(title="find in the menus", placeholder="hip mean", name="find")
        found = CustomJS.from_file(
            SCRIPTS / "find.mjs", columns=self._columns, options=options
        )
        find.js_on_change("value_input", found)
        panel = Column(
            flow(*self._columns, find, least_px=215),
            self._cloud,
            flow(self.selection, clear, least_px=110),
            self._refusal.layout,
            flow(*self._histograms, least_px=160),
            flow(count, self.row, take),
            self._row_refusal.layout,
            name="Points",
        )
        self.selection.styles = {"flex": "4 1 260px"}
        self.panels = [panel, self._rows_panel]
        self._refusal.watch(self.selection, "value", self._check)
        for attribute in ("value", "tags"):  # the second: the same row, clicked again
            self._row_refusal.watch(self.row, attribute, self._picked)
        for slot, select in enumerate(self._columns):
            message.watch(select, "value", partial(self._look_at, slot))

    @property
    def _names(self) -> list[str]:
        """The five columns that are shown."""
        return [select.value for select in self._columns]

    def _table(self) -> DataTable:
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
            shown = self._names
            hidden = {name: ranges[name] for name in ranges if name not in shown}
            if hidden != self._hidden:
                self._hidden = hidden
                kept = selected(hidden, self._read, len(self._rows))
                self._source.data["kept"] = kept.astype(np.uint8)

    def _picked(self) -> None:
        """Hand on the row that was clicked or typed."""
        self._row_refusal.tell("")
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
        return numbers_of(self._store, name, self._at_hand)

    def _load(self, slot: int) -> None:
        """Put a column into a slot; the script finds its bounds."""
        name = self._columns[slot].value
        _, words, meaning = self._words[name]
        self._columns[slot].description = f"{name}: {meaning}"
        # A name between dollars would be drawn as TeX.
        text = PlainText(words)
        self._histograms[slot].title.text = text
        across, bar = self._cloud.below
        (up,) = self._cloud.left
        match ROLES[slot]:
            case "across":
                across.axis_label = text
            case "up":
                up.axis_label = text
            case "colour":
                bar.title = text
        self._draw_front()
        # Last: it makes the script paint.
        self._source.data[f"c{slot}"] = self._read(name)

    def _draw_front(self) -> None:
        """Join the trials of a front where the axes are the two goals."""
        store, axes = self._store, self._names[:2]
        front = self._cloud.renderers[-1].data_source
        joined: list[int] = []
        if isinstance(store, Trials) and {*axes} == {*store.goals}:
            joined = store.front
        on_front = np.isin(self._rows, joined)
        x, y = (self._read(name)[on_front] for name in axes)
        order = np.argsort(x)
        front.data = {"x": x[order], "y": y[order]}

    def _connect(self, count: Div) -> None:
        """Let the page's script know its parts, and hear of what a person does."""
        rgba = matplotlib.colormaps[PALETTE](np.arange(256), bytes=True)
        script = CustomJS.from_file(
            SCRIPTS / "brush.mjs",
            source=self._source,
            columns=self._columns,
            selection=self.selection,
            plot=self._cloud,
            histograms=self._histograms,
            count=count,
            table=self._listed,
            row=self.row,
            listing=self._rows_panel,
            word=self._store.ROW,
            mark=MARKED[self._store.ROW][-1],
            palette=rgba.view("<u4").ravel().tolist(),
        )
        for each in self._histograms:
            each.js_on_event("selectiongeometry", script)
        for event in ("selectiongeometry", "tap", "mousemove", "mouseleave"):
            self._cloud.js_on_event(event, script)
        for ends in (self._cloud.x_range, self._cloud.y_range):
            ends.js_on_change("start", script)
            ends.js_on_change("end", script)
        self._cloud.js_on_change("inner_width", script)  # it has been laid out
        self._source.js_on_change("data", script)
        self._listed.selected.js_on_change("indices", script)
        for field in (self.row, self.selection):
            field.js_on_change("value", script)
