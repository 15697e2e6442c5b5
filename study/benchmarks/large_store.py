"""A store of millions of rows, made up, and what it takes to propose from it."""

import statistics
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import pyarrow as pa

from storage import open_store
from storage.specification import Specification, read_specification
from storage.store_folder import StoreFolder
from study.benchmarks.sampler_timing import memory_mib
from study.features.feature_table import FeatureTable
from study.sampler.feature_sampler import FeatureKernelSampler
from taichi_nmm.config import Table
from taichi_nmm.parameters import lower_bounds, upper_bounds

FEATURES = ("phi_printed", "mean_speed_mps")
SHARD_ROWS = 65536
TRIALS = 20
FIRST_TRIALS = 10  # by the order of the rows; then the model proposes
ENGINE = {
    "code_version": "made up", "engine": "none", "engine_version": "0", "arch": "cpu",
    "precision": "float32", "fast_math": False,
}  # fmt: skip


@dataclass(frozen=True)
class LargeStore:
    """What was measured, in one process.

    Attributes:
        rows: of the store.
        disk_bytes: of its files.
        open_s: `open_store`.
        table_s: reading 16 parameters and two features.
        first_s: the first proposal.
        later_s: each of those that the model makes.
        peak_mib: of memory, at its most.
    """

    rows: int
    disk_bytes: int
    open_s: float
    table_s: float
    first_s: float
    later_s: tuple[float, ...]
    peak_mib: float | None

    @property
    def median_s(self) -> float:
        """Of the later proposals."""
        return statistics.median(self.later_s)

    def as_dict(self) -> dict[str, Any]:
        """Plain values for programs."""
        return asdict(self) | {"median_s": self.median_s}


def make(rows: int, folder: Path) -> None:
    """A store whose gains and two features are drawn, and all else is zero."""
    table = {"samples": rows, "shard_rows": SHARD_ROWS, "simulation": {"arch": "cpu"}}
    specification = read_specification(Table(table))
    with StoreFolder.claim(folder, specification, fresh=False) as store:
        for number in range(specification.shard_count):
            store.write_shard(number, _shard(specification, number), ENGINE)
        store.write_manifest()


def _shard(specification: Specification, number: int) -> pa.Table:
    _, size = specification.shard_range(number)
    unit = np.random.default_rng([specification.seed, number]).uniform(size=(size, 16))
    gains = lower_bounds() + unit * (upper_bounds() - lower_bounds())
    drawn = dict(zip((p.name for p in specification.parameters), gains.T, strict=True))
    drawn |= {FEATURES[0]: np.sin(3.0 * unit[:, 0]) + unit[:, 1], FEATURES[1]: unit[:, 2]}
    columns = [
        pa.array(["completed"] * size, field.type)
        if pa.types.is_string(field.type)
        else pa.array(drawn.get(field.name, np.zeros(size))).cast(field.type)
        for field in specification.schema
    ]
    return pa.Table.from_arrays(columns, schema=specification.schema)


def measure(folder: Path) -> LargeStore:
    """Open a store and propose from it; in a process of its own."""
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    times_s = [time.perf_counter()]
    store = open_store(folder)
    times_s.append(time.perf_counter())
    table = FeatureTable.from_parquet(folder, features=FEATURES)
    times_s.append(time.perf_counter())
    study = optuna.create_study(sampler=FeatureKernelSampler(table, seed=1))
    space = table.rows.space.as_dict()
    for _ in range(TRIALS):
        trial = study.ask(space)
        times_s.append(time.perf_counter())
        study.tell(trial, sum(trial.params.values()))
    open_s, table_s, first_s, *later_s = np.diff(times_s).tolist()
    disk = sum(file.stat().st_size for file in store.files)
    model_s = tuple(later_s[FIRST_TRIALS - 1 :])
    return LargeStore(len(store), disk, open_s, table_s, first_s, model_s, memory_mib("VmHWM"))
