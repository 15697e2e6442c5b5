"""Points of parameters: between the unit cube and their bounds, and those of a Sobol sequence.

A store's points are one scrambled Sobol sequence, any part of which can be made alone.
"""

import warnings
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from storage.simulator import Parameter, Uniform

LARGEST_SEQUENCE = 2**30  # SciPy's default of 30 bits a coordinate

# Purposes of random streams. They begin at 100, so that no study has a ground or body of a store. A
# rule may draw parts of its worlds from the purposes in between.
SOBOL, BASE_WORLD, FAMILY_WORLD, TRIAL_WORLDS, EVOLUTION = 100, 101, 103, 107, 108


def seed_sequence(seed: int, purpose: int, index: int = 0) -> np.random.SeedSequence:
    """The random stream of one draw: every draw of a store has its own."""
    return np.random.SeedSequence(entropy=seed, spawn_key=(purpose, index))


def within_bounds(
    unit: NDArray[np.float64], parameters: Sequence[Parameter]
) -> NDArray[np.float64]:
    """Points of the unit cube as values of the parameters, [n, p]."""
    low, high = _bounds(parameters)
    points = low + unit * (high - low)
    for place, scale in _scales(parameters):
        points[:, place] = scale.of_unit(unit[:, place])
    return points


def in_unit_cube(
    points: NDArray[np.float64], parameters: Sequence[Parameter]
) -> NDArray[np.float64]:
    """Values of the parameters as points of the unit cube, [n, p]."""
    low, high = _bounds(parameters)
    unit = (points - low) / (high - low)
    for place, scale in _scales(parameters):
        unit[:, place] = scale.to_unit(points[:, place])
    return unit


def sobol_points(
    seed: int, first: int, count: int, parameters: Sequence[Parameter]
) -> NDArray[np.float64]:
    """Points `first`, `first + 1`, ... of the sequence of `seed`, within the bounds.

    Returns:
        [count, p]. Another number of parameters gives another sequence in all of them.
    """
    from scipy.stats import qmc  # here: its import takes longer than to refuse bad input

    generator = np.random.default_rng(seed_sequence(seed, SOBOL))
    sequence = qmc.Sobol(d=len(parameters), scramble=True, rng=generator)
    if first:  # SciPy cannot skip zero points
        sequence.fast_forward(first)
    with warnings.catch_warnings():
        # A shard is a stretch of a longer sequence: its own length need not be a power of two.
        warnings.filterwarnings("ignore", message="The balance properties")
        return within_bounds(sequence.random(count), parameters)


def _scales(parameters: Sequence[Parameter]) -> Iterator[tuple[int, Uniform]]:
    """The parameters that are logarithms or come in steps, with their places."""
    for place, each in enumerate(parameters):
        if isinstance(each, Uniform) and (each.log or each.step):
            yield place, each


def _bounds(
    parameters: Sequence[Parameter],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    low, high = ([getattr(each, end) for each in parameters] for end in ("low", "high"))
    return np.array(low), np.array(high)
