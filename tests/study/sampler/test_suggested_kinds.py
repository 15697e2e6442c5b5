"""Studies that suggest a table's parameters in their own way: it works where the values fit."""

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import optuna
import pandas as pd
import pytest
from numpy.typing import NDArray
from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution
from optuna.trial import TrialState

from study import FeatureKernelSampler, FeatureTable
from taichi_nmm.errors import InputError

RATE = np.geomspace(1e-4, 1.0, 12)
UNITS = np.tile([16, 32, 64, 128], 3)
KIND = np.array(["relu", "tanh", "gelu"] * 4)
DEPTH = np.array([2.0, 4.0, 8.0] * 4)
FEATURES = np.column_stack([np.log(RATE), UNITS])


def table(**options: Any) -> FeatureTable:
    columns = {"rate": RATE, "units": UNITS, "kind": KIND, "depth": DEPTH}
    return FeatureTable.from_arrays(columns, FEATURES, **options)


def as_the_table(trial: optuna.Trial) -> dict[str, Any]:
    return {
        "rate": trial.suggest_float("rate", 1e-5, 1),
        "units": trial.suggest_int("units", 1, 500),
        "kind": trial.suggest_categorical("kind", ["relu", "tanh", "gelu"]),
        "depth": trial.suggest_float("depth", 1, 10),
    }


Suggest = Callable[[optuna.Trial], Any]
OTHERWISE: dict[str, tuple[str, Suggest]] = {
    "a float on a logarithmic scale": (
        "rate",
        lambda trial: trial.suggest_float("rate", 1e-5, 1, log=True),
    ),
    "an integer on a logarithmic scale": (
        "units",
        lambda trial: trial.suggest_int("units", 1, 512, log=True),
    ),
    "integers as choices": (
        "units",
        lambda trial: trial.suggest_categorical("units", [8, 16, 32, 64, 128]),
    ),
    "integers as floats": ("units", lambda trial: trial.suggest_float("units", 16, 128)),
    "floats as integers": ("depth", lambda trial: trial.suggest_int("depth", 1, 8)),
    "floats as choices": ("depth", lambda trial: trial.suggest_categorical("depth", [8, 4, 2])),
    "another order of choices": (
        "kind",
        lambda trial: trial.suggest_categorical("kind", ["gelu", "relu", "tanh"]),
    ),
    "more choices": (
        "kind",
        lambda trial: trial.suggest_categorical("kind", ["elu", "gelu", "relu", "tanh", None]),
    ),
    "a step": ("depth", lambda trial: trial.suggest_float("depth", 0, 8, step=0.5)),
}


def objective(name: str, suggest: Suggest) -> Callable[[optuna.Trial], float]:
    """With one parameter suggested otherwise than the table has it."""

    def cost(trial: optuna.Trial) -> float:
        suggest(trial)
        values = {
            other: ask(trial)
            for other, ask in {
                "rate": lambda t: t.suggest_float("rate", 1e-5, 1),
                "units": lambda t: t.suggest_int("units", 1, 500),
                "kind": lambda t: t.suggest_categorical("kind", ["relu", "tanh", "gelu"]),
                "depth": lambda t: t.suggest_float("depth", 1, 10),
            }.items()
            if other != name
        }
        return float(len(str(values)))

    return cost


def new_study(given: FeatureTable | None = None, **options: Any) -> optuna.Study:
    return optuna.create_study(sampler=FeatureKernelSampler(given or table(), seed=1, **options))


@pytest.mark.parametrize("strict", [True, False])
@pytest.mark.parametrize("how", OTHERWISE)
def test_what_holds_the_rows_works(how: str, strict: bool) -> None:
    name, suggest = OTHERWISE[how]
    study = new_study(strict=strict)
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        study.optimize(objective(name, suggest), n_trials=12)
    rows = [trial.user_attrs["row"] for trial in study.trials]
    assert sorted(rows) == list(range(12))
    content = table().rows
    for trial, row in zip(study.trials, rows, strict=True):
        assert trial.params == content.as_parameters(row)
        distribution = trial.distributions[name]
        wanted = {IntDistribution: int, FloatDistribution: float}.get(type(distribution))
        assert wanted is None or type(trial.params[name]) is wanted


@pytest.mark.parametrize("how", OTHERWISE)
def test_several_workers_and_resumed_studies_go_on_with_it(how: str) -> None:
    whole = new_study()
    whole.optimize(objective(*OTHERWISE[how]), n_trials=8)
    pieces = optuna.create_study()
    for _ in range(8):
        pieces.sampler = FeatureKernelSampler(table(), seed=1)
        pieces.optimize(objective(*OTHERWISE[how]), n_trials=1)
    assert [trial.params for trial in pieces.trials] == [trial.params for trial in whole.trials]


MISFITS: dict[str, tuple[str, Suggest, str]] = {
    "too narrow, logarithmic": (
        "rate",
        lambda trial: trial.suggest_float("rate", 0.01, 1, log=True),
        r"rate: .*log=True.* a range that holds all rows: row 0 has 0.0001 .*space=",
    ),
    "floats as integers": (
        "rate",
        lambda trial: trial.suggest_int("rate", 0, 1),
        r"rate: 'IntDistribution.* a range that holds all rows: row 0 has 0.0001 .*space=",
    ),
    "too few choices": (
        "kind",
        lambda trial: trial.suggest_categorical("kind", ["gelu", "relu"]),
        r"kind: .* choices that hold all rows: row 1 has 'tanh' .*space=",
    ),
    "too few integers": (
        "units",
        lambda trial: trial.suggest_categorical("units", [16, 32, 64]),
        r"units: .* choices that hold all rows: row 3 has 128 .*space=",
    ),
    "words as numbers": (
        "kind",
        lambda trial: trial.suggest_int("kind", 0, 2),
        r"kind: .* row 0 has 'relu' .*space=",
    ),
    "a step between": (
        "depth",
        lambda trial: trial.suggest_float("depth", 0, 9, step=3),
        r"depth: .* row 0 has 2.0 .*space=",
    ),
    "too narrow, as the table": (
        "rate",
        lambda trial: trial.suggest_float("rate", 0, 0.5),
        r"rate: .* a range that holds all rows: row 11 has 1.0",
    ),
}


@pytest.mark.parametrize("how", MISFITS)
def test_what_does_not_hold_them_is_one_line_before_the_objective(how: str) -> None:
    name, suggest, message = MISFITS[how]
    study = new_study()
    done: list[float] = []
    cost = objective(name, suggest)
    with pytest.raises(InputError, match=message):
        study.optimize(lambda trial: done.append(cost(trial)) or 0.0, n_trials=1)
    assert not done


@pytest.mark.parametrize("how", MISFITS)
def test_where_it_need_not_fit_it_is_one_warning(how: str) -> None:
    name, suggest, _ = MISFITS[how]
    study = new_study(strict=False)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        study.optimize(objective(name, suggest), n_trials=6)
    ours = [w for w in said if "independent sampler takes over" in str(w.message)]
    assert len(ours) == 1
    assert all(trial.state is TrialState.COMPLETE for trial in study.trials)
    assert all(trial.user_attrs.get("row", -1) == -1 for trial in study.trials)


def coordinates(study: optuna.Study) -> NDArray[np.float64]:
    """What a kernel over the parameters saw of the rows in the latest trial."""
    source = study.sampler._policy  # type: ignore[attr-defined]
    return np.asarray(source.rows.unit)


def test_a_logarithmic_scale_is_the_kernels_too() -> None:
    study = new_study(kernel="euclidean")
    study.optimize(objective(*OTHERWISE["a float on a logarithmic scale"]), n_trials=4)
    logarithmic = table(space={"rate": FloatDistribution(1e-4, 1, log=True)}).rows.unit
    assert coordinates(study) == pytest.approx(logarithmic)
    given = table(space={"rate": FloatDistribution(1e-4, 1, log=True)})
    other = new_study(given, kernel="euclidean")
    other.optimize(objective(*OTHERWISE["a float on a logarithmic scale"]), n_trials=8)
    study.optimize(objective(*OTHERWISE["a float on a logarithmic scale"]), n_trials=4)
    params = [trial.params for trial in study.trials if trial.params]
    assert params == [trial.params for trial in other.trials]


def test_points_near_the_table_are_on_the_logarithmic_scale_and_within_the_range() -> None:
    rate = np.geomspace(1e-4, 1.0, 30)
    given = FeatureTable.from_arrays({"rate": rate}, np.log(rate))
    study = new_study(given, feature_function=np.log, off_grid=50)
    study.optimize(
        lambda trial: abs(np.log(trial.suggest_float("rate", 1e-4, 1, log=True)) + 3.3), n_trials=15
    )
    assert any(trial.user_attrs["row"] == -1 for trial in study.trials)
    assert study.best_value < 0.1


def test_points_near_the_table_that_the_study_does_not_take_are_one_line() -> None:
    units = np.arange(1, 60, 2)
    given = FeatureTable.from_arrays({"units": units}, units)
    study = new_study(given, feature_function=lambda params: params, off_grid=50)
    with pytest.raises(InputError, match=r"units: .* off the table.*space="):
        study.optimize(
            lambda trial: (trial.suggest_categorical("units", units.tolist()) - 30.2) ** 2,
            n_trials=25,
        )


def test_trials_off_the_table_are_learned_from_whatever_they_are_suggested_as() -> None:
    study = new_study(feature_function=lambda params: np.column_stack([params[:, 0], params[:, 1]]))
    study.enqueue_trial({"rate": 0.002, "units": 64, "kind": "relu", "depth": 2.0})
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        study.optimize(objective(*OTHERWISE["integers as choices"]), n_trials=5)
    first, *others = study.trials
    assert first.params["rate"] == 0.002 and "row" not in first.user_attrs
    assert all("row" in trial.user_attrs for trial in others)


NONE = {"none": ["sqrt", None, "log2"], "flags": [True, None, False]}


@pytest.mark.parametrize("column", NONE)
def test_none_is_a_choice_of_a_column_of_objects(column: str) -> None:
    values = NONE[column]
    given = FeatureTable.from_arrays({"kind": values}, [1.0, 2.0, 4.0])
    study = new_study(given)
    study.optimize(
        lambda trial: float(trial.suggest_categorical("kind", [None, *values[::2]]) is None),
        n_trials=3,
    )
    assert {trial.params["kind"] for trial in study.trials} == set(values)
    assert sorted(trial.user_attrs["row"] for trial in study.trials) == [0, 1, 2]


@pytest.mark.parametrize("values", [[3, None, 5], [None, None], ["x", float("nan")]])
def test_what_may_be_a_gap_names_the_way_to_make_it_a_choice(values: list[Any]) -> None:
    with pytest.raises(InputError, match=r"table.depth\[\d\]: .* None .*space=\{'depth': "):
        FeatureTable.from_arrays({"depth": values}, np.arange(float(len(values))))


@pytest.mark.parametrize("values", [[3, None, 5], [3.0, float("nan"), 5.0], ["x", None, "y"]])
def test_given_as_a_choice_a_gap_is_none(values: list[Any]) -> None:
    choices = [None if value is None or value != value else value for value in values]
    frame = pd.DataFrame({"depth": values, "feature": [1.0, 2.0, 3.0]})
    space = {"depth": CategoricalDistribution(choices)}
    given = FeatureTable.from_dataframe(
        frame, parameters=["depth"], features=["feature"], space=space
    )
    assert [given.rows.as_parameters(row)["depth"] for row in range(3)] == choices


def test_a_list_of_words_and_numbers_keeps_its_numbers() -> None:
    given = FeatureTable.from_arrays({"gamma": ["scale", 0.1, 1]}, [1.0, 2.0, 4.0])
    study = new_study(given)
    study.optimize(
        lambda trial: float(trial.suggest_categorical("gamma", [0.1, 1, "scale"]) == 1), n_trials=3
    )
    assert {trial.params["gamma"] for trial in study.trials} == {"scale", 0.1, 1}
