"""Filling a store: shard after shard, from wherever an earlier run stopped."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from storage.schema import evaluated_name
from storage.scoring import score_shard
from storage.specification import Specification
from storage.store import open_store
from storage.store_folder import StoreFolder
from taichi_nmm import __version__
from taichi_nmm.result import COMPLETED, END_REASONS

Progress = Callable[[float], None]
"""Called with the points done so far, those of earlier runs and parts of a shard included."""


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
) -> Summary:
    """Finish the store at `path`, or make it.

    Whatever stops this loses the shard in work and no other. Calling it again goes on, and the
    manifest at the end is that of a run that nothing stopped.

    Raises:
        InputError: see `StoreFolder.claim`; or the disk is full.
    """
    with StoreFolder.claim(path, specification, fresh) as folder:
        missing = folder.missing()
        computed = sum(specification.shard_range(number)[1] for number in missing)
        start_s = time.perf_counter()
        _fill(folder, missing, specification.samples - computed, progress)
        wall_s = time.perf_counter() - start_s
        folder.write_manifest()
        return _summary(specification, path, computed, wall_s)


def _fill(folder: StoreFolder, missing: list[int], done: int, progress: Progress) -> None:
    specification, code = folder.specification, {"code_version": __version__}
    progress(done)
    for number in missing:
        _, size = specification.shard_range(number)

        def report(part: float, done: int = done, size: int = size) -> None:
            progress(done + part * size)

        shard = score_shard(specification, number, report)
        folder.write_shard(number, shard.table, code | shard.engine)
        done += size
        progress(done)


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
