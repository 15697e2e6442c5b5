"""The right half of a page: the gains of a gait, the ground it walks on, and the walk."""

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
    Div,
    NumericInput,
    RadioButtonGroup,
    Select,
    Slider,
    Spinner,
)

from study.experiment.gains import NamedGains, gains_of_source
from study.explore.downloads import COMMAND, NAMES, file_of_walk
from study.explore.server import Latest, Message, Saver
from study.explore.stage import Cycle, Player, Score
from study.explore.walk import (
    DISTURBANCES,
    DURATIONS_S,
    GROUNDS,
    WORLDS,
    Walk,
    chosen_setting,
    walk,
)
from taichi_nmm.errors import InputError
from taichi_nmm.parameters import GAINS
from taichi_nmm.settings import ENGINES


class WalkView:
    """Choices of a setting, the stages, the gains, and files to save.

    Of processes, `walkers` simulate and `makers` make files.
    """

    def __init__(
        self, document: Document, walkers: Executor, makers: Executor, message: Message
    ) -> None:
        self._message = message
        self._walk: Walk | None = None
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
        setting = chosen_setting(**chosen)
        self._walks.ask(walk, self._hands.gains, setting)
        if self._beside is not None:
            self._others.ask(walk, self._beside, setting)

    def _walked(self, found: Walk) -> None:
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
        buttons = []
        for name in NAMES:
            button = Button(label=name, width=110, name=f"save-{name}")
            button.on_click(self._message.safely(partial(self._take, name)))
            buttons.append(button)
        words = Div(text="With both files, this command draws, films and records the walk:")
        command = Div(text=f"<code>{COMMAND}</code>", name="command", width=700)
        return column(row(*buttons), words, command)

    def _take(self, name: str) -> None:
        if self._walk is not None:
            self.save(file_of_walk, self._walk, name)


def _choices() -> dict[str, Any]:
    """By the names of `chosen_setting`'s arguments."""
    grounds = list(GROUNDS)
    durations = [f"{duration:g} s" for duration in DURATIONS_S]
    return {
        "ground": Select(title="ground", options=grounds, value=grounds[0], width=230,
                         name="ground"),
        "disturbance": Select(title="masses of the body", options=list(DISTURBANCES),
                              value="nominal", width=140, name="disturbance"),
        "seed": Spinner(title="seed of body, ground, world", step=1, value=1, mode="int",
                        width=180, name="seed"),
        "world": Select(title="world", options=list(WORLDS), value="nominal", width=200,
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
        self._numbers = [
            NumericInput(mode="float", width=NUMBER_PX, name=f"number-{gain.name}")
            for gain in GAINS
        ]
        message.watch(self._starts, "value", self._from_start)
        for place, (slider, number) in enumerate(zip(self._sliders, self._numbers, strict=True)):
            message.watch(slider, "value", partial(self._moved, place))
            message.watch(number, "value", partial(self._typed, place))
        self.take(gains_of_source(STARTS[0]))
        pairs = [row(*pair) for pair in zip(self._sliders, self._numbers, strict=True)]
        half = len(pairs) // 2
        self.layout: Column = column(
            self._starts, row(column(*pairs[:half]), column(*pairs[half:]))
        )

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
