"""What is not known is unknown to a prediction: neither certain nor impossible."""

import numpy as np
import optuna
import pytest
from numpy.testing import assert_allclose
from optuna.distributions import FloatDistribution
from scipy.stats import norm
from scipy.stats import t as student

from study import FeatureKernelSampler, FeatureTable
from study.sampler.calibration import COST, MISFIT
from study.sampler.prediction import REACH
from study.sampler.unlike import READING
from tests.study.sampler.studies import told

LINE = np.linspace(0.0, 1.0, 40)
SPACE = {"x": FloatDistribution(0.0, 1.0)}
COSTS = np.column_stack([0.1 + (LINE - place) ** 2 for place in (0.3, 0.5, 0.8)])


def sampler_of(outcomes, features=None):
    table = FeatureTable.from_arrays({"x": LINE}, features, outcomes=outcomes)
    return FeatureKernelSampler(table, seed=1, success=0.5)


def predicted(outcomes, values, limits=(), features=None):
    """What is predicted of all rows after trials of the first ones."""
    study = optuna.create_study(sampler=sampler_of(outcomes, features))
    for row, value in enumerate(values):
        known = {"limit": limits[row]} if row < len(limits) else {}
        told(study, SPACE, {"x": LINE[row]}, value, **known)
    return study.sampler.predict(study)


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
    outcomes,
):
    found = predicted(outcomes, [])
    assert_allclose(found.value, outcomes.reshape(40, -1)[:, 0])
    assert np.isnan([found.low, found.high, found.success, found.kept]).all()
    shown = str(found).split("\n")
    first = f"row 0: {found.value[0]:.4g} (interval unknown), success unknown, limits kept unknown"
    assert shown[0] == first and shown[-1] == "and 30 more"


def test_where_worlds_agree_on_a_row_alone_its_interval_is_unknown():
    outcomes = COSTS.copy()
    outcomes[7] = 1.0
    found = predicted(outcomes, [])
    assert np.flatnonzero(np.isnan(found.success)).tolist() == [7]
    assert (found.low < found.high).sum() == 39


def test_before_a_trial_the_interval_is_that_of_a_machine_unlike_one_more_world():
    """Student's t, of three worlds in units of the model: in one, without a logarithm."""
    outcomes = COSTS - 0.2
    found = predicted(outcomes, [])
    unit = MISFIT * outcomes.std()
    sd = np.hypot(outcomes.std(axis=1, ddof=1) * np.sqrt(1.0 + 1.0 / 3.0), unit)
    middle, away = outcomes.mean(axis=1) + COST.bias * sd, student.ppf(0.975, 2) * sd
    most = np.array([outcomes.min(), outcomes.max()])
    most += REACH * outcomes.std() * np.array([-1.0, 1.0])
    assert_allclose(found.low, np.clip(middle - away, *most))
    assert_allclose(found.high, np.clip(middle + away, *most))
    # A success in as many of the worlds, and of one more of each kind.
    z = (0.5 - outcomes) / (READING * outcomes.std())
    assert_allclose(found.success, (norm.cdf(z).sum(axis=1) + 1.0) / 5.0)


@pytest.mark.parametrize(
    "outcomes", [COSTS[:, 0], COSTS[:, [0, 0, 0]]], ids=["one", "equal"]
)
def test_a_trial_that_failed_where_the_only_world_succeeds_leaves_nothing_certain(
    outcomes,
):
    found = predicted(outcomes, [0.9])
    assert (found.low < found.value).all() and (found.value < found.high).all()
    assert found.success.max() < 0.9


# Values.
@pytest.mark.parametrize("factor", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("count", [1, 3])
def test_after_trials_of_one_value_no_interval_is_known(count, factor):
    """Whatever its unit: nothing tells how far other values may be."""
    features = np.column_stack([LINE, LINE**2])
    found = predicted(None, [4.777 * factor] * count, features=features)
    assert_allclose(found.value, 4.777 * factor)
    assert np.isnan([found.low, found.high, found.success]).all()
    study = optuna.create_study(sampler=sampler_of(None, features))
    for row in range(count):
        told(study, SPACE, {"x": LINE[row]}, factor)
    shown = str(study.sampler.best(study))
    assert f"{factor:.4g} (interval unknown), by 1 trial" in shown


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
def test_of_a_limit_of_which_too_little_is_known_no_model_is_asked(limits, expected):
    found = predicted(COSTS, [0.3] * 8, limits)
    assert_allclose(found.kept, np.nan if expected is None else expected)


def test_a_limit_is_kept_near_trials_that_kept_it_and_not_near_those_that_did_not():
    study = optuna.create_study(sampler=sampler_of(COSTS))
    for row in range(0, 40, 4):
        x = LINE[row]
        told(study, SPACE, {"x": x}, float(COSTS[row, 1]), limit=x - 0.5)
    found = study.sampler.predict(study)
    assert (found.kept[LINE < 0.4] > 0.9).all() and (found.kept[LINE > 0.6] < 0.1).all()
    for name in ("value", "low", "high", "success", "kept"):
        assert np.isfinite(getattr(found, name)).all()


def test_a_limit_that_the_best_trial_has_not_told_of_is_named():
    study = optuna.create_study(sampler=sampler_of(COSTS))
    told(study, SPACE, {"x": LINE[3]}, 0.9, torque=-1.0)
    told(study, SPACE, {"x": LINE[20]}, 0.2)
    best = study.sampler.best(study)
    assert best.number == 1 and best.untold == ("torque",)
    assert str(best).endswith("the others tell. Whether it keeps torque is unknown.")
