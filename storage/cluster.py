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
    """So many worker processes of this machine; or in their place, the workers of a cluster.

    They fill a folder (None: a new one) by units that use the simulator, on one thread,
    further packages that decide results, and stores, which they read at the path of
    `Pool.there`.

    Raises:
        InputError: as `local_pool` and `cluster_pool`.
    """
    if cluster is None:
        return local_pool(workers)
    from storage.dask_session import cluster_pool  # Dask: a second, and an extra

    return cluster_pool(cluster, folder, simulator, tuple(packages), stores)
