"""A simulator that takes no time: every number is a fixed function of the walker's own input."""

from itertools import count
from unittest import mock

import numpy as np
import pyarrow.parquet as pq
import pytest

import taichi_nmm
from storage.inputs.config import Table
from storage.precompute import precompute
from storage.specification import read_specification
from taichi_nmm.parameters import upper_bounds
from taichi_nmm.result import COMPLETED, FELL, RESULT_DTYPE, Result

ENGINE = {
    "engine": "fake",
    "engine_version": "1",
    "arch": "cpu",
    "precision": "float32",
    "fast_math": False,
}


def simulate(gains, **options):
    """The signature of `taichi_nmm.simulate`; walkers live longer the larger their first gain."""
    unit = gains[:, 0] / upper_bounds()[0]
    bodies, terrains = options["bodies"], options["terrains"]
    index = options.get("terrain_index", np.zeros(len(gains), dtype=int))
    slopes = [
        terrain.height_m.std()
        for terrain in np.atleast_1d(np.array(terrains, dtype=object))
    ]
    mass = bodies.mass_kg.sum(axis=1) / 80.0
    fitness = unit * mass - 0.001 * np.array(slopes)[index]
    if "worlds" in options:
        fitness = fitness - 0.1 * (0.9 - options["worlds"].friction)
    if options.get("low_level_gains") is not None:
        fitness = fitness + 0.1 * options["low_level_gains"][:, 7]  # theta_ref
    rows = np.zeros(len(gains), RESULT_DTYPE)
    for number, name in enumerate(RESULT_DTYPE.names or ()):
        rows[name] = 10.0 * np.sin(number + 7.0 * fitness) ** 2
    horizon = options["duration_s"]
    rows["duration_s"] = np.clip(10.0 * fitness, 0.0, horizon)
    rows["survived_fraction"] = rows["duration_s"] / horizon
    rows["end_reason"] = np.where(rows["duration_s"] < horizon, FELL, COMPLETED)
    options["progress"](horizon, len(gains))
    return Result(rows, metadata=ENGINE)


def flip_a_bit(file):
    """Damage a number in the middle of a shard, and nothing that is needed to open it."""
    groups = pq.read_metadata(file).row_group(0)
    column = groups.column(groups.num_columns // 2)
    data = bytearray(file.read_bytes())
    data[column.data_page_offset + column.total_compressed_size // 2] ^= 1
    file.write_bytes(bytes(data))


def configuration(**changes):
    """A small store's configuration; `robust=True` adds six settings on rough ground."""
    robust = changes.pop("robust", False)
    data = {"samples": 50, "shard_rows": 8, "seed": 7} | changes
    if robust:
        data["robust"] = family(kind="rough", amplitude_m=0.08)
    return data


def family(settings=6, seed=8, **terrain):
    """The table of a family of settings."""
    return {
        "settings": settings,
        "min_survival_s": 3.0,
        "horizon_s": 8.0,
        "seed": seed,
        "terrain": terrain,
        "body": {"disturbance": 0.15},
    }


def specification(**changes):
    """The specification of `configuration`."""
    return read_specification(Table(configuration(**changes)))


def content(folder):
    """Files of a folder by name."""
    return {file.name: file.read_bytes() for file in folder.iterdir()}


def stopping(after, simulate=simulate, error=KeyboardInterrupt):
    """`simulate`, which an error ends in the call after so many, and in later ones."""
    calls = count(1)

    def stopped(*args, **options):
        if next(calls) > after:
            raise error
        return simulate(*args, **options)

    return stopped


def interrupt(after, specification, path, **options):
    """Fill a store until Ctrl-C comes, in the call of the simulator after so many."""
    simulator = mock.patch.dict(vars(taichi_nmm), simulate=stopping(after))
    with simulator, pytest.raises(KeyboardInterrupt):
        precompute(specification, path, **options)
