"""Points to choose from: over the whole space, and near the best ones."""

import numpy as np
from numpy.typing import NDArray
from optuna.distributions import CategoricalDistribution

from study.sampler.space import Space

Floats = NDArray[np.float64]

STEP_DECADES = (-2.5, -0.3)  # log10 of a step's standard deviation, in ranges: 0.3 % to 50 %


def anywhere(space: Space, count: int, rng: np.random.Generator) -> Floats:
    """Points uniform over the space, logarithmic parameters over their logarithms, [count, d]."""
    return space.from_fractions(rng.random((count, len(space))))


def nearby(space: Space, centres: Floats, count: int, rng: np.random.Generator) -> Floats:
    """Points near some of the centres [c, d], each at its own distance, [count, d].

    Each moves a random part of its coordinates (at least one) by normal steps of one size, drawn
    evenly over decades; at an edge it is reflected. A categorical that moves takes any choice.
    """
    start = space.fractions(centres[rng.integers(len(centres), size=count)])
    size = 10.0 ** rng.uniform(*STEP_DECADES, (count, 1))
    moved = rng.random(start.shape) < rng.random((count, 1))
    moved[np.arange(count), rng.integers(len(space), size=count)] = True
    steps = size * rng.standard_normal(start.shape)
    target = np.abs(start + steps)
    target = np.clip(np.where(target > 1.0, 2.0 - target, target), 0.0, 1.0)
    chosen = rng.random(start.shape)
    target = np.where(_categorical(space), chosen, target)
    return space.from_fractions(np.where(moved, target, start))


def _categorical(space: Space) -> NDArray[np.bool_]:
    """Which parameters are categorical, [d]."""
    return np.array([isinstance(d, CategoricalDistribution) for d in space.distributions])


def not_among(points: Floats, taken: Floats) -> NDArray[np.bool_]:
    """Which points [m, d] are none of the taken ones [t, d]; all, if that leaves none, [m]."""
    known = {row.tobytes() for row in np.ascontiguousarray(taken)}
    new = np.array([row.tobytes() not in known for row in np.ascontiguousarray(points)], dtype=bool)
    return new if new.any() else np.ones(len(points), dtype=bool)
