"""Signals of both gaits over time, or over the stride beside people: any columns of a recording.

A recording is that of the command `walk` (study/pictures/trajectory_files.py), with its
names and units. It takes eight times as long as the walk, and is made in another
process, while signals are looked at.
"""

import html
from concurrent.futures import Executor
from itertools import zip_longest
from typing import Any

import numpy as np
from bokeh.document import Document
from bokeh.layouts import gridplot
from bokeh.models import Column, DataRange1d, Div, MultiChoice, RadioButtonGroup

from study.explore.curves import Curves, Plot, curve, people
from study.explore.server import Latest, Message
from study.explore.stage import OVER_TIME
from study.explore.walk import Walk, recorded
from study.explore.words import CHOICES, in_words
from study.pictures import gait_cycle
from study.pictures.gait_cycle import PANELS, PERCENT
from study.pictures.stick_figure import LEFT, RIGHT
from study.pictures.trajectory_files import OWN_COLUMNS, own_columns
from taichi_nmm.result import Trajectory

OVER = (OVER_TIME, "over the stride")
X_AXES = ("time (s)", "stride (%)")
FIRST = ("l_knee_flexion_rad", "l_ground_z_n")
MOST = 8  # signals at once
HEIGHT_PX = 150  # of a signal
SIDES = {"l_": "left ", "r_": "right "}
GAITS = {"signal": "blue", "beside": "black, dashed"}  # as they are drawn


def label(name: str) -> str:
    """A column in words with its unit, and its name in files."""
    side = SIDES.get(name[:2], "")
    words, _ = in_words(name[2:] if side else name)
    return f"{side}{words}: {name}"


class Signals:
    """A field to find columns in, and a figure for each that is chosen.

    The present walk is drawn blue, the one beside it black and dashed. A click on a
    figure over time moves the clock, by `script` of the player. `names` and `over` are
    the fields, `plots` the figures: empty at first, since a new one takes half a second.
    """

    def __init__(
        self, document: Document, makers: Executor, message: Message, script: Any
    ) -> None:
        self._walks: tuple[Walk | None, ...] = (None, None)
        self._recorded: dict[Walk, Trajectory] = {}
        # What decides the curves of each figure, as they were drawn.
        self._drawn: list[Any] = [()] * MOST
        self._calls = [
            Latest(document, makers, self._came, message.failed) for _ in GAITS
        ]
        labels = [(name, label(name)) for name in OWN_COLUMNS]
        self.names = MultiChoice(
            title="signals: type parts of a name",
            options=labels,
            value=list(FIRST),
            max_items=MOST,
            search_option_limit=len(labels),
            placeholder="type here, such as left soleus",
            name="signals",
        )
        self.over = RadioButtonGroup(labels=list(OVER), active=0, name="over")
        self._words = Div(name="signal-words")
        x_range = DataRange1d(range_padding=0.0)
        self.plots = [
            Plot(
                f"signals-{slot}",
                height=HEIGHT_PX,
                tools="xpan,xwheel_zoom,reset,save",
                x_range=x_range,
                visible=False,
            )
            for slot in range(MOST)
        ]
        figures = [plot.figure for plot in self.plots]
        for figure in figures:
            figure.yaxis.ticker.desired_num_ticks = 4
            figure.js_on_event("tap", script)
        grid = gridplot([[each] for each in figures], toolbar_location="above")
        self.layout = Column(self.names, self.over, self._words, grid)
        message.watch(self.names, "value", self._draw)
        message.watch(self.over, "active", self._draw)

    def show(self, *walks: Walk | None) -> None:
        """Draw the signals of a walk, and of another one, as soon as they are recorded."""
        before, self._walks = self._walks, walks
        known = self._recorded
        self._recorded = {walk: known[walk] for walk in walks if walk in known}
        for call, walk, old in zip_longest(self._calls, walks, before):
            if walk is not None and walk is not old and walk not in known:
                call.ask(recorded, walk, id(walk))
        self._draw()

    def _came(self, found: tuple[Trajectory, int]) -> None:
        trajectory, number = found
        for walk in self._walks:
            if walk is not None and id(walk) == number:  # else others have come since
                self._recorded[walk] = trajectory
        self._draw()

    def _draw(self) -> None:
        """Draw what has changed."""
        self._say()
        over = self.over.active
        for slot, name in zip_longest(range(MOST), self.names.value):
            plot = self.plots[slot]
            decides = (name, over, *self._walks, len(self._recorded))
            plot.figure.visible = name is not None
            if name is None or self._drawn[slot] == decides:
                continue
            self._drawn[slot] = decides
            plot.figure.title.text = label(name)
            plot.figure.tags = [OVER[over], name]
            plot.figure.xaxis.axis_label = X_AXES[over]
            curves = self._of_people(name) if over else {}
            for look, walk in zip(GAITS, self._walks, strict=True):
                if walk in self._recorded:
                    curves |= self._curve(look, self._recorded[walk], name)
            plot.draw(curves)

    def _say(self) -> None:
        """Which colour is which, or that it is still being recorded."""
        parts = []
        for look, walk in zip(GAITS.values(), self._walks, strict=True):
            if walk is not None:
                state = "" if walk in self._recorded else " (recording ...)"
                parts.append(f"{look}: {walk.gains.name}{state}")
        if self.over.active:
            parts.append("mean ± 1 sd of whole strides after settling")
            parts.append(f"grey: {gait_cycle.SOURCE}; sand: {gait_cycle.EMG_SOURCE}")
        self._words.text = html.escape("; ".join(parts))

    def _of_people(self, name: str) -> Curves:
        """What people do over a stride, in the unit of the column, and when a muscle is on."""
        walk, own = self._walks[0], name[2:]
        usual = (own.removesuffix("_activation"), 1.0)
        panel_name, sign = CHOICES["of_people"].get(own, usual)
        if panel_name not in PANELS or walk is None:
            return {}
        weight_n = walk.experiment.weight_n(walk.run)
        units = {"rad": np.deg2rad(1.0), "n": weight_n}
        return people(PANELS[panel_name], sign * units.get(own.rpartition("_")[2], 1.0))

    def _curve(self, look: str, trajectory: Trajectory, name: str) -> Curves:
        """What is drawn of a column of a gait: nothing over too few strides."""
        values = own_columns(trajectory)[name]
        if not self.over.active:
            return {look: curve(trajectory.time_s, values)}
        side = RIGHT if name.startswith("r_") else LEFT
        times_s = gait_cycle.stride_times(trajectory, side)
        if len(times_s) < gait_cycle.FEWEST_STRIDES:
            return {}
        strides = np.interp(times_s, trajectory.time_s, values)
        return {look: curve(PERCENT, strides.mean(axis=0), strides.std(axis=0))}
