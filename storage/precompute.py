"""Filling a store: shard after shard, from wherever an earlier run stopped."""

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from storage.pool import IN_PROCESS, Pool
from storage.schema import evaluated_name
from storage.scoring import ScoredShard, score_shard
from storage.specification import Specification
from storage.store import open_store
from storage.store_folder import StoreFolder
from taichi_nmm import __version__
from taichi_nmm.result import COMPLETED, END_REASONS

Progress = Callable[[float], None]
"""Called with the points done so far, those of earlier runs and parts of a shard included."""

Unit = tuple[Specification, int]
"""A store and the number of one of its shards."""


@dataclass(frozen=True)
class Summary:
    """What a run has to say at its end.

    Attributes:
        path: the store's folder.
        points: in the store.
        points_computed: by this run.
        shards: in the store.
        alive_at_horizon: points that completed the base setting.
        alive_fraction: the same, over all points.
        evaluated: points run on the settings of each family, by its name.
        wall_s: of computing and writing, compilation included.
        walkers_per_s: points computed over `wall_s`.
        specification_hash: SHA-256 of what the store was to hold.
    """

    path: str
    points: int
    points_computed: int
    shards: int
    alive_at_horizon: int
    alive_fraction: float
    evaluated: dict[str, int]
    wall_s: float
    walkers_per_s: float
    specification_hash: str


def precompute(
    specification: Specification,
    path: Path,
    fresh: bool = False,
    progress: Progress = lambda points: None,
    pool: Pool = IN_PROCESS,
) -> Summary:
    """Finish the store at `path`, or make it.

    Whatever stops this loses the shards in work and no others. Calling it again goes on, and the
    manifest at the end is that of a run that nothing stopped.

    Args:
        specification: what the store is to hold.
        path: of its folder.
        fresh: start over.
        progress: told within a shard by a pool in this process, by others a shard at a time.
        pool: what computes the shards; the files do not depend on it. A single shard is computed
            in this process.

    Raises:
        InputError: see `StoreFolder.claim`; the disk is full, or a process of the pool was killed.
    """
    with StoreFolder.claim(path, specification, fresh) as folder:
        missing = folder.missing()
        computed = sum(specification.shard_range(number)[1] for number in missing)
        start_s = time.perf_counter()
        done = specification.samples - computed
        _fill(folder, missing, done, progress, pool if len(missing) > 1 else IN_PROCESS)
        wall_s = time.perf_counter() - start_s
        folder.write_manifest()
        return _summary(specification, path, computed, wall_s)


def _fill(
    folder: StoreFolder, missing: list[int], done: int, progress: Progress, pool: Pool
) -> None:
    """Commit the missing shards as they come; `done` points are there."""
    specification, code = folder.specification, {"code_version": __version__}

    def score_here(unit: Unit) -> ScoredShard:
        _, size = specification.shard_range(unit[1])
        return score_shard(*unit, lambda part: progress(done + part * size))

    score = score_here if pool.in_process else _score
    asked = specification
    if pool.shares_machine:  # threads decide no number, and are no part of what a store is
        asked = replace(specification, conditions=specification.conditions.on_one_thread())
    progress(done)
    for (_, number), shard in pool.results(score, deque((asked, number) for number in missing)):
        folder.write_shard(number, shard.table, code | shard.engine)
        done += specification.shard_range(number)[1]
        progress(done)


def _score(unit: Unit) -> ScoredShard:
    return score_shard(*unit, report=lambda part: None)


def _summary(specification: Specification, path: Path, computed: int, wall_s: float) -> Summary:
    store = open_store(path)
    alive = np.count_nonzero(store.numpy(["end_reason"])["end_reason"] == END_REASONS[COMPLETED])
    names = {family.name: evaluated_name(family.name) for family in specification.families}
    run = store.numpy(names.values())
    return Summary(
        path=str(path),
        points=specification.samples,
        points_computed=computed,
        shards=specification.shard_count,
        alive_at_horizon=int(alive),
        alive_fraction=float(alive / specification.samples),
        evaluated={family: int(run[name].sum()) for family, name in names.items()},
        wall_s=round(wall_s, 3),
        walkers_per_s=round(computed / wall_s, 1) if computed else 0.0,
        specification_hash=specification.hash,
    )
