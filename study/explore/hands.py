"""A slider and a number for each of the 16 gains."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from bokeh.layouts import column, row
from bokeh.models import Column, NumericInput, Select, Slider

from study.explore.message import Message
from study.gains import NamedGains, gains_of_source
from taichi_nmm.errors import InputError
from taichi_nmm.parameters import GAINS

STARTS = ("K_T", "reference")
STEPS = 400  # of a slider
SLIDER_PX, NUMBER_PX = 225, 95


class Hands:
    """What holds a walker's gains, and says so when a hand has changed them.

    Args:
        message: for a number that is out of its bounds.
        changed: called with the new gains.
        start: called with the gains of a starting point.
    """

    def __init__(
        self,
        message: Message,
        changed: Callable[[NamedGains], None],
        start: Callable[[NamedGains], None],
    ) -> None:
        self._message, self._changed, self._start = message, changed, start
        self._gains = gains_of_source(STARTS[0])
        self._still = False  # while the page, not a hand, moves them
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
        self.take(self._gains)
        pairs = [row(*pair) for pair in zip(self._sliders, self._numbers, strict=True)]
        half = len(pairs) // 2
        self.layout: Column = column(
            self._starts, row(column(*pairs[:half]), column(*pairs[half:]))
        )

    def take(self, gains: NamedGains) -> None:
        """Hold other gains; nobody is told."""
        self._gains = gains
        self._still = True
        for slider, number, value in zip(
            self._sliders, self._numbers, gains.gains.tolist(), strict=True
        ):
            slider.value, number.value = value, value
        self._still = False

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
            self._show(place, float(self._gains.gains[place]))
            raise InputError(gain.name, value, f"{gain.low:g} to {gain.high:g}")
        self._set(place, float(value))

    def _set(self, place: int, value: float) -> None:
        if self._still or value == self._gains.gains[place]:
            return
        gains = self._gains.gains.copy()
        gains[place] = np.clip(value, GAINS[place].low, GAINS[place].high)
        name = self._gains.name.removesuffix(" changed") + " changed"
        self._gains = replace(self._gains, name=name, gains=gains)
        self._show(place, value)
        self._message.tell("")
        self._changed(self._gains)

    def _show(self, place: int, value: float) -> None:
        self._still = True
        self._sliders[place].value = self._numbers[place].value = value
        self._still = False
