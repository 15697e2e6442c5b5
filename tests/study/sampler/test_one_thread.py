"""Proposals are computed on one thread of BLAS, whatever their process has."""

from collections.abc import Callable
from typing import Any

import numpy as np
import optuna
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from study import FeatureKernelSampler, FeatureTable
from study.experiment.arms import find_arm
from study.experiment.experiment import Experiment
from study.experiment.one_study import OneStudy
from study.experiment.trials import simulate_trials
from study.sampler import acquisition as model

GIVEN = 2


def blas_threads() -> set[int]:
    return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}


@pytest.fixture
def watch(monkeypatch: pytest.MonkeyPatch) -> Callable[[Any, str], list[set[int]]]:
    """Has a function note the threads that BLAS has where it is called."""

    def watch(owner: Any, name: str) -> list[set[int]]:
        seen: list[set[int]] = []
        function = getattr(owner, name)

        def watched(*arguments: Any, **options: Any) -> Any:
            seen.append(blas_threads())
            return function(*arguments, **options)

        monkeypatch.setattr(owner, name, watched)
        return seen

    return watch


def bowl(trial: optuna.Trial) -> float:
    return trial.suggest_float("a", -1, 1) ** 2 + 0.01 * trial.suggest_float("b", 0, 5)


@pytest.mark.parametrize("tabled", [True, False])
def test_of_a_sampler(
    tabled: bool, table: FeatureTable, watch: Callable[[Any, str], list[set[int]]]
) -> None:
    seen = watch(model, "learn")
    sampler = FeatureKernelSampler(table, seed=1) if tabled else FeatureKernelSampler(seed=1)
    with threadpool_limits(GIVEN, user_api="blas"):
        optuna.create_study(sampler=sampler).optimize(bowl, n_trials=6)
        assert blas_threads() == {GIVEN}
    assert seen and all(threads == {1} for threads in seen)


def test_of_an_experiments_study(
    toy: Experiment, watch: Callable[[Any, str], list[set[int]]]
) -> None:
    """Also where another library proposes."""
    asked, told = watch(optuna.Study, "ask"), watch(optuna.Study, "tell")
    with threadpool_limits(GIVEN, user_api="blas"):
        one = OneStudy(toy, find_arm("random"), 0, optuna.create_study())
        rows = simulate_trials(toy, [0], np.array([one.ask()])).rows
        one.tell(1.0, rows)
        assert blas_threads() == {GIVEN}
    assert asked == told == [{1}]
