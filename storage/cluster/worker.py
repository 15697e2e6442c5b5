"""A session's part on every worker of a cluster: processes that run calls, and stores they read.

Taichi compiles on a main thread only, and a worker's main thread is Dask's own; so calls go to
processes that end with the worker. A worker that is started again, or joins late, is set up
likewise. Workers share no disk with the command, so stores are sent to them.
"""

import io
import multiprocessing
import os
import pickle
import shutil
import signal
import tarfile
import threading
import traceback
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Future
from contextlib import suppress
from pathlib import Path
from typing import Any

from distributed import Worker, WorkerPlugin, get_worker

from storage.pool import Kind
from storage.processes import Processes
from storage.store import MANIFEST_NAME, Manifest
from taichi_nmm.errors import one_line, shortened
from taichi_nmm.reading import reading

LIVES = 3  # processes of a worker that a call may lose


def packed(store: Path) -> bytes:
    """A tar of "store": a store's folder, or the one file that it is.

    Raises:
        InputError: a file of it cannot be read.
    """
    whole = io.BytesIO()
    names = (MANIFEST_NAME, *Manifest.read(store).hashes) if store.is_dir() else ("",)
    with tarfile.open(fileobj=whole, mode="w") as tar:
        for name in names:
            with reading("store", store / name, "a file that can be read") as file:
                tar.add(file, Path("store", name))
    return whole.getvalue()


def unpack(package: bytes, place: Path) -> None:
    """Lay a store down at a place that is called "store"."""
    with tarfile.open(fileobj=io.BytesIO(package)) as tar:
        tar.extractall(place.parent, filter="data")


def dask_setup(worker: Any) -> None:
    """A worker of this machine preloads this file: Ctrl-C is for the command alone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


class Workplace(WorkerPlugin):  # type: ignore[misc]
    """The processes of one session on one worker, as many as it has threads.

    Args:
        session: name of the session: of this plugin, of its events, and of the resource that a
            worker offers once it is let in.
        describe: makes the worker's kind; called in one of the processes.
        freights: packed stores that calls read, by their places in the folder that these run in.
    """

    def __init__(
        self, session: str, describe: Callable[[], Kind], freights: dict[Path, bytes]
    ) -> None:
        self.name = session
        self._describe = describe
        self._freights = freights

    def setup(self, worker: Worker) -> None:
        """Unpack the stores, start a process, and send its kind to the session."""
        # Dask's nannies start workers as daemons, which may have no children. Ours end with their
        # worker.
        multiprocessing.current_process().daemon = False
        self._folder = Path(worker.local_directory) / self.name
        self._folder.mkdir(parents=True, exist_ok=True)
        self._processes = Processes(worker.state.nthreads)
        for place, package in self._freights.items():
            unpack(package, self._folder / place)

        def introduce(done: "Future[bytes]") -> None:
            event = {"worker": worker.address}
            try:
                event["kind"] = pickle.loads(done.result())
            except Exception as error:
                said = "".join(traceback.format_exception_only(error)).strip()
                event["error"] = one_line(shortened(said))
            worker.loop.add_callback(worker.log_event, self.name, event)

        self._call(pickle.dumps((self._describe, ()))).add_done_callback(introduce)

    def teardown(self, worker: Worker) -> None:
        """End the processes, in a thread of its own: the worker's loop does not wait."""

        def end() -> None:
            self._processes.shutdown(wait=False, cancel_futures=True)
            shutil.rmtree(self._folder, ignore_errors=True)

        threading.Thread(target=end, daemon=True).start()

    def answer(self, words: bytes) -> bytes:
        """Make a call in a process, and in another one where that is killed."""
        for _ in range(LIVES - 1):
            with suppress(BrokenExecutor):
                return self._call(words).result()
        return self._call(words).result()

    def _call(self, words: bytes) -> "Future[bytes]":
        return self._processes.submit(_within, self._folder, words)


def answer(session: str, words: bytes) -> bytes:
    """On a worker: the result of a call, pickled."""
    plugin: Workplace = get_worker().plugins[session]
    return plugin.answer(words)


async def let_in(session: str, dask_worker: Worker | None = None) -> None:
    """On a worker: offer the session as many places as there are threads."""
    if dask_worker is not None:
        await dask_worker.set_resources(**{session: dask_worker.state.nthreads})


def _within(folder: Path, words: bytes) -> bytes:
    """In a process: the pickled result of a call whose relative paths begin in this folder."""
    os.chdir(folder)
    function, args = pickle.loads(words)
    return pickle.dumps(function(*args), protocol=5)
