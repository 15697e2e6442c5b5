"""What is not known is unknown to a prediction: neither certain nor impossible."""

from typing import Any

import numpy as np
import optuna
import pytest
from numpy.testing import assert_allclose
from scipy.stats import t as student

from study import FeatureKernelSampler, FeatureTable
from study.sampler.prediction import Prediction
from tests.study.sampler.studies import Floats

LINE = np.linspace(0.0, 1.0, 40)
COSTS = np.column_stack([0.1 + (LINE - place) ** 2 for place in (0.3, 0.5, 0.8)])


def sampler_of(outcomes: Any, features: Any = None) -> FeatureKernelSampler:
    table = FeatureTable.from_arrays({"x": LINE}, features, outcomes=outcomes)
    return FeatureKernelSampler(table, seed=1, success=0.5)


def told(
    sampler: FeatureKernelSampler,
    values: list[float],
    limits: list[float] | None = None,
) -> Prediction:
    """What is predicted of all rows after trials of the first ones."""
    study, space = (
        optuna.create_study(sampler=sampler),
        {"x": optuna.distributions.FloatDistribution(0, 1)},
    )
    for row, value in enumerate(values):
        study.enqueue_trial({"x": LINE[row]})
        trial = study.ask(space)
        if limits is not None and row < len(limits):
            trial.set_constraint("limit", limits[row])
        study.tell(trial, value)
    return sampler.predict(study)


# Worlds.
@pytest.mark.parametrize(
    "outcomes",
    [
        COSTS[:, 0],
        COSTS[:, [0, 0, 0]],
        COSTS[:, [0, 0]] * [1.0, 1.0 + 1e-12],
        np.ones((40, 3)),
    ],
    ids=["one", "equal", "nearly equal", "all the same"],
)
def test_of_one_world_or_of_worlds_that_agree_no_interval_is_known(
    outcomes: Floats,
) -> None:
    found = told(sampler_of(outcomes), [])
    assert_allclose(found.value, outcomes.reshape(40, -1)[:, 0])
    assert np.isnan([found.low, found.high, found.success, found.kept]).all()
    shown = str(found).split("\n")
    first = f"row 0: {found.value[0]:.4g} (interval unknown), success unknown, limits kept unknown"
    assert shown[0] == first and shown[-1] == "and 30 more"


def test_where_worlds_agree_on_a_row_alone_its_interval_is_unknown() -> None:
    outcomes = COSTS.copy()
    outcomes[7] = 1.0
    found = told(sampler_of(outcomes), [])
    assert np.flatnonzero(np.isnan(found.success)).tolist() == [7]
    assert (found.low < found.high).sum() == 39


def test_before_a_trial_the_interval_is_that_of_one_more_world() -> None:
    """Student's t, of three worlds in units of the model: in one, without a logarithm."""
    outcomes = COSTS - 0.2
    found = told(sampler_of(outcomes), [])
    sd = outcomes.std(axis=1, ddof=1) * np.sqrt(1.0 + 1.0 / 3.0)
    away = student.ppf(0.975, 2) * sd
    assert_allclose(found.high - found.low, 2.0 * away)
    assert_allclose(found.success, student.cdf((0.5 - outcomes.mean(axis=1)) / sd, 2))


@pytest.mark.parametrize(
    "outcomes", [COSTS[:, 0], COSTS[:, [0, 0, 0]]], ids=["one", "equal"]
)
def test_a_trial_that_failed_where_the_only_world_succeeds_leaves_nothing_certain(
    outcomes: Floats,
) -> None:
    found = told(sampler_of(outcomes), [0.9])
    assert (found.low < found.value).all() and (found.value < found.high).all()
    assert found.success.max() < 0.9


# Values.
@pytest.mark.parametrize("factor", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("count", [1, 3])
def test_after_trials_of_one_value_no_interval_is_known(
    count: int, factor: float
) -> None:
    """Whatever its unit: nothing tells how far other values may be."""
    sampler = sampler_of(None, np.column_stack([LINE, LINE**2]))
    found = told(sampler, [4.777 * factor] * count)
    assert_allclose(found.value, 4.777 * factor)
    assert np.isnan([found.low, found.high, found.success]).all()
    study = optuna.create_study(sampler=sampler)
    study.optimize(
        lambda trial: trial.suggest_float("x", 0, 1) * 0.0 + factor, n_trials=count
    )
    assert f"{factor:.4g} (interval unknown), by 1 trial" in str(sampler.best(study))


# Limits.
@pytest.mark.parametrize(
    ("limits", "expected"),
    [
        ([], None),
        ([-1.0], None),
        ([-30.0, -29.0], None),
        ([-1e-3] * 2, None),
        ([-30.0] * 3, 4 / 5),
        ([-1e-3] * 8, 9 / 10),
        ([110.0], 1 / 3),
        ([1e-3] * 3, 1 / 5),
    ],
)
def test_of_a_limit_of_which_too_little_is_known_no_model_is_asked(
    limits: list[float], expected: float | None
) -> None:
    found = told(sampler_of(COSTS), [0.3] * 8, limits)
    assert_allclose(found.kept, np.nan if expected is None else expected)


def test_a_limit_is_kept_near_trials_that_kept_it_and_not_near_those_that_did_not() -> (
    None
):
    sampler = sampler_of(COSTS)
    study = optuna.create_study(sampler=sampler)
    for row in range(0, 40, 4):
        study.enqueue_trial({"x": LINE[row]})
        trial = study.ask(
            sampler.infer_relative_search_space(study, study.trials[row // 4])
        )
        trial.set_constraint("limit", LINE[row] - 0.5)
        study.tell(trial, float(COSTS[row, 1]))
    found = sampler.predict(study)
    assert (found.kept[LINE < 0.4] > 0.9).all() and (found.kept[LINE > 0.6] < 0.1).all()
    for name in ("value", "low", "high", "success", "kept"):
        assert np.isfinite(getattr(found, name)).all()


def test_a_limit_that_the_best_trial_has_not_told_of_is_named() -> None:
    sampler = sampler_of(COSTS)
    study = optuna.create_study(sampler=sampler)
    for row, value in ((3, 0.9), (20, 0.2)):
        study.enqueue_trial({"x": LINE[row]})
        trial = study.ask({"x": optuna.distributions.FloatDistribution(0, 1)})
        if row == 3:
            trial.set_constraint("torque", -1.0)
        study.tell(trial, value)
    best = sampler.best(study)
    assert best.number == 1 and best.untold == ("torque",)
    assert str(best).endswith("the others tell. Whether it keeps torque is unknown.")
