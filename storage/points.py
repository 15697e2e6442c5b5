"""Points of parameters: between the unit cube and their bounds, and those of a Sobol sequence.

A store's points are one scrambled Sobol sequence, any part of which can be made alone.
"""

import warnings
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from storage.simulator import Parameter, Uniform

LARGEST_SEQUENCE = 2**30  # SciPy's default of 30 bits a coordinate

# Purposes of random streams. They begin at 100, so that no study has a ground or body
# of a store. A rule may draw parts of its worlds from the purposes in between.
SOBOL, BASE_WORLD, FAMILY_WORLD, TRIAL_WORLDS, EVOLUTION = 100, 101, 103, 107, 108


def seed_sequence(seed: int, purpose: int, index: int = 0) -> np.random.SeedSequence:
    """The random stream of one draw: every draw of a store has its own.

    Args:
        seed: of the store, or of a family.
        purpose: one of the numbers above.
        index: of the draw among those of its purpose, from 0.
    """
    return np.random.SeedSequence(entropy=seed, spawn_key=(purpose, index))


def within_bounds(
    unit: NDArray[np.float64], parameters: Sequence[Parameter]
) -> NDArray[np.float64]:
    """Points of the unit cube as values of the parameters, [n, p].

    Args:
        unit: points of the unit cube, [n, p].
        parameters: p of them.
    """
    pairs = zip(parameters, unit.T, strict=True)
    return np.column_stack([_from_unit(each, column) for each, column in pairs])


def in_unit_cube(
    points: NDArray[np.float64], parameters: Sequence[Parameter]
) -> NDArray[np.float64]:
    """Values of the parameters as points of the unit cube, [n, p].

    Args:
        points: in units of the parameters, [n, p].
        parameters: p of them.
    """
    pairs = zip(parameters, points.T, strict=True)
    return np.column_stack([_to_unit(each, column) for each, column in pairs])


def sobol_points(
    seed: int, first: int, count: int, parameters: Sequence[Parameter]
) -> NDArray[np.float64]:
    """Points `first`, `first + 1`, ... of the sequence of `seed`, within the bounds.

    Returns:
        [count, p]. Another number of parameters gives another sequence in all of them.
    """
    # here: its import takes longer than to refuse bad input
    from scipy.stats import qmc

    generator = np.random.default_rng(seed_sequence(seed, SOBOL))
    sequence = qmc.Sobol(d=len(parameters), scramble=True, rng=generator)
    if first:  # SciPy cannot skip zero points
        sequence.fast_forward(first)
    with warnings.catch_warnings():
        # A shard is a stretch of a longer sequence: its own length need not be a power
        # of two.
        warnings.filterwarnings("ignore", message="The balance properties")
        return within_bounds(sequence.random(count), parameters)


def _from_unit(parameter: Parameter, unit: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values at some places of the range, 0 to 1, in the parameter's unit, [n]."""
    each = _uniform(parameter)
    low, high = _ends(each)
    values = low * (high / low) ** unit if each.log else low + unit * (high - low)
    if each.step:
        values = each.low + each.step * np.rint((values - each.low) / each.step)
    return np.clip(values, each.low, each.high)


def _to_unit(parameter: Parameter, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """The places of some values in the range, from 0 to 1, [n]."""
    each = _uniform(parameter)
    low, high = _ends(each)
    if each.log:
        return np.asarray(np.log(values / low) / np.log(high / low))
    return (values - low) / (high - low)


def _ends(parameter: Uniform) -> tuple[float, float]:
    """Half a step beyond the bounds, so that all steps are as likely."""
    half = parameter.step / 2
    return parameter.low - half, parameter.high + half


def _uniform(parameter: Parameter) -> Uniform:
    """The parameter with its scale; one that names none is drawn between its bounds."""
    if isinstance(parameter, Uniform):
        return parameter
    return Uniform(parameter.name, parameter.low, parameter.high)
