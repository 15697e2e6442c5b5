"""The pool of a cluster: connected, its workers set up, and left as it was found."""

import logging
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import dask
from distributed import Client, LocalCluster
from distributed.security import Security

from storage.cluster.asked import Cluster
from storage.cluster.executor import ClusterExecutor
from storage.cluster.freight import Freight, packed
from storage.cluster.gate import Gate
from storage.cluster.plugin import Walkers
from storage.document import agree
from storage.pool import KIND_NAME, Kind, Pool, own_kind
from storage.processes import Processes
from storage.simulator import Simulator
from taichi_nmm.errors import InputError, one_line, shortened
from taichi_nmm.reading import json_document

SESSION = "taichi-nmm-"  # and the client's name
AHEAD = 2  # calls a place, one of which waits on the worker
CONNECT_S = 30.0
CLOSE_S = 5.0
MOST_DEATHS = 20  # of workers of this machine that one call may take with it
LARGEST_TASK = "1 TiB"  # without a warning: sixty studies with all their trials are some MiB
LOOPBACK = "127.0.0.1"
REMEDY = "--mixed; or another --out"


@dataclass(frozen=True)
class ClusterPool(Pool):
    """A pool whose places come and go.

    Attributes:
        gate: that lets workers in.
        freights: the stores that they have, by where they are here.
        may_mix: whether they may differ.
    """

    gate: Gate
    freights: dict[Path, Freight]
    may_mix: bool

    def room(self) -> int:
        """One unit a place, and one that waits there."""
        return max(1, AHEAD * self.gate.places())

    def there(self, store: Path) -> Path:
        """Its place in the folder that units run in."""
        return self.freights[store].place if store in self.freights else store

    def agree(self, folder: Path) -> None:
        """Write the kind into a folder that has none yet."""
        if not self.may_mix and self.gate.kind is not None:
            agree(folder / KIND_NAME, self.gate.kind, remedy=REMEDY)

    @property
    def kinds(self) -> list[Kind]:
        """Of all workers that were let in."""
        return list(self.gate.kinds)

    @property
    def mixed(self) -> bool:
        """Whether they may differ."""
        return self.may_mix


@contextmanager
def cluster_pool(
    asked: Cluster,
    folder: Path | None,
    simulator: Simulator,
    packages: tuple[str, ...] = (),
    stores: Sequence[Path] = (),
) -> Iterator[Pool]:
    """A pool of a cluster's workers; they have nothing of it when the context ends.

    Args:
        asked: which cluster.
        folder: that is to be filled, and decides what kind workers must be of; None: a new one.
        simulator: that units use, on one thread.
        packages: beside the simulator's, that decide results.
        stores: that units read, by `Pool.there`.

    Raises:
        InputError: no scheduler there, none of its workers is of the folder's kind, or a store
            that cannot be read.
    """
    describe = partial(own_kind, simulator, packages)
    freights = {store: packed(store) for store in stores}
    reference = None if asked.mixed or folder is None else folder_kind(folder, describe)
    with _scheduler(asked) as where, _client(asked, *where) as client:
        session = SESSION + client.id
        gate = Gate(client, session, reference, asked.mixed, _tell)
        plugin = Walkers(
            session, describe, tuple({f.digest: f for f in freights.values()}.values())
        )
        executor = ClusterExecutor(client, session, gate, asked.address)
        try:
            with _failures(asked):
                for left in client.run_on_scheduler(left_behind):
                    client.unregister_worker_plugin(left)
                client.subscribe_topic(session, gate.meet)
                client.register_plugin(plugin)
                gate.wait_for_one(asked.address)
            yield ClusterPool(executor, AHEAD * gate.places(), gate, freights, asked.mixed)
        finally:
            executor.shutdown()
            with suppress(Exception):  # a scheduler that is gone, or stalls
                leave = client.scheduler.unregister_worker_plugin
                client.sync(leave, name=session, callback_timeout=CLOSE_S)


def folder_kind(folder: Path, describe: Callable[[], Kind]) -> Kind | None:
    """The kind of what is in a folder; None of a new one.

    What no cluster has begun is taken to be of this machine.

    Raises:
        InputError: its note of the kind cannot be read.
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
        if name.startswith(SESSION) and name.removeprefix(SESSION) not in dask_scheduler.clients
    ]


@contextmanager
def _scheduler(asked: Cluster) -> Iterator[tuple[str, Security]]:
    """The address of the cluster and how to talk to it; one of this machine is started and ended.

    Whoever reaches a scheduler can have it run anything. So of ours nobody else hears: it is on the
    loopback address, and asks for certificates that only this process and its workers have.
    """
    if not asked.local_processes:
        yield asked.address, Security()  # as Dask's own settings say
        return
    with _failures(asked):
        security = Security.temporary()
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": MOST_DEATHS}),
        LocalCluster(
            n_workers=asked.local_processes,
            threads_per_worker=1,
            host=LOOPBACK,
            dashboard_address=f"{LOOPBACK}:0",
            scheduler_kwargs={"dashboard": False},
            security=security,
            silence_logs=logging.CRITICAL,
            preload="storage.cluster.deaf",
        ) as cluster,
    ):
        yield cluster.scheduler_address, security


@contextmanager
def _client(asked: Cluster, address: str, security: Security) -> Iterator[Client]:
    logging.getLogger("distributed").setLevel(logging.CRITICAL + 1)  # it speaks of every retry
    dask.config.set({"distributed.admin.large-graph-warning-threshold": LARGEST_TASK})
    with _failures(asked):
        client = Client(
            address,
            security=security,
            timeout=CONNECT_S,
            set_as_default=False,
            direct_to_workers=bool(asked.local_processes),  # of others they may be out of reach
        )
    try:
        yield client
    finally:
        with suppress(Exception):
            client.close(timeout=CLOSE_S)


@contextmanager
def _failures(asked: Cluster) -> Iterator[None]:
    """What a scheduler can do to its client, in one line."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:  # of sockets, TLS, or what a worker made of the plugin
        said = one_line(shortened(f"{type(error).__name__}: {error}"))
        allowed = f"a scheduler that answers, and workers with this project ({said})"
        raise InputError("cluster", asked.address, allowed) from None


def _tell(line: str) -> None:
    print(line, file=sys.stderr, flush=True)
