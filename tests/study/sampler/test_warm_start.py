"""Trials off the table, of this study or an earlier one: learned from by a function, or by the
nearest row where the user says how near."""

import warnings
from typing import Any

import numpy as np
import optuna
import pytest
from optuna.distributions import CategoricalDistribution, FloatDistribution
from optuna.trial import FrozenTrial

from study import FeatureKernelSampler, FeatureTable
from taichi_nmm.errors import InputError

SPACE = {"a": FloatDistribution(0, 1), "b": FloatDistribution(0.01, 100, log=True)}
A = np.linspace(0, 1, 40)
B = np.geomspace(0.01, 100, 40)


def table() -> FeatureTable:
    rng = np.random.default_rng(0)
    return FeatureTable.from_arrays({"a": A, "b": rng.permutation(B)}, A, space=SPACE)


def cost(trial: optuna.Trial) -> float:
    a = trial.suggest_float("a", 0, 1)
    return (a - 0.7) ** 2 + 0 * trial.suggest_float("b", 0.01, 100, log=True)


def earlier(count: int = 15) -> list[FrozenTrial]:
    study = optuna.create_study(sampler=optuna.samplers.RandomSampler(seed=5))
    study.optimize(cost, n_trials=count)
    return study.get_trials()


def new_study(**options: Any) -> optuna.Study:
    return optuna.create_study(sampler=FeatureKernelSampler(table(), seed=1, **options))


def test_trials_of_an_earlier_study_start_the_model() -> None:
    study = new_study(nearest=0.5)
    study.add_trials(earlier())
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        study.optimize(cost, n_trials=2)
    assert min(trial.values[0] for trial in study.trials[15:]) < 0.01
    assert all(trial.user_attrs["row"] >= 0 for trial in study.trials[15:])


def test_an_enqueued_trial_near_a_row_is_learned_from_and_is_no_row() -> None:
    study = new_study(nearest=0.05)
    near = table().rows.as_parameters(20)
    near["a"] += 0.01
    study.enqueue_trial(near)
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        study.optimize(cost, n_trials=1)
        assert study.trials[0].user_attrs == {}
        study.optimize(cost, n_trials=40)  # its nearest row is still free
    assert len({trial.user_attrs["row"] for trial in study.trials[1:]}) == 40


@pytest.mark.parametrize("nearest", [None, 0.001])
def test_the_warning_names_both_ways_and_how_far_the_nearest_row_is(nearest: float | None) -> None:
    study = new_study(nearest=nearest)
    far = table().rows.as_parameters(20)
    far["a"] += 0.01
    study.enqueue_trial(far)
    with pytest.warns(UserWarning) as said:
        study.optimize(cost, n_trials=4)
    assert len(said) == 1
    message = str(said[0].message)
    assert message.startswith("trials whose parameters are no row of the table are ignored: ")
    for part in ("such as trial 0", "feature_function", "nearest=", f"{0.01 / 2**0.5:.2g} from"):
        assert part in message


def test_resumed_is_uninterrupted_after_a_warm_start() -> None:
    def study() -> optuna.Study:
        made = optuna.create_study()
        made.add_trials(earlier())
        return made

    whole, pieces = study(), study()
    whole.sampler = FeatureKernelSampler(table(), seed=1, nearest=0.5)
    whole.optimize(cost, n_trials=6)
    for _ in range(6):
        pieces.sampler = FeatureKernelSampler(table(), seed=1, nearest=0.5)
        pieces.optimize(cost, n_trials=1)
    assert [trial.params for trial in whole.trials] == [trial.params for trial in pieces.trials]


def test_distances_are_root_mean_squares_of_shares_of_the_ranges() -> None:
    columns = {"a": [0.0, 1.0], "b": [0.01, 100.0], "kind": ["x", "y"]}
    space = SPACE | {"kind": CategoricalDistribution(["x", "y", "z"])}
    rows = FeatureTable.from_arrays(columns, [1, 2], space=space).rows

    def of(a: float, b: float, kind: str) -> tuple[int, float]:
        values = rows.space.row({"a": a, "b": b, "kind": kind})
        assert values is not None
        return rows.nearest(values)

    assert of(0.0, 0.01, "x") == (0, 0.0)
    assert of(1.0, 100.0, "z") == (1, pytest.approx((1 / 3) ** 0.5))
    assert of(0.3, 0.01, "x") == (0, pytest.approx(0.3 / 3**0.5))
    assert of(0.0, 0.1, "x") == (0, pytest.approx(0.25 / 3**0.5))  # a quarter of four decades
    assert of(1.4, 100.0, "y") == (1, pytest.approx(0.4 / 3**0.5))  # outside the range
    assert of(1.0, 1000.0, "y") == (1, pytest.approx(0.25 / 3**0.5))
    assert rows.space.row({"a": 0.0, "b": -5.0, "kind": "x"}) is None  # no logarithm


def test_a_constant_parameter_is_near_only_where_it_is_equal() -> None:
    rows = FeatureTable.from_arrays({"a": A, "c": np.full(40, 2.0)}, A).rows
    assert rows.nearest(np.array([0.0, 2.0])) == (0, 0.0)
    assert rows.nearest(np.array([0.0, 2.5]))[1] == np.inf


@pytest.mark.filterwarnings("ignore:FeatureTable")
def test_a_row_without_features_lends_none() -> None:
    features = A.copy()
    features[20] = np.nan
    rows = FeatureTable.from_arrays({"a": A}, features).rows
    assert rows.nearest(rows.parameters[20])[0] in (19, 21)


@pytest.mark.parametrize("nearest", [-0.1, float("nan")])
def test_how_near_must_be_a_number(nearest: float) -> None:
    with pytest.raises(InputError, match=r"nearest: .* a finite number from 0"):
        new_study(nearest=nearest)


def test_it_is_one_way_or_the_other() -> None:
    with pytest.raises(InputError, match=r"nearest: 0.1 .* feature_function"):
        new_study(nearest=0.1, feature_function=lambda params: params)
    with pytest.raises(InputError, match=r"nearest: 0.1 .* table"):
        FeatureKernelSampler(nearest=0.1)
    with pytest.raises(InputError, match=r"nearest: 0.1 .* table"):
        FeatureKernelSampler(lambda params: params, nearest=0.1)


def test_an_earlier_study_may_have_suggested_otherwise() -> None:
    """Another scale and narrower ranges: Optuna's own samplers fail on the first."""
    rate = np.geomspace(1e-3, 1, 30)
    given = FeatureTable.from_arrays({"rate": rate}, np.log(rate))
    before = optuna.create_study(sampler=FeatureKernelSampler(given, seed=2))
    before.optimize(lambda trial: trial.suggest_float("rate", 1e-3, 1), n_trials=3)
    before.enqueue_trial({"rate": 0.4})
    before.optimize(lambda trial: trial.suggest_float("rate", 0.3, 0.5), n_trials=1)
    study = optuna.create_study(sampler=FeatureKernelSampler(given, seed=1, nearest=0.1))
    study.add_trials(before.trials)
    study.optimize(lambda trial: trial.suggest_float("rate", 1e-3, 1, log=True), n_trials=5)
    assert len({trial.user_attrs["row"] for trial in study.trials if trial.user_attrs}) == 8
    assert study.best_value == rate[0]
