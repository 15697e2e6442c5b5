"""What a session puts on every worker of a cluster: processes that walk, and the stores they read.

Taichi compiles on a main thread only, and a worker's is Dask's own; so calls go to processes of the
worker's, which end with it. A worker that is started again, or joins late, is set up likewise.
"""

import multiprocessing
import os
import pickle
import shutil
import threading
import traceback
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Future
from pathlib import Path
from typing import Any

from distributed import Worker, WorkerPlugin, get_worker

from storage.cluster.freight import Freight
from storage.pool import Kind
from storage.processes import Processes
from taichi_nmm.errors import one_line, shortened

LIVES = 3  # processes of a worker that a call may lose


class Walkers(WorkerPlugin):  # type: ignore[misc]
    """The processes of one session on one worker, as many as it has threads.

    Args:
        session: name of the session: of this plugin, of its events, and of the resource that a
            worker offers once it is let in.
        describe: makes the worker's kind; called in one of the processes.
        freights: stores that calls read.
    """

    def __init__(
        self, session: str, describe: Callable[[], Kind], freights: tuple[Freight, ...]
    ) -> None:
        self.name = session
        self._describe = describe
        self._freights = freights

    def setup(self, worker: Worker) -> None:
        """Unpack the stores, start a process, and tell the session what it computes with."""
        # Dask's nannies start workers as daemons, which may have no children; ours end by
        # themselves when their worker does.
        multiprocessing.current_process().daemon = False
        self._folder = Path(worker.local_directory) / self.name
        self._folder.mkdir(parents=True, exist_ok=True)
        self._processes = Processes(worker.state.nthreads)
        for freight in self._freights:
            freight.unpack(self._folder)
        described = self._processes.submit(
            _within, self._folder, pickle.dumps((self._describe, ()))
        )

        def introduce(done: "Future[memoryview]") -> None:
            worker.loop.add_callback(worker.log_event, self.name, _event(worker.address, done))

        described.add_done_callback(introduce)

    def teardown(self, worker: Worker) -> None:
        """End the processes, without keeping the worker's loop waiting."""
        threading.Thread(target=self._end, daemon=True).start()

    def answer(self, words: bytes) -> memoryview:
        """Make a call in a process, and in another one where that is killed."""
        for life in range(LIVES):
            try:
                outcome: memoryview = self._processes.submit(_within, self._folder, words).result()
                return outcome
            except BrokenExecutor:
                if life == LIVES - 1:
                    raise
        raise AssertionError("no life left")

    def _end(self) -> None:
        self._processes.shutdown(wait=False, cancel_futures=True)
        shutil.rmtree(self._folder, ignore_errors=True)


def answer(session: str, words: bytes) -> memoryview:
    """On a worker: what comes of a call, pickled."""
    plugin: Walkers = get_worker().plugins[session]
    return plugin.answer(words)


async def let_in(session: str, dask_worker: Worker | None = None) -> None:
    """On a worker: offer the session as many places as there are threads."""
    if dask_worker is not None:
        await dask_worker.set_resources(**{session: dask_worker.state.nthreads})


def _within(folder: Path, words: bytes) -> pickle.PickleBuffer:
    """In a process: a call whose relative paths begin in the session's folder.

    What comes of it is pickled, and marked as what needs no copy on its way.
    """
    os.chdir(folder)
    function, args = pickle.loads(words)
    return pickle.PickleBuffer(pickle.dumps(function(*args), protocol=5))


def _event(address: str, described: "Future[memoryview]") -> dict[str, Any]:
    """What the session is told of a worker: its kind, or why it has none."""
    try:
        return {"worker": address, "kind": pickle.loads(described.result())}
    except Exception as error:
        said = "".join(traceback.format_exception_only(error)).strip()
        return {"worker": address, "error": one_line(shortened(said))}
