"""What a user can get wrong: each an error that names the cause before a trial is lost,
or, with strict=False, one warning; each message that docs/sampler-messages.md explains,
and no other."""

import re
import warnings
from pathlib import Path

import numpy as np
import optuna
import pandas as pd
import pytest
from optuna.distributions import CategoricalDistribution, FloatDistribution
from optuna.samplers import PartialFixedSampler
from optuna.trial import TrialState

from study import FeatureKernelSampler, FeatureTable
from study.sampler.table_policy import TableExhaustedError
from tests.study.conftest import refused
from tests.study.sampler.studies import (
    bowl,
    only_a,
    params_of,
    rows_of,
    study_of,
    summed,
)

PAGE = Path(__file__).parents[3] / "docs" / "sampler-messages.md"
EXPLAINED = re.findall(r"^\| (?:warning )?`([^`]+)`", PAGE.read_text(), re.M)

PARAMETERS = {"a": [0.1, 0.5, 0.9], "b": [1.0, 2.0, 3.0]}
FEATURES = [[0.0], [1.0], [4.0]]
SPACE = {"a": FloatDistribution(0, 1), "b": FloatDistribution(0, 5)}
TABLE = FeatureTable.from_arrays(PARAMETERS, FEATURES)
IN_WORLDS = FeatureTable.from_arrays(PARAMETERS, outcomes=np.eye(3, 4))
LINE = np.linspace(0, 1, 20)
DAYS = np.array(["2026-11-27", "2026-11-28", "2026-11-29"], dtype="M8[s]")


def within(distribution=SPACE["a"], name="a"):
    """An objective that suggests b of the table, and before it a parameter in some way."""

    def objective(trial):
        trial._suggest(name, distribution)
        trial.suggest_float("b", 0, 5)
        return 0.0

    return objective


both = within()


def fixed(value):
    """The study whose trials have this value of a."""
    return lambda: study_of(TABLE, both, 2, enqueued=[{"a": value}] * 2)


def run(sampler, objective=both, trials=5):
    study = optuna.create_study(sampler=sampler)
    study.optimize(objective, n_trials=trials)
    return study


# Messages of a column a, and of options of the table.
COLUMNS = {
    "table.….shape: … allowed: …, as features or outcomes have rows": ([1.0, 2.0], {}),
    "table.…: nan cannot be used; allowed: a finite number": ([1.0, np.nan, 3.0], {}),
    "table.feature_names: … allowed: … names": (
        LINE[:3],
        {"feature_names": ["f", "g"]},
    ),
    "table.…: … allowed: … to …": (LINE[:3], {"bounds": {"a": (0, 0.01)}}),
    "table.bounds.…: … allowed: none beside space=, …": (
        LINE[:3],
        {"bounds": {"a": (0, 1)}, "space": {"a": SPACE["a"]}},
    ),
    "table.…: … allowed: a value of …": (
        LINE[:3],
        {"space": {"a": FloatDistribution(0, 1, step=0.25)}},
    ),
    "table.…: … allowed: a value; or None as a choice: space=…": ([1, None, 3], {}),
    "table.…: … allowed: whole numbers up to 2^53, which a float holds; …": (
        [2**60, 2**60 + 1, 5],
        {},
    ),
    "table.…: … allowed: flags or numbers, not both: …": ([1, True, "x"], {}),
    "table.…: … allowed: numbers, words or flags; …": (DAYS, {}),
    "table.…: … allowed: one of (…)": (
        ["x", "y", "z"],
        {"space": {"a": CategoricalDistribution(["x", "y"])}},
    ),
    "… rows repeat the parameters of another and are not proposed": ([1.0, 1, 2], {}),
}
FEATURES_OF = {
    "table.features…: … allowed: numbers, [n, k]": ["x", "y", "z"],
    "table.features: … allowed: whole numbers up to 2^53, or …": [2**60, 2**60 + 1, 5],
    "… rows that lack more than half of their features are not proposed": [
        0.0,
        1.0,
        np.nan,
    ],
    "features without information are ignored: …": [[0, 1], [1, 1], [4, 1]],
}
OPTIONS = {
    "kernel: … allowed: one of …": (TABLE, {"kernel": "gauss"}),
    "kernel: … allowed: euclidean: there are no features": (None, {"kernel": "rbf"}),
    "off_grid: … allowed: 0 without a feature_function": (TABLE, {"off_grid": 9}),
    "space: … allowed: none: a table knows its own": (TABLE, {"space": SPACE}),
    "allowed_risk: … allowed: a chance above 0 and below 1": (
        TABLE,
        {"allowed_risk": 1},
    ),
    "allowed_risk: … allowed: none without strict: …": (
        TABLE,
        {"allowed_risk": 0.1, "strict": False},
    ),
    "features: … allowed: a FeatureTable, a function, or None": (FEATURES, {}),
}
# Of trials: features, options, and the objective.
TRIALS = {
    "…: … allowed: a range that holds all rows: …": (
        TABLE,
        {},
        within(FloatDistribution(0, 0.7)),
    ),
    "…: … allowed: choices that hold all rows: …": (
        TABLE,
        {},
        within(CategoricalDistribution([0.1, 0.5])),
    ),
    "…: … allowed: what has …, a point off the table …": (
        FeatureTable.from_arrays({"a": [1, 30]}, [1.0, 30.0]),
        {"feature_function": lambda params: params, "off_grid": 50},
        lambda trial: trial.suggest_categorical("a", [1, 30]),
    ),
    "…: 'suggested, and not in the table' …": (TABLE, {}, within(name="A")),
    "…: 'not suggested in trial …' …": (TABLE, {}, only_a),
    "allowed_risk.…: … allowed: from … on, "
    "the least risk of a candidate that is left; …": (
        FeatureTable.from_arrays(PARAMETERS, FEATURES, limits={"fall": FEATURES}),
        {"allowed_risk": 0.01},
        both,
    ),
    "allowed_risk.…: … allowed: … first: neither worlds nor 3 trials tell of …": (
        TABLE,
        {"allowed_risk": {"fall": 0.1}},
        both,
    ),
    "all … rows that may be proposed have been tried": (TABLE, {}, both),
    "…: … allowed: the range declared in …": (
        None,
        {"space": SPACE},
        within(FloatDistribution(0, 0.001)),
    ),
    "features(params): … allowed: features [n, k], no exception": (
        lambda params: 1 / 0,
        {"space": SPACE},
        both,
    ),
    "features(params).shape: … allowed: …": (
        lambda params: np.ones((7, 2)),
        {"space": SPACE},
        both,
    ),
    "features(params): 'no row without NaN' …": (
        lambda params: params * np.nan,
        {"space": SPACE},
        both,
    ),
    "outcomes(params): … allowed: outcomes, no exception": (
        IN_WORLDS,
        {"feature_function": lambda params: 1 / 0},
        both,
    ),
    "outcomes(params).shape: … allowed: …": (
        IN_WORLDS,
        {"feature_function": lambda params: np.ones((7, 2))},
        both,
    ),
    "feature_function: row …, simulated, comes to other outcomes than the table has; …": (
        IN_WORLDS,
        {"feature_function": lambda params: np.ones((len(params), 4))},
        both,
    ),
    "… the independent sampler takes over": (TABLE, {"strict": False}, both),
    "success: … is better than all that any world has, …": (
        FeatureTable.from_arrays(PARAMETERS, outcomes=[3.0, 1.0, 2.0]),
        {"success": 0.9},
        both,
    ),
    "success: … is reached by all rows in all worlds, …": (
        FeatureTable.from_arrays(PARAMETERS, outcomes=[3.0, 1.0, 2.0]),
        {"success": 3.0},
        both,
    ),
}
TWO_GOALS = {
    "success: … allowed: none in a study of … goals": (TABLE, {"success": 1.0}),
    "table.outcomes: … allowed: those of … goals, …": (
        FeatureTable.from_arrays({"a": LINE}, outcomes=LINE),
        {},
    ),
}
OTHERS = {
    "column: … allowed: one of …": lambda: FeatureTable.from_dataframe(
        pd.DataFrame(PARAMETERS), parameters=["a"], features=["c"]
    ),
    "…: … allowed: a Parquet file, a folder of them, or a text such as CSV, that exists": (
        lambda: FeatureTable.from_parquet("no", parameters=["a"], features=["f"])
    ),
    "kernel: … allowed: one that uses features, or there is nothing to report": (
        lambda: FeatureKernelSampler().worth(optuna.create_study())
    ),
    "If the study is being used for multi-objective optimization, … cannot be used.": (
        lambda: FeatureKernelSampler(TABLE).worth(
            optuna.create_study(directions=["minimize", "maximize"])
        )
    ),
    "…: … allowed: a value that a row of the table has…; "
    "or all parameters, in enqueue_trial": fixed(0.2),
    "…: … allowed: values of a row that has not been tried; …": fixed(0.1),
    "…: 'fixed' cannot be used; …": lambda: run(
        PartialFixedSampler({"a": 0.5}, FeatureKernelSampler(TABLE))
    ),
    "trials whose parameters are no row of the table are ignored: …": lambda: study_of(
        TABLE, both, 3, enqueued=[{"a": 0.33, "b": 2.0}]
    ),
}


def test_all_that_is_explained_is_tested():
    tested = COLUMNS | FEATURES_OF | OPTIONS | TRIALS | TWO_GOALS | OTHERS
    assert set(tested) == set(EXPLAINED)


def assert_says(message, case):
    """A warning, or the error that ended it, is this message."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        error = []
        try:
            case()
        except (ValueError, RuntimeError) as raised:
            error = [str(raised)]
    ours = [str(w.message) for w in caught if w.category is UserWarning]
    pattern = re.escape(message).replace("…", ".+")
    assert any(re.search(pattern, line) for line in ours + error), ours + error


@pytest.mark.parametrize("message", COLUMNS)
def test_a_column_is_refused_or_warned_of(message):
    column, options = COLUMNS[message]
    assert_says(
        message, lambda: FeatureTable.from_arrays({"a": column}, LINE[:3], **options)
    )


@pytest.mark.parametrize("message", FEATURES_OF)
def test_features_are_refused_or_warned_of(message):
    features = FEATURES_OF[message]
    assert_says(message, lambda: FeatureTable.from_arrays(PARAMETERS, features))


@pytest.mark.parametrize("message", OPTIONS)
def test_options_are_refused(message):
    features, options = OPTIONS[message]
    assert_says(message, lambda: FeatureKernelSampler(features, **options))


@pytest.mark.parametrize("message", TRIALS)
def test_trials_are_refused_or_warned_of(message):
    features, options, objective = TRIALS[message]
    assert_says(message, lambda: study_of(features, objective, 5, **options))


@pytest.mark.parametrize("message", TWO_GOALS)
def test_two_goals_are_refused(message):
    features, options = TWO_GOALS[message]
    sampler = FeatureKernelSampler(features, **options)
    study = optuna.create_study(sampler=sampler, directions=["minimize"] * 2)
    assert_says(message, lambda: study.ask(SPACE))


@pytest.mark.parametrize("message", OTHERS)
def test_others_are_said(message):
    assert_says(message, OTHERS[message])


def test_nothing_is_said_of_what_fits_and_strictness_changes_nothing(table):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        FeatureTable.from_arrays(PARAMETERS, FEATURES)
        study = study_of(table, bowl, 6, strict=False)
        assert rows_of(study) == rows_of(study_of(table, bowl, 6))


@pytest.mark.parametrize(
    ("direction", "success"), [("minimize", 1.0), ("maximize", 3.0)]
)
def test_nothing_is_said_of_a_success_that_a_world_has(direction, success):
    table = FeatureTable.from_arrays(PARAMETERS, outcomes=[3.0, 1.0, 2.0])
    for beyond in (0.0, 0.01 if direction == "maximize" else -0.01):
        sampler = FeatureKernelSampler(table, success=success + beyond)
        study = optuna.create_study(sampler=sampler, direction=direction)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            study.optimize(both, n_trials=2)
        said = [str(w.message) for w in caught if w.category is UserWarning]
        assert [line.split(",")[1] for line in said] == (
            [f" {success:g} at best; is it in the unit of the outcomes"] * bool(beyond)
        )


def test_nor_of_one_that_is_beyond_a_stand_in_for_infinity():
    table = FeatureTable.from_arrays(PARAMETERS, outcomes=[3.0, -np.inf, 2.0])
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        run(FeatureKernelSampler(table, success=-1e6), trials=2)


BOX = {"a": FloatDistribution(-1, 1), "b": FloatDistribution(0, 5)}


def test_other_names_are_one_warning_where_the_table_need_not_fit(table):
    message = "none of the table's parameters: a, b.* independent sampler takes over"
    with pytest.warns(UserWarning, match=message) as said:
        other = {"strict": False}
        study = study_of(table, summed(A=(-1, 1)), 5, **other)
    assert [trial.state for trial in study.trials] == [TrialState.COMPLETE] * 5
    assert len(said) == 1


@pytest.mark.filterwarnings("ignore:Fixed parameter")
def test_a_range_that_shrinks_is_an_error_where_it_leaves_the_row_out(table):
    def shrunk(trial):
        return trial.suggest_float("a", -0.999, 1) + trial.suggest_float("b", 0, 1e-9)

    study = study_of(table, bowl, 2)
    study.enqueue_trial(table.rows.as_parameters(3))
    study.optimize(shrunk, n_trials=1)
    # What another trial suggested is no fault of this one.
    study.optimize(bowl, n_trials=1)
    with refused(r"b: .* a range that holds all rows: row \d+ has"):
        study.optimize(shrunk, n_trials=1)


def test_extra_parameters_come_after_the_tables_or_are_named(table):
    def first(trial):
        return trial.suggest_int("n", 1, 9) + bowl(trial)

    def last(trial):
        return bowl(trial) + (trial.suggest_categorical("kind", ["x", "y"]) == "x")

    with refused(r"extra_parameters=\['n'\]"):
        run(FeatureKernelSampler(table, seed=0), first)
    named = {"extra_parameters": ["n"]}
    for objective, name, options in ((first, "n", named), (last, "kind", {})):
        study, again = (study_of(table, objective, 8, **options) for _ in range(2))
        assert params_of(study) == params_of(again)
        assert len({trial.params[name] for trial in study.trials}) > 1
        assert len(set(rows_of(study))) == 8


@pytest.mark.parametrize("count", [2, 1])
@pytest.mark.filterwarnings("ignore:FeatureTable")
def test_an_exhausted_table(count):
    columns = {"a": [0.0, 0.5][:count], "b": [0.0, 1.0][:count]}
    small = FeatureTable.from_arrays(columns, [1, 2][:count])
    study = study_of(small, bowl, count)
    with pytest.raises(TableExhaustedError, match=f"^all {count} rows"):
        study.optimize(bowl, n_trials=1)
    states = [TrialState.COMPLETE] * count + [TrialState.FAIL]
    assert [trial.state for trial in study.trials] == states
    with pytest.warns(UserWarning) as said:
        assert len(study_of(small, bowl, 5, strict=False).trials) == 5
    assert (
        sum(f"all {count} rows that may be proposed" in str(w.message) for w in said)
        == 1
    )


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda params: 1 / 0, "ZeroDivisionError: division by zero"),
        (lambda params: params[:-1], "shape"),
        (lambda params: params[:, :, None], "shape"),
        (lambda params: params[:, :0], "n and k at least 1"),
        (lambda params: "no", r"features\(params\): 'str' .* numbers, \[n, k\]"),
        (lambda params: np.hstack([params, params]), r"shape: \(20, 4\) .* \[20, 1\]"),
        (lambda params: np.full((len(params), 2), np.nan), "no row without NaN"),
    ],
)
def test_a_broken_function_is_an_error_before_a_trial_is_lost(function, message, table):
    given, options = function, {"space": BOX}
    if message.startswith("shape: "):  # against the table's one feature
        given, options = table, {"off_grid": 20, "feature_function": function}
    with refused(message):
        study_of(given, bowl, 5, **options)
    with pytest.warns(UserWarning, match="independent sampler takes over") as said:
        assert len(study_of(given, bowl, 5, strict=False, **options).trials) == 5
    assert len(said) == 1


@pytest.mark.filterwarnings("ignore:PartialFixedSampler is experimental")
def test_a_fixed_parameter_and_a_declared_one_that_is_never_suggested():
    ours = FeatureKernelSampler(lambda params: params, space=BOX)
    with refused("a: 'fixed"):
        run(PartialFixedSampler({"a": 0.5}, ours), bowl)
    plain = PartialFixedSampler({"a": 0.5}, FeatureKernelSampler(seed=0))
    assert {trial.params["a"] for trial in run(plain, bowl).trials} == {0.5}
    with refused("b: 'not suggested in trial 0'"):
        study_of(None, only_a, 3, space=SPACE)


def test_a_trial_that_could_not_be_asked_for_is_ended_as_documented(table):
    """Optuna keeps the trial of an `ask` that raises RUNNING, whichever sampler raised."""
    study = study_of(table, enqueued=[{"a": 0.123}])
    with refused(r"a: 0\.123"):
        study.ask(BOX)
    study.tell(study.trials[-1].number, state=TrialState.FAIL)
    study.optimize(bowl, n_trials=1)
    assert [trial.state for trial in study.trials] == [
        TrialState.FAIL,
        TrialState.COMPLETE,
    ]
