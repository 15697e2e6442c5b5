"""The page of a store or a comparison: what was scored on the left, on the right a gait walks."""

import html
from collections.abc import Callable
from concurrent.futures import Executor
from functools import partial
from pathlib import Path
from typing import Any

from bokeh.document import Document
from bokeh.layouts import column, row
from bokeh.models import Div

from storage.simulator import WALKER
from storage.store import SHARD_PATTERN, Store, open_store
from storage.store_folder import SPECIFICATION_NAME
from study.experiment.experiment import Experiment
from study.experiment.folder import EXPERIMENT_NAME, RESULTS_NAME
from study.experiment.gains import gains_at, gains_of_source
from study.experiment.identity import documented_experiment
from study.explore.comparison_view import ComparisonView
from study.explore.downloads import file_of_selection
from study.explore.robot_view import RobotView, filmable
from study.explore.server import Message
from study.explore.store_view import StoreView
from study.explore.walk_view import WalkView
from study.report.runs import Results, read_results
from taichi_nmm.errors import InputError
from taichi_nmm.reading import is_file, is_folder

Page = Callable[[Executor, Executor, Document], None]
"""Takes the processes that simulate, those that make files, and the document of a tab."""

Left = tuple[str, Any, Callable[[], None]]
"""A page's title, the layout of its left half, and what lets the first gait walk."""

FIRST_GAIT = "reference"


def page_of(path: Path, simulator: str | None = None) -> Page:
    """What fills the document of a tab with a store or a comparison, finished or not.

    Each tab reads the folder anew: it may be growing. `simulator` films rows of a store of its own.

    Raises:
        InputError: neither a store nor a comparison, or one that cannot be read.
    """
    if simulator is not None:
        filmable(simulator)
    compared = is_folder(path) and any(
        (path / name).exists() for name in (EXPERIMENT_NAME, RESULTS_NAME)
    )
    if compared:
        _comparison(path)
    elif is_file(path) or (is_folder(path) and _of_store(path)):
        _store(path)
    else:
        raise InputError("folder", str(path), "the folder of a store or of a comparison")

    def fill(walkers: Executor, makers: Executor, document: Document) -> None:
        message = Message()
        try:
            view: WalkView | RobotView
            if not compared and (store := _store(path)).simulator != WALKER:
                view = RobotView(document, makers, message, simulator)
                title, left, begin = _robot_half(path, store, message, view)
            else:
                view = WalkView(document, walkers, makers, message, tried=compared)
                half = _comparison_half if compared else _store_half
                title, left, begin = half(path, message, view)
        except Exception as error:  # the folder cannot be read any more
            message.failed(error)
            document.add_root(message.layout)
            return
        document.title = title
        head = Div(text=f"<b>{html.escape(title)}</b>", disable_math=True)
        document.add_root(column(row(head, message.layout), row(left, view.layout), margin=8))
        message.safely(begin)()

    return fill


def _of_store(path: Path) -> bool:
    return (path / SPECIFICATION_NAME).exists() or any(path.glob(SHARD_PATTERN))


def _store(path: Path) -> Store:
    store = open_store(path, unfinished=True)
    store.require_bounds()
    return store


def _comparison(path: Path) -> tuple[Results, Experiment]:
    results = read_results(path)
    return results, documented_experiment(results.facts)


def _store_half(path: Path, message: Message, view: WalkView) -> Left:
    store = _store(path)
    points = StoreView(
        store,
        message,
        pick=lambda place, row: view.show(gains_at(store, place, row)),
        save=partial(view.save, file_of_selection, path),
    )
    title = f"{path}: {len(store):,} rows"
    return title, points.layout, lambda: view.show(gains_of_source(FIRST_GAIT))


def _robot_half(path: Path, store: Store, message: Message, view: RobotView) -> Left:
    points = StoreView(
        store,
        message,
        pick=lambda place, row: view.show(store, place),
        save=partial(view.save, file_of_selection, path),
    )
    title = f"{path}: {len(store):,} rows of {store.simulator}"
    return title, points.layout, lambda: None


def _comparison_half(path: Path, message: Message, view: WalkView) -> Left:
    results, experiment = _comparison(path)
    arms = ComparisonView(results, experiment, message, view.show)
    title = f"{path}: {results.name}, {len(results.arms)} arms, {results.found:,} trials"
    return title, arms.layout, arms.watch_chosen
