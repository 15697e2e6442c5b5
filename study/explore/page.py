"""The page of a store or a study: what was scored on the left, on the right a gait walks.

Of other simulators than the walker, the right half has a row's numbers, and a film of
it where the command was given the simulator (`--simulator my_robot.py:robot`) and that
is one of MuJoCo: a store is data, and names code that is never looked for.
"""

import base64
import html
from collections.abc import Callable
from concurrent.futures import Executor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from bokeh.document import Document
from bokeh.models import Column, Div, Select

from storage.simulator import WALKER
from storage.specification import require_parameters
from storage.store import Store
from storage.tables import document_hash
from study.experiment.repair import DIGITS
from study.explore.server import THEME, Latest, Message, Saver, flow
from study.explore.store_view import StoreView, file_of_selection, numbers_of
from study.explore.trials import Trials, open_rows
from study.explore.walk_view import WalkView
from study.explore.words import Tables
from study.pictures.movie import filmable, filmed

Page = Callable[[Executor, Executor, Executor, Document], None]
"""Takes processes that simulate, make files and repair, and the document of a tab."""

BASE = "base setting"
TEMPLATE = Path(__file__).with_name("page.html").read_text(encoding="utf-8")
VIDEO_CSS = "video { width: 100% }"


class RobotView:
    """A row of a store: its parameters, what it did in each family, and a film in a chosen world.

    Of processes, `makers` make films and files. What films the rows is `robot`, the
    simulator of this name, or None.
    """

    def __init__(
        self,
        document: Document,
        makers: Executor,
        message: Message,
        store: Store,
        simulator: str | None,
        robot: Any,
    ) -> None:
        self._message = message
        self._store = store
        self._simulator = simulator
        self._robot = robot
        self._place: int | None = None  # of the row that is shown
        self._films = Latest(document, makers, self._filmed, message.failed)
        saver = Saver(document, makers, message)
        self.save = saver.save
        self._numbers = Div(text="click a point", name="numbers")
        self._video = Div(name="film", stylesheets=[VIDEO_CSS], tags=[saver.source])
        self._world = Select(title="world", options=[BASE], value=BASE, name="world")
        self._duration = Select(
            title="at most", options=["5 s", "10 s", "20 s"], value="5 s"
        )
        film = message.button(
            "film", self._film, name="film-it", disabled=simulator is None
        )
        words = "" if simulator else "films: explore --simulator my_robot.py:robot"
        no_films = Div(text=words, name="no-films")
        panel = Column(
            flow(self._world, self._duration, film, no_films),
            self._video,
            self._numbers,
            name="The chosen row",
        )
        self.panels = [panel]

    def start(self) -> None:
        """Wait for a click on a row."""

    def show_row(self, place: int, row: int) -> None:
        """Show a row, by its place among the store's rows; its number is not asked for."""
        self._place = place
        self._world.options = list(worlds_of(self._store))
        self._numbers.text = numbers_text(self._store, place)
        self._film()

    def _film(self) -> None:
        if self._place is None or self._robot is None:
            return
        # A store has whole numbers as floats, a choice as its number.
        values = self._store.points()[self._place].tolist()
        point = {
            name: self._robot.space[name].to_external_repr(value)
            for name, value in zip(self._store.parameter_names, values, strict=True)
        }
        seconds = float(self._duration.value.removesuffix(" s"))
        self._message.tell("filming ...")
        world = worlds_of(self._store)[self._world.value]
        self._films.ask(filmed, self._simulator, world, seconds, point)

    def _filmed(self, content: bytes) -> None:
        self._message.tell("")
        film = base64.b64encode(content).decode()
        self._video.text = (
            f'<video autoplay loop controls muted aria-label="the run" '
            f'src="data:video/mp4;base64,{film}"></video>'
        )


def worlds_of(store: Store) -> dict[str, dict[str, float]]:
    """The numbers of the worlds in which a store's rows ran, by name."""
    drawn = store.specification.get("drawn", {})
    found = {BASE: {name: float(each[0]) for name, each in drawn.items()}}
    for family in store.families:
        drawn = store.settings_of(family).get("drawn", {})
        for number in range(len(drawn.get("seed", ()))):
            world = {name: float(each[number]) for name, each in drawn.items()}
            found[f"{family} {number}"] = world
    return found


def numbers_text(store: Store, place: int) -> str:
    """A row's numbers as a table in HTML: parameters, and columns of the base setting and means."""
    (row,) = store.table().slice(place, 1).to_pylist()
    lines = []
    for name, value in row.items():
        if isinstance(value, list):  # of each world
            continue
        if isinstance(value, float):
            number = numbers_of(store, name)[place]
            value = None if np.isnan(number) else f"{number:.4g}"
        text = "-" if value is None else str(value)
        lines.append(
            f"<tr><td>{html.escape(name)}</td><td>{html.escape(text)}</td></tr>"
        )
    rows = "".join(lines)
    return f"<div style='columns: 240px; font-size: 11px'><table>{rows}</table></div>"


def page_of(
    path: Path, repairs: Path, study: str | None = None, simulator: str | None = None
) -> Page:
    """What fills the document of a tab with a store, finished or not, or a study.

    Each tab reads the rows anew: there may be more. The arguments are those of
    `open_rows`, a folder for repairs, and a simulator that films the rows of its own.

    Raises:
        InputError: as `open_rows`, or no simulator to film.
    """
    rows = open_rows(path, study)
    robot = None if simulator is None else filmable(simulator, rows.parameter_names)
    # whose numbers have no kinds
    if robot is not None and not isinstance(rows, Trials):
        require_parameters(rows, robot)

    rows_hash = document_hash({"path": str(path.resolve()), "study": study})
    noted = repairs / f"{rows_hash[:DIGITS]}.json"  # of what is repaired

    def fill(
        walkers: Executor, makers: Executor, menders: Executor, document: Document
    ) -> None:
        message = Message("message")
        document.title = str(path)
        document.template = TEMPLATE
        document.theme = THEME
        try:
            store = open_rows(path, study)
            shared: Tables = {
                "document": document,
                "makers": makers,
                "message": message,
                "store": store,
            }
            view = (
                WalkView(**shared, walkers=walkers, repairs=(menders, noted))
                if store.simulator == WALKER
                else RobotView(**shared, simulator=simulator, robot=robot)
            )
            points = StoreView(
                store,
                message,
                pick=view.show_row,
                save=partial(view.save, file_of_selection, store),
            )
        except Exception as error:  # the store cannot be read any more
            message.failed(error)
            document.add_root(message.layout)
            return
        document.title = title_of(store, path)
        # Frozen: else Bokeh walks through all models after each root.
        with document.models.freeze():
            first, *later = view.panels
            above, below = points.panels
            for root in (message.layout, above, first, below, *later):
                document.add_root(root)
        if isinstance(store, Trials):
            points.row.value = store.best
        else:
            message.safely(view.start)()

    return fill


def title_of(store: Store, path: Path) -> str:
    """Of a tab: where the rows are, how many, and of what."""
    rows = store.ROW if len(store) == 1 else f"{store.ROW}s"
    title = f"{path}: {len(store):,} {rows}"
    of = store.study if isinstance(store, Trials) else store.simulator
    return title if of == WALKER else f"{title} of {of}"
