"""Optuna's own tests of a sampler, and one of a table; from the registry's root: pytest package."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import optuna
from optuna.samplers import BaseSampler
from optuna.testing.pytest_samplers import BasicSamplerTestCase
from optuna.testing.pytest_samplers import RelativeSamplerTestCase
import optunahub
import pytest


REGISTRY = Path(__file__).parents[3]
module = optunahub.load_local_module("samplers/feature_kernel", registry_root=str(REGISTRY))


class TestFeatureKernelSampler(BasicSamplerTestCase, RelativeSamplerTestCase):
    """Without features it is a Gaussian process over the parameters."""

    @pytest.fixture
    def sampler(self) -> Callable[[], BaseSampler]:
        return lambda: module.FeatureKernelSampler(seed=1, strict=False)


def test_a_wrong_simulator_helps() -> None:
    x = np.linspace(-5, 5, 500)
    table = module.FeatureTable.from_arrays({"x": x}, np.abs(x - 1.2)[:, None])
    study = optuna.create_study(sampler=module.FeatureKernelSampler(table, seed=1))
    study.optimize(lambda trial: (trial.suggest_float("x", -5, 5) - 1.0) ** 2, n_trials=15)
    assert study.best_value < 0.25  # within half a unit
