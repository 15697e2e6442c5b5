"""pycma in the unit cube, drawing from a generator of ours: the one place where it is set up."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def new_strategy(start: Floats, sigma: float, draws: np.random.Generator, **options: Any) -> Any:
    """A `cma.CMAEvolutionStrategy`; the same start, draws and costs give the same points.

    Args:
        start: mean of the first generation, in the unit cube, [d].
        sigma: its spread, of each range.
        draws: all random numbers.
        **options: of pycma, such as popsize and tolfun.
    """
    import cma

    ours = {
        "bounds": [0.0, 1.0],
        "verbose": -9,
        "seed": np.nan,  # pycma's own seed is NumPy's global one, which all strategies would share
        "randn": lambda *shape: draws.standard_normal(shape),
        "signals_filename": "",  # it would read options from a file of the current folder
    }
    return cma.CMAEvolutionStrategy(start, sigma, ours | options)
