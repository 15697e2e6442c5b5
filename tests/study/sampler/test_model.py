"""What the improvement that a model lets expect is made of."""

import numpy as np
import pytest

from study.sampler.acquisition import Model
from study.sampler.gp import KERNELS
from study.sampler.transforms import Points

TRIALS = 40


@pytest.mark.parametrize("kernel", KERNELS)
def test_noise_is_a_chance_of_improvement_only_where_it_is_the_spread_of_alike_candidates(
    kernel: str,
) -> None:
    """Costs at random. Over features alone, the next of alike candidates may be that much better.

    Where parameters are looked at, candidates that are alike are the same, and what one shows by
    chance is nothing that could be found.
    """
    rng = np.random.default_rng(0)
    seen = Points(np.zeros((TRIALS, 1)), np.full((TRIALS, 2), 0.5))
    none = Points(np.empty((0, 1)), np.empty((0, 2)))
    cost = rng.uniform(1.0, 2.0, TRIALS)
    model = Model(KERNELS[kernel], None, 2, seen, cost, np.empty((TRIALS, 0)), none, {})
    visible = model.kernel
    there = seen.take(np.arange(1)).only(
        features=visible.of_features, coordinates=visible.of_parameters
    )
    _, variance = model.posterior.predict(there)
    share = float(variance[0]) / float(np.var(model.cost()))
    assert share > 0.9 if kernel in ("rbf", "rbf_ard") else share < 0.1
