"""First trials, turns that are left to the parameters, why a trial is made, one thread of BLAS."""

import numpy as np
import optuna
import pytest
from optuna.distributions import FloatDistribution
from threadpoolctl import threadpool_info, threadpool_limits

from study import FeatureTable
from study.experiment.arms import find_arm
from study.experiment.one_study import OneStudy
from study.sampler import acquisition
from study.sampler.acquisition import Aim, Model
from study.sampler.covariance import ADDITIVE, NEARNESS
from study.sampler.evidence import PATIENCE
from study.sampler.transforms import Points
from tests.study.sampler.studies import (
    bowl,
    model_after,
    rows_of,
    run_code,
    study_of,
    summed,
)

ROWS = 70


only_x = summed(x=(0, 1))


def drawn(seed):
    """Three features with a common part, heavy-tailed, of different units, [70, 3]."""
    rng = np.random.default_rng(seed)
    common = rng.standard_normal(ROWS)
    own = rng.standard_normal((ROWS, 3))
    return np.exp(0.8 * common[:, None] + 0.4 * own) * [1.0, 1e3, 1e-3]


def table_of(features, **known):
    return FeatureTable.from_arrays({"x": np.linspace(0, 1, ROWS)}, features, **known)


def first_rows(
    features,
    trials,
    *,
    seed=0,
    kernel=None,
    **known,
):
    """Rows of the first trials, whose costs have nothing to do with them."""
    costs = np.random.default_rng(seed).uniform(size=ROWS)

    def cost(trial):
        return float(costs[trial.number] + 0 * only_x(trial))

    return rows_of(
        study_of(table_of(features, **known), cost, trials, seed=seed, kernel=kernel)
    )


@pytest.mark.parametrize("better", ["higher", "lower"])
@pytest.mark.parametrize("column", range(3))
def test_with_a_ranking_they_are_its_first_three(better, column):
    """A ranking tells no cost, so that one trial is no model yet."""
    for seed in range(3):
        features = drawn(seed)
        best_first = np.argsort(
            features[:, column] * (1.0 if better == "lower" else -1.0)
        )
        rows = first_rows(
            features, 3, seed=seed, outcomes=features[:, column], better=better
        )
        assert rows == best_first[:3].tolist()


@pytest.mark.parametrize("seed", range(5))
def test_with_features_they_are_the_ends_of_the_first_principal_component(seed):
    features = drawn(seed)
    scores = table_of(features).rows.scores.standard(features)
    centred = scores - scores.mean(axis=0)
    along = np.linalg.svd(centred)[0][:, 0]  # not by eigenvalues, as the sampler does
    ends = {int(np.argmin(along)), int(np.argmax(along))}
    rows = first_rows(features, 2, seed=seed)
    assert set(rows) == ends
    assert scores[rows[0]].sum() > scores[rows[1]].sum()  # more of most features first


def test_one_feature_is_tried_at_its_ends_an_infinite_score_first_and_other_kernels_at_random():
    features = drawn(1)
    feature = features[:, 0]
    assert first_rows(feature, 2) == [int(np.argmax(feature)), int(np.argmin(feature))]
    feature[[5, 6]] = np.inf, -np.inf
    assert first_rows(features, 1, outcomes=feature, better="higher") == [5]
    assert first_rows(features, 1, outcomes=feature, better="lower") == [6]
    for kernel in ("rbf", "euclidean"):
        first = {
            tuple(first_rows(drawn(0), 3, seed=seed, kernel=kernel))
            for seed in range(6)
        }
        assert len(first) == 6


@pytest.mark.parametrize("ranked", [False, True])
def test_trials_that_can_be_learned_from_count_among_them(ranked):
    """Two finished rows, enqueued: the third trial is the model's, or still the ranking's."""
    features = drawn(2)
    table = table_of(
        features,
        outcomes=features[:, 0] if ranked else None,
        better="higher" if ranked else None,
    )
    middle = map(
        table.rows.as_parameters, np.argsort(features[:, 0])[[30, 40]].tolist()
    )
    study = study_of(table, only_x, 3, enqueued=middle)
    assert bool(study.sampler._policy.known) is not ranked
    assert not ranked or rows_of(study)[2] == features[:, 0].argmax()


def ends_first(params):
    return np.column_stack([np.exp(9.0 * params[:, 0]), params[:, 0] ** 3])


def test_of_a_space_they_are_the_ends_too():
    """Of 2,048 points anywhere, the last lies within a hundredth of an end: 1 - 1e-9 are sure."""
    space = {"x": FloatDistribution(0, 1)}
    first, second = study_of(ends_first, only_x, 2, seed=3, space=space).trials
    assert first.params["x"] >= 0.99 and second.params["x"] <= 0.01


def doubts(costs, turn, limits=None):
    """Whether a sampler by features leaves this trial to the parameters, after these costs."""
    trials = Points.of(np.empty((len(costs), 0)), np.empty((len(costs), 0)))
    model = model_after(trials, costs, ADDITIVE, limits=limits)
    return study_of(table_of(np.eye(ROWS))).sampler._policy.doubts(model, turn)


# How long features are followed.
def test_every_other_trial_is_doubtful_once_patience_is_over():
    patience = PATIENCE
    for turn in range(6):
        for age in (0, patience - 1, patience, patience + 1, patience + 40):
            costs = np.array([5.0, 1.0] + [1.0] * age)  # an equal one is no better one
            doubtful = age >= patience and turn % 2 == 1
            assert doubts(costs, turn) is doubtful
    assert not doubts(np.array([3.0]), 1)
    broken = np.array([1.0] + [0.0] * patience)[:, None]
    assert not doubts(np.arange(1.0 + len(broken))[1:], 1, broken)
    assert not doubts(np.array([3.0]), 1, np.ones((1, 1)))  # none kept its limits


X, Y = np.random.default_rng(0).uniform(size=(2, 60))
XY, FEATURES = {"x": X, "y": Y}, np.column_stack([X + Y, X - Y])


def without_success(trial):
    """The second trial is the best, and no other is better."""
    trial.suggest_float("x", 0, 1), trial.suggest_float("y", 0, 1)
    return 0.0 if trial.number == 1 else 1.0 + 0.01 * trial.number


def kernels_asked(study, objective, trials):
    """Kernel of the model of each trial, by its number."""
    asked = {}
    made = Model.__init__

    def spied(model, *given, **named):
        made(model, *given, **named)
        asked[len(model.costs)] = model.kernel

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Model, "__init__", spied)
        study.optimize(objective, n_trials=trials)
    return asked


def test_a_doubtful_trial_looks_at_parameters_alone():
    first = 5  # 3 trials after number 1; then odd
    study = study_of(FeatureTable.from_arrays(XY, FEATURES))
    asked = kernels_asked(study, without_success, first + 5)
    for turn, kernel in asked.items():
        assert kernel is (NEARNESS if turn >= first and turn % 2 == 1 else ADDITIVE)
    assert sum(kernel is NEARNESS for kernel in asked.values()) == 3


def test_trials_that_broke_their_limits_are_neither_success_nor_failure():
    """They cost less and less; of those that kept them, number 1 is the best."""

    def objective(trial):
        broken = trial.number % 3 == 2
        trial.set_constraint("limit", 1.0 if broken else -1.0)
        return without_success(trial) - (100.0 * trial.number if broken else 0.0)

    asked = kernels_asked(
        study_of(FeatureTable.from_arrays(XY, FEATURES)), objective, 10
    )
    # Kept after number 1: 3, 4, 6, 7, ...; the third of them is told before number 7.
    assert [turn for turn, kernel in asked.items() if kernel is NEARNESS] == [7, 9]


DIMENSION, TRIALS = 4, 24
SEEDS = range(12)  # chosen before the first run


def round_bowl(unit):
    return np.asarray(((unit - 0.65) ** 2).sum(axis=1))


def misleading(unit, rng):
    """The cost, folded at its best tenth: the best rows look like mediocre ones."""
    cost = round_bowl(unit)
    return np.abs(cost - np.quantile(cost, 0.1))


def useless(unit, rng):
    return rng.standard_cauchy(len(unit))


@pytest.mark.slow
@pytest.mark.parametrize("feature", [useless, misleading])
def test_features_that_are_worth_nothing_leave_the_parameters_to_learn_from(feature):
    """Half the regret of rows at random, of which 24 of 400 are expected to hold the best 4 %.

    At the worst 12 trials are left to a process of four parameters on a bowl of 15
    coefficients.
    """
    ours, at_random = [], []
    names = [f"p{i}" for i in range(DIMENSION)]

    def bowl_of(trial):
        point = [trial.suggest_float(name, 0, 1) for name in names]
        return float(round_bowl(np.array([point]))[0])

    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        unit = rng.uniform(size=(400, DIMENSION))
        cost = round_bowl(unit)
        table = FeatureTable.from_arrays(
            dict(zip(names, unit.T, strict=True)), feature(unit, rng)
        )
        ours.append(study_of(table, bowl_of, TRIALS, seed=seed).best_value - cost.min())
        drawn = [rng.choice(cost, TRIALS, replace=False).min() for _ in range(200)]
        at_random.append(np.mean(drawn) - cost.min())
    assert np.mean(ours) <= 0.5 * np.mean(at_random)


# Threads.
GIVEN = 2


def blas_threads():
    return {
        pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"
    }


@pytest.fixture
def watch(monkeypatch):
    """Has a function note the threads that BLAS has where it is called."""

    def watch(owner, name):
        seen = []
        function = getattr(owner, name)

        def watched(*arguments, **options):
            seen.append(blas_threads())
            return function(*arguments, **options)

        monkeypatch.setattr(owner, name, watched)
        return seen

    return watch


@pytest.mark.parametrize("tabled", [True, False])
def test_a_sampler_computes_on_one_thread_of_blas(tabled, table, watch):
    seen = watch(acquisition, "learn")
    with threadpool_limits(GIVEN, user_api="blas"):
        study_of(table if tabled else None, bowl, 6)
        assert blas_threads() == {GIVEN}
    assert seen and all(threads == {1} for threads in seen)


def test_a_study_of_an_experiment_does(toy, watch):
    """Also where another library proposes."""
    asked, told = watch(optuna.Study, "ask"), watch(optuna.Study, "tell")
    with threadpool_limits(GIVEN, user_api="blas"):
        one = OneStudy(toy, find_arm("random"), 0, optuna.create_study())
        one.ask()
        one.tell([1.0], {})
        assert blas_threads() == {GIVEN}
    assert asked == told == [{1}]


PROGRAM = """
import numpy as np, optuna
from threadpoolctl import threadpool_info
from study import FeatureKernelSampler, FeatureTable
from study.sampler import acquisition
learn = acquisition.learn
def watched(*arguments):
    print({pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"})
    return learn(*arguments)
acquisition.learn = watched
x = np.linspace(0.0, 1.0, 9)
sampler = FeatureKernelSampler(FeatureTable.from_arrays({"x": x}, x**2), seed=1)
optuna.create_study(sampler=sampler).optimize(lambda t: t.suggest_float("x", 0.0, 1.0), 3)
"""


@pytest.mark.slow
def test_scipys_own_library_is_limited_too():
    """It is loaded by the first proposal of a process, after NumPy's."""
    done = run_code(PROGRAM, OPENBLAS_NUM_THREADS="2")
    assert done.stdout == "{1}\n", done.stderr


def whys_of(study):
    return [trial.user_attrs["why"] for trial in study.trials]


# A row falls in a world for reasons of its own.
FALLS = np.where(np.random.default_rng(0).random((ROWS, 12)) < 0.5, 40.0, 1.0)


@pytest.mark.parametrize(
    ("outcomes", "value", "limit", "aims"),
    [
        (None, 1.0, -1.0, [Aim.BEGIN] * 2 + [Aim.IMPROVEMENT]),
        (None, 1.0, 1.0, [Aim.BEGIN] * 2 + [Aim.LIMITS]),
        (FALLS, 3.0, -1.0, [Aim.RANKING] * 3 + [Aim.SUCCESS]),
        (FALLS, 1.0, -1.0, [Aim.RANKING] + [Aim.IMPROVEMENT] * 2),
        (FALLS, 1.0, 1.0, [Aim.RANKING] * 3 + [Aim.LIMITS]),
    ],
    ids=["features", "all break a limit", "none succeeds", "all do", "none counts"],
)
def test_a_trial_says_what_it_was_chosen_for(outcomes, value, limit, aims):
    features = None if outcomes is not None else drawn(1)
    study = study_of(table_of(features, outcomes=outcomes), success=1.5)

    def objective(trial):
        trial.set_constraint("heat", limit)
        return value + 0.01 * only_x(trial)

    study.optimize(objective, n_trials=len(aims))
    assert whys_of(study) == aims


def test_so_does_one_that_is_left_to_the_parameters():
    study = study_of(table_of(drawn(1)))
    study.optimize(lambda trial: only_x(trial) + trial.number, n_trials=2 * PATIENCE)
    stalled = [Aim.IMPROVEMENT, Aim.PARAMETERS]
    assert whys_of(study)[-2:] == stalled
    table = table_of(None, outcomes=FALLS[:, :1])
    lost = study_of(table, lambda trial: 50.0 + only_x(trial), 8, success=1.5)
    assert Aim.PARAMETERS in whys_of(lost)[-2:]


def test_so_does_a_point_of_a_space():
    space = {"x": FloatDistribution(0, 1)}
    study = study_of(None, only_x, 4, space=space)
    assert whys_of(study) == [Aim.BEGIN] * 3 + [Aim.IMPROVEMENT]


def test_a_kernel_that_asks_no_world_follows_no_ranking():
    study = study_of(table_of(None, outcomes=FALLS), only_x, 3, kernel="euclidean")
    assert whys_of(study) == [Aim.BEGIN] * 3


def test_what_ran_otherwise_was_chosen_for_nothing():
    """Optuna asks no sampler where a range has one value, and for a new range another one."""
    grid = np.array([(a, b) for a in (0.0, 0.5, 1.0) for b in range(4)])
    columns = {"a": grid[:, 0], "b": grid[:, 1]}
    table = FeatureTable.from_arrays(columns, grid.sum(axis=1)[:, None])
    study = study_of(table, strict=False)
    with pytest.warns(UserWarning, match="^a: .* the independent sampler takes over$"):
        study.optimize(summed(b=(0, 3), a=(0.5, 0.5)), n_trials=1)
    assert study.trials[0].user_attrs["row"] in (4, 5, 6, 7)
    space = {name: FloatDistribution(0, 1) for name in ("a", "b")}
    free = study_of(None, space=space, strict=False)
    with pytest.warns(UserWarning, match="^a: .* the independent sampler takes over$"):
        free.optimize(summed(b=(0, 1), a=(0.5, 0.6)), n_trials=1)
    for each in (study, free):
        assert each.trials[0].user_attrs["why"] is None
