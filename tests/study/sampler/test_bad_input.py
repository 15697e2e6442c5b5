"""What a user can get wrong: each an error that names the cause before a trial is lost, or, with
strict=False, a fall-back with one warning."""

import warnings
from collections.abc import Callable

import numpy as np
import optuna
import pytest
from numpy.typing import NDArray
from optuna.distributions import CategoricalDistribution, FloatDistribution
from optuna.trial import TrialState

from study import FeatureKernelSampler, FeatureTable
from study.sampler.table_policy import TableExhaustedError
from taichi_nmm.errors import InputError

Objective = Callable[[optuna.Trial], float]
SPACE = {"a": FloatDistribution(-1, 1), "b": FloatDistribution(0, 5)}


def bowl(trial: optuna.Trial) -> float:
    return trial.suggest_float("a", -1, 1) ** 2 + 0.01 * trial.suggest_float("b", 0, 5)


def other_names(trial: optuna.Trial) -> float:
    return trial.suggest_float("A", -1, 1) + trial.suggest_float("B", 0, 5)


def narrow(trial: optuna.Trial) -> float:
    return trial.suggest_float("a", -1, 1) + trial.suggest_float("b", 0, 1e-9)


def logarithmic(trial: optuna.Trial) -> float:
    return trial.suggest_float("a", -1, 1) + trial.suggest_float("b", 1, 5, log=True)


def integers(trial: optuna.Trial) -> float:
    return trial.suggest_float("a", -1, 1) + trial.suggest_int("b", 0, 5)


def categorical(trial: optuna.Trial) -> float:
    return trial.suggest_float("a", -1, 1) + float(trial.suggest_categorical("b", [1, 2]))


def only_a(trial: optuna.Trial) -> float:
    return trial.suggest_float("a", -1, 1)


def run(sampler: FeatureKernelSampler, objective: Objective, trials: int = 6) -> optuna.Study:
    study = optuna.create_study(sampler=sampler)
    study.optimize(objective, n_trials=trials)
    return study


@pytest.mark.parametrize(
    ("objective", "message"),
    [
        (other_names, r"A: 'suggested, and not in the table' .*first \(a, b"),
        (narrow, r"b: .*high=1e-09.* a range that holds all rows: row 0 has 2.0.*space="),
        (logarithmic, r"b: .*log=True.* a range that holds all rows: row \d+ has 0.*space="),
        (integers, r"b: 'IntDistribution.* a range that holds all rows: row 0 has 2.0.*space="),
        (categorical, r"b: 'CategoricalDistribution.* choices that hold all rows: .*space="),
    ],
)
def test_what_does_not_fit_is_an_error_before_a_trial_is_lost(
    table: FeatureTable, objective: Objective, message: str
) -> None:
    lost = []

    def costly(trial: optuna.Trial) -> float:
        value = objective(trial)
        lost.append(trial.number)
        return value

    with pytest.raises(ValueError, match=message):
        run(FeatureKernelSampler(table, seed=0), costly)
    assert lost == []


@pytest.mark.parametrize(
    "objective", [other_names, narrow, logarithmic, integers, categorical, only_a]
)
def test_what_does_not_fit_is_otherwise_left_to_the_independent_sampler(
    table: FeatureTable, objective: Objective
) -> None:
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        study = run(FeatureKernelSampler(table, seed=0, strict=False), objective)
    assert [trial.state for trial in study.trials] == [TrialState.COMPLETE] * 6
    about_fit = [w for w in said if "independent sampler takes over" in str(w.message)]
    assert len(about_fit) == 1


def test_a_table_that_fits_is_used_without_strictness_too(table: FeatureTable) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        study = run(FeatureKernelSampler(table, seed=0, strict=False), bowl)
    assert study.best_value < 0.1
    rows = [trial.user_attrs["row"] for trial in study.trials]
    strict = run(FeatureKernelSampler(table, seed=0), bowl)
    assert rows == [trial.user_attrs["row"] for trial in strict.trials]


@pytest.mark.filterwarnings("ignore:Fixed parameter")
def test_a_range_that_shrinks_is_an_error_where_it_leaves_the_row_out(table: FeatureTable) -> None:
    def shrunk(trial: optuna.Trial) -> float:
        return trial.suggest_float("a", -0.999, 1) + trial.suggest_float("b", 0, 1e-9)

    study = run(FeatureKernelSampler(table, seed=0), bowl, trials=2)
    study.enqueue_trial(table.rows.as_parameters(3))
    study.optimize(shrunk, n_trials=1)
    study.optimize(bowl, n_trials=1)  # what another trial suggested is no fault of this one
    with pytest.raises(InputError, match=r"b: .* a range that holds all rows: row \d+ has"):
        study.optimize(shrunk, n_trials=1)


@pytest.mark.parametrize("features", ["table", "callable", "none"])
def test_several_objectives_are_refused(table: FeatureTable, features: str) -> None:
    given = {"table": table, "callable": lambda params: params, "none": None}[features]
    study = optuna.create_study(
        sampler=FeatureKernelSampler(given), directions=["minimize", "maximize"]
    )
    with pytest.raises(ValueError, match="multi-objective"):
        study.ask(SPACE)


def test_extra_parameters_come_after_the_tables_or_are_named(table: FeatureTable) -> None:
    def first(trial: optuna.Trial) -> float:
        return trial.suggest_int("n", 1, 9) + bowl(trial)

    with pytest.raises(InputError, match=r"extra_parameters=\['n'\]"):
        run(FeatureKernelSampler(table, seed=0), first)
    study = run(FeatureKernelSampler(table, seed=0, extra_parameters=["n"]), first)
    assert len({trial.params["n"] for trial in study.trials}) > 1


def test_categoricals_with_features_are_rows_like_others() -> None:
    table = FeatureTable.from_arrays(
        {"kind": ["x", "y", "z"] * 5, "n": list(range(15))}, np.arange(15.0)
    )
    study = run(
        FeatureKernelSampler(table, seed=0),
        lambda t: (
            t.suggest_int("n", 0, 14) + (t.suggest_categorical("kind", ["x", "y", "z"]) == "x")
        ),
    )
    assert all(type(trial.params["n"]) is int for trial in study.trials)
    with pytest.raises(InputError, match=r"kind: .* choices that hold all rows: row 1 has 'y'"):
        run(
            FeatureKernelSampler(table, seed=0),
            lambda t: t.suggest_int("n", 0, 14) + len(t.suggest_categorical("kind", ["x", "q"])),
        )


def test_an_exhausted_table(table: FeatureTable) -> None:
    small = FeatureTable.from_arrays({"a": [0.0, 0.5], "b": [0.0, 1.0]}, [1, 2])
    study = run(FeatureKernelSampler(small, seed=0), bowl, trials=2)
    with pytest.raises(TableExhaustedError, match="all 2 rows"):
        study.optimize(bowl, n_trials=1)
    with pytest.warns(UserWarning) as said:
        study = run(FeatureKernelSampler(small, seed=0, strict=False), bowl, trials=5)
    assert sum("all 2 rows of the table have been tried" in str(w.message) for w in said) == 1
    assert len(study.trials) == 5


def test_a_table_of_one_row_of_one_feature() -> None:
    with pytest.warns(UserWarning, match="without information"):
        table = FeatureTable.from_arrays({"a": [0.25], "b": [1.0]}, [7.0])
    assert run(FeatureKernelSampler(table), bowl, trials=1).best_params == {"a": 0.25, "b": 1.0}


def test_rows_without_features_or_repeated_are_never_proposed() -> None:
    a = [0.0, 0.1, 0.2, 0.3, 0.1]
    with pytest.warns(UserWarning, match="1 rows that lack .* 1 rows repeat"):
        table = FeatureTable.from_arrays({"a": a}, [1.0, 2.0, np.nan, 4.0, 5.0])
    sampler = FeatureKernelSampler(table, seed=0)
    study = run(sampler, lambda t: t.suggest_float("a", 0, 1), trials=3)
    assert {trial.user_attrs["row"] for trial in study.trials} == {0, 1, 3}
    with pytest.raises(TableExhaustedError):
        study.optimize(lambda t: t.suggest_float("a", 0, 1), n_trials=1)


@pytest.mark.parametrize("value", [float("nan"), None])
def test_a_trial_without_a_cost_fails_and_teaches_nothing(
    table: FeatureTable, value: float | None
) -> None:
    study = run(FeatureKernelSampler(table, seed=0), bowl, trials=4)

    def broken(trial: optuna.Trial) -> float:
        bowl(trial)
        return value  # type: ignore[return-value]

    study.optimize(broken, n_trials=2)
    study.optimize(bowl, n_trials=2)
    states = [trial.state for trial in study.trials]
    assert states.count(TrialState.FAIL) == 2
    assert len({trial.user_attrs["row"] for trial in study.trials}) == 8


def raising(params: NDArray[np.float64]) -> NDArray[np.float64]:
    raise OSError("the simulator is not there")


BROKEN = [
    (raising, "OSError: the simulator is not there"),
    (lambda params: params[:-1], "shape"),
    (lambda params: params[:, :, None], "shape"),
    (lambda params: params[:, :0], "at least one feature"),
    (lambda params: "no", "an array of numbers"),
    (lambda params: np.full((len(params), 2), np.nan), "no row without NaN"),
]


@pytest.mark.parametrize(("function", "message"), BROKEN)
def test_a_broken_function_is_an_error_before_a_trial_is_lost(
    function: Callable[[NDArray[np.float64]], NDArray[np.float64]], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        run(FeatureKernelSampler(function, seed=0, space=SPACE), bowl)
    lenient = FeatureKernelSampler(function, seed=0, space=SPACE, strict=False)
    with pytest.warns(UserWarning, match="independent sampler takes over") as said:
        assert len(run(lenient, bowl).trials) == 6
    assert len(said) == 1


def test_a_broken_function_of_a_table_too(table: FeatureTable) -> None:
    def wide(params: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.hstack([params, params])

    options = {"seed": 0, "off_grid": 20, "feature_function": wide}
    with pytest.raises(InputError, match=r"shape: \(20, 4\) .* \[20, 1\]"):
        run(FeatureKernelSampler(table, **options), bowl)
    with pytest.warns(UserWarning, match="independent sampler takes over"):
        run(FeatureKernelSampler(table, strict=False, **options), bowl)


def test_a_declared_space_that_does_not_fit() -> None:
    sampler = FeatureKernelSampler(lambda params: params, seed=0, space=SPACE)
    with pytest.raises(InputError, match=r"b: .* the range declared in `space`"):
        run(sampler, narrow)
    sampler = FeatureKernelSampler(lambda params: params, seed=0, space=SPACE)
    with pytest.raises(InputError, match="b: 'not suggested in trial 0'"):
        run(sampler, only_a)


@pytest.mark.filterwarnings("ignore:PartialFixedSampler is experimental")
def test_a_fixed_parameter() -> None:
    table = FeatureTable.from_arrays({"a": [0.0, 0.5, 1.0], "b": [0.0, 1.0, 2.0]}, [1, 2, 3])
    for features in (table, lambda params: params):
        space = None if features is table else SPACE
        strict = FeatureKernelSampler(features, seed=0, space=space)
        with pytest.raises(InputError, match="a: 'fixed"):
            run(optuna.samplers.PartialFixedSampler({"a": 0.5}, strict), bowl)
    plain = optuna.samplers.PartialFixedSampler({"a": 0.5}, FeatureKernelSampler(seed=0))
    assert {trial.params["a"] for trial in run(plain, bowl).trials} == {0.5}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"kernel": "cubic"}, "kernel: 'cubic' .*rbf_ard"),
        ({"kernel": "nearness"}, "kernel: 'nearness' .*additive"),
        ({"prior": "speed"}, "prior: 'speed' .*feature_0"),
        ({"prior": "-speed"}, "prior: '-speed' .*feature_0, or one with a minus"),
        ({"off_grid": -1}, "off_grid: -1 .* from 0 to 1000000"),
        ({"off_grid": 5}, "off_grid: 5 .* feature_function"),
        ({"space": {"x": CategoricalDistribution([1])}}, "space"),
    ],
)
def test_options_that_cannot_be_used(
    table: FeatureTable, options: dict[str, object], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        FeatureKernelSampler(table, **options)


@pytest.mark.parametrize(
    ("features", "options", "message"),
    [
        (None, {"kernel": "rbf"}, "kernel: 'rbf' .*no features"),
        (None, {"kernel": "additive"}, "kernel: 'additive' .*no features"),
        (None, {"prior": "p"}, "prior"),
        (None, {"off_grid": 3}, "off_grid"),
        (None, {"feature_function": len}, "feature_function"),
        (3, {}, "features: 'int'"),
    ],
)
def test_options_that_need_features(
    features: object, options: dict[str, object], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        FeatureKernelSampler(features, **options)  # type: ignore[arg-type]


def test_bounds_beside_a_distribution_are_refused() -> None:
    with pytest.raises(InputError, match=r"table\.bounds\.a: .* none beside space="):
        FeatureTable.from_arrays(
            {"a": [0.0, 1.0]}, [1.0, 2.0], bounds={"a": (0, 2)}, space={"a": SPACE["a"]}
        )


def test_a_trial_that_could_not_be_asked_for_is_ended_as_documented(table: FeatureTable) -> None:
    """Optuna keeps the trial of an `ask` that raises RUNNING, whichever sampler raised."""
    study = optuna.create_study(sampler=FeatureKernelSampler(table, seed=0))
    study.enqueue_trial({"a": 0.123})
    with pytest.raises(InputError, match=r"a: 0\.123"):
        study.ask(SPACE)
    study.tell(study.trials[-1].number, state=TrialState.FAIL)
    study.optimize(bowl, n_trials=1)
    assert [trial.state for trial in study.trials] == [TrialState.FAIL, TrialState.COMPLETE]
