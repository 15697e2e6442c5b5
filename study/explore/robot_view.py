"""The right half of the page of a store of any simulator: a row's numbers, and a film of it.

A film is made where the command was given the simulator (`--simulator my_robot.py:robot`) and that
is one of MuJoCo: a store is data, and names code that is never looked for.
"""

import base64
import html
from concurrent.futures import Executor

import pyarrow as pa
from bokeh.document import Document
from bokeh.layouts import column, row
from bokeh.models import Button, Div, Select

from storage.store import Store
from study.explore.server import Latest, Message, Saver
from study.pictures.movie import filmed

BASE = "base setting"
DURATIONS_S = (5.0, 10.0, 20.0)
WIDTH_PX = 720


class RobotView:
    """A row of a store: its parameters, what it did in each family, and a film in a chosen world.

    Of processes, `makers` make films and files.
    """

    def __init__(
        self, document: Document, makers: Executor, message: Message, simulator: str | None
    ) -> None:
        self._message, self._simulator = message, simulator
        self._shown: tuple[Store, int] | None = None
        self._films = Latest(document, makers, self._filmed, message.failed)
        saver = Saver(document, makers, message)
        self.save = saver.save
        self._numbers = Div(text="click a point", name="numbers", width=WIDTH_PX, disable_math=True)
        self._video = Div(text="", name="film", width=WIDTH_PX, disable_math=True)
        self._video.tags = [saver.source]
        self._world = Select(title="world", options=[BASE], value=BASE, width=230, name="world")
        durations = [f"{duration:g} s" for duration in DURATIONS_S]
        self._duration = Select(title="at most", options=durations, value=durations[0], width=90)
        film = Button(label="film", width=80, name="film-it", disabled=simulator is None)
        film.on_click(message.safely(self._film))
        words = "" if simulator else "films: explore --simulator my_robot.py:robot"
        above = row(self._world, self._duration, film, Div(text=words, name="no-films"))
        self.layout = column(above, self._video, self._numbers)

    def show(self, store: Store, place: int) -> None:
        """Show a row, by its place among the store's rows."""
        self._shown = store, place
        self._world.options = [BASE, *world_names(store)]
        self._numbers.text = numbers_text(store, place)
        if self._simulator is not None:
            self._film()

    def _film(self) -> None:
        if self._shown is None or self._simulator is None:
            return
        store, place = self._shown
        names = store.gain_names
        point = dict(zip(names, store.gains()[place].tolist(), strict=True))
        seconds = float(self._duration.value.removesuffix(" s"))
        self._message.tell("filming ...")
        world = world_of(store, self._world.value)
        self._films.ask(filmed, self._simulator, point, world, seconds)

    def _filmed(self, content: bytes) -> None:
        self._message.tell("")
        film = base64.b64encode(content).decode()
        self._video.text = (
            f'<video width="{WIDTH_PX}" autoplay loop controls muted '
            f'src="data:video/mp4;base64,{film}"></video>'
        )


def world_names(store: Store) -> list[str]:
    """The worlds of a store's families, in which its rows ran."""
    return [
        f"{family} {number}"
        for family in store.families
        for number in range(len(_drawn(store, family).get("seed", ())))
    ]


def world_of(store: Store, name: str) -> dict[str, float]:
    """The numbers of a world, by its name among `world_names`; of the base setting, none."""
    if name == BASE:
        return {}
    family, _, number = name.rpartition(" ")
    return {key: float(each[int(number)]) for key, each in _drawn(store, family).items()}


def _drawn(store: Store, family: str) -> dict[str, list[float]]:
    drawn: dict[str, list[float]] = store.specification["families"][family].get("drawn", {})
    return drawn


def numbers_text(store: Store, place: int) -> str:
    """A row's numbers as a table in HTML: parameters, and columns of the base setting and means."""
    table = store.table().slice(place, 1)
    cells = [
        (name, value.as_py())
        for name, value in zip(table.column_names, (each[0] for each in table.columns), strict=True)
        if not pa.types.is_fixed_size_list(value.type)
    ]
    shown = [
        f"<tr><td>{html.escape(name)}</td><td>"
        f"{value:.4g}</td></tr>" if isinstance(value, float) else
        f"<tr><td>{html.escape(name)}</td><td>{html.escape(str(value))}</td></tr>"
        for name, value in cells
    ]  # fmt: skip
    third = -(-len(shown) // 3)
    parts = ["".join(shown[first : first + third]) for first in range(0, len(shown), third)]
    tables = "".join(f"<table style='font-size:11px'>{part}</table>" for part in parts)
    return f"<div style='display:flex;gap:24px;align-items:flex-start'>{tables}</div>"
