"""The page of a store: what was scored on the left, on the right a gait walks."""

import html
from collections.abc import Callable
from concurrent.futures import Executor
from functools import partial
from pathlib import Path

from bokeh.document import Document
from bokeh.layouts import column, row
from bokeh.models import Div

from storage.simulator import WALKER
from storage.store import Store, open_store
from study.experiment.folder import EXPERIMENT_NAME, RESULTS_NAME
from study.experiment.gains import gains_at, gains_of_source
from study.explore.downloads import file_of_selection
from study.explore.robot_view import RobotView
from study.explore.server import Message
from study.explore.store_view import StoreView
from study.explore.walk_view import WalkView
from study.pictures.movie import filmable
from taichi_nmm.errors import InputError
from taichi_nmm.reading import is_folder

Page = Callable[[Executor, Executor, Document], None]
"""Takes the processes that simulate, those that make files, and the document of a tab."""

FIRST_GAIT = "reference"
OF_COMPARISONS = (
    "a store; for a comparison: taichi-nmm report DIR, taichi-nmm dashboard DIR, "
    "or taichi-nmm walk --trial STUDY/NUMBER --storage DIR; for a bench: taichi-nmm bench serve"
)


def page_of(path: Path, simulator: str | None = None) -> Page:
    """What fills the document of a tab with a store, finished or not.

    Each tab reads the store anew: it may be growing. `simulator` films rows of a store of its own.

    Raises:
        InputError: a comparison, a bench, or no store that can be read.
    """
    if simulator is not None:
        filmable(simulator)
    compared = is_folder(path) and any(
        (path / name).exists() for name in (EXPERIMENT_NAME, RESULTS_NAME)
    )
    if compared or path.suffix == ".toml":
        raise InputError("folder", str(path), OF_COMPARISONS)
    _store(path)

    def fill(walkers: Executor, makers: Executor, document: Document) -> None:
        message = Message()
        try:
            store = _store(path)
            title = f"{path}: {len(store):,} rows"
            view: WalkView | RobotView
            if store.simulator == WALKER:
                view = WalkView(document, walkers, makers, message)
            else:
                view = RobotView(document, makers, message, simulator)
                title += f" of {store.simulator}"
            pick, save = partial(_pick, store, view), partial(view.save, file_of_selection, path)
            points = StoreView(store, message, pick, save)
        except Exception as error:  # the store cannot be read any more
            message.failed(error)
            document.add_root(message.layout)
            return
        document.title = title
        head = Div(text=f"<b>{html.escape(title)}</b>", disable_math=True)
        document.add_root(column(row(head, message.layout), row(points.layout, view.layout),
                                 margin=8))  # fmt: skip
        if isinstance(view, WalkView):
            message.safely(partial(view.show, gains_of_source(FIRST_GAIT)))()

    return fill


def _pick(store: Store, view: WalkView | RobotView, place: int, row: int) -> None:
    """Show a clicked row of the store."""
    if isinstance(view, WalkView):
        view.show(gains_at(store, place, row))
    else:
        view.show(store, place)


def _store(path: Path) -> Store:
    store = open_store(path, unfinished=True)
    store.require_bounds()
    return store
