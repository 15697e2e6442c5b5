"""What `sampler.worth(study)` says: its closed forms, features of known worth, and its texts."""

import warnings
from dataclasses import replace

import numpy as np
import optuna
import pytest
from numpy.testing import assert_allclose
from optuna.distributions import FloatDistribution
from optuna.trial import TrialState, create_trial
from scipy import stats

from study import FeatureKernelSampler, FeatureTable
from study.sampler import gp
from study.sampler.diagnostics import RankCorrelation, residuals, residuals_of_constant
from study.sampler.transforms import Points
from tests.study.conftest import refused
from tests.study.sampler.studies import params_of, study_of

# Features that are constant.
pytestmark = pytest.mark.filterwarnings("ignore:FeatureTable")

ROWS = 200
NAMES = ("error", "nothing", "constant")
SPACE = {"a": FloatDistribution(-1, 1), "b": FloatDistribution(0, 5)}
KERNELS = ("additive", "rbf")


def cost_of(a, b):
    """Rough, so that likeness of the parameters says little of it."""
    return np.abs(a) + np.sin(40.0 * a) * np.cos(30.0 * b)


def objective(trial):
    a, b = trial.suggest_float("a", -1, 1), trial.suggest_float("b", 0, 5)
    return float(cost_of(a, b))


def columns():
    rng = np.random.default_rng(0)
    return {"a": rng.uniform(-1, 1, ROWS), "b": rng.uniform(0, 5, ROWS)}


def good_features():
    """The cost itself, slightly wrong and on another scale; noise; a constant."""
    rng = np.random.default_rng(1)
    cost = cost_of(**columns())
    error = np.exp(2.0 * cost + rng.normal(0, 0.1, ROWS))
    return np.column_stack([error, rng.normal(size=ROWS), np.ones(ROWS)])


def new_table(features=None, names=NAMES):
    made = good_features() if features is None else features
    return FeatureTable.from_arrays(columns(), made, list(names), space=SPACE)


with warnings.catch_warnings(action="ignore"):  # one feature is constant
    TABLE = new_table()


def add(study, row, value, **limits):
    """A finished trial of a row of the table, and its limits by name."""
    known = {"params": TABLE.rows.as_parameters(row), "distributions": SPACE}
    study.add_trial(create_trial(value=value, constraints=limits, **known))


def drawn_rows(trials, rng=None):
    """Rows drawn at random; without a generator the first ones, whose order is none."""
    study = optuna.create_study()
    rows = np.arange(ROWS) if rng is None else rng.permutation(ROWS)
    for row in rows[:trials].tolist():
        add(study, row, float(cost_of(**TABLE.rows.as_parameters(row))))
    return study


def worth_of(study, features=TABLE, **options):
    return FeatureKernelSampler(features, seed=1, **options).worth(study)


def model_of(study, **options):
    present = FeatureKernelSampler(TABLE, seed=1, **options)._policy.present(study)
    return present.model


# Closed forms.
@pytest.mark.parametrize("n", [4, 7, 40])
def test_the_correlation_is_spearmans_with_its_interval(n):
    rng = np.random.default_rng(n)
    feature, cost = rng.integers(0, 6, n).astype(float), rng.normal(size=n)
    found = RankCorrelation.of(feature, cost)
    r = stats.spearmanr(feature, cost).statistic
    assert found.value == pytest.approx(r)
    error = np.sqrt((1 + r**2 / 2) / (n - 3))
    ends = np.tanh(np.arctanh(r) + stats.norm.ppf(0.975) * error * np.array([-1, 1]))
    assert_allclose([found.low, found.high], ends, rtol=1e-5)
    assert found.errors == pytest.approx(np.arctanh(r) / error)


@pytest.mark.slow
def test_the_interval_holds_the_correlation_as_often_as_it_says():
    rng = np.random.default_rng(0)
    for rho in (0.0, 0.7):
        spearman = 6 / np.pi * np.arcsin(rho / 2)  # of a normal pair
        draws = rng.multivariate_normal([0, 0], [[1, rho], [rho, 1]], (2000, 20))
        found = [RankCorrelation.of(*draw.T) for draw in draws]
        held = np.mean([r is not None and r.low <= spearman <= r.high for r in found])
        assert 0.93 < held < 0.97


def test_infinite_features_are_extreme_missing_ones_left_out_and_few_trials_not_certain():
    feature = np.array([1.0, np.inf, 2.0, np.nan, -np.inf, 3.0])
    found = RankCorrelation.of(feature, np.array([1.0, 4.0, 2.0, -9.0, 0.0, 3.0]))
    assert found.value == 1.0
    few, many = (RankCorrelation.of(np.arange(n), -np.arange(n)) for n in (4.0, 40.0))
    assert few.value == many.value == few.low == many.low == -1.0
    assert few.high > 0.5 and many.high < -0.95


@pytest.mark.parametrize(
    ("feature", "cost"),
    [
        (np.arange(3.0), np.arange(3.0)),
        (np.ones(9), np.arange(9.0)),
        (np.arange(9.0), np.ones(9)),
        (np.array([1.0, 2, 3, np.nan, np.nan]), np.arange(5.0)),
    ],
)
def test_without_enough_there_is_no_correlation(feature, cost):
    assert RankCorrelation.of(feature, cost) is None


@pytest.mark.parametrize("kernel", KERNELS)
def test_leaving_out_is_that_of_refits_with_the_same_constants(kernel, monkeypatch):
    monkeypatch.setattr(gp, "LARGEST_RATIO", 0.0)  # 64 bits everywhere
    posterior = model_of(drawn_rows(12), kernel=kernel).posterior
    y = posterior.cost_mean + posterior.cost_sd * posterior.y
    missed = []
    for left in range(len(y)):
        x, others = posterior.x, np.arange(len(y)) != left
        kept = posterior.covariance, posterior.theta, x[others], y[others]
        refit = gp.condition(*kept, noisy=False)
        missed.append(y[left] - refit.mean(Points.of(x[[left]], x[[left], :0]))[0])
    assert_allclose(residuals(posterior), missed, rtol=1e-6, atol=1e-9)
    assert_allclose(
        residuals_of_constant(np.array([1.0, 2.0, 6.0])), [1 - 4, 2 - 3.5, 6 - 1.5]
    )


# Features of known worth.
@pytest.mark.parametrize("kernel", KERNELS)
def test_a_feature_that_tells_the_cost_is_worth_something(kernel):
    worth = worth_of(drawn_rows(30), kernel=kernel)
    good, useless, constant = worth.correlations
    assert good.low > 0.8
    assert useless.low < 0.0 < useless.high
    assert constant is None
    assert worth.errors.model < 0.6
    assert (worth.errors.without is None) == (kernel != "additive")
    assert worth.verdict.startswith("The features explain part of the costs")


@pytest.mark.slow
@pytest.mark.parametrize("kernel", KERNELS)
def test_features_without_worth_are_rarely_praised(kernel):
    """One in ten may be mistaken: 5 % by their correlations, as many by the model."""
    praised, ratios = 0, []
    for seed in range(60):
        rng = np.random.default_rng([7, seed])
        useless = new_table(rng.normal(size=(ROWS, 3)), ("one", "two", "three"))
        worth = worth_of(drawn_rows(20, rng), useless, kernel=kernel)
        assert worth.errors is not None
        ratios.append(worth.errors.model / (worth.errors.without or 1.0))
        praised += worth.verdict.startswith(
            ("The features explain", "The costs follow")
        )
    assert stats.binomtest(praised, 60, 0.1, alternative="greater").pvalue > 0.001
    assert np.median(ratios) > 0.9


def test_a_constant_feature_has_no_worth():
    worth = worth_of(drawn_rows(12), new_table(np.ones((ROWS, 1)), ("constant",)))
    assert worth.correlations == (None,)
    assert "not (yet) worth anything" in worth.verdict


def test_the_gain_is_over_the_parameters_where_they_are_better_than_a_constant():
    study = drawn_rows(0)
    for row in range(20):
        add(study, row, TABLE.rows.as_parameters(row)["a"] ** 2)
    errors, model = worth_of(study).errors, model_of(study)
    assert errors.without is not None and errors.without < 1.0
    alike = Points.of(np.zeros_like(model.trials.features), model.trials.coordinates)
    blind = residuals(replace(model, trials=alike).posterior)
    less = np.abs(blind) - np.abs(residuals(model.posterior))
    assert errors.gain == pytest.approx(less.mean() / stats.sem(less))


# The study, and how it is left.
@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("trials", [0, 1, 3, 4])
def test_few_trials_or_those_that_cost_the_same_are_no_error(kernel, trials):
    worth = worth_of(drawn_rows(trials), kernel=kernel)
    assert worth.verdict == f"too few trials: {trials} of 5"
    assert worth.errors is None
    assert (worth.correlations[0] is not None) == (trials == 4)
    assert worth.names == NAMES
    assert str(worth).startswith(worth.verdict) and worth.verdict in worth.markdown()
    alike = worth_of(study_of(TABLE, lambda trial: 0.0 * objective(trial), trials + 5))
    known = f"nothing is known of the features: all {trials + 5} trials cost the same"
    assert (alike.verdict, alike.correlations) == (known, (None, None, None))


def by_hand(points):
    return np.column_stack([cost_of(*points.T), points[:, 1] % 0.3])


BY_HAND = new_table(by_hand(np.column_stack(list(columns().values()))), ("error", "b"))
FORMS = {
    "table": (TABLE, {}),
    "dog": (new_table(good_features()[:, :1], ("error",)), {"kernel": "rbf"}),
    "off_grid": (BY_HAND, {"feature_function": by_hand, "off_grid": 20}),
    "function": (by_hand, {"space": SPACE}),
    "function, found": (by_hand, {}),
    "function, rbf": (by_hand, {"kernel": "rbf"}),
}


@pytest.mark.parametrize("form", FORMS)
def test_every_form_tells_the_same_twice_and_leaves_the_study_and_what_is_proposed(
    form,
):
    features, options = FORMS[form]
    study, not_looked = (study_of(features, **options) for _ in range(2))
    sampler = study.sampler
    for _ in range(9):
        study.optimize(objective, n_trials=1)
        sampler.worth(study)
        not_looked.optimize(objective, n_trials=1)
    assert params_of(study) == params_of(not_looked)
    study.tell(study.ask(), state=TrialState.FAIL)
    before = study.get_trials()
    worth = sampler.worth(study)
    assert worth.trials == 9
    assert np.isfinite(worth.errors.model)
    assert worth.correlations[0].value > 0.5
    assert worth_of(study, features, **options) == worth == sampler.worth(study)
    assert study.get_trials() == before
    assert not study.user_attrs and not study._storage.get_study_system_attrs(
        study._study_id
    )
    study.ask().suggest_float("a", -1, 1)  # one that is running is not counted
    assert sampler.worth(study).trials == 9


@pytest.mark.parametrize("trials", [0, 1, 4])
@pytest.mark.parametrize("space", [None, SPACE])
def test_a_function_with_few_trials_is_no_error(trials, space):
    worth = worth_of(study_of(by_hand, objective, trials), by_hand, space=space)
    assert worth.verdict == f"too few trials: {trials} of 5"
    assert worth.names == (("feature_0", "feature_1") if trials else ())
    assert str(worth) and worth.markdown()


def test_a_maximised_study_is_the_same_with_the_sign_turned():
    down, up = drawn_rows(15), optuna.create_study(direction="maximize")
    for trial in down.trials:
        given = {"params": trial.params, "distributions": trial.distributions}
        up.add_trial(create_trial(value=-trial.values[0], **given))
    of_down, of_up = map(worth_of, (down, up))
    assert of_up.correlations == of_down.correlations
    assert of_up.errors == of_down.errors
    assert "minus the study's value" in str(of_up) and "minus" not in str(of_down)


def test_trials_off_the_table_are_not_counted_and_infinite_costs_are():
    study = drawn_rows(6)
    study.enqueue_trial({"a": 0.123, "b": 4.5})
    study.optimize(objective, n_trials=1)
    assert worth_of(study).trials == 6
    first = worth_of(drawn_rows(20), by_hand, space=SPACE).correlations[0]
    assert first.value == 1.0  # without a note, the function is called
    study = drawn_rows(10)
    add(study, 50, np.inf)
    add(study, 51, -np.inf)
    worth = worth_of(study)
    assert worth.trials == 12
    assert np.isfinite(worth.errors.model)


@pytest.mark.parametrize("options", [{}, {"features": TABLE, "kernel": "euclidean"}])
def test_without_features_or_with_several_objectives_there_is_no_worth(options):
    sampler = FeatureKernelSampler(**options)
    with refused(r"^kernel: 'euclidean'.*nothing to report$"):
        sampler.worth(optuna.create_study())
    assert not sampler.has_features and FeatureKernelSampler(TABLE).has_features
    with pytest.raises(ValueError, match="multi-objective"):
        worth_of(optuna.create_study(directions=["minimize", "maximize"]))


# What people read.
def test_the_table_and_the_note_have_a_row_a_feature():
    worth = worth_of(drawn_rows(20))
    lines = str(worth).splitlines()
    assert lines[0] == worth.verdict
    assert lines[2].split() == ["feature", "rank", "correlation", "with", "the", "cost"]
    assert [line.split()[0] for line in lines[3:6]] == list(NAMES)
    assert "20 trials" in lines[6] and "biased towards zero" in lines[6]
    note = worth_of(drawn_rows(20), new_table(names=("a|b", *NAMES[1:]))).markdown()
    assert note.startswith("## Are the features worth anything?\n")
    assert "\n| feature | rank correlation with the cost |\n|---|---|\n" in note
    assert "\n| a\\|b | +" in note and "\n| constant | - |\n" in note


def test_turns_that_are_left_to_the_parameters_are_said():
    study = drawn_rows(10)
    add(study, 100, -99.0)
    assert "left to the parameters" not in str(worth_of(study))
    for row in (101, 102, 103):
        add(study, row, 9.0)
    add(study, 104, -999.0, limit=1.0)  # it is broken, and no success
    assert "left to the parameters" in str(worth_of(study))
    assert "left to the parameters" not in str(worth_of(study, kernel="rbf"))
