"""Filling a store: shard after shard, from wherever an earlier run stopped."""

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from storage.evolved import evolved_points
from storage.kind import PACKAGES, own_kind
from storage.pool import IN_PROCESS, Pool
from storage.schema import evaluated_name
from storage.scoring import Report, ScoredShard, score_shard
from storage.specification import Specification
from storage.store import open_store
from storage.store_folder import StoreFolder
from taichi_nmm import __version__
from taichi_nmm.result import COMPLETED, END_REASONS

Progress = Callable[[float], None]
"""Called with the points done so far, those of earlier runs and parts of a shard included.

The walks of a search count as points.
"""

Unit = tuple[Specification, int, NDArray[np.float64] | None]
"""A store, the number of one of its shards, and the shard's points if they are no Sobol points."""


@dataclass(frozen=True)
class Summary:
    """What a run has to say at its end.

    Attributes:
        path: the store's folder.
        points: in the store.
        points_computed: by this run.
        walks_searched: by this run, for candidates beyond the grid.
        shards: in the store.
        alive_at_horizon: points that completed the base setting.
        alive_fraction: the same, over all points.
        evaluated: points run on the settings of each family, by its name.
        wall_s: of computing and writing, compilation included.
        walkers_per_s: points computed and walks searched, over `wall_s`.
        specification_hash: SHA-256 of what the store was to hold.
    """

    path: str
    points: int
    points_computed: int
    walks_searched: int
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
        pool.agree(path)
        missing = folder.missing()
        grid = [number for number in missing if number < specification.grid_shards]
        computed = sum(specification.shard_range(number)[1] for number in missing)
        start_s = time.perf_counter()
        tally = Tally(progress, specification.rows - computed)
        asked = specification
        if pool.shares_machine:  # threads decide no number, and are no part of what a store is
            asked = replace(specification, conditions=specification.conditions.on_one_thread())
        _fill(folder, asked, grid, tally, pool)
        if specification.repertoire is not None:
            points = evolved_points(folder, asked, specification.repertoire, pool, tally.walked)
            _fill(folder, asked, missing[len(grid) :], tally, pool, points)
        wall_s = time.perf_counter() - start_s
        folder.write_manifest()
        return _summary(specification, path, computed, tally.walks, wall_s)


@dataclass
class Tally:
    """Counts what is done, and tells whoever asked.

    Attributes:
        progress: is told.
        done: points, and walks of a search.
        walks: of a search that this run did.
    """

    progress: Progress
    done: int
    walks: int = 0

    def add(self, points: int) -> None:
        """Count points that are done."""
        self.done += points
        self.progress(self.done)

    def walked(self, walks: int, now: bool) -> None:
        """Count walks of a search; those of earlier runs are not of `now`."""
        self.walks += walks if now else 0
        self.add(walks)


def _fill(
    folder: StoreFolder,
    asked: Specification,
    missing: list[int],
    tally: Tally,
    pool: Pool,
    evolved: NDArray[np.float64] | None = None,
) -> None:
    """Commit the missing shards of one kind as they come; `evolved` are the points of all rows
    after the grid's, [candidates, 16 + k].
    """
    specification, code = folder.specification, {"code_version": __version__}
    pool = pool if len(missing) > 1 or pool.kinds else IN_PROCESS

    def unit(number: int) -> Unit:
        if evolved is None:
            return asked, number, None
        first, size = specification.shard_range(number)
        return asked, number, evolved[first - specification.samples :][:size]

    def score_here(unit: Unit) -> ScoredShard:
        _, size = specification.shard_range(unit[1])
        return _score(unit, lambda part: tally.progress(tally.done + part * size))

    score = score_here if pool.in_process else _score_mixed if pool.mixed else _score
    tally.add(0)
    for (_, number, _), shard in pool.results(score, deque(map(unit, missing))):
        folder.write_shard(number, shard.table, code | shard.engine)
        tally.add(specification.shard_range(number)[1])


def _score(unit: Unit, report: Report = lambda part: None) -> ScoredShard:
    specification, number, evolved = unit
    return score_shard(specification, number, report, evolved)


def _score_mixed(unit: Unit) -> ScoredShard:
    """With the kind of the machine beside what it computed."""
    shard = _score(unit)
    kind = own_kind(unit[0].conditions.settings, PACKAGES)
    return ScoredShard(shard.table, shard.engine | {"kind": kind})


def _summary(
    specification: Specification, path: Path, computed: int, walks: int, wall_s: float
) -> Summary:
    store = open_store(path)
    alive = np.count_nonzero(store.numpy(["end_reason"])["end_reason"] == END_REASONS[COMPLETED])
    names = {family.name: evaluated_name(family.name) for family in specification.families}
    run = store.numpy(names.values())
    return Summary(
        path=str(path),
        points=specification.rows,
        points_computed=computed,
        walks_searched=walks,
        shards=specification.shard_count,
        alive_at_horizon=int(alive),
        alive_fraction=float(alive / specification.rows),
        evaluated={family: int(run[name].sum()) for family, name in names.items()},
        wall_s=round(wall_s, 3),
        walkers_per_s=round((computed + walks) / wall_s, 1) if computed + walks else 0.0,
        specification_hash=specification.hash,
    )
