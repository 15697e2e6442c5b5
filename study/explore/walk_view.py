"""The panels of the walker's page: gains, ground, the stage, the stride and the scores."""

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
    Div,
    NumericInput,
    RadioButtonGroup,
    Select,
    Slider,
    Span,
    Spinner,
)
from bokeh.plotting import figure
from numpy.typing import NDArray

from study.experiment.gains import NamedGains, gains_of_source
from study.explore import walk as walking
from study.explore.server import Latest, Message, Saver, flow
from study.explore.stage import Player
from study.explore.words import in_words
from study.pictures import gait_cycle, style
from study.pictures.gait_cycle import EMG_ON_PERCENT, PANELS, PEOPLE, PERCENT, Strides
from study.pictures.stick_figure import LEFT, RIGHT, finite
from taichi_nmm.errors import InputError
from taichi_nmm.parameters import GAINS
from taichi_nmm.result import MUSCLES, OUTCOME_FIELDS, SCORE_FIELDS
from taichi_nmm.settings import ENGINES

Floats = NDArray[np.float64]
WRAPS = ".bk-slider-title { white-space: normal } .bk-btn-group { flex-wrap: wrap }"


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
        self._walks = Latest(document, walkers, self._walked, self._failed)
        saver = Saver(document, makers, message)
        self.save = saver.save
        self._player, self._score, self._cycle = Player(document), Score(), Cycle()
        self._others = Latest(document, walkers, self._walked_beside, message.failed)
        self._hands = Hands(message, self._again, self.show)
        self._choices = _choices()
        for name, choice in self._choices.items():
            chosen = self._on_ground if name == "ground" else self._chosen
            message.watch(choice, "value", chosen)
        self._parts = {
            "gains": self._hands.layout, "score": self._score.layout,
            "stride beside people": self._cycle.layout, "take it with you": self._taking(),
        }  # fmt: skip
        self._part = RadioButtonGroup(labels=list(self._parts), active=0, name="part",
                                      stylesheets=[WRAPS])  # fmt: skip
        self._part.tags = [saver.source]
        self._below = column(self._hands.layout, sizing_mode="stretch_width")
        message.watch(self._part, "active", self._turn)
        keep = Button(label="keep it beside", name="keep")
        keep.on_click(message.safely(self._keep))
        self._player.removed.on_click(message.safely(self._remove))
        choices = flow(*self._choices.values(), keep)
        self.panels = [
            column(choices, self._player.layout, sizing_mode="stretch_width", name="The walk"),
            column(self._part, self._below, sizing_mode="stretch_width",
                   name="Gains, score, stride and files"),
        ]  # fmt: skip

    def show(self, gains: NamedGains) -> None:
        """Let gains walk in the setting of the choices."""
        self._hands.take(gains)
        self._first = True
        self._again()

    def _on_ground(self) -> None:
        """Walk until the ground has been met: flat ground lies before all others."""
        kind = walking.GROUNDS[self._choices["ground"].value]["kind"]
        duration, lasts = self._choices["duration_s"], f"{walking.LASTS_S[kind]:g} s"
        if duration.value == lasts:
            self._chosen()
        duration.value = lasts

    def _failed(self, error: BaseException) -> None:
        self._message.failed(error)
        self._player.stages[0].words.text = "no walk"

    def _chosen(self) -> None:
        self._first = True  # a walk of another setting is no comparison
        self._again()

    def _again(self) -> None:
        self._message.tell("")
        chosen = {name: choice.value for name, choice in self._choices.items()}
        chosen["duration_s"] = float(chosen["duration_s"].removesuffix(" s"))
        setting = walking.chosen_setting(**chosen)
        self._player.stages[0].wait(self._hands.gains.name)
        self._walks.ask(walking.walk, self._hands.gains, setting)
        if self._beside is not None:
            self._others.ask(walking.walk, self._beside, setting)

    def _walked(self, found: walking.Walk) -> None:
        self._walk = found
        self._player.show(found)
        self._score.show(found, self._first and self._beside is None)
        self._first = False
        self._cycle.show(found)

    def _walked_beside(self, found: walking.Walk) -> None:
        if self._beside is not None:  # it may have been removed meanwhile
            self._player.show(found, place=1)
            self._score.compare(found)
            self._cycle.show(found, beside=True)

    def _turn(self) -> None:
        """Show another part alone: a hidden figure never gets a size."""
        self._below.children = [list(self._parts.values())[self._part.active]]

    def _keep(self) -> None:
        if self._walk is not None:
            self._beside = self._walk.gains
            self._walked_beside(self._walk)

    def _remove(self) -> None:
        self._beside = None
        self._player.remove()
        self._cycle.forget()
        if self._walk is not None:
            self._score.show(self._walk, True)

    def _taking(self) -> Any:
        buttons = [Button(label=name, name=f"save-{name}") for name in walking.NAMES]
        for button in buttons:
            take = partial(self._take, walking.file_of_walk, button.label)
            button.on_click(self._message.safely(take))
        film = Button(label="a film of its last 8 s", name="save-walk.mp4")
        film.on_click(self._message.safely(partial(self._take, walking.film_of_walk)))
        words = Div(text="With both files, this command draws, films and records the walk:")
        command = Div(text=f"<code>{walking.COMMAND}</code>", name="command")
        return column(flow(*buttons, film), words, command, sizing_mode="stretch_width")

    def _take(self, function: Callable[..., tuple[str, bytes]], *names: str) -> None:
        if self._walk is not None:
            self.save(function, self._walk, *names)


def _choices() -> dict[str, Any]:
    """By the names of `chosen_setting`'s arguments."""
    grounds = list(walking.GROUNDS)
    durations = [f"{duration:g} s" for duration in walking.DURATIONS_S]
    return {
        "ground": Select(title="ground", options=grounds, value=grounds[0],
                         name="ground"),
        "disturbance": Select(title="masses of the body", options=list(walking.DISTURBANCES),
                              value="nominal", name="disturbance"),
        "seed": Spinner(title="seed", step=1, value=1, mode="int",
                        name="seed"),
        "world": Select(title="world", options=list(walking.WORLDS), value="nominal",
                        name="world"),
        "engine": Select(title="engine", options=list(ENGINES), value=ENGINES[0],
                         name="engine"),
        "duration_s": Select(title="at most", options=durations, value=durations[1],
                             name="duration"),
    }  # fmt: skip


STARTS = ("published", "reference")
STEPS = 400  # of a slider
NUMBER_PX = 130


class Hands:
    """A slider and a number for each gain of a walker.

    `changed` is called when a person has changed `gains`, `start` with those of a starting point.
    """

    def __init__(
        self, message: Message, changed: Callable[[], None], start: Callable[[NamedGains], None]
    ) -> None:
        self._message, self._changed, self._start = message, changed, start
        self._still = False  # while the page, not a person, moves the sliders
        self._starts = Select(title="start from", options=["", *STARTS], value="",
                              name="start")  # fmt: skip
        self._sliders = [
            Slider(title=gain.meaning, start=gain.low, end=gain.high, value=gain.low,
                   step=(gain.high - gain.low) / STEPS, show_value=False, stylesheets=[WRAPS],
                   sizing_mode="stretch_width", name=f"gain-{gain.name}")
            for gain in GAINS
        ]  # fmt: skip
        self._numbers = [
            NumericInput(title=f"{gain.name} ({gain.unit})", mode="float", width=NUMBER_PX,
                         name=f"number-{gain.name}")
            for gain in GAINS
        ]  # fmt: skip
        message.watch(self._starts, "value", self._from_start)
        pairs = list(zip(self._sliders, self._numbers, strict=True))
        for place, (slider, number) in enumerate(pairs):
            message.watch(slider, "value", partial(self._moved, place))
            message.watch(number, "value", partial(self._typed, place))
        self.take(gains_of_source(STARTS[0]))
        rows = flow(*(row(*pair) for pair in pairs), least_px=300)
        self.layout: Column = column(self._starts, rows, sizing_mode="stretch_width")

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


HEIGHT_PX, LEAST_PX = 180, 215  # of a panel of the stride
CURVES = ("y", "low", "high", "right", "beside")  # y is the left leg's, low and high one sd from it
NO_CURVE = np.full(len(PERCENT), np.nan)


class Cycle:
    """A small figure for each joint, each ground force and each muscle."""

    def __init__(self) -> None:
        self._words = Div(text="", name="cycle", sizing_mode="stretch_width")
        self._curves: dict[str, ColumnDataSource] = {}
        self._figures: dict[str, Any] = {}
        self._toe_offs: list[Span] = []
        muscles = PEOPLE["muscles"]
        for name in (*PANELS, *muscles):
            panel = PANELS.get(name)
            title = panel.title if panel else f"{name}, {muscles[name]}"
            plot = figure(
                name=f"cycle-{title}", height=HEIGHT_PX, tools="", toolbar_location=None,
                title=title, x_axis_label="stride (%)", x_range=(0, 100),
                y_axis_label=panel.unit if panel else "activation (1)",
                y_range=(panel.low, panel.high) if panel else (0.0, 1.05),
            )  # fmt: skip
            if panel:
                mean, sd = panel.at(PERCENT)
                plot.varea(PERCENT, mean - sd, mean + sd, fill_color=style.HUMAN, fill_alpha=0.35)
                plot.line(PERCENT, mean, line_color=style.FAINT, line_dash="dashed")
            else:
                starts, ends = zip(*EMG_ON_PERCENT[name], strict=True)
                plot.quad(starts, ends, 1.05, 0.0, fill_color=style.EMG, fill_alpha=0.6,
                          line_color=None)  # fmt: skip
            empty = dict.fromkeys(CURVES, NO_CURVE)
            source = ColumnDataSource({"x": PERCENT, **empty}, name=f"cycle-{name}")
            plot.varea("x", "low", "high", source=source, fill_color=style.MODEL, fill_alpha=0.3)
            plot.line("x", "right", source=source, line_color=style.OTHER_LEG)
            plot.line("x", "beside", source=source, line_color=style.BLACK, line_dash="dashed")
            plot.line("x", "y", source=source, line_color=style.MODEL, line_width=2)
            toe_off = Span(dimension="height", line_color=style.MODEL, line_dash="dotted")
            plot.add_layout(toe_off)
            plot.title.text_font_size = "11px"
            self._curves[name], self._figures[name] = source, plot
            self._toe_offs.append(toe_off)
        figures = flow(*self._figures.values(), least_px=LEAST_PX)
        self.layout: Column = column(self._words, figures, sizing_mode="stretch_width")

    def show(self, walk: walking.Walk, beside: bool = False) -> None:
        """The mean strides of a walk that has enough of them; of a gait beside it, the left leg."""
        whole, weight_n = finite(walk.trajectory), walk.experiment.weight_n(0)
        left, right = (gait_cycle.strides_of(whole, weight_n, side) for side in (LEFT, RIGHT))
        for name, toe_off in zip(self._curves, self._toe_offs, strict=True):
            mean, sd = _mean(left, name)
            if beside:
                self._curves[name].data = dict(self._curves[name].data) | {"beside": mean}
                continue
            curves = dict(zip(CURVES, (mean, mean - sd, mean + sd, _mean(right, name)[0]),
                              strict=False))  # fmt: skip
            self._curves[name].data = dict(self._curves[name].data) | curves
            offs = left.take_off_percent
            toe_off.location = float(offs.mean()) if left.enough and len(offs) else None
        if not beside:
            self._write(left)

    def forget(self) -> None:
        """Take away the curves of the gait beside it."""
        for source in self._curves.values():
            source.data = dict(source.data) | {"beside": NO_CURVE}

    def _write(self, left: Strides) -> None:
        """Set words, titles and axes."""
        self._words.text = (
            f"{gait_cycle.subtitle(left)} Blue: left leg, 1 sd and toe-off (dotted); orange: right "
            f"leg; black, dashed: the gait beside it. Grey: {gait_cycle.SOURCE}, number: RMSE; "
            f"sand: {gait_cycle.EMG_SOURCE}."
        )
        distances = gait_cycle.human_distances(left)
        for name, panel in PANELS.items():
            title, axis = panel.title.removeprefix("ground "), self._figures[name].y_range
            if far := distances.get(name):
                unit = "deg" if name.endswith("deg") else "bw"
                title += f": {far.rmse:.3g} {unit}, {far.deviations:.2g} sd"
            self._figures[name].title.text = title
            shown = [self._curves[name].data[curve] for curve in ("y", "low", "high", "right")]
            seen = [value for curve in shown for value in curve if np.isfinite(value)]
            axis.start = max(min([*seen, panel.low]), panel.floor)
            axis.end = min(max([*seen, panel.high]), panel.ceiling)


def _mean(strides: Strides, name: str) -> tuple[Floats, Floats]:
    """Mean and standard deviation of a panel's curve, by the panel's name or that of a muscle."""
    if not strides.enough:
        return NO_CURVE, NO_CURVE
    muscle = name in MUSCLES
    curves = strides.activation[MUSCLES.index(name)] if muscle else getattr(strides, name)
    return curves.mean(axis=0), curves.std(axis=0)


LEFT_OUT = ("end_reason", "hip_x_m", "hip_z_m")
FIELDS = tuple(name for name, _ in (*OUTCOME_FIELDS, *SCORE_FIELDS) if name not in LEFT_OUT)


class Score:
    """A table of numbers of two walks on the same ground."""

    def __init__(self) -> None:
        self._start: walking.Walk | None = None
        self._now: walking.Walk | None = None
        self.layout = Div(text="", name="score", disable_math=True)

    def show(self, walk: walking.Walk, start: bool) -> None:
        """The numbers of a walk; later ones are compared with those of a `start`."""
        self._now = walk
        if start or self._start is None:
            self._start = walk
        self._write(self._now, self._start)

    def compare(self, walk: walking.Walk) -> None:
        """The start is another walk from now on: that beside."""
        self._start = walk
        if self._now is not None:
            self._write(self._now, walk)

    def _write(self, walk: walking.Walk, start: walking.Walk) -> None:
        heads = (
            html.escape("start" if start is walk else start.gains.name),
            html.escape(walk.gains.name),
            "change",
        )
        text = "<tr><td></td>" + "".join(f"<th scope=col>{head}</th>" for head in heads) + "</tr>"
        for name in FIELDS:
            before, now = float(start.row[name]), float(walk.row[name])
            change = "" if before == now else f"{now - before:+.3g}"
            cells = (f"{before:.4g}", f"{now:.4g}", f"<b>{change}</b>")
            right = "".join(f"<td align=right>{cell}</td>" for cell in cells)
            text += f"<tr><th scope=row align=left>{in_words(name)[0]}</th>{right}</tr>"
        self.layout.text = f"<table cellspacing=4>{text}</table>"
