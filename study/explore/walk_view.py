"""The right half of the walker's page: gains, ground, the stick figure, its cycle and scores."""

import html
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from bokeh.document import Document
from bokeh.layouts import column, row
from bokeh.models import (
    Button,
    Column,
    ColumnDataSource,
    CustomJS,
    Div,
    NumericInput,
    RadioButtonGroup,
    Range1d,
    Select,
    Slider,
    Spinner,
    Toggle,
)
from bokeh.plotting import figure

from study.experiment.gains import NamedGains, gains_of_source
from study.explore import walk as walking
from study.explore.server import SCRIPTS, Latest, Message, Saver
from study.pictures import gait_cycle, style
from study.pictures.gait_cycle import PANELS, PERCENT
from study.pictures.scene import BELOW_GROUND_M, VIEW_WIDTH_M
from study.pictures.stick_figure import HEAD_RADIUS_M, PATH_POINTS, finite
from taichi_nmm.errors import InputError
from taichi_nmm.parameters import GAINS
from taichi_nmm.result import MUSCLES, OUTCOME_FIELDS, SCORE_FIELDS
from taichi_nmm.settings import ENGINES


class WalkView:
    """Choices of a setting, the stages, the gains, and files to save.

    Of processes, `walkers` simulate and `makers` make files.
    """

    def __init__(
        self, document: Document, walkers: Executor, makers: Executor, message: Message
    ) -> None:
        self._message = message
        self._walk: walking.Walk | None = None
        self._beside: NamedGains | None = None
        self._first = True  # later walks are compared with the next one
        self._walks = Latest(document, walkers, self._walked, message.failed)
        saver = Saver(document, makers, message)
        self.save = saver.save
        self._player, self._score, self._cycle = Player(), Score(), Cycle()
        beside = partial(self._player.show, place=1)
        self._others = Latest(document, walkers, beside, message.failed)
        self._hands = Hands(message, self._again, self.show)
        self._choices = _choices()
        for choice in self._choices.values():
            message.watch(choice, "value", self._chosen)
        self._parts = {
            "gains": self._hands.layout, "score": self._score.layout,
            "stride beside people": self._cycle.layout, "take it with you": self._taking(),
        }  # fmt: skip
        self._part = RadioButtonGroup(labels=list(self._parts), active=0, name="part")
        self._part.tags = [saver.source]
        self._below = column(self._hands.layout)
        message.watch(self._part, "active", self._turn)
        keep = Button(label="keep it beside", width=110, name="keep")
        keep.on_click(message.safely(self._keep))
        values = list(self._choices.values())
        self.layout = column(
            row(*values[:3]), row(*values[3:], keep), self._player.layout, self._part,
            self._below,
        )  # fmt: skip

    def show(self, gains: NamedGains) -> None:
        """Let gains walk in the setting of the choices."""
        self._hands.take(gains)
        self._first = True
        self._again()

    def _chosen(self) -> None:
        self._first = True  # a walk of another setting is no comparison
        self._again()

    def _again(self) -> None:
        self._message.tell("")
        chosen = {name: choice.value for name, choice in self._choices.items()}
        chosen["duration_s"] = float(chosen["duration_s"].removesuffix(" s"))
        setting = walking.chosen_setting(**chosen)
        self._walks.ask(walking.walk, self._hands.gains, setting)
        if self._beside is not None:
            self._others.ask(walking.walk, self._beside, setting)

    def _walked(self, found: walking.Walk) -> None:
        self._walk = found
        self._player.show(found)
        self._score.show(found.row, self._first)
        self._first = False
        self._cycle.show(found)

    def _turn(self) -> None:
        """Show another part alone: a hidden figure never gets a size."""
        self._below.children = [list(self._parts.values())[self._part.active]]

    def _keep(self) -> None:
        if self._walk is not None:
            self._beside = self._walk.gains
            self._player.show(self._walk, place=1)

    def _taking(self) -> Any:
        buttons = [Button(label=name, width=110, name=f"save-{name}") for name in walking.NAMES]
        for button in buttons:
            button.on_click(self._message.safely(partial(self._take, button.label)))
        words = Div(text="With both files, this command draws, films and records the walk:")
        command = Div(text=f"<code>{walking.COMMAND}</code>", name="command", width=700)
        return column(row(*buttons), words, command)

    def _take(self, name: str) -> None:
        if self._walk is not None:
            self.save(walking.file_of_walk, self._walk, name)


def _choices() -> dict[str, Any]:
    """By the names of `chosen_setting`'s arguments."""
    grounds = list(walking.GROUNDS)
    durations = [f"{duration:g} s" for duration in walking.DURATIONS_S]
    return {
        "ground": Select(title="ground", options=grounds, value=grounds[0], width=230,
                         name="ground"),
        "disturbance": Select(title="masses of the body", options=list(walking.DISTURBANCES),
                              value="nominal", width=140, name="disturbance"),
        "seed": Spinner(title="seed of body, ground, world", step=1, value=1, mode="int",
                        width=180, name="seed"),
        "world": Select(title="world", options=list(walking.WORLDS), value="nominal", width=200,
                        name="world"),
        "engine": Select(title="engine", options=list(ENGINES), value=ENGINES[0], width=110,
                         name="engine"),
        "duration_s": Select(title="at most", options=durations, value=durations[1], width=90,
                             name="duration"),
    }  # fmt: skip


STARTS = ("published", "reference")
STEPS = 400  # of a slider
SLIDER_PX, NUMBER_PX = 225, 95


class Hands:
    """A slider and a number for each gain of a walker.

    `changed` is called when a person has changed `gains`, `start` with those of a starting point.
    """

    def __init__(
        self, message: Message, changed: Callable[[], None], start: Callable[[NamedGains], None]
    ) -> None:
        self._message, self._changed, self._start = message, changed, start
        self._still = False  # while the page, not a person, moves the sliders
        self._starts = Select(title="start from", options=["", *STARTS], value="", width=150,
                              name="start")  # fmt: skip
        self._sliders = [
            Slider(title=f"{gain.name} ({gain.unit})", start=gain.low, end=gain.high,
                   value=gain.low, step=(gain.high - gain.low) / STEPS, show_value=False,
                   width=SLIDER_PX, name=f"gain-{gain.name}")
            for gain in GAINS
        ]  # fmt: skip
        names = [f"number-{gain.name}" for gain in GAINS]
        self._numbers = [NumericInput(mode="float", width=NUMBER_PX, name=name) for name in names]
        message.watch(self._starts, "value", self._from_start)
        pairs = list(zip(self._sliders, self._numbers, strict=True))
        for place, (slider, number) in enumerate(pairs):
            message.watch(slider, "value", partial(self._moved, place))
            message.watch(number, "value", partial(self._typed, place))
        self.take(gains_of_source(STARTS[0]))
        rows, half = [row(*pair) for pair in pairs], len(pairs) // 2
        self.layout: Column = column(self._starts, row(column(*rows[:half]), column(*rows[half:])))

    def take(self, gains: NamedGains) -> None:
        """Show other gains, without a call of `changed`."""
        self.gains = gains
        for place, value in enumerate(gains.gains.tolist()):
            self._show(place, value)

    def _from_start(self) -> None:
        if self._starts.value:
            gains = gains_of_source(self._starts.value)
            self._starts.value = ""
            self._start(gains)

    def _moved(self, place: int) -> None:
        self._set(place, float(self._sliders[place].value))

    def _typed(self, place: int) -> None:
        if self._still:
            return
        value, gain = self._numbers[place].value, GAINS[place]
        if value is None or not gain.low <= value <= gain.high:
            self._show(place, float(self.gains.gains[place]))
            raise InputError(gain.name, value, f"{gain.low:g} to {gain.high:g}")
        self._set(place, float(value))

    def _set(self, place: int, value: float) -> None:
        if self._still or value == self.gains.gains[place]:
            return
        gains = self.gains.gains.copy()
        gains[place] = np.clip(value, GAINS[place].low, GAINS[place].high)
        name = self.gains.name.removesuffix(" changed") + " changed"
        self.gains = replace(self.gains, name=name, gains=gains)
        self._show(place, value)
        self._changed()

    def _show(self, place: int, value: float) -> None:
        self._still = True
        self._sliders[place].value = self._numbers[place].value = value
        self._still = False


FRAME_PX = (720, 370)
BONE_PX = 7
SPEEDS = ("0.1x", "0.25x", "0.5x", "1x", "2x", "5x")
MUSCLE_COUNT = 2 * len(MUSCLES)
HEIGHT_M = VIEW_WIDTH_M * FRAME_PX[1] / FRAME_PX[0]


def points(count: int) -> ColumnDataSource:
    """Points of a line, which the script moves."""
    return ColumnDataSource({"x": np.full(count, np.nan, "f4"), "y": np.full(count, np.nan, "f4")})


def outlines(parts: int, count: int, **more: Any) -> ColumnDataSource:
    """The same of several lines or patches."""
    xs, ys = ([np.full(count, np.nan, "f4") for _ in range(parts)] for _ in range(2))
    return ColumnDataSource({"xs": xs, "ys": ys, **more})


class Stage:
    """One walker, drawn as in films: muscles by activation, forces of the ground."""

    def __init__(self, name: str) -> None:
        self.frames = ColumnDataSource({}, name=f"{name}-frames")
        self.words = Div(text="", styles={"font-size": "13px"}, disable_math=True)
        self._near, self._far, self._trunk, self._head = map(points, (5, 5, 2, 1))
        colour = [walking.COLOURS[0]] * MUSCLE_COUNT
        self._muscles = outlines(MUSCLE_COUNT, 2 * PATH_POINTS, colour=colour)
        self._forces = outlines(2, 2)
        self._ground = points(2)
        self.figure = self._drawn(name)
        self.layout = column(self.figure, self.words)

    @property
    def parts(self) -> dict[str, Any]:
        """The models that the player's script moves."""
        return {
            "frames": self.frames, "near": self._near, "far": self._far, "trunk": self._trunk,
            "head": self._head, "muscles": self._muscles, "forces": self._forces,
            "figure": self.figure,
        }  # fmt: skip

    def show(self, walk: walking.Walk) -> None:
        """Begin to play a walk."""
        x, y = walk.frames["ground"].T
        self._ground.data = {"x": x, "y": y}
        self.words.text = f"<b>{html.escape(walk.gains.name)}</b>: {html.escape(walk.ended)}"
        # Each as the one entry of a column, as Bokeh sends arrays of any shape.
        self.frames.data = {name: [values] for name, values in walk.frames.items()}

    def _drawn(self, name: str) -> Any:
        plot = figure(
            name=name, frame_width=FRAME_PX[0], frame_height=FRAME_PX[1], tools="",
            toolbar_location=None, x_range=Range1d(0.0, VIEW_WIDTH_M),
            y_range=Range1d(-BELOW_GROUND_M, HEIGHT_M - BELOW_GROUND_M), title=" ",
        )  # fmt: skip
        plot.grid.visible = False
        plot.yaxis.visible = False
        plot.varea("x", -1e4, "y", source=self._ground, fill_color=style.GROUND)
        plot.line("x", "y", source=self._ground, line_color=style.INK, line_width=1.5)
        for bones, colour in ((self._far, style.FAR_LIMB), (self._trunk, style.NEAR_LIMB),
                              (self._near, style.NEAR_LIMB)):  # fmt: skip
            plot.line("x", "y", source=bones, line_color=colour, line_width=BONE_PX,
                      line_cap="round", line_join="round")  # fmt: skip
        plot.circle("x", "y", radius=HEAD_RADIUS_M, source=self._head, color=style.NEAR_LIMB)
        plot.patches("xs", "ys", fill_color="colour", source=self._muscles, line_color=style.INK,
                     line_width=0.5)  # fmt: skip
        plot.multi_line("xs", "ys", source=self._forces, line_color=style.MODEL, line_width=3)
        return plot


class Player:
    """Two stages and the clock of both; the second stage is off the page until a walk is kept."""

    def __init__(self) -> None:
        self.stages = (Stage("stage"), Stage("beside"))
        play = Toggle(label="play / pause", active=True, width=100, name="play")
        speed = Select(value="1x", options=list(SPEEDS), width=80)
        slider = Slider(start=0.0, end=1.0, value=0.0, step=0.01, title="time (s)", width=480,
                        name="time")  # fmt: skip
        script = CustomJS.from_file(
            SCRIPTS / "play.mjs",
            stages=[stage.parts for stage in self.stages], play=play, speed=speed, slider=slider,
            levels=walking.COLOURS,
        )  # fmt: skip
        for stage in self.stages:
            stage.frames.js_on_change("data", script)
        slider.js_on_change("value", script)
        play.js_on_change("active", script)
        self._controls = row(play, speed, slider)
        self.layout: Column = column(self.stages[0].layout, self._controls)

    def show(self, walk: walking.Walk, place: int = 0) -> None:
        """Play a walk on a stage; the second stage comes to the page with its first walk."""
        if place:
            self.layout.children = [*(stage.layout for stage in self.stages), self._controls]
        self.stages[place].show(walk)


SIZE_PX = (232, 170)
COLUMNS = 3


class Cycle:
    """A small figure for each joint and each ground force."""

    def __init__(self) -> None:
        self._words = Div(text="", name="cycle", width=SIZE_PX[0] * COLUMNS)
        self._curves: dict[str, ColumnDataSource] = {}
        self._figures = {}
        for name, panel in PANELS.items():
            plot = figure(
                name=f"cycle-{panel.title}", width=SIZE_PX[0], height=SIZE_PX[1], tools="",
                toolbar_location=None, title=panel.title, y_axis_label=panel.unit,
                x_range=(0, 100), y_range=(panel.low, panel.high),
            )  # fmt: skip
            mean, sd = panel.at(PERCENT)
            plot.varea(PERCENT, mean - sd, mean + sd, fill_color=style.HUMAN, fill_alpha=0.35)
            plot.line(PERCENT, mean, line_color=style.FAINT, line_dash="dashed")
            empty = np.full(len(PERCENT), np.nan)
            source = ColumnDataSource({"x": PERCENT, "y": empty}, name=f"cycle-{name}")
            plot.line("x", "y", source=source, line_color=style.MODEL, line_width=2)
            plot.title.text_font_size = "10px"
            self._curves[name], self._figures[name] = source, plot
        plots = list(self._figures.values())
        self.layout: Column = column(self._words, row(*plots[:COLUMNS]), row(*plots[COLUMNS:]))

    def show(self, walk: walking.Walk) -> None:
        """The mean stride of a walk that has enough strides."""
        strides = gait_cycle.strides_of(finite(walk.trajectory), walk.experiment.weight_n(0))
        distances = gait_cycle.human_distances(strides)
        words = gait_cycle.subtitle(strides)
        self._words.text = f"{words} Grey: {gait_cycle.SOURCE}. Numbers: RMSE."
        for name, panel in PANELS.items():
            curves = getattr(strides, name)
            mean = curves.mean(axis=0) if strides.enough else np.full(len(PERCENT), np.nan)
            self._curves[name].data = {"x": PERCENT, "y": mean}
            title = panel.title.removeprefix("ground ")
            if far := distances.get(name):
                unit = "deg" if name.endswith("deg") else "bw"
                title += f": {far.rmse:.3g} {unit}, {far.deviations:.2g} sd"
            self._figures[name].title.text = title


LEFT_OUT = ("end_reason", "hip_x_m", "hip_z_m")
FIELDS = tuple(name for name, _ in (*OUTCOME_FIELDS, *SCORE_FIELDS) if name not in LEFT_OUT)
HEAD = "<tr><th align=left></th><th>start</th><th>now</th><th>change</th></tr>"


class Score:
    """A table of numbers of two walks on the same ground."""

    def __init__(self) -> None:
        self._start: np.void | None = None
        self.layout = Div(text="", name="score", width=420)

    def show(self, row: np.void, start: bool) -> None:
        """The result row of a walk; later rows are compared with that of a `start`."""
        if start or self._start is None:
            self._start = row
        text = HEAD
        for name in FIELDS:
            before, now = float(self._start[name]), float(row[name])
            change = "" if before == now else f"{now - before:+.3g}"
            cells = (f"{before:.4g}", f"{now:.4g}", f"<b>{change}</b>")
            right = "".join(f"<td align=right>{cell}</td>" for cell in cells)
            text += f"<tr><td>{name}</td>{right}</tr>"
        self.layout.text = f"<table cellspacing=4>{text}</table>"
