"""The pool of a command: processes of this machine, or a Dask cluster, which needs an extra."""

from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path

from storage.pool import Cluster, Pool, local_pool
from storage.simulator import Simulator


def open_pool(
    workers: int,
    cluster: Cluster | None,
    folder: Path | None,
    simulator: Simulator,
    packages: Sequence[str] = (),
    stores: Sequence[Path] = (),
) -> AbstractContextManager[Pool]:
    """The pool of a command: processes of this machine, or a cluster's workers.

    Args:
        workers: number of processes.
        cluster: used in their place.
        folder: that is to be filled; None: a new one.
        simulator: that units use, on one thread.
        packages: beside the simulator's, that decide results.
        stores: that units read, at the path that `Pool.there` returns.

    Raises:
        InputError: as `local_pool` and `cluster_pool`.
    """
    if cluster is None:
        return local_pool(workers)
    from storage.dask_session import cluster_pool  # Dask: a second, and an extra

    return cluster_pool(cluster, folder, simulator, tuple(packages), stores)
