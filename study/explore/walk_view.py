"""The panels of the walker's page: gains, ground, the stage, the stride and the scores."""

import html
from collections.abc import Callable
from concurrent.futures import Executor
from functools import partial
from pathlib import Path
from typing import Any

from bokeh import models
from bokeh.document import Document
from bokeh.layouts import column, row

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
from study.explore.server import WRAPS, Latest, Message, Saver, flow
from study.explore.signals import Signals
from study.explore.stage import Player
from study.explore.strides import Cycle
from study.explore.trials import Trials
from study.explore.what_if import WhatIf
from study.report.people import FURTHER, QUANTITIES
from taichi_nmm.parameters import DEVICE, GAINS
from taichi_nmm.result import known_numbers
from taichi_nmm.settings import ENGINES

SIGNALS = "signals"
STRIDE = "stride beside people"
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
        self._figures: dict[str, Cycle | Signals] = {}
        self._signals = partial(Signals, document, makers, message, self._player.script)
        self._score = models.Div(text="", name="score", disable_math=True)
        self._others = Latest(document, walkers, self._walked_beside, message.failed)
        self._hands = Hands(self._again, self.show)
        self._files: dict[str, Any] = {}  # grounds of a person's own
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
        self._parts = {
            "gains": self._hands.layout,
            "what if": column(
                self._what_if.layout,
                self._repair.layout,
                sizing_mode="stretch_width",
            ),
            "score": self._score,
            SIGNALS: None,
            STRIDE: None,
            "take it with you": self._taking(),
        }
        self._part = models.RadioButtonGroup(
            labels=list(self._parts),
            active=0,
            stylesheets=[WRAPS],
            name="part",
            tags=[saver.source],
        )
        self._below = column(self._hands.layout, sizing_mode="stretch_width")
        message.watch(self._part, "active", self._turn)
        keep = models.Button(label="keep it beside", name="keep")
        keep.on_click(message.safely(lambda: self._put_beside(self._walk)))
        self._player.removed.on_click(message.safely(lambda: self._put_beside(None)))
        walk = column(
            flow(*self._choices.values(), keep),
            refusal.layout,
            self._player.layout,
            sizing_mode="stretch_width",
            name="The walk",
        )
        parts = column(
            self._part,
            self._below,
            sizing_mode="stretch_width",
            name="Gains, what if, score, signals, stride and files",
        )
        self.panels = [walk, parts]
        refusal.safely(self._go_on)()

    def _page(self) -> dict[str, Any]:
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

    def _add_ground(self, name: str, table: dict[str, Any]) -> None:
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
            for part in (SIGNALS, STRIDE):
                if self._looked_at == part:
                    self._drawn(part).show(self._walk, self._beside)

    @property
    def _looked_at(self) -> str:
        """The part that is shown."""
        return str(self._part.labels[self._part.active])

    def _drawn(self, part: str) -> Cycle | Signals:
        """Made when it is first looked at: a page would open a quarter later."""
        if part not in self._figures:
            self._figures[part] = Cycle() if part == STRIDE else self._signals()
        return self._figures[part]

    def _turn(self) -> None:
        """Show another part alone: a hidden figure never gets a size."""
        self._compare()
        part = self._looked_at
        self._below.children = [self._parts[part] or self._drawn(part).layout]

    def _taking(self) -> Any:
        names = (
            *walking.NAMES,
            walking.FILM,
            *walking.RECORDINGS,
            *walking.PICTURES,
        )
        buttons = [models.Button(label=name, name=f"save-{name}") for name in names]
        for button in buttons:
            button.on_click(self._message.safely(partial(self._take, button.label)))
        words = "With both files, this command draws, films and records the walk:"
        command = f"<code>{walking.COMMAND}</code>"
        if self._own.get("run"):
            command = f"<code>{walking.COMMAND} --run {self._own['run']}</code>"
        return column(
            flow(*buttons),
            models.Div(text=words),
            models.Div(text=command, name="command"),
            sizing_mode="stretch_width",
        )

    def _take(self, name: str) -> None:
        if self._walk is not None:
            self.save(walking.file_of_walk, self._walk, name)


def _choices(own: dict[str, Any]) -> dict[str, Any]:
    """By the names of `chosen_setting`'s arguments; first those of a study, if there is one."""
    study = [walking.OWN] if own else []
    grounds = [*study, *walking.GROUNDS]
    lasts = _lasts(grounds[0], own, {})
    menus: dict[str, tuple[str, list[str]]] = {
        "ground": ("ground", grounds),
        "world": ("world", [*study, *walking.WORLDS]),
        "disturbance": ("masses of the body", [*study, *walking.DISTURBANCES]),
        "engine": ("engine", list(ENGINES)),
        "duration_s": ("at most", list(dict.fromkeys([*walking.DURATIONS, lasts]))),
    }
    found: dict[str, Any] = {
        name: models.Select(
            title=title,
            options=options,
            value=options[0],
            name=name.removesuffix("_s"),
        )
        for name, (title, options) in menus.items()
    }
    found["duration_s"].value = lasts
    found["engine"].value = own.get("simulation", {}).get("engine", ENGINES[0])
    found["seed"] = models.Spinner(
        title="seed", value=own.get("seed", 1), step=1, mode="int", name="seed"
    )
    return found


def _lasts(ground: str, own: dict[str, Any], files: dict[str, Any]) -> str:
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

    def __init__(
        self, changed: Callable[[], None], start: Callable[[NamedGains], None]
    ) -> None:
        self._refusal = message = Message("gains-message")
        self._changed = changed
        self._start = start
        self._still = False  # while the page, not a person, moves the sliders
        self._starts = models.Select(
            title="start from", options=["", *STARTS], name="start"
        )
        self._sliders = [
            models.Slider(
                title=gain.meaning,
                start=gain.low,
                end=gain.high,
                value=gain.low,
                step=(gain.high - gain.low) / STEPS,
                show_value=False,
                stylesheets=[WRAPS],
                sizing_mode="stretch_width",
                name=f"gain-{gain.name}",
            )
            for gain in MOVED
        ]
        self._numbers = [
            models.NumericInput(
                title=f"{gain.name} ({gain.unit})",
                mode="float",
                format="0.[00000]",
                width=NUMBER_PX,
                name=f"number-{gain.name}",
            )
            for gain in MOVED
        ]
        message.watch(self._starts, "value", self._from_start)
        pairs = list(zip(self._sliders, self._numbers, strict=True))
        for place, (slider, number) in enumerate(pairs):
            slider.js_link("value", number, "value")
            number.js_link("value", slider, "value")
            message.watch(number, "value", partial(self._set, place))
        self.take(gains_of_source(STARTS[0]))
        rows = flow(*(row(*pair) for pair in pairs), least_px=300)
        self.layout: models.Column = column(
            self._starts, message.layout, rows, sizing_mode="stretch_width"
        )

    def take(self, gains: NamedGains) -> None:
        """Show other gains, without a call of `changed`."""
        self.gains = gains
        values = gains.by_name()
        for place, gain in enumerate(MOVED):
            self._show(place, values[gain.name])

    def _from_start(self) -> None:
        if self._starts.value:
            gains = gains_of_source(self._starts.value)
            self._starts.value = ""
            self._start(gains)

    def _set(self, place: int) -> None:
        gain, values = MOVED[place], self.gains.by_name()
        before, value = values[gain.name], self._numbers[place].value
        if self._still or value == before:
            return
        if value is None or not gain.low <= value <= gain.high:
            self._show(place, before)
            raise InputError(gain.name, value, f"{gain.low:g} to {gain.high:g}")
        self._refusal.tell("")
        name = self.gains.name.removesuffix(" changed") + " changed"
        self.gains = named_gains(name, {**values, gain.name: value})
        self._changed()

    def _show(self, place: int, value: float) -> None:
        self._still = True
        # The number first: a link that answered to the slider would change the number
        # once more.
        self._numbers[place].value = self._sliders[place].value = value
        self._still = False


def score_text(walk: walking.Walk, start: walking.Walk) -> str:
    """The numbers of a walk beside those of another one, and of people, in HTML."""
    first = "start" if start is walk else start.gains.name
    heads = ["number", first, walk.gains.name, "change", "people"]
    lines = ["".join(f"<th scope=col>{html.escape(head)}</th>" for head in heads)]
    known = [
        {**known_numbers(each.row), "mass_kg": each.mass_kg} for each in (start, walk)
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
