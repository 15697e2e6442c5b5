"""Signals of both gaits over time, or over the stride beside people: any columns of a recording.

A recording is that of the command `walk` (study/pictures/trajectory_files.py), with its
names and units. It takes eight times as long as the walk, and is made in another
process, while signals are looked at.
"""

import html
from concurrent.futures import Executor
from functools import partial
from itertools import zip_longest
from typing import Any

import numpy as np
from bokeh import models
from bokeh.document import Document
from bokeh.layouts import column, gridplot
from bokeh.plotting import figure

from study.explore import walk as walking
from study.explore.server import NIGHT, Latest, Message
from study.explore.stage import GAITS, OVER_TIME
from study.explore.words import in_words
from study.pictures import gait_cycle, style
from study.pictures.gait_cycle import PANELS, PERCENT
from study.pictures.stick_figure import LEFT, RIGHT
from study.pictures.trajectory_files import OWN_COLUMNS, own_columns
from taichi_nmm.result import MUSCLES, Trajectory

OVER = (OVER_TIME, "over the stride")
X_AXES = ("time (s)", "stride (%)")
FIRST = ("l_knee_flexion_rad", "l_ground_z_n")
MOST = 8  # signals at once
HEIGHT_PX = 150  # of a signal
BODY_WEIGHTS = None
RADIANS = np.deg2rad(1.0)
# By the name of a column without its side: what people do, and its unit in the column's.
OF_PEOPLE: dict[str, tuple[str, float | None]] = {
    "hip_extension_rad": ("hip_flexion_deg", -RADIANS),
    "knee_flexion_rad": ("knee_flexion_deg", RADIANS),
    "ankle_plantarflexion_rad": ("dorsiflexion_deg", -RADIANS),
    "ground_x_n": ("forward_bw", BODY_WEIGHTS),
    "ground_z_n": ("vertical_bw", BODY_WEIGHTS),
} | {f"{muscle}_activation": (muscle, 1.0) for muscle in MUSCLES}

SIDES = {"l_": "left ", "r_": "right "}

Columns = dict[str, Any]
NOTHING: Columns = {name: np.zeros(0) for name in ("x", "y", "low", "high")}
CURVES = ("people", "on", "signal", "beside")  # of a plot


def label(name: str) -> str:
    """A column in words with its unit, and its name in files."""
    side = SIDES.get(name[:2], "")
    words, _ = in_words(name[2:] if side else name)
    return f"{side}{words}: {name}"


class Plot:
    """A figure of one signal; it is made empty, since a new figure would take half a second.

    Its sources have the names of `CURVES`: what people do, when their muscle is on, the
    walk, and the walk beside it.
    """

    def __init__(self, slot: int, x_range: models.DataRange1d, script: Any) -> None:
        self.sources = {
            name: models.ColumnDataSource(NOTHING, name=f"{name}-{slot}")
            for name in CURVES
        }
        self.drawn: tuple[Any, ...] = ()  # what decides the curves that are drawn
        self.figure = plot = figure(
            name=f"signals-{slot}",
            height=HEIGHT_PX,
            sizing_mode="stretch_width",
            title="",
            tools="xpan,xwheel_zoom,reset,save",
            x_range=x_range,
            visible=False,
        )
        plot.title.text_font_size = "11px"
        plot.yaxis.ticker.desired_num_ticks = 4
        plot.js_on_event("tap", script)
        colours = (style.HUMAN, style.EMG, *GAITS)
        alphas = (0.35, 0.6, 0.25, 0.2)
        dashes = ("dotted", "solid", "solid", "dashed")
        for name, colour, alpha, dash in zip(
            CURVES, colours, alphas, dashes, strict=True
        ):
            source = self.sources[name]
            plot.varea(
                "x", "low", "high", source=source, fill_color=colour, fill_alpha=alpha
            )
            line = style.FAINT if name == "people" else colour
            plot.line(
                "x", "y", source=source, line_color=line, line_dash=dash, line_width=1.5
            )


class Signals:
    """A field to find columns in, and a figure for each that is chosen.

    The present walk is drawn blue, the one beside it black and dashed. A click on a
    figure over time moves the clock, by `script` of the player. `names` and `over` are
    the fields, `plots` the figures.
    """

    def __init__(
        self, document: Document, makers: Executor, message: Message, script: Any
    ) -> None:
        self._walks: list[walking.Walk | None] = [None, None]
        self._recorded: list[Trajectory | None] = [None, None]
        self._columns: list[Columns] = [{}, {}]
        self._calls = [
            Latest(document, makers, partial(self._came, place), message.failed)
            for place in range(2)
        ]
        labels = [(name, label(name)) for name in OWN_COLUMNS]
        self.names = models.MultiChoice(
            title="signals: type parts of a name",
            options=labels,
            value=list(FIRST),
            max_items=MOST,
            search_option_limit=len(labels),
            placeholder="type here, such as left soleus",
            sizing_mode="stretch_width",
            stylesheets=[NIGHT],
            name="signals",
        )
        self.over = models.RadioButtonGroup(
            labels=list(OVER), active=0, name="over", stylesheets=[NIGHT]
        )
        self._words = models.Div(text="", name="signal-words", disable_math=True)
        x_range = models.DataRange1d(range_padding=0.0)
        self.plots = [Plot(slot, x_range, script) for slot in range(MOST)]
        grid = gridplot(
            [[plot.figure] for plot in self.plots],
            toolbar_location="above",
            sizing_mode="stretch_width",
        )
        self.layout: models.Column = column(
            self.names, self.over, self._words, grid, sizing_mode="stretch_width"
        )
        message.watch(self.names, "value", self._draw)
        message.watch(self.over, "active", self._draw)

    def show(self, walk: walking.Walk, other: walking.Walk | None) -> None:
        """Draw the signals of a walk, and of another one, as soon as they are recorded."""
        known = dict(zip(self._walks, self._recorded, strict=True))
        for place, each in enumerate((walk, other)):
            if each is not self._walks[place]:
                self._walks[place] = each
                self._take(place, known.get(each) if each else None)
                if each and self._recorded[place] is None:
                    self._calls[place].ask(walking.recorded, each, id(each))
        self._draw()

    def _came(self, place: int, found: tuple[Trajectory, int]) -> None:
        trajectory, number = found
        if number == id(self._walks[place]):  # else another walk has come meanwhile
            self._take(place, trajectory)
            self._draw()

    def _take(self, place: int, trajectory: Trajectory | None) -> None:
        self._recorded[place] = trajectory
        self._columns[place] = own_columns(trajectory) if trajectory else {}

    @property
    def _on_strides(self) -> bool:
        return bool(self.over.active)

    def _draw(self) -> None:
        """Draw what has changed."""
        self._say()
        names = self.names.value
        for plot, name in zip_longest(self.plots, names):
            decides = (name, self.over.active, *map(id, self._recorded))
            plot.figure.visible = name is not None
            if name is None or plot.drawn == decides:
                continue
            plot.drawn = decides
            plot.figure.title.text = label(name)
            plot.figure.tags = [OVER[self.over.active], name]
            plot.figure.xaxis.axis_label = X_AXES[self.over.active]
            people, on = self._of_people(name)
            curves = (people, on, self._curve(0, name), self._curve(1, name))
            for source, data in zip(plot.sources.values(), curves, strict=True):
                source.data = data

    def _say(self) -> None:
        """Which colour is which, or that it is still being recorded."""
        parts = []
        looks = ("blue", "black, dashed")
        both = zip(looks, self._walks, self._recorded, strict=True)
        for look, walk, recorded in both:
            if walk is not None:
                state = "" if recorded else " (recording ...)"
                parts.append(f"{look}: {walk.gains.name}{state}")
        if self._on_strides:
            parts.append("mean ± 1 sd of whole strides after settling")
            parts.append(f"grey: {gait_cycle.SOURCE}; sand: {gait_cycle.EMG_SOURCE}")
        self._words.text = html.escape("; ".join(parts))

    def _of_people(self, name: str) -> tuple[Columns, Columns]:
        """What people do over a stride, in the unit of the column, and when a muscle is on."""
        panel_name, unit = OF_PEOPLE.get(name[2:], ("", 1.0))
        walk = self._walks[0]
        if not self._on_strides or not panel_name or walk is None:
            return NOTHING, NOTHING
        panel = PANELS[panel_name]
        if panel.on_percent:
            ends = [(start, start, end, end) for start, end in panel.on_percent]
            x = np.ravel(ends)
            high = np.tile([0.0, 1.0, 1.0, 0.0], len(ends))
            low = np.zeros(len(x))
            return NOTHING, {
                "x": x,
                "y": np.full(len(x), np.nan),
                "low": low,
                "high": high,
            }
        if unit is BODY_WEIGHTS:
            unit = walk.experiment.weight_n(walk.run)
        mean, sd = panel.at(PERCENT)
        return band(unit * mean, abs(unit) * sd), NOTHING

    def _curve(self, place: int, name: str) -> Columns:
        """Of a gait, what is drawn of a column; nothing before it is recorded."""
        trajectory = self._recorded[place]
        if trajectory is None:
            return NOTHING
        values = self._columns[place][name]
        if not self._on_strides:
            return {"x": trajectory.time_s, "y": values, "low": values, "high": values}
        side = RIGHT if name.startswith("r_") else LEFT
        times_s = gait_cycle.stride_times(trajectory, side)
        if len(times_s) < gait_cycle.FEWEST_STRIDES:
            return NOTHING
        strides = np.interp(times_s, trajectory.time_s, values)
        return band(strides.mean(axis=0), strides.std(axis=0))


def band(mean: Any, sd: Any) -> Columns:
    """A mean over the stride, [p], and one standard deviation about it."""
    return {"x": PERCENT, "y": mean, "low": mean - sd, "high": mean + sd}
