"""What a user can get wrong: each an error that names the cause before a trial is lost,
or, with strict=False, one warning; each message that docs/sampler-messages.md explains,
and no other."""

import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import pandas as pd
import pytest
from optuna.distributions import CategoricalDistribution, FloatDistribution
from optuna.samplers import BaseSampler, PartialFixedSampler
from optuna.trial import TrialState

from storage.inputs.errors import InputError
from study import FeatureKernelSampler, FeatureTable
from study.sampler.table_policy import TableExhaustedError
from tests.study.sampler.studies import bowl, only_a, rows_of, study_of

PAGE = Path(__file__).parents[3] / "docs" / "sampler-messages.md"
EXPLAINED = re.findall(r"^\| (?:warning )?`([^`]+)`", PAGE.read_text(), re.M)

PARAMETERS = {"a": [0.1, 0.5, 0.9], "b": [1.0, 2.0, 3.0]}
FEATURES = [[0.0], [1.0], [4.0]]
SPACE = {"a": FloatDistribution(0, 1), "b": FloatDistribution(0, 5)}
LINE = np.linspace(0, 1, 20)


def new_table(features: Any = FEATURES, **options: Any) -> FeatureTable:
    return FeatureTable.from_arrays(PARAMETERS, features, **options)


def two_goals(sampler: FeatureKernelSampler) -> optuna.Trial:
    return optuna.create_study(sampler=sampler, directions=["minimize"] * 2).ask(SPACE)


def sampler(features: Any = None, **options: Any) -> FeatureKernelSampler:
    return FeatureKernelSampler(
        new_table() if features is None else features, seed=1, **options
    )


def a_within(low: float, high: float) -> Callable[[optuna.Trial], float]:
    return lambda trial: (
        trial.suggest_float("a", low, high) + trial.suggest_float("b", 0, 5)
    )


both = a_within(0, 1)


def arrays(a: Any, **options: Any) -> FeatureTable:
    return FeatureTable.from_arrays({"a": a}, FEATURES, **options)


def run(sampler: BaseSampler, objective: Any = both, trials: int = 5) -> optuna.Study:
    study = optuna.create_study(sampler=sampler)
    study.optimize(objective, n_trials=trials)
    return study


def run_enqueued(**fixed: float) -> None:
    study_of(new_table(), both, 2, enqueued=[fixed, fixed])


def run_points_as_choices() -> None:
    units = FeatureTable.from_arrays({"a": [1, 30]}, [1.0, 30.0])
    options = {"feature_function": lambda params: params, "off_grid": 50}
    run(
        sampler(units, **options), lambda trial: trial.suggest_categorical("a", [1, 30])
    )


CASES: dict[str, Callable[[], object]] = {
    "table.….shape: … allowed: …, as the features": lambda: arrays([1.0, 2.0]),
    "table.…: nan cannot be used; allowed: a finite number": lambda: arrays(
        [1.0, np.nan, 3.0]
    ),
    "table.features…: … allowed: numbers, [n, k]": lambda: new_table(["x", "y", "z"]),
    "table.feature_names: … allowed: … names": lambda: new_table(
        feature_names=["f", "g"]
    ),
    "table.…: … allowed: … to …": lambda: new_table(bounds={"a": (0, 0.5)}),
    "table.bounds.…: … allowed: none beside space=, …": lambda: new_table(
        bounds={"a": (0, 1)}, space=SPACE
    ),
    "table.…: … allowed: a value of …": lambda: new_table(
        space={"a": FloatDistribution(0, 1, step=0.25)}
    ),
    "table.…: … allowed: a value; or None as a choice: space=…": lambda: arrays(
        [1, None, 3]
    ),
    "table.…: … allowed: whole numbers up to 2^53, which a float holds; …": lambda: (
        arrays([2**60, 2**60 + 1, 5])
    ),
    "table.features: … allowed: whole numbers up to 2^53, or …": lambda: new_table(
        [2**60, 2**60 + 1, 5]
    ),
    "table.…: … allowed: flags or numbers, not both: …": lambda: arrays([1, True, "x"]),
    "table.…: … allowed: numbers, words or flags; …": lambda: arrays(
        np.array(["2026-11-27", "2026-11-28", "2026-11-29"], dtype="M8[s]")
    ),
    "table.…: … allowed: one of (…)": lambda: arrays(
        ["x", "y", "z"], space={"a": CategoricalDistribution(["x", "y"])}
    ),
    "column: … allowed: one of …": lambda: FeatureTable.from_dataframe(
        pd.DataFrame(PARAMETERS), parameters=["a"], features=["c"]
    ),
    "…: … allowed: a Parquet file, a folder of them, or a text such as CSV, that exists": lambda: (
        FeatureTable.from_parquet("missing.parquet", parameters=["a"], features=["f"])
    ),
    "… rows that lack more than half of their features are not proposed": lambda: (
        new_table([[0.0], [1.0], [np.nan]])
    ),
    "… rows repeat the parameters of another and are not proposed": lambda: arrays(
        [1.0, 1.0, 2.0]
    ),
    "features without information are ignored: …": lambda: new_table(
        [[0, 1], [1, 1], [4, 1]]
    ),
    "kernel: … allowed: one of …": lambda: sampler(kernel="gauss"),
    "kernel: … allowed: euclidean: there are no features": lambda: FeatureKernelSampler(
        kernel="rbf"
    ),
    "kernel: … allowed: one that uses features, or there is nothing to report": lambda: (
        FeatureKernelSampler().worth(optuna.create_study())
    ),
    "off_grid: … allowed: 0 without a feature_function": lambda: sampler(off_grid=9),
    "space: … allowed: none: a table knows its own": lambda: sampler(space=SPACE),
    "features: … allowed: a FeatureTable, a function, or None": lambda: sampler(
        FEATURES
    ),
    "success: … allowed: none in a study of … goals": lambda: two_goals(
        sampler(success=1.0)
    ),
    "table.outcomes: … allowed: those of … goals, …": lambda: two_goals(
        FeatureKernelSampler(FeatureTable.from_arrays({"a": LINE}, outcomes=LINE))
    ),
    "If the study is being used for multi-objective optimization, … cannot be used.": lambda: (
        sampler().worth(optuna.create_study(directions=["minimize", "maximize"]))
    ),
    "…: … allowed: a range that holds all rows: …": lambda: run(
        sampler(), a_within(0, 0.7)
    ),
    "…: … allowed: choices that hold all rows: …": lambda: run(
        sampler(), lambda trial: trial.suggest_categorical("a", [0.1, 0.5])
    ),
    "…: … allowed: what has …, a point off the table …": run_points_as_choices,
    "…: … allowed: a value that a row of the table has…; "
    "or all parameters, in enqueue_trial": lambda: run_enqueued(a=0.2),
    "…: … allowed: values of a row that has not been tried; …": lambda: run_enqueued(
        a=0.1
    ),
    "…: 'suggested, and not in the table' …": lambda: run(
        sampler(), lambda trial: trial.suggest_float("A", 0, 1)
    ),
    "…: 'not suggested in trial …' …": lambda: run(sampler(), only_a),
    "…: 'fixed' cannot be used; …": lambda: run(
        PartialFixedSampler({"a": 0.5}, sampler())
    ),
    "all … rows of the table have been tried": lambda: run(sampler()),
    "…: … allowed: the range declared in …": lambda: run(
        FeatureKernelSampler(space=SPACE, seed=1), a_within(0, 0.001)
    ),
    "features(params): … allowed: features [n, k], no exception": lambda: run(
        sampler(lambda params: 1 / 0, space=SPACE)
    ),
    "features(params).shape: … allowed: …": lambda: run(
        sampler(lambda params: np.ones((7, 2)), space=SPACE)
    ),
    "features(params): 'no row without NaN' …": lambda: run(
        sampler(lambda params: params * np.nan, space=SPACE)
    ),
    "… the independent sampler takes over": lambda: run(sampler(strict=False)),
    "trials whose parameters are no row of the table are ignored: …": lambda: study_of(
        new_table(), both, 3, enqueued=[{"a": 0.33, "b": 2.0}]
    ),
}


def said_by(case: Callable[[], object]) -> list[str]:
    """Warnings, then the error that ended it."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        error: list[str] = []
        try:
            case()
        except (ValueError, RuntimeError) as raised:
            error = [str(raised)]
    ours = [str(w.message) for w in caught if w.category is UserWarning]
    return ours + error


@pytest.mark.parametrize("message", EXPLAINED)
def test_what_is_explained_is_said(message):
    assert list(CASES) == EXPLAINED
    pattern = re.escape(message).replace("…", ".+")
    said = said_by(CASES[message])
    assert any(re.search(pattern, line) for line in said), said


def test_nothing_is_said_of_what_fits_and_strictness_changes_nothing(table):
    assert said_by(lambda: run(sampler(), trials=3)) == []
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        study = run(FeatureKernelSampler(table, seed=0, strict=False), bowl, trials=6)
    assert rows_of(study) == rows_of(
        run(FeatureKernelSampler(table, seed=0), bowl, trials=6)
    )


BOX = {"a": FloatDistribution(-1, 1), "b": FloatDistribution(0, 5)}


def test_other_names_are_one_warning_where_the_table_need_not_fit(table):
    message = "none of the table's parameters: a, b.* independent sampler takes over"
    with pytest.warns(UserWarning, match=message) as said:
        sampler = FeatureKernelSampler(table, seed=0, strict=False)
        study = run(sampler, lambda trial: trial.suggest_float("A", -1, 1))
    assert [trial.state for trial in study.trials] == [TrialState.COMPLETE] * 5
    assert len(said) == 1


@pytest.mark.filterwarnings("ignore:Fixed parameter")
def test_a_range_that_shrinks_is_an_error_where_it_leaves_the_row_out(table):
    def shrunk(trial):
        return trial.suggest_float("a", -0.999, 1) + trial.suggest_float("b", 0, 1e-9)

    study = study_of(table, bowl, 2)
    study.enqueue_trial(table.rows.as_parameters(3))
    study.optimize(shrunk, n_trials=1)
    study.optimize(
        bowl, n_trials=1
    )  # what another trial suggested is no fault of this one
    with pytest.raises(
        InputError, match=r"b: .* a range that holds all rows: row \d+ has"
    ):
        study.optimize(shrunk, n_trials=1)


def test_extra_parameters_come_after_the_tables_or_are_named(table):
    def first(trial):
        return trial.suggest_int("n", 1, 9) + bowl(trial)

    def last(trial):
        return bowl(trial) + (trial.suggest_categorical("kind", ["x", "y"]) == "x")

    with pytest.raises(InputError, match=r"extra_parameters=\['n'\]"):
        run(FeatureKernelSampler(table, seed=0), first)
    for objective, name, options in (
        (first, "n", {"extra_parameters": ["n"]}),
        (last, "kind", {}),
    ):
        samplers = (FeatureKernelSampler(table, seed=0, **options) for _ in range(2))
        study, again = (run(sampler, objective, 8) for sampler in samplers)
        assert [trial.params for trial in study.trials] == [
            trial.params for trial in again.trials
        ]
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
        study = study_of(small, bowl, 5, strict=False)
    assert sum(f"all {count} rows of the table" in str(w.message) for w in said) == 1
    assert len(study.trials) == 5


def test_rows_without_features_or_repeated_are_never_proposed():
    a = [0.0, 0.1, 0.2, 0.3, 0.1]
    with pytest.warns(UserWarning, match="1 rows that lack .* 1 rows repeat"):
        table = FeatureTable.from_arrays({"a": a}, [1.0, 2.0, np.nan, 4.0, 5.0])
    study = study_of(table, lambda t: t.suggest_float("a", 0, 1), 3)
    assert set(rows_of(study)) == {0, 1, 3}
    with pytest.raises(TableExhaustedError):
        study.optimize(lambda t: t.suggest_float("a", 0, 1), n_trials=1)


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
    given, options = function, {"seed": 0, "space": BOX}
    if message.startswith("shape: "):  # against the table's one feature
        given, options = (
            table,
            {"seed": 0, "off_grid": 20, "feature_function": function},
        )
    with pytest.raises(InputError, match=message):
        run(FeatureKernelSampler(given, **options), bowl)
    lenient = FeatureKernelSampler(given, strict=False, **options)
    with pytest.warns(UserWarning, match="independent sampler takes over") as said:
        assert len(run(lenient, bowl).trials) == 5
    assert len(said) == 1


@pytest.mark.filterwarnings("ignore:PartialFixedSampler is experimental")
def test_a_fixed_parameter_and_a_declared_one_that_is_never_suggested():
    table = FeatureTable.from_arrays(
        {"a": [0.0, 0.5, 1.0], "b": [0.0, 1.0, 2.0]}, [1, 2, 3]
    )
    for given, space in ((table, None), (lambda params: params, BOX)):
        strict = FeatureKernelSampler(given, seed=0, space=space)
        with pytest.raises(InputError, match="a: 'fixed"):
            run(PartialFixedSampler({"a": 0.5}, strict), bowl)
    plain = PartialFixedSampler({"a": 0.5}, FeatureKernelSampler(seed=0))
    assert {trial.params["a"] for trial in run(plain, bowl).trials} == {0.5}
    with pytest.raises(InputError, match="b: 'not suggested in trial 0'"):
        study_of(None, only_a, 3, space=SPACE)


def test_a_trial_that_could_not_be_asked_for_is_ended_as_documented(table):
    """Optuna keeps the trial of an `ask` that raises RUNNING, whichever sampler raised."""
    study = study_of(table, enqueued=[{"a": 0.123}])
    with pytest.raises(InputError, match=r"a: 0\.123"):
        study.ask(BOX)
    study.tell(study.trials[-1].number, state=TrialState.FAIL)
    study.optimize(bowl, n_trials=1)
    assert [trial.state for trial in study.trials] == [
        TrialState.FAIL,
        TrialState.COMPLETE,
    ]
