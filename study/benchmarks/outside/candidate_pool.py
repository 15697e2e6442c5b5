"""The candidates of a problem: scrambled Sobol points of the unit cube, made settings."""

from collections.abc import Mapping
from typing import Any
from zlib import crc32

import numpy as np
from numpy.typing import NDArray
from optuna.distributions import (
    BaseDistribution,
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
)
from scipy.stats import qmc

Floats = NDArray[np.float64]
Column = NDArray[Any]  # floats, integers or words

POOL_SEED = 2026
POOL_BITS = 10  # 1,024 candidates
DIGITS = 4  # significant, of floats: a table that reads as people write settings


def pool(name: str, space: Mapping[str, BaseDistribution]) -> dict[str, Column]:
    """The candidates of a problem, a column [1024] a parameter; the name is part of the seed."""
    seed = np.random.SeedSequence(POOL_SEED, spawn_key=(crc32(name.encode()),))
    unit = qmc.Sobol(len(space), rng=np.random.default_rng(seed)).random_base2(POOL_BITS)
    return {
        parameter: column(distribution, unit[:, place])
        for place, (parameter, distribution) in enumerate(space.items())
    }


def column(distribution: BaseDistribution, unit: Floats) -> Column:
    """Values of a parameter at places [n] of the unit interval, uniform on its scale."""
    if isinstance(distribution, CategoricalDistribution):
        words = np.array([str(choice) for choice in distribution.choices])
        return np.asarray(words[np.minimum((unit * len(words)).astype(int), len(words) - 1)])
    if isinstance(distribution, IntDistribution):
        # Half a step beyond the ends, as Optuna has it: each integer has its whole share.
        ends = np.array([distribution.low - 0.5, distribution.high + 0.5])
        drawn = _between(ends, unit, distribution.log)
        whole = np.clip(np.round(drawn), distribution.low, distribution.high)
        return np.asarray(whole.astype(np.int64))
    assert isinstance(distribution, FloatDistribution)
    ends = np.array([distribution.low, distribution.high])
    drawn = _between(ends, unit, distribution.log)
    rounded = np.array([float(f"{value:.{DIGITS}g}") for value in drawn])
    return np.asarray(np.clip(rounded, *ends))


def _between(ends: Floats, unit: Floats, log: bool) -> Floats:
    """Values between two ends, on a linear or a logarithmic scale."""
    if log:
        return np.asarray(np.exp(_between(np.log(ends), unit, log=False)))
    return np.asarray(ends[0] + unit * (ends[1] - ends[0]))
