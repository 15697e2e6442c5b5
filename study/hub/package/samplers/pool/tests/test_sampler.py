"""Optuna's own tests of a sampler, and those of a pool; from the registry's root: pytest package."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import optuna
from optuna.samplers import BaseSampler
from optuna.testing.pytest_samplers import BasicSamplerTestCase
import optunahub
import pytest


REGISTRY = Path(__file__).parents[3]
PLACES = np.random.default_rng(1).random((80, 2))
GRAM = np.exp(-10.0 * ((PLACES[:, None] - PLACES[None]) ** 2).sum(axis=2))
COST = np.hypot(*(PLACES - 0.5).T)

PoolSampler = optunahub.load_local_module("samplers/pool", registry_root=str(REGISTRY)).PoolSampler


class TestPoolSampler(BasicSamplerTestCase):
    """Parameters that the pool does not have are drawn at random."""

    @pytest.fixture
    def sampler(self) -> Callable[[], BaseSampler]:
        return lambda: PoolSampler(kernel=GRAM, seed=1, strict=False)


def test_it_finds_the_best_candidate_and_tries_none_twice() -> None:
    study = optuna.create_study(sampler=PoolSampler(kernel=GRAM, seed=1))
    study.optimize(lambda trial: COST[trial.suggest_int("row", 0, 79)], n_trials=20)
    assert len({trial.params["row"] for trial in study.trials}) == 20
    assert study.best_value == COST.min()


def test_a_matrix_that_is_no_covariance_is_refused() -> None:
    with pytest.raises(ValueError, match="positive semidefinite"):
        PoolSampler(kernel=-GRAM)
