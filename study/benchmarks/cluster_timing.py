"""What a cluster of this machine costs: a task, a shard on the wire, and its speed."""

import pickle
import statistics
import tempfile
import time
from collections import deque
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from storage.cluster.asked import Cluster
from storage.cluster.opening import open_pool
from storage.pool import Pool, local_pool
from storage.precompute import precompute
from storage.scoring import ScoredShard, score_shard
from storage.specification import Specification

SHARDS = 25  # of a store that is timed: as many as configs/store.toml has
TASKS = 200  # that do nothing

_kept: dict[str, ScoredShard] = {}  # in a worker: so that a task does nothing but return it


@dataclass(frozen=True)
class ClusterTiming:
    """Figures of one machine.

    Attributes:
        workers: processes, of one thread each.
        shard_rows: of a task.
        shard_bytes: pickled, as it comes back.
        task_ms: submit, run nothing, return a shard; wall time over tasks, all places being busy.
        shard_s: the work of a task, on one thread.
        start_s: of the cluster, its kernels compiled before.
        here: walkers a second of one process on as many threads, of each round.
        there: of the cluster.
    """

    workers: int
    shard_rows: int
    shard_bytes: int
    task_ms: float
    shard_s: float
    start_s: float
    here: tuple[float, ...]
    there: tuple[float, ...]

    @property
    def overhead(self) -> float:
        """Of a task, as a fraction of its work."""
        return self.task_ms / 1e3 / self.shard_s

    @property
    def ratio(self) -> float:
        """The cluster's speed over the one process's, median of the rounds."""
        return statistics.median(t / h for h, t in zip(self.here, self.there, strict=True))

    def as_dict(self) -> dict[str, Any]:
        """Plain values for programs."""
        return asdict(self) | {"overhead": self.overhead, "ratio": self.ratio}


def measure(specification: Specification, workers: int, rounds: int) -> ClusterTiming:
    """Time a store's shards here and on a cluster of this machine, by turns.

    Args:
        specification: of the store; the size of its shards is that of a task.
        workers: processes of the cluster.
        rounds: of both.
    """
    asked = Cluster(f"local:{workers}")
    settings = specification.conditions.on_one_thread().settings
    here, there = [], []
    with tempfile.TemporaryDirectory() as scratch:
        for turn in range(rounds):
            with local_pool(1) as pool:
                here.append(_speed(specification, Path(scratch, f"here-{turn}"), pool))
            began_s = time.perf_counter()
            with open_pool(1, asked, Path(scratch, f"there-{turn}"), settings) as pool:
                start_s = time.perf_counter() - began_s
                there.append(_speed(specification, Path(scratch, f"there-{turn}"), pool))
                if turn == rounds - 1:
                    unit = (specification, 0)
                    task_ms = _task_ms(pool, unit)
                    ((_, shard_s),) = pool.results(shard_seconds, deque([unit]))
    shard = len(pickle.dumps(keep(unit)))
    return ClusterTiming(
        workers,
        specification.shard_rows,
        shard,
        task_ms,
        shard_s,
        start_s,
        tuple(here),
        tuple(there),
    )


def _speed(specification: Specification, path: Path, pool: Pool) -> float:
    return precompute(specification, path, pool=pool).walkers_per_s


def _task_ms(pool: Pool, unit: tuple[Specification, int]) -> float:
    """Of tasks that return a shard that their worker has already."""
    list(pool.results(keep, deque([unit] * 2 * pool.room())))
    began_s = time.perf_counter()
    list(pool.results(keep, deque([unit] * TASKS)))
    return 1e3 * (time.perf_counter() - began_s) / TASKS


def keep(unit: tuple[Specification, int]) -> ScoredShard:
    """A shard, computed by the first call alone."""
    specification, number = unit
    key = f"{specification.hash} {number}"
    if key not in _kept:
        _kept[key] = _score(specification, number)
    return _kept[key]


def shard_seconds(unit: tuple[Specification, int]) -> float:
    """Of the work of a task, its process being warm."""
    specification, number = unit
    began_s = time.perf_counter()
    _score(specification, number)
    return time.perf_counter() - began_s


def _score(specification: Specification, number: int) -> ScoredShard:
    return score_shard(specification, number, lambda part: None)
