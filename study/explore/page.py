"""The page of a store or a comparison: what was scored on the left, on the right a gait walks."""

import html
from collections.abc import Callable
from concurrent.futures import Executor
from functools import partial, wraps
from pathlib import Path
from typing import Any

import numpy as np
from bokeh.document import Document
from bokeh.layouts import column, row
from bokeh.models import Div
from numpy.typing import NDArray

from storage.store import SHARD_PATTERN, Store, open_store
from storage.store_folder import SPECIFICATION_NAME
from study.comparison.folder import EXPERIMENT_NAME, RESULTS_NAME
from study.experiment.experiment import Experiment
from study.experiment.identity import documented_experiment
from study.explore.comparison_view import ComparisonView
from study.explore.downloads import file_of_selection
from study.explore.server import Message
from study.explore.store_view import StoreView
from study.explore.walk_view import WalkView
from study.gains import NamedGains, gains_of_source, named_gains
from study.report.runs import Results, read_results
from taichi_nmm.errors import InputError
from taichi_nmm.reading import is_file, is_folder

Page = Callable[[Executor, Executor, Document], None]
"""Takes who simulates, who makes files, and the document of a tab."""

FIRST_GAIT = "reference"


def page_of(path: Path) -> Page:
    """What fills the document of a tab. Each tab reads the folder anew: it may be growing.

    Args:
        path: of a store or a comparison, finished or not.

    Raises:
        InputError: neither of both, or one that cannot be read.
    """
    if is_folder(path) and any((path / name).exists() for name in (EXPERIMENT_NAME, RESULTS_NAME)):
        _opened_comparison(path)
        return partial(_comparison_page, path)
    if not is_file(path) and not (is_folder(path) and _of_store(path)):
        raise InputError("folder", str(path), "the folder of a store or of a comparison")
    _opened_store(path)
    return partial(_store_page, path)


def _of_store(path: Path) -> bool:
    return (path / SPECIFICATION_NAME).exists() or any(path.glob(SHARD_PATTERN))


def _opened_store(path: Path) -> Store:
    store = open_store(path, unfinished=True)
    store.require_bounds()
    return store


def _opened_comparison(path: Path) -> tuple[Results, Experiment]:
    results = read_results(path)
    experiment = documented_experiment(results.facts)
    if experiment is None:
        raise InputError("folder", str(path), "a comparison whose experiment.json says its ground")
    return results, experiment


def _told(page: Callable[..., None]) -> Callable[..., None]:
    """The same page; where its folder cannot be read any more, one line that says so."""

    @wraps(page)
    def fill(*arguments: Any) -> None:
        try:
            page(*arguments)
        except Exception as error:
            message = Message()
            message.failed(error)
            arguments[-1].add_root(message.layout)

    return fill


@_told
def _store_page(path: Path, walkers: Executor, makers: Executor, document: Document) -> None:
    store, message = _opened_store(path), Message()
    view = WalkView(document, walkers, makers, message)
    gains = StoreGains(store)
    points = StoreView(
        store,
        pick=lambda place: view.show(gains.at(place)),
        tell=message.tell,
        save=lambda ranges, suffix: view.save(file_of_selection, path, ranges, suffix),
    )
    points.listen(message)
    _fill(document, f"{path}: {len(store):,} rows", message, points.layout, view)
    view.show(gains_of_source(FIRST_GAIT))


@_told
def _comparison_page(path: Path, walkers: Executor, makers: Executor, document: Document) -> None:
    results, experiment = _opened_comparison(path)
    message = Message()
    view = WalkView(document, walkers, makers, message, tried=True)
    arms = ComparisonView(results, experiment, message, view.show)
    title = f"{path}: {results.name}, {len(results.arms)} arms, {results.found:,} trials"
    _fill(document, title, message, arms.layout, view)
    arms.watch_chosen()


def _fill(document: Document, title: str, message: Message, left: Any, view: WalkView) -> None:
    document.title = title
    head = Div(text=f"<b>{html.escape(title)}</b>")
    document.add_root(column(row(head, message.layout), row(left, view.layout), margin=8))


class StoreGains:
    """The parameters of a store's rows, read when the first is asked for.

    Args:
        store: whose.
    """

    def __init__(self, store: Store) -> None:
        self._store = store
        self._points: NDArray[np.float64] | None = None
        self._rows: NDArray[np.int64] | None = None

    def at(self, place: int) -> NamedGains:
        """Those of the row at a place."""
        if self._points is None or self._rows is None:
            self._points = self._store.gains()
            self._rows = self._store.table(["row"])["row"].to_numpy()
        values = dict(zip(self._store.gain_names, self._points[place].tolist(), strict=True))
        return named_gains(f"{self._store.path.name}-row-{self._rows[place]}", values)
