"""Each message that docs/sampler.md explains is raised by the code; each case is explained."""

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

from study import FeatureKernelSampler, FeatureTable

PAGE = Path(__file__).parents[3] / "docs" / "sampler.md"
EXPLAINED = re.findall(
    r"^\| (?:warning )?`([^`]+)`", PAGE.read_text().split("## Messages, and what to do")[1], re.M
)

PARAMETERS = {"a": [0.1, 0.5, 0.9], "b": [1.0, 2.0, 3.0]}
FEATURES = [[0.0], [1.0], [4.0]]
SPACE = {"a": FloatDistribution(0, 1), "b": FloatDistribution(0, 5)}


def table(features: Any = FEATURES, **options: Any) -> FeatureTable:
    return FeatureTable.from_arrays(PARAMETERS, features, **options)


def sampler(features: Any = None, **options: Any) -> FeatureKernelSampler:
    return FeatureKernelSampler(table() if features is None else features, seed=1, **options)


def both(trial: optuna.Trial) -> float:
    return trial.suggest_float("a", 0, 1) + trial.suggest_float("b", 0, 5)


def a_within(low: float, high: float) -> Callable[[optuna.Trial], float]:
    return lambda trial: trial.suggest_float("a", low, high) + trial.suggest_float("b", 0, 5)


def run(
    sampler: BaseSampler, objective: Callable[..., Any] = both, trials: int = 5, objectives: int = 1
) -> None:
    study = optuna.create_study(sampler=sampler, directions=["minimize"] * objectives)
    study.optimize(objective, n_trials=trials)


def run_after_a_point_off_the_table() -> None:
    study = optuna.create_study(sampler=sampler())
    study.enqueue_trial({"a": 0.33, "b": 2.0})
    study.optimize(both, n_trials=3)


def run_enqueued(**fixed: float) -> None:
    study = optuna.create_study(sampler=sampler())
    study.enqueue_trial(fixed)
    study.enqueue_trial(fixed)
    study.optimize(both, n_trials=2)


def run_against_the_prior() -> None:
    values = np.linspace(0, 1, 20)
    many = FeatureTable.from_arrays({"a": values}, values)
    study = optuna.create_study(sampler=sampler(many, prior="feature_0"))
    study.optimize(lambda trial: trial.suggest_float("a", 0, 1), n_trials=8)


def run_points_as_choices() -> None:
    units = FeatureTable.from_arrays({"a": [1, 30]}, [1.0, 30.0])
    options = {"feature_function": lambda params: params, "off_grid": 50}
    run(sampler(units, **options), lambda trial: trial.suggest_categorical("a", [1, 30]))


def frame_without_c() -> None:
    FeatureTable.from_dataframe(pd.DataFrame(PARAMETERS), parameters=["a"], features=["c"])


def no_file() -> None:
    FeatureTable.from_parquet("missing.parquet", parameters=["a"], features=["f"])


CASES: dict[str, Callable[[], object]] = {
    "table.….shape: … allowed: …, as the features": lambda: FeatureTable.from_arrays(
        {"a": [1.0, 2.0]}, FEATURES
    ),
    "table.…: nan cannot be used; allowed: a finite number": lambda: FeatureTable.from_arrays(
        {"a": [1.0, np.nan, 3.0]}, FEATURES
    ),
    "table.features: … allowed: numbers, [n, k]": lambda: table(["x", "y", "z"]),
    "table.feature_names: … allowed: … names": lambda: table(feature_names=["f", "g"]),
    "table.…: … allowed: … to …": lambda: table(bounds={"a": (0, 0.5)}),
    "table.bounds.…: … allowed: none beside space=, …": lambda: table(
        bounds={"a": (0, 1)}, space=SPACE
    ),
    "table.…: … allowed: a value of …": lambda: table(
        space={"a": FloatDistribution(0, 1, step=0.25)}
    ),
    "table.…: … allowed: a value; or None as a choice: space=…": lambda: FeatureTable.from_arrays(
        {"a": [1, None, 3]}, FEATURES
    ),
    "table.…: … allowed: one of (…)": lambda: FeatureTable.from_arrays(
        {"a": ["x", "y", "z"]}, FEATURES, space={"a": CategoricalDistribution(["x", "y"])}
    ),
    "column: … allowed: one of …": frame_without_c,
    "…: … allowed: a Parquet file, or a folder of them, that exists": no_file,
    "… rows that lack more than half of their features are not proposed": lambda: table(
        [[0.0], [1.0], [np.nan]]
    ),
    "… rows repeat the parameters of another and are not proposed": (
        lambda: FeatureTable.from_arrays({"a": [1.0, 1.0, 2.0]}, FEATURES)
    ),
    "features without information are ignored: …": lambda: table([[0, 1], [1, 1], [4, 1]]),
    "kernel: … allowed: one of …": lambda: sampler(kernel="gauss"),
    "kernel: … allowed: euclidean: there are no features": lambda: FeatureKernelSampler(
        kernel="rbf"
    ),
    "kernel: … allowed: one that uses features, or there is nothing to report": lambda: (
        FeatureKernelSampler().worth(optuna.create_study())
    ),
    "prior: … allowed: one of …, or one with a minus": lambda: sampler(prior="phi"),
    "nearest: … allowed: none with a feature_function, …": lambda: sampler(
        nearest=0.1, feature_function=len
    ),
    "constraints_func: … allowed: None: call trial.set_constraint(key, value) in the objective": (
        lambda: sampler(constraints_func=3)
    ),
    "off_grid: … allowed: 0 without a feature_function": lambda: sampler(off_grid=9),
    "space: … allowed: none: a table knows its own": lambda: sampler(space=SPACE),
    "features: … allowed: a FeatureTable, a function, or None": lambda: sampler(FEATURES),
    "If the study is being used for multi-objective optimization, … cannot be used.": lambda: run(
        sampler(), lambda trial: (both(trial), 0.0), objectives=2
    ),
    "…: … allowed: a range that holds all rows: …": lambda: run(sampler(), a_within(0, 0.7)),
    "…: … allowed: choices that hold all rows: …": lambda: run(
        sampler(), lambda trial: trial.suggest_categorical("a", [0.1, 0.5])
    ),
    "…: … allowed: what has …, a point off the table …": run_points_as_choices,
    "…: … allowed: a value that a row of the table has…; or all parameters, in enqueue_trial": (
        lambda: run_enqueued(a=0.2)
    ),
    "…: … allowed: values of a row that has not been tried; …": lambda: run_enqueued(a=0.1),
    "…: 'suggested, and not in the table' …": lambda: run(
        sampler(), lambda trial: trial.suggest_float("A", 0, 1)
    ),
    "…: 'not suggested in trial …' …": lambda: run(
        sampler(), lambda trial: trial.suggest_float("a", 0, 1)
    ),
    "…: 'fixed' cannot be used; …": lambda: run(PartialFixedSampler({"a": 0.5}, sampler())),
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
    "prior: … cost more than the median of the trials; …": run_against_the_prior,
    "… the independent sampler takes over": lambda: run(sampler(strict=False)),
    "trials whose parameters are no row of the table are ignored: …": (
        run_after_a_point_off_the_table
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


def test_every_explained_message_has_a_case() -> None:
    assert list(CASES) == EXPLAINED


@pytest.mark.parametrize("message", CASES)
def test_it_is_said(message: str) -> None:
    pattern = re.escape(message).replace("…", ".+")
    said = said_by(CASES[message])
    assert any(re.search(pattern, line) for line in said), said


def test_nothing_is_said_of_what_fits() -> None:
    assert said_by(lambda: run(sampler(), trials=3)) == []


def test_a_table_of_one_row_has_one_trial() -> None:
    one = FeatureTable.from_arrays({"a": [0.5], "b": [1.0]}, [[2.0]])
    run(sampler(one), trials=1)
    assert said_by(lambda: run(sampler(one), trials=2))[-1].startswith("all 1 rows")
