"""The points of a store: one scrambled Sobol sequence, any part of which can be made alone."""

import warnings

import numpy as np
from numpy.typing import NDArray

from storage.seeds import SOBOL, seed_sequence
from taichi_nmm.parameters import GAINS, Parameter, lower_bounds, upper_bounds

LARGEST_SEQUENCE = 2**30  # SciPy's default of 30 bits a coordinate


def sobol_gains(
    seed: int, first: int, count: int, group: tuple[Parameter, ...] = GAINS
) -> NDArray[np.float64]:
    """Points `first`, `first + 1`, ... of the sequence of `seed`, in the bounds of `group`.

    Returns:
        [count, len(group)]. Another number of parameters is another sequence in all of them.
    """
    from scipy.stats import qmc  # here: it takes longer to import than bad input to refuse

    generator = np.random.default_rng(seed_sequence(seed, SOBOL))
    sequence = qmc.Sobol(d=len(group), scramble=True, rng=generator)
    if first:  # SciPy cannot skip zero points
        sequence.fast_forward(first)
    with warnings.catch_warnings():
        # A shard is a stretch of a longer sequence: its own length need not be a power of two.
        warnings.filterwarnings("ignore", message="The balance properties")
        unit: NDArray[np.float64] = sequence.random(count)
    low, high = lower_bounds(group), upper_bounds(group)
    return low + unit * (high - low)
