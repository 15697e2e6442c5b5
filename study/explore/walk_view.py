"""The panels of the walker's page: gains, ground, the stage, the stride and the scores."""

import html
from collections.abc import Callable
from concurrent.futures import Executor
from functools import cache, partial
from pathlib import Path
from typing import Any

from bokeh.document import Document
from bokeh.models import (
    Column,
    CustomJS,
    Div,
    NumericInput,
    RadioButtonGroup,
    Row,
    Select,
    Slider,
    Spinner,
)

from storage.inputs.errors import InputError
from storage.store import Store
from study.experiment.gains import (
    NamedGains,
    gains_at,
    gains_of_source,
    named_gains,
)
from study.explore import walk as walking
from study.explore.repair_view import RepairView
from study.explore.server import Call, Latest, Message, Saver, flow
from study.explore.signals import Signals
from study.explore.stage import Player
from study.explore.strides import Cycle
from study.explore.trials import Trials
from study.explore.what_if import WhatIf
from study.explore.words import CHOICES, Tables
from study.report.people import FURTHER, QUANTITIES
from taichi_nmm.parameters import DEVICE, GAINS, Parameter
from taichi_nmm.result import known_numbers
from taichi_nmm.settings import ENGINES

FIRST_GAIT = "reference"


class WalkView:
    """Choices of a setting, the stages, the gains, and files to save.

    Of processes, `walkers` simulate and `makers` make files; `repairs` are those that
    run trials, and a file, as `RepairView` has them. The walks of a study of
    ours are as its experiment has them, until another setting is chosen.
    """

    def __init__(
        self,
        document: Document,
        walkers: Executor,
        makers: Executor,
        message: Message,
        store: Store,
        repairs: tuple[Executor, Path],
    ) -> None:
        self._message = message
        self._store = store
        self._own = store.document if isinstance(store, Trials) else {}
        self._walk: walking.Walk | None = None
        self._start: walking.Walk | None = None  # with which later ones are compared
        self._beside: walking.Walk | None = None  # of the gait that is kept
        self._makers = makers
        self._walks = Latest(document, walkers, self._walked, self._failed)
        saver = Saver(document, makers, message)
        self.save = saver.save
        self._player = Player(document)
        self._score = Div(name="score")
        self._others = Latest(document, walkers, self._walked_beside, message.failed)
        self._hands = Hands(self._again, self.show)
        self._files: Tables = {}  # grounds of a person's own
        self._what_if = WhatIf(self._chosen, self._add_ground)
        menders, noted = repairs
        self._repair = RepairView(
            document=document,
            menders=menders,
            noted=noted,
            store=store,
            show=self._show_repaired,
            page=self._page,
        )
        self._choices = _choices(self._own)
        self._refusal = refusal = Message("setting-message")
        for name, choice in self._choices.items():
            answer = self._on_ground if name == "ground" else self._chosen
            refusal.watch(choice, "value", answer)
        # What draws is made when it is first looked at: a page would open a quarter later.
        self._figures: dict[str, Callable[[], Signals | Cycle]] = {
            "signals": cache(
                partial(Signals, document, makers, message, self._player.script)
            ),
            "stride beside people": cache(Cycle),
        }
        self._parts = {
            "gains": self._hands.layout,
            "what if": Column(self._what_if.layout, self._repair.layout),
            "score": self._score,
            **dict.fromkeys(self._figures),
            "take it with you": self._taking(),
        }
        self._part = RadioButtonGroup(
            labels=list(self._parts), active=0, name="part", tags=[saver.source]
        )
        self._below = Column(self._hands.layout)
        message.watch(self._part, "active", self._turn)
        keep = message.button(
            "keep it beside", lambda: self._put_beside(self._walk), name="keep"
        )
        self._player.removed.on_click(message.safely(lambda: self._put_beside(None)))
        walk = Column(
            flow(*self._choices.values(), keep),
            refusal.layout,
            self._player.layout,
            name="The walk",
        )
        parts = Column(
            self._part,
            self._below,
            name="Gains, what if, score, signals, stride and files",
        )
        self.panels = [walk, parts]
        refusal.safely(self._go_on)()

    def _page(self) -> Tables:
        """What a repair is of, for a later tab."""
        return {
            "files": self._files,
            "choices": {name: each.value for name, each in self._choices.items()},
            "what_if": self._what_if.tables,
        }

    def _go_on(self) -> None:
        """Repair what an earlier tab was repairing."""
        known = self._repair.left()
        if known is not None:
            for name, table in known["files"].items():
                self._add_ground(name, table)
            for name, value in known["choices"].items():
                self._choices[name].value = value
            self._what_if.take(known["what_if"])
            self._repair.begin()

    def start(self) -> None:
        """Let the first gait walk."""
        self.show(gains_of_source(FIRST_GAIT))

    def show_row(self, place: int, row: int) -> None:
        """Let the gains of a row walk, by its place among the store's rows and its number."""
        self.show(gains_at(self._store, place, row))

    def show(self, gains: NamedGains) -> None:
        """Let gains walk in the setting of the choices."""
        self._start = None
        self._show_repaired(gains)

    def _show_repaired(self, gains: NamedGains) -> None:
        """Let gains walk beside the start, which the repair is of."""
        self._hands.take(gains)
        self._again()

    def _on_ground(self) -> None:
        """Walk until the ground has been met: flat ground lies before all others."""
        duration = self._choices["duration_s"]
        lasts = _lasts(self._choices["ground"].value, self._own, self._files)
        if duration.value == lasts:
            self._chosen()
        else:
            duration.value = lasts  # which is another choice

    def _add_ground(self, name: str, table: Tables) -> None:
        """Let a ground of a person's own be chosen, and walk there."""
        menu = self._choices["ground"]
        self._files[name] = table
        menu.options = list(dict.fromkeys([*menu.options, name]))
        if menu.value == name:  # read again
            self._chosen()
        menu.value = name

    def _failed(self, error: BaseException) -> None:
        self._message.failed(error)
        self._player.stages[0].say("no walk", "see above")

    def _chosen(self) -> None:
        self._start = None  # a walk of another setting is no comparison
        self._again()

    def _again(self) -> None:
        self._message.tell("")
        self._refusal.tell("")
        chosen = {name: choice.value for name, choice in self._choices.items()}
        chosen["duration_s"] = float(chosen["duration_s"].removesuffix(" s"))
        robot = chosen["disturbance"], chosen["world"], self._own
        self._what_if.lie_on(walking.chosen_robot(*robot))
        setting = walking.chosen_setting(
            **chosen, own=self._own, files=self._files, changes=self._what_if.tables
        )
        self._repair.take(setting)
        self._player.stages[0].say(self._hands.gains.name, "simulating ...")
        self._walks.ask(walking.walk, self._hands.gains, setting)
        if self._beside is not None:
            self._others.ask(walking.walk, self._beside.gains, setting)

    def _walked(self, found: walking.Walk) -> None:
        if self._walk is None:  # the page is there: time for what may be asked next
            self._makers.submit(walking.warm_up)
        self._walk = found
        self._start = self._start or found
        self._player.show(found)
        self._compare()

    def _walked_beside(self, found: walking.Walk) -> None:
        if self._beside is not None:  # it may have been removed meanwhile
            self._put_beside(found)

    def _put_beside(self, walk: walking.Walk | None) -> None:
        """Keep a walk beside the next ones; none takes it away."""
        self._beside = walk
        self._player.show(walk, place=1)
        self._compare()

    def _compare(self) -> None:
        """Show the numbers of both gaits, and their strides where they are looked at."""
        start = self._beside or self._start
        if self._walk is not None and start is not None:
            self._score.text = score_text(self._walk, start)
            if (drawn := self._figures.get(self._looked_at)) is not None:
                drawn().show(self._walk, self._beside)

    @property
    def _looked_at(self) -> str:
        """The part that is shown."""
        return str(self._part.labels[self._part.active])

    def _turn(self) -> None:
        """Show another part alone: a hidden figure never gets a size."""
        self._compare()
        part = self._looked_at
        self._below.children = [self._parts[part] or self._figures[part]().layout]

    def _taking(self) -> Any:
        buttons = [
            self._message.button(name, partial(self._take, name), name=f"save-{name}")
            for name in walking.FILES
        ]
        words = "With both files, this command draws, films and records the walk:"
        run = self._own.get("run")
        command = walking.COMMAND + (f" --run {run}" if run else "")
        return Column(
            flow(*buttons),
            Div(text=words),
            Div(text=f"<code>{command}</code>", name="command"),
        )

    def _take(self, name: str) -> None:
        if self._walk is not None:
            self.save(walking.file_of_walk, self._walk, name)


def _choices(own: Tables) -> Tables:
    """By the names of `chosen_setting`'s arguments; first those of a study, if there is one."""
    study = [walking.OWN] if own else []
    grounds = [*study, *walking.GROUNDS]
    lasts = _lasts(grounds[0], own, {})
    menus = {
        "ground": grounds,
        "world": [*study, *walking.WORLDS],
        "disturbance": [*study, *walking.DISTURBANCES],
        "engine": list(ENGINES),
        "duration_s": list(dict.fromkeys([*walking.DURATIONS, lasts])),
    }
    first = {**own.get("simulation", {}), "duration_s": lasts}
    found: Tables = {
        name: Select(
            title=CHOICES["menus"].get(name, name),
            options=options,
            value=first.get(name, options[0]),
            name=name.removesuffix("_s"),
        )
        for name, options in menus.items()
    }
    found["seed"] = Spinner(
        title="seed", value=own.get("seed", 1), step=1, mode="int", name="seed"
    )
    return found


def _lasts(ground: str, own: Tables, files: Tables) -> str:
    """How long a walk is asked for at first: as in the study, or until it has met the ground."""
    if ground == walking.OWN:
        return f"{own['simulation']['duration_s']:.12g} s"
    kind = {**walking.GROUNDS, **files}[ground]["kind"]
    return f"{walking.LASTS_S[kind]:g} s"


STARTS = ("published", "reference")
MOVED = (*GAINS, *DEVICE)  # by hand: gains, and the torque of an exoskeleton
STEPS = 400  # of a slider
NUMBER_PX = 130


class Hands:
    """A slider and a number for each of `MOVED` of a walker.

    `changed` is called when a person has changed `gains`, `start` with those of a
    starting point.
    """

    def __init__(self, changed: Call, start: Callable[[NamedGains], None]) -> None:
        self._refusal = message = Message("gains-message")
        self._changed = changed
        self._start = start
        self._starts = Select(title="start from", options=["", *STARTS], name="start")
        message.watch(self._starts, "value", self._from_start)
        self._fields: dict[str, tuple[NumericInput, Slider]] = {}
        for gain in MOVED:
            slider = Slider(
                title=gain.meaning,
                start=gain.low,
                end=gain.high,
                value=gain.low,
                step=(gain.high - gain.low) / STEPS,
                show_value=False,
                name=f"gain-{gain.name}",
            )
            number = NumericInput(
                title=f"{gain.name} ({gain.unit})",
                mode="float",
                format="0.[00000]",
                width=NUMBER_PX,
                name=f"number-{gain.name}",
            )
            slider.js_link("value", number, "value")
            # An emptied number has no value, which a slider cannot take.
            moved = "if (cb_obj.value !== null) slider.value = cb_obj.value"
            number.js_on_change("value", CustomJS(args={"slider": slider}, code=moved))
            message.watch(number, "value", partial(self._set, gain))
            self._fields[gain.name] = number, slider
        self.take(gains_of_source(STARTS[0]))
        rows = [Row(slider, number) for number, slider in self._fields.values()]
        self.layout = Column(self._starts, message.layout, flow(*rows, least_px=300))

    def take(self, gains: NamedGains) -> None:
        """Show other gains, without a call of `changed`."""
        self.gains = gains
        values = gains.by_name()
        for name in self._fields:
            self._show(name, values[name])

    def _from_start(self) -> None:
        if self._starts.value:
            gains = gains_of_source(self._starts.value)
            self._starts.value = ""
            self._start(gains)

    def _set(self, gain: Parameter) -> None:
        values, (number, _) = self.gains.by_name(), self._fields[gain.name]
        before, value = values[gain.name], number.value
        if value == before:  # the page, not a person, has moved it
            return
        if value is None or not gain.low <= value <= gain.high:
            self._show(gain.name, before)
            raise InputError(gain.name, value, f"{gain.low:g} to {gain.high:g}")
        self._refusal.tell("")
        name = self.gains.name.removesuffix(" changed") + " changed"
        self.gains = named_gains(name, {**values, gain.name: value})
        self._changed()

    def _show(self, name: str, value: float) -> None:
        # The number first: a link that answered to the slider would change the number
        # once more.
        for field in self._fields[name]:
            field.value = value


def score_text(walk: walking.Walk, start: walking.Walk) -> str:
    """The numbers of a walk beside those of another one, and of people, in HTML."""
    first = "start" if start is walk else start.gains.name
    heads = ["number", first, walk.gains.name, "change", "people"]
    lines = ["".join(f"<th scope=col>{html.escape(head)}</th>" for head in heads)]
    known = [
        {
            **known_numbers(each.row),
            "mass_kg": each.experiment.body(each.run).mass_kg.sum(),
        }
        for each in (start, walk)
    ]
    for each in (*QUANTITIES, *FURTHER):
        before, now = (each.value(numbers) for numbers in known)
        change = ""
        if before is not None and now is not None and before != now:
            sign = "+" if now > before else ""
            change = f"<b>{sign}{each.text(now - before).lstrip('+')}</b>"
        cells = (each.text(before), each.text(now), change, each.range_text)
        row = "".join(f"<td align=right nowrap>{cell}" for cell in cells)
        lines.append(f"<th scope=row align=left>{html.escape(each.label)}</th>{row}")
    return f"<table cellspacing=4><tr>{'<tr>'.join(lines)}</table>"
