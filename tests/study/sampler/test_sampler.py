"""The contract of all forms of the sampler with Optuna, their options, and large tables."""

import json
import pickle
import re
import time
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import optuna
import pytest
from numpy.typing import NDArray
from optuna.distributions import FloatDistribution
from optuna.samplers import RandomSampler
from optuna.trial import TrialState

import study
from study import DoGSampler, FeatureKernelSampler, FeatureTable
from study.sampler.covariance import KERNELS
from study.sampler.worlds import Worlds
from tests.study.sampler.studies import (
    bowl,
    model_of,
    params_of,
    resumed,
    rows_of,
    run_code,
    study_of,
    summed,
)
from tests.study.sampler.test_goals import studied

Floats = NDArray[np.float64]

BOUNDS = {"a": (-1, 1), "b": (0, 5)}
SPACE = {"a": FloatDistribution(-1, 1), "b": FloatDistribution(0, 5)}


def features(params):
    return np.column_stack([np.abs(params[:, 0]), params[:, 1] - 2.0])


def small_table():
    rng = np.random.default_rng(0)
    columns = {"a": rng.uniform(-1, 1, 80), "b": rng.uniform(0, 5, 80)}
    values = features(np.column_stack(list(columns.values())))
    return FeatureTable.from_arrays(columns, values, ["size", "side"], bounds=BOUNDS)


TABLE = small_table()
FORMS = {
    "table": (TABLE, {}),
    "off_grid": (TABLE, {"off_grid": 30, "feature_function": features}),
    "paper": (TABLE, {"kernel": "rbf"}),
    "callable": (features, {}),
    "plain": (None, {}),
}


def new_sampler(form):
    given, options = FORMS[form]
    return FeatureKernelSampler(given, seed=1, **options)


def run(form):
    given, options = FORMS[form]
    return params_of(study_of(given, bowl, 9, **options))


@pytest.mark.parametrize("form", FORMS)
def test_the_state_is_in_the_trials_also_after_reseeding(form):
    study = optuna.create_study(sampler=new_sampler(form))
    study.sampler.reseed_rng()
    study.optimize(bowl, n_trials=9)

    def travelled():
        return pickle.loads(pickle.dumps(new_sampler(form)))

    pieces = resumed(travelled, bowl, 9, optuna.create_study())
    assert params_of(study) == params_of(pieces) == run(form)


def proposals():
    """Of all forms, and of a study with two goals."""
    return {form: run(form) for form in FORMS} | {
        "goals": params_of(studied("worlds", 6))
    }


ELSEWHERE = """
import json, optuna
from tests.study.sampler.test_sampler import proposals
optuna.logging.set_verbosity(optuna.logging.ERROR)
print(json.dumps(proposals()))
"""


@pytest.mark.slow
def test_another_process_proposes_the_same():
    there = run_code(ELSEWHERE)
    assert json.loads(there.stdout) == proposals(), there.stderr


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize(("direction", "sign"), [("minimize", 1.0), ("maximize", -1.0)])
def test_every_kernel_finds_good_rows(kernel, direction, sign):
    options = {"seed": 3, "kernel": kernel, "direction": direction}
    study = study_of(TABLE, lambda trial: sign * bowl(trial), 16, **options)
    assert sign * study.best_value < 0.04


@pytest.mark.parametrize("given", [features, None])
def test_points_of_a_space_become_good(given):
    study = study_of(given, bowl, 20, seed=0)
    assert study.best_value < 0.01
    noted = [trial.user_attrs.get("features") for trial in study.trials[1:]]
    assert [values is not None for values in noted] == [given is features] * 19


def test_points_off_the_table_beat_its_best_row():
    table = TABLE
    best_row = (
        table.rows.parameters[:, 0] ** 2 + 0.01 * table.rows.parameters[:, 1]
    ).min()
    calls = []

    def counted(params):
        calls.append(len(params))
        return features(params)

    study = study_of(table, bowl, 25, seed=0, off_grid=100, feature_function=counted)
    assert study.best_value < best_row
    assert calls == [100] * 23  # once a trial after the first two
    off = [t for t in study.trials if t.user_attrs["row"] == -1]
    assert off and all(len(trial.user_attrs["features"]) == 2 for trial in off)


def test_an_infinite_feature_of_a_point_off_the_table_is_learned_as_such():
    """What is noted in trials has no infinity."""

    def function(params):
        first = np.where(params[:, 0] < 0.5, -np.inf, 1.0)
        return np.column_stack([first, params[:, 1]])

    columns = {"a": [0.1, 0.9, 0.2], "b": [0.0, 0.5, 1.0]}
    table = FeatureTable.from_arrays(columns, np.eye(3)[:, :2])
    study = study_of(table, seed=0, off_grid=30, feature_function=function)
    study.optimize(summed(a=(0.1, 0.9), b=(0, 1)), 8)
    a = np.array([trial.params["a"] for trial in study.trials])
    off = (np.array(rows_of(study)) == -1) & (a < 0.5)
    learned = model_of(study).trials.features
    lowest = table.rows.scores.standard(np.array([[-np.inf, 0.0]]))[0, 0]
    assert off.any() and learned[off, 0] == pytest.approx(lowest)


@pytest.mark.parametrize("gaps", [[np.nan, 1.0], [np.nan, np.nan]])
def test_a_trial_off_the_table_may_have_gaps_and_none_near_it_is_tried_twice(gaps):
    """As a function may return for a point that it cannot do, here one that a user enqueued."""

    def function(params):
        return np.where((params[:, 0] < -0.5)[:, None], gaps, features(params))

    options = {"seed": 0, "feature_function": function}
    study = study_of(TABLE, bowl, 6, enqueued=[{"a": -0.77, "b": 1.0}], **options)
    assert len({trial.user_attrs.get("row") for trial in study.trials}) == 6
    table = FeatureTable.from_arrays({"n": [1, 3, 9]}, [1.0, 3.0, 9.0])
    options = {"seed": 0, "off_grid": 50, "feature_function": lambda p: p}
    study = study_of(table, lambda trial: trial.suggest_int("n", 1, 9), 7, **options)
    assert len({trial.params["n"] for trial in study.trials}) == 7


def test_a_ranking_that_is_wrong_is_left():
    table, size = TABLE, np.sort(TABLE.rows.features[:, 0])
    rows = replace(table.rows, worlds=Worlds.of(table.rows.features[:, 0], "lower"))
    study = study_of(FeatureTable(rows), lambda trial: -bowl(trial), 40, seed=0)
    assert max(abs(trial.params["a"]) for trial in study.trials) >= size[-3]


@pytest.mark.filterwarnings("ignore:FeatureTable")
@pytest.mark.parametrize("kernel", ["additive", "rbf"])
def test_rows_left_out_change_no_choice(kernel):
    rng = np.random.default_rng(0)
    params = np.column_stack([rng.uniform(-1, 1, 300), rng.uniform(0, 5, 300)])
    values = features(params)
    values[100:] = np.nan

    def proposed(rows):
        columns = dict(zip("ab", params[:rows].T, strict=True))
        table = FeatureTable.from_arrays(columns, values[:rows], bounds=BOUNDS)
        return params_of(study_of(table, bowl, 12, seed=3, kernel=kernel))

    assert proposed(300) == proposed(100)


def test_a_thousand_trials_are_no_trouble():
    rng = np.random.default_rng(0)
    table = FeatureTable.from_arrays(
        {"a": rng.uniform(size=3000)}, rng.normal(size=(3000, 3))
    )
    study = study_of(table, seed=0)
    space = table.rows.space.as_dict()
    for row, value in enumerate(table.rows.features[:1000].sum(axis=1).tolist()):
        known = {"params": table.rows.as_parameters(row), "distributions": space}
        study.add_trial(optuna.create_trial(value=value, **known))
    start = time.perf_counter()
    study.ask(space)
    assert time.perf_counter() - start < 5.0  # a second on an idle machine


MEMORY = """
import numpy as np, optuna
from study import FeatureKernelSampler, FeatureTable
import study.sampler.table_policy, study.sampler.space_policy
optuna.logging.set_verbosity(optuna.logging.ERROR)
def resident(): return int(open("/proc/self/statm").read().split()[1]) * 4096 / 1e6
def peak():
    lines = open("/proc/self/status").read().splitlines()
    return int(next(l for l in lines if l.startswith("VmHWM")).split()[1]) / 1e3
rng = np.random.default_rng(0)
columns = {f"x{i}": rng.uniform(size=100_000) for i in range(16)}
features = rng.normal(size=(100_000, 5))
before = resident()
table = FeatureTable.from_arrays(columns, features)
study = optuna.create_study(sampler=FeatureKernelSampler(table, seed=0))
study.optimize(lambda t: sum(t.suggest_float(n, 0, 1) for n in columns), n_trials=8)
print(peak() - before)
"""


@pytest.mark.slow
@pytest.mark.skipif(
    not Path("/proc/self/status").exists(), reason="no /proc on this system"
)
def test_a_hundred_thousand_rows_take_little_memory():
    done = run_code(MEMORY)
    assert float(done.stdout) < 200.0, done.stderr


@pytest.mark.slow
def test_importing_the_package_is_light():
    done = run_code(
        "import sys, study; print({'taichi', 'matplotlib', 'torch', 'sklearn', 'optuna'} "
        "& set(sys.modules)); study.FeatureTable; study.FeatureKernelSampler; "
        "print({'taichi', 'matplotlib', 'torch'} & set(sys.modules)); "
        "print('DoGSampler' in dir(study))"
    )
    assert done.stdout.splitlines() == ["set()", "set()", "True"]
    with pytest.raises(AttributeError, match="no attribute 'Sampler'"):
        _ = study.Sampler


NO_POSIX = """
import sys
sys.modules.update(dict.fromkeys(("fcntl", "resource", "termios", "pwd", "grp")))
import numpy, optuna
from study import FeatureKernelSampler, FeatureTable
x = numpy.linspace(0.0, 1.0, 9)
table = FeatureTable.from_arrays({"x": x}, x**2)
study = optuna.create_study(sampler=FeatureKernelSampler(table, seed=1))
study.optimize(lambda trial: trial.suggest_float("x", 0.0, 1.0), n_trials=9)
print(study.best_value)
"""


@pytest.mark.slow
def test_it_works_where_there_is_no_posix():
    """As on Windows: stores and commands lock files, the sampler does not."""
    done = run_code(NO_POSIX)
    assert done.stdout == "0.0\n", done.stderr


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("unknown", [np.nan, 0.5])
def test_where_no_row_is_left_points_off_the_table_are(kernel, unknown):
    """All rows tried, or one tried and none with half of its features."""
    values = np.full((6, 3), unknown)
    values[np.arange(6), np.arange(6) % 3] = np.linspace(0.1, 0.4, 6)
    columns = {"a": np.linspace(0.1, 0.4, 6), "b": np.linspace(0.4, 0.1, 6)}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        table = FeatureTable.from_arrays(columns, values)
    near = {
        "feature_function": lambda p: np.column_stack([p, p.sum(axis=1)]),
        "off_grid": 16,
    }
    study = study_of(table, seed=0, kernel=kernel, **near)
    for row in range(1 if np.isnan(unknown) else 6):
        study.enqueue_trial(table.rows.as_parameters(row))
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        study.optimize(summed(a=(0.1, 0.4), b=(0.1, 0.4)), n_trials=9)
    assert [trial.user_attrs["row"] for trial in study.trials[6:]] == [-1, -1, -1]


# The paper's sampler.
def test_trials_are_rows_with_plain_notes_and_no_row_comes_twice_running_or_not(table):
    study = study_of(table, bowl, 30, kernel="rbf")
    for trial, row in zip(study.trials, rows_of(study), strict=True):
        assert trial.params == table.rows.as_parameters(row)
        assert trial.user_attrs["score"] == table.rows.features[row, 0]
        assert set(json.loads(json.dumps(trial.user_attrs))) == {"row", "score", "why"}
        assert all(type(value) is float for value in trial.params.values())
    for _ in range(20):
        study.ask(SPACE)
    assert len(set(rows_of(study))) == 50


@pytest.mark.parametrize("state", [TrialState.FAIL, TrialState.PRUNED])
def test_failed_and_pruned_trials_teach_nothing_nor_do_their_limits(table, state):
    lost, clean = (study_of(table, bowl, 6, kernel="rbf") for _ in range(2))
    trial = lost.ask(SPACE)
    trial.set_constraint("limit", trial.params["a"])
    lost.tell(trial, state=state)
    for each in (lost, clean):
        each.optimize(bowl, n_trials=1)
    rows, expected = rows_of(lost), rows_of(clean)
    assert rows[:7] == expected
    assert rows[7] not in rows[:7]
    # it goes on where it was, as if nothing had been learned
    score = table.rows.features[:, 0]
    assert abs(score[rows[7]] - score[expected[6]]) < 0.2


def test_ties_are_broken_by_the_seed():
    columns = {"a": np.linspace(0, 1, 50), "b": np.ones(50)}
    tied = FeatureTable.from_arrays(columns, np.zeros(50))
    studies = [study_of(tied, bowl, 4, seed=seed, kernel="rbf") for seed in range(12)]
    assert len({rows_of(each)[3] for each in studies}) > 6


# Extreme numbers.
LARGEST = np.finfo(np.float64).max
LINE = np.linspace(0.0, 1.0, 30)
EXTREMES = [
    ((5e307, -5e307), -1.0),
    ((LARGEST, -LARGEST), -1.0),
    ((LARGEST, LARGEST), -1.0),
    ((-LARGEST, 0.0), -1.0),
    ((1e155, 1.0), -1.0),
    ((np.inf, -LARGEST), -1.0),
    ((1.0, 2.0), LARGEST),
    ((1.0, 2.0), -LARGEST),
    ((1.0, 2.0), 1e200),
]


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize(("costs", "limit"), EXTREMES)
def test_extreme_costs_and_constraints_are_learned_from(costs, limit, kernel):
    def objective(trial):
        x = trial.suggest_float("x", 0, 1)
        trial.set_constraint("limit", limit * x)
        return costs[trial.number] if trial.number < 2 else x

    table = FeatureTable.from_arrays({"x": LINE}, np.column_stack([LINE, LINE**2]))
    study = study_of(table, objective, 9, seed=1, kernel=kernel)
    assert len({trial.params["x"] for trial in study.trials}) == 9
    if kernel != "euclidean":
        study.sampler.worth(study).markdown()


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("kernel", ["additive", "rbf"])
def test_extreme_features_tell_rows_apart(kernel):
    features = np.where(np.arange(30) % 2, LARGEST, -LARGEST) * LINE
    table = FeatureTable.from_arrays({"x": LINE}, features)
    study = study_of(table, summed(x=(0, 1)), 6, seed=1, kernel=kernel)
    assert len({trial.params["x"] for trial in study.trials}) == 6


# What a sampler looks like at a prompt.
SIXTEEN = {f"x{i}": np.linspace(0, 1, 600) for i in range(16)}
SIX = np.random.default_rng(0).random((600, 6))
SHOWN = FeatureTable.from_arrays(SIXTEEN, SIX, ["survival", *"bcdef"])
SIZE = "FeatureTable(600 rows, 16 parameters, 6 features: survival, b, c, ...)"
UNIT = FloatDistribution(0, 1)
OTHER = {"independent_sampler": RandomSampler(), "extra_parameters": ["n"]}


@pytest.mark.parametrize(
    ("given", "options", "shown"),
    [
        (SHOWN, {}, f"{SIZE}, seed=3"),
        (
            SHOWN,
            {"kernel": "rbf", "strict": True, "success": 0.1},
            f"{SIZE}, seed=3, kernel='rbf', success=0.1",
        ),
        (
            features,
            OTHER,
            "features, seed=3, extra_parameters=('n',), independent_sampler=RandomSampler",
        ),
        (None, {"space": {"x": UNIT}}, f"seed=3, space={{'x': {UNIT!r}}}"),
    ],
)
def test_a_sampler_shows_its_seed_and_what_was_chosen_wherever_it_travels(
    given, options, shown
):
    sampler = FeatureKernelSampler(given, seed=3, **options)
    there = pickle.loads(pickle.dumps(sampler))
    assert repr(sampler) == f"FeatureKernelSampler({shown})" == repr(there)


def test_presets_go_by_their_own_names_and_a_seed_that_was_drawn_is_shown():
    assert repr(DoGSampler(SHOWN, seed=1)).startswith(f"DoGSampler({SIZE}, seed=1")
    found = re.fullmatch(
        r"FeatureKernelSampler\(seed=(\d+)\)", repr(FeatureKernelSampler())
    )
    assert found and int(found[1]) > 0
