"""What a session puts on every worker of a cluster: processes that run calls, and stores they read.

Taichi compiles on a main thread only, and a worker's is Dask's own; so calls go to processes of the
worker's, which end with it. A worker that is started again, or joins late, is set up likewise.
Workers share no disk with whoever reads the configuration, so stores are sent to them.
"""

import hashlib
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
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from distributed import Worker, WorkerPlugin, get_worker

from storage.pool import Kind
from storage.processes import Processes
from storage.store import MANIFEST_NAME, Manifest
from taichi_nmm.errors import one_line, shortened
from taichi_nmm.reading import reading

LIVES = 3  # processes of a worker that a call may lose


@dataclass(frozen=True)
class Freight:
    """A store, packed.

    Attributes:
        digest: SHA-256 of the package, by which workers keep it.
        package: a tar of the store's files.
    """

    digest: str
    package: bytes

    @property
    def place(self) -> Path:
        """Where calls find the store, seen from the folder that they run in."""
        return Path("stores", self.digest, "store")

    def unpack(self, folder: Path) -> None:
        """Lay the store down at its place in a folder; nothing where it is there."""
        target = folder / self.place.parent
        if target.exists():
            return
        with tarfile.open(fileobj=io.BytesIO(self.package)) as tar:
            tar.extractall(target, filter="data")


def packed(path: Path) -> Freight:
    """A store's folder, or the one file that it is.

    Raises:
        InputError: a file of it cannot be read.
    """
    whole = io.BytesIO()
    with tarfile.open(fileobj=whole, mode="w") as tar:
        if path.is_dir():
            for name in (MANIFEST_NAME, *Manifest.read(path).hashes):
                _add(tar, path / name, f"store/{name}")
        else:
            _add(tar, path, "store")
    package = whole.getvalue()
    return Freight(hashlib.sha256(package).hexdigest(), package)


def _add(tar: tarfile.TarFile, path: Path, name: str) -> None:
    """The content alone: neither dates nor owners, which would make two packages of one store."""
    with reading("store", path, "a file that can be read") as file:
        content = file.read_bytes()
    about = tarfile.TarInfo(name)
    about.size = len(content)
    tar.addfile(about, io.BytesIO(content))


def dask_setup(worker: Any) -> None:
    """Of a worker of this machine, which preloads this file: Ctrl-C is for the command alone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


class Workplace(WorkerPlugin):  # type: ignore[misc]
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
    plugin: Workplace = get_worker().plugins[session]
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
