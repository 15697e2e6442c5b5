"""How long features are followed, and what becomes of those that say nothing or mislead."""

from collections.abc import Callable
from typing import Any

import numpy as np
import optuna
import pytest
from numpy.typing import NDArray

from study import FeatureKernelSampler, FeatureTable
from study.sampler.acquisition import Model
from study.sampler.gp import ADDITIVE, NEARNESS
from study.sampler.transforms import PATIENCE, PATIENCE_WITH_PRIOR, is_doubtful

Floats = NDArray[np.float64]


def after(age: int) -> Floats:
    """Costs of which the best is followed by so many that are not better."""
    return np.concatenate([[5.0, 1.0], np.full(age, 1.0)])  # an equal one is no better one


@pytest.mark.parametrize(("told", "patience"), [(False, PATIENCE), (True, PATIENCE_WITH_PRIOR)])
def test_every_other_trial_is_doubtful_once_patience_is_over(told: bool, patience: int) -> None:
    assert (PATIENCE, PATIENCE_WITH_PRIOR) == (3, 20)
    for turn in range(6):
        assert not is_doubtful(after(0), turn, told)
        assert not is_doubtful(after(patience - 1), turn, told)
        for age in (patience, patience + 1, patience + 40):
            assert is_doubtful(after(age), turn, told) is (turn % 2 == 1)
    assert not is_doubtful(np.array([3.0]), 1, told)
    assert not is_doubtful(np.empty(0), 1, told)  # no trial has kept its limits


ROWS = 60
X, Y = np.random.default_rng(0).uniform(size=(2, ROWS))
FEATURES = np.column_stack([X + Y, X - Y])


def study_of(features: Floats, **options: Any) -> optuna.Study:
    table = FeatureTable.from_arrays({"x": X, "y": Y}, features)
    return optuna.create_study(sampler=FeatureKernelSampler(table, seed=1, **options))


def without_success(trial: optuna.Trial) -> float:
    """The second trial is the best, and no other is better."""
    trial.suggest_float("x", 0, 1), trial.suggest_float("y", 0, 1)
    return 0.0 if trial.number == 1 else 1.0 + 0.01 * trial.number


def kernels_asked(study: optuna.Study, objective: Any, trials: int) -> dict[int, tuple[Any, Any]]:
    """Kernel and guess of the model of each trial, by its number."""
    asked: dict[int, tuple[Any, Any]] = {}
    made = Model.__init__

    def spied(model: Model, *given: Any, **named: Any) -> None:
        made(model, *given, **named)
        asked[len(model.costs)] = (model.kernel, model.prior_mean)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Model, "__init__", spied)
        study.optimize(objective, n_trials=trials)
    return asked


@pytest.mark.parametrize(
    ("prior", "first"), [(None, 5), ("feature_0", 23)]  # 3, or 20, trials after number 1; then odd
)  # fmt: skip
def test_a_doubtful_trial_looks_at_parameters_alone(prior: str | None, first: int) -> None:
    asked = kernels_asked(study_of(FEATURES, prior=prior), without_success, first + 5)
    for turn, (kernel, guess) in asked.items():
        doubtful = turn >= first and turn % 2 == 1
        assert kernel is (NEARNESS if doubtful else ADDITIVE)
        assert (guess is None) is (doubtful or prior is None)
    assert sum(kernel is NEARNESS for kernel, _ in asked.values()) == 3


def test_trials_that_broke_their_limits_are_neither_success_nor_failure() -> None:
    """They cost less and less; of those that kept them, number 1 is the best."""

    def objective(trial: optuna.Trial) -> float:
        broken = trial.number % 3 == 2
        trial.set_constraint("limit", 1.0 if broken else -1.0)
        return without_success(trial) - (100.0 * trial.number if broken else 0.0)

    asked = kernels_asked(study_of(FEATURES), objective, 10)
    # Kept after number 1: 3, 4, 6, 7, ...; the third of them is told before number 7.
    assert [turn for turn, (kernel, _) in asked.items() if kernel is NEARNESS] == [7, 9]


@pytest.mark.parametrize("number", [5, 6])
def test_it_proposes_the_same_whatever_the_features_are(number: int) -> None:
    """Of the same finished trials, trial 5 is doubtful, trial 6 is not."""
    rows, chosen = [3, 8, 20, 31, 44, 50][:number], set()
    for seed in range(8):
        features = np.random.default_rng(seed).standard_normal((ROWS, 2))
        study = study_of(features)
        for row in rows:
            study.enqueue_trial({"x": X[row], "y": Y[row]})
        study.optimize(without_success, n_trials=number + 1)
        chosen.add(study.trials[number].user_attrs["row"])
    assert (len(chosen) == 1) is (number == 5)


DIMENSION, TRIALS = 4, 24
SEEDS = range(12)  # chosen before the first run


def bowl(unit: Floats) -> Floats:
    return np.asarray(((unit - 0.65) ** 2).sum(axis=1))


def useless(unit: Floats, rng: np.random.Generator) -> Floats:
    return rng.standard_cauchy(len(unit))


def misleading(unit: Floats, rng: np.random.Generator) -> Floats:
    """The cost, folded at its best tenth: the best rows look like mediocre ones."""
    cost = bowl(unit)
    return np.abs(cost - np.quantile(cost, 0.1))


@pytest.mark.parametrize("feature", [useless, misleading])
def test_features_that_are_worth_nothing_leave_the_parameters_to_learn_from(
    feature: Callable[[Floats, np.random.Generator], Floats],
) -> None:
    """Regret against the best of 400 rows: at most half of that of rows drawn at random.

    24 of 400 rows at random are expected to hold the best 4 % of them. At the worst every other
    trial follows the feature, and 12 trials are left to a process of four parameters on a bowl: as
    many as a quadratic has coefficients (15), nearly. Halving the regret asks for less than that.
    """
    ours, at_random = [], []
    names = [f"p{i}" for i in range(DIMENSION)]
    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        unit = rng.uniform(size=(400, DIMENSION))
        cost = bowl(unit)
        columns = dict(zip(names, unit.T, strict=True))
        table = FeatureTable.from_arrays(columns, feature(unit, rng))
        study = optuna.create_study(sampler=FeatureKernelSampler(table, seed=seed))
        study.optimize(
            lambda t: float(bowl(np.array([[t.suggest_float(n, 0, 1) for n in names]]))[0]),
            n_trials=TRIALS,
        )
        ours.append(study.best_value - cost.min())
        drawn = [rng.choice(cost, TRIALS, replace=False).min() for _ in range(200)]
        at_random.append(np.mean(drawn) - cost.min())
    assert np.mean(ours) <= 0.5 * np.mean(at_random)
