"""A session of work on a Dask cluster: a scheduler that runs already, or workers of this machine.

Workers that compute the bits of the folder get work, however late they join. Dask makes
a call again elsewhere when its worker is killed. The cluster is left as it was found.

On every worker a session has a *workplace*: processes that run calls, and stores that
these read. Taichi compiles on a main thread only, and a worker's main thread is Dask's
own; so calls go to processes that end with the worker. A worker that is started again,
or joins late, is set up likewise. Workers share no disk with the command, so stores are
sent to them.
"""

import asyncio
import logging
import multiprocessing
import os
import pickle
import shutil
import signal
import sys
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import dask
from distributed import (
    Client,
    KilledWorker,
    LocalCluster,
    Worker,
    WorkerPlugin,
    get_worker,
)
from distributed import Future as Remote
from distributed.comm import CommClosedError
from distributed.security import Security

from storage.inputs.errors import InputError, in_a_line
from storage.inputs.reading import json_document, reading
from storage.pool import KIND_NAME, Cluster, Kind, Pool, differences, own_kind
from storage.processes import Processes
from storage.simulator import Simulator
from storage.store import MANIFEST_NAME, Manifest
from storage.tables import agree

SESSION = "taichi-nmm-"  # and the client's name
AHEAD = 2  # calls a place, one of which waits on the worker
CONNECT_S = 30.0
CLOSE_S = 5.0
START_S = 300.0  # for the first worker: its processes may have to compile the walker
POLL_S = 0.2
WORKERLESS_S = 300.0  # after which a cluster without a worker is given up
WATCH_S = 2.0
ANSWER_S = 30.0  # that a scheduler may take: of one that stalls, connections stay open
LIVES = 3  # processes of a worker that a call may lose
MOST_DEATHS = 20  # of workers of this machine that one call may take with it
# without a warning: sixty studies with all their trials are some MiB
LARGEST_TASK = "1 TiB"
LOOPBACK = "127.0.0.1"
REMEDY = "--mixed; or another --out"
GOES_ON = "the same command goes on where it stopped"


def packed(store: Path) -> dict[str, bytes]:
    """A store's files by name; the one file that it is has none.

    Raises:
        InputError: a file of it cannot be read.
    """
    files = {}
    for name in (
        (MANIFEST_NAME, *Manifest.read(store).hashes) if store.is_dir() else ("",)
    ):
        with reading("store", store / name, "a file that can be read") as file:
            files[name] = file.read_bytes()
    return files


def unpack(files: dict[str, bytes], place: Path) -> None:
    """Lay a store down; of a name only the last part is used, so that no file lies elsewhere."""
    for name, content in files.items():
        target = place / Path(name).name
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(content)


def dask_setup(worker: Any) -> None:
    """A worker of this machine preloads this file: Ctrl-C is for the command alone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


class Workplace(WorkerPlugin):  # type: ignore[misc]
    """The processes of one session on one worker, as many as it has threads."""

    def __init__(
        self,
        session: str,
        describe: Callable[[], Kind],
        freights: dict[Path, dict[str, bytes]],
    ) -> None:
        # of this plugin, its events, and the resource of a worker let in
        self.name = session
        # makes the worker's kind; called in one of the processes
        self._describe = describe
        # of stores, by their places in the folder that calls run in
        self._freights = freights

    def setup(self, worker: Worker) -> None:
        """Unpack the stores, start a process, and send its kind to the session."""
        # Dask's nannies start workers as daemons, which may have no children. Ours end
        # with their worker.
        multiprocessing.current_process().daemon = False
        self._folder = Path(worker.local_directory) / self.name
        self._folder.mkdir(parents=True, exist_ok=True)
        self._processes = Processes(worker.state.nthreads)
        for place, files in self._freights.items():
            unpack(files, self._folder / place)

        def introduce(done: "Future[bytes]") -> None:
            event = {"worker": worker.address}
            try:
                event["kind"] = pickle.loads(done.result())
            except Exception as error:
                event["error"] = in_a_line(error)
            worker.loop.add_callback(worker.log_event, self.name, event)

        self.call(pickle.dumps((self._describe, ()))).add_done_callback(introduce)

    def teardown(self, worker: Worker) -> None:
        """End the processes, in a thread of its own: the worker's loop does not wait."""

        def end() -> None:
            self._processes.shutdown(wait=False, cancel_futures=True)
            shutil.rmtree(self._folder, ignore_errors=True)

        threading.Thread(target=end, daemon=True).start()

    def call(self, words: bytes) -> "Future[bytes]":
        """Make a pickled call in a process."""
        return self._processes.submit(_within, self._folder, words)


def answer(session: str, words: bytes) -> bytes:
    """On a worker: the pickled result of a call, made again where its process is killed."""
    plugin: Workplace = get_worker().plugins[session]
    for _ in range(LIVES - 1):
        with suppress(BrokenExecutor):
            return plugin.call(words).result()
    return plugin.call(words).result()


async def let_in(session: str, dask_worker: Worker | None = None) -> None:
    """On a worker: offer the session as many places as there are threads."""
    if dask_worker is not None:
        await dask_worker.set_resources(**{session: dask_worker.state.nthreads})


def _within(folder: Path, words: bytes) -> bytes:
    """In a process: the pickled result of a call whose relative paths begin in this folder."""
    os.chdir(folder)
    function, args = pickle.loads(words)
    return pickle.dumps(function(*args), protocol=5)


class Session(Executor):
    """Lets workers in and makes calls on them. A failure is an `InputError`."""

    def __init__(self, client: Client, asked: Cluster, kind: Kind | None) -> None:
        # of workers' plugin, of their events, and their resource
        self.name = SESSION + client.id
        self.kind = kind  # that workers must be of, unless mixed; None: that of the first worker
        # of all workers that were ever let in, in this order
        self.kinds: list[Kind] = []
        self._client = client
        self._asked = asked
        self._inside: set[str] = set()
        # threads of the scheduler's workers, by address
        self._there: dict[str, int] = {}
        self._refused: dict[str, str] = {}  # reasons, by address
        self._pending: dict[asyncio.Task[Any], Remote] = {}
        self._fault = "a scheduler that stays"  # of a call that is cancelled
        client.loop.add_callback(self._watch)

    def places(self) -> int:
        """Calls that can be under way at once: threads of the workers that are in and alive.

        As of the last look: to ask the scheduler would double the cost of a call.
        """
        return sum(self._there.get(address, 0) for address in self._inside)

    async def meet(self, event: tuple[float, dict[str, Any]]) -> None:
        """Let in a worker that sends its kind, or tell the user why not."""
        _, told = event
        address, kind, reason = (
            str(told["worker"]),
            told.get("kind"),
            str(told.get("error", "")),
        )
        if kind is not None:
            self.kind = self.kind or kind
            reason = "" if self._asked.mixed else differences(kind, self.kind)
        if reason or kind is None:
            # one line for a hundred workers alike
            if reason not in self._refused.values():
                print(
                    f"worker {address} gets no work: {reason}",
                    file=sys.stderr,
                    flush=True,
                )
            self._refused[address] = reason
        else:
            if kind not in self.kinds:
                self.kinds.append(kind)
            await self._client.run(let_in, self.name, workers=[address])
            self._inside.add(address)
            await self._look()

    def wait_for_one(self) -> None:
        """Return when a worker is in.

        Raises:
            InputError: all workers were refused, or there is none in time.
        """
        began_s = time.monotonic()
        while not self.places():
            self._client.sync(self._look)
            if self._there and self._there.keys() <= self._refused.keys():
                reason = next(iter(self._refused.values()))
                allowed = f"workers like the folder's ({reason}); or {REMEDY}"
                raise InputError("cluster", self._asked.address, allowed)
            if time.monotonic() - began_s > START_S:
                allowed = f"a scheduler that has a worker within {START_S:.0f} s"
                raise InputError("cluster", self._asked.address, allowed)
            time.sleep(POLL_S)

    def submit(
        self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any
    ) -> Future[Any]:
        """Call a function of an importable module on some worker; arguments by place alone."""
        if kwargs:
            raise TypeError("arguments by name")
        remote = self._client.submit(
            answer,
            self.name,
            pickle.dumps((fn, args)),
            key=f"{fn.__name__}-{uuid.uuid4().hex}",
            resources={self.name: 1},
        )
        loop = self._client.loop.asyncio_loop
        return asyncio.run_coroutine_threadsafe(self._outcome(remote), loop)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Drop the calls that are not over."""
        if self._pending and self._client.status == "running":
            self._client.cancel(list(self._pending.values()), force=True)

    async def _look(self) -> None:
        """Read the list of workers from the scheduler."""
        self._there = dict(await self._client.scheduler.ncores())

    async def _outcome(self, remote: Remote) -> Any:
        """The result of a call, which is let go."""
        call = asyncio.current_task()
        assert call is not None
        self._pending[call] = remote
        try:
            return pickle.loads(await remote)
        except InputError:
            raise
        except (asyncio.CancelledError, CancelledError, CommClosedError):
            allowed = self._fault
        except KilledWorker as killed:
            allowed = (
                f"workers that live: a call took {killed.allowed_failures + 1} with it"
            )
        except Exception as failed:
            allowed = f"calls that do not fail there ({in_a_line(failed)})"
        finally:
            del self._pending[call]
        raise InputError("cluster", self._asked.address, f"{allowed}; {GOES_ON}")

    async def _watch(self) -> None:
        """Give up calls when there has been no worker for long, or no answer."""
        seen_s = time.monotonic()
        while self._client.status not in ("closed", "closing"):
            await asyncio.sleep(WATCH_S)
            try:
                await asyncio.wait_for(self._look(), ANSWER_S)
            except TimeoutError:
                self._give_up(f"a scheduler that answers within {ANSWER_S:.0f} s")
            except OSError:
                pass  # Dask connects again, or cancels the calls
            if self.places() or not self._pending:
                seen_s = time.monotonic()
            elif time.monotonic() - seen_s > WORKERLESS_S:
                self._give_up(
                    f"a cluster that is not without a worker for {WORKERLESS_S:.0f} s"
                )

    def _give_up(self, allowed: str) -> None:
        self._fault = allowed
        for call in list(self._pending):
            call.cancel()


@dataclass(frozen=True)
class ClusterPool(Pool):
    """A pool whose places come and go.

    Attributes:
        executor: the session with the cluster.
        places: stores as workers find them, by their paths on this machine; others lie
            at the same path.
    """

    executor: Session
    places: dict[Path, Path] = field(default_factory=dict)

    def room(self) -> int:
        """One unit a place, and one that waits there."""
        return max(1, AHEAD * self.executor.places())

    def there(self, store: Path) -> Path:
        """Its place in the folder that units run in."""
        return self.places.get(store, store)

    def agree(self, folder: Path) -> None:
        """Write the kind into a folder that has none yet."""
        if not self.mixed and self.executor.kind is not None:
            agree(folder / KIND_NAME, self.executor.kind, remedy=REMEDY)

    @property
    def kinds(self) -> list[Kind]:
        """Kinds of all workers that were let in."""
        return list(self.executor.kinds)


@contextmanager
def cluster_pool(
    asked: Cluster,
    folder: Path | None,
    simulator: Simulator,
    packages: tuple[str, ...] = (),
    stores: Sequence[Path] = (),
) -> Iterator[Pool]:
    """A pool of a cluster's workers, on which nothing is left when the context ends.

    Arguments as of `storage.cluster.open_pool`; the folder decides of which kind
    workers must be.

    Raises:
        InputError: no scheduler there, none of its workers is of the folder's kind, or
            a store that cannot be read.
    """
    describe = partial(own_kind, simulator, packages)
    places = {
        store: Path("stores", str(place), "store") for place, store in enumerate(stores)
    }
    freights = {place: packed(store) for store, place in places.items()}
    kind = None if asked.mixed or folder is None else folder_kind(folder, describe)
    with _scheduler(asked) as where, _client(asked, *where) as client:
        session = Session(client, asked, kind)
        plugin = Workplace(session.name, describe, freights)
        try:
            with _failures(asked):
                for left in client.run_on_scheduler(left_behind):
                    client.unregister_worker_plugin(left)
                client.subscribe_topic(session.name, session.meet)
                client.register_plugin(plugin)
                session.wait_for_one()
            slots = AHEAD * session.places()
            yield ClusterPool(session, slots, asked.mixed, places)
        finally:
            session.shutdown()
            with suppress(Exception):  # a scheduler that is gone, or stalls
                leave = client.scheduler.unregister_worker_plugin
                client.sync(leave, name=session.name, callback_timeout=CLOSE_S)


def folder_kind(folder: Path, describe: Callable[[], Kind]) -> Kind | None:
    """The kind of machine that has begun a folder; None: it is new.

    A folder that no cluster has begun is taken to be of this machine.

    Raises:
        InputError: its file of the kind cannot be read.
    """
    path = folder / KIND_NAME
    if path.exists():
        kind = json_document("out", path, f"a readable {KIND_NAME}; or {REMEDY}")
        return {str(name): str(value) for name, value in kind.items()}
    if not any(folder.rglob("*.parquet")):
        return None
    with Processes(1) as here:
        return dict(here.submit(describe).result())


def left_behind(dask_scheduler: Any = None) -> list[str]:
    """On a scheduler: sessions whose client was killed."""
    return [
        name
        for name in dask_scheduler.worker_plugins
        if name.startswith(SESSION)
        and name.removeprefix(SESSION) not in dask_scheduler.clients
    ]


@contextmanager
def _scheduler(asked: Cluster) -> Iterator[tuple[str, Security]]:
    """The address of the cluster and how to talk to it; one of this machine is started and ended.

    A scheduler runs anything for anybody who reaches it. So ours is on the loopback
    address, and asks for certificates that only this process and its workers have.
    """
    if not asked.local_processes:
        yield asked.address, Security()  # as Dask's own settings say
        return
    with _failures(asked):
        security = Security.temporary()
    with dask.config.set({"distributed.scheduler.allowed-failures": MOST_DEATHS}):
        try:
            cluster = LocalCluster(
                n_workers=asked.local_processes,
                threads_per_worker=1,
                host=LOOPBACK,
                dashboard_address=f"{LOOPBACK}:0",
                scheduler_kwargs={"dashboard": False},
                security=security,
                silence_logs=logging.CRITICAL,
                preload="storage.dask_session",
            )
        except RuntimeError as error:  # Dask's processes meet by semaphores
            allowed = "a machine with shared memory (/dev/shm) that can be written; or --workers"
            raise InputError(
                "cluster", asked.address, f"{allowed} ({_first(error)})"
            ) from None
    with cluster:
        yield cluster.scheduler_address, security


@contextmanager
def _client(asked: Cluster, address: str, security: Security) -> Iterator[Client]:
    # it speaks of every retry
    logging.getLogger("distributed").setLevel(logging.CRITICAL + 1)
    dask.config.set({"distributed.admin.large-graph-warning-threshold": LARGEST_TASK})
    with _failures(asked):
        client = Client(
            address,
            security=security,
            timeout=CONNECT_S,
            set_as_default=False,
            direct_to_workers=bool(
                asked.local_processes
            ),  # of others they may be out of reach
        )
    try:
        yield client
    finally:
        with suppress(Exception):
            client.close(timeout=CLOSE_S)


@contextmanager
def _failures(asked: Cluster) -> Iterator[None]:
    """Turn whatever a scheduler does to its client into one line."""
    try:
        yield
    except InputError:
        raise
    except (
        Exception
    ) as error:  # of sockets, TLS, or a worker that cannot set up the plugin
        allowed = f"a scheduler that answers, and workers with this project ({in_a_line(error)})"
        raise InputError("cluster", asked.address, allowed) from None


def _first(error: BaseException) -> str:
    """The error that others followed, in a line."""
    while cause := error.__cause__ or error.__context__:
        error = cause
    return in_a_line(error)
