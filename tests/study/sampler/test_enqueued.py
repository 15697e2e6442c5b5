"""Trials that a user fixes, wholly or in part: no row is noted, or learned, that was not run."""

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import pytest
from numpy.typing import NDArray
from optuna.samplers import PartialFixedSampler
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from optuna.trial import FrozenTrial, TrialState

from study import FeatureKernelSampler, FeatureTable
from study.sampler.acquisition import Model
from study.sampler.history import read_history, row_of
from taichi_nmm.errors import InputError
from tests.study.sampler.test_history import kill

A = np.repeat([0.0, 0.5, 1.0], 6)
B = np.tile(np.arange(6.0), 3)
FEATURES = np.column_stack([A + B, A - B])


def table() -> FeatureTable:
    """18 rows on a grid, with two features."""
    return FeatureTable.from_arrays({"a": A, "b": B}, FEATURES)


def compute(params: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.column_stack([params[:, 0] + params[:, 1], params[:, 0] - params[:, 1]])


def both(trial: optuna.Trial) -> float:
    return trial.suggest_float("a", 0, 1) + trial.suggest_float("b", 0, 5)


def new_study(features: Any = None, **options: Any) -> optuna.Study:
    given = table() if features is None else features
    return optuna.create_study(sampler=FeatureKernelSampler(given, seed=1, **options))


def run_quietly(study: optuna.Study, trials: int, objective: Callable[..., float] = both) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        study.optimize(objective, n_trials=trials)


def assert_rows_were_run(study: optuna.Study) -> None:
    """What is noted in each trial is true of it."""
    content = table().rows
    for trial in study.trials:
        row = trial.user_attrs.get("row", -1)
        if row >= 0:
            assert trial.params | content.as_parameters(row) == trial.params
            assert trial.user_attrs["features"] == content.features[row].tolist()
        else:
            assert content.find(trial.params) is None


def features_learned(study: optuna.Study) -> NDArray[np.float64]:
    """Of the finished trials, as the next proposal's model sees them, in standard units [n, 2]."""
    seen = []
    made = Model.__init__

    def spied(model: Model, *given: Any, **named: Any) -> None:
        made(model, *given, **named)
        seen.append(model.trials.features)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Model, "__init__", spied)
        study.tell(study.ask(table().rows.space.as_dict()), state=TrialState.FAIL)
    return seen[-1]


@pytest.mark.parametrize("finished", [0, 6])
def test_a_partly_enqueued_trial_is_a_row_that_has_the_fixed_values(finished: int) -> None:
    study = new_study()
    study.optimize(both, n_trials=finished)
    for _ in range(3):
        study.enqueue_trial({"a": 1.0})
    study.optimize(both, n_trials=5)
    assert [trial.params["a"] for trial in study.trials[finished : finished + 3]] == [1.0] * 3
    assert len({trial.user_attrs["row"] for trial in study.trials}) == finished + 5
    assert_rows_were_run(study)


def test_of_the_rows_that_have_it_the_model_chooses_the_best() -> None:
    study = new_study()
    for row in (0, 1, 3, 6, 8, 11):
        study.enqueue_trial(table().rows.as_parameters(row))
    study.optimize(lambda trial: 10.0 * both(trial), n_trials=6)
    study.enqueue_trial({"a": 1.0})
    study.optimize(both, n_trials=1)
    assert study.trials[-1].params == {"a": 1.0, "b": 0.0}


def test_where_no_row_has_the_fixed_values_it_is_an_error_before_the_objective() -> None:
    study = new_study()
    study.enqueue_trial({"a": 0.3})
    done: list[float] = []
    with pytest.raises(InputError, match=r"^a: 0.3 cannot be used; allowed: .* row .* 0.5; or"):
        study.optimize(lambda trial: done.append(both(trial)) or 0.0, n_trials=1)
    assert not done
    assert "row" not in study.trials[0].user_attrs
    study.optimize(both, n_trials=2)
    assert_rows_were_run(study)


def test_no_row_has_all_of_them_or_those_that_have_are_tried() -> None:
    small = FeatureTable.from_arrays({"a": [0.0, 1.0], "b": [0.0, 5.0], "c": [1.0, 2.0]}, [1, 2])

    def three(trial: optuna.Trial) -> float:
        return both(trial) + trial.suggest_float("c", 0, 5)

    study = new_study(small)
    study.enqueue_trial({"a": 0.0, "b": 5.0})
    with pytest.raises(InputError, match=r"^a, b: \(0.0, 5.0\) cannot be used"):
        study.optimize(three, n_trials=1)
    study = new_study(small)
    study.enqueue_trial({"a": 1.0})
    study.enqueue_trial({"a": 1.0})
    with pytest.raises(InputError, match=r"^a: 1.0 .* not been tried"):
        study.optimize(three, n_trials=2)


def test_where_the_table_need_not_fit_the_rest_is_drawn_and_not_learned() -> None:
    study = new_study(strict=False)
    study.optimize(both, n_trials=4)
    study.enqueue_trial({"a": 0.25})
    with pytest.warns(UserWarning, match=r"a: 0.25 .* independent sampler takes over") as said:
        study.optimize(both, n_trials=1)
    assert len(said) == 1
    assert study.trials[-1].params["a"] == 0.25
    assert "row" not in study.trials[-1].user_attrs
    assert "features" not in study.trials[-1].user_attrs
    run_quietly(study, 3)
    assert_rows_were_run(study)
    assert len(features_learned(study)) == 7


def test_with_a_function_it_is_learned_with_its_own_features() -> None:
    study = new_study(feature_function=compute)
    study.enqueue_trial({"a": 0.25})
    with pytest.warns(UserWarning, match="a: 0.25"):
        study.optimize(both, n_trials=1)
    study.optimize(both, n_trials=3)
    params = study.trials[0].params
    own = compute(np.array([[params["a"], params["b"]]]))
    assert features_learned(study)[0] == pytest.approx(
        table().rows.scale(by_order=True).standard(own)[0]
    )


@pytest.mark.parametrize("value", [0.25, 0.5])
def test_points_near_the_table_keep_the_fixed_value(value: float) -> None:
    study = new_study(feature_function=compute, off_grid=40)
    for row in range(18 if value == 0.5 else 5):  # all rows, or some
        study.enqueue_trial(table().rows.as_parameters(row))
    study.optimize(both, n_trials=18 if value == 0.5 else 5)
    study.enqueue_trial({"a": value})
    study.optimize(both, n_trials=1)
    last = study.trials[-1]
    assert last.params["a"] == value
    assert last.user_attrs["row"] == -1 or last.params["b"] == 0.0  # that is row 6 again
    own = compute(np.array([[value, last.params["b"]]]))[0]
    assert last.user_attrs["features"] == pytest.approx(own)


@pytest.mark.parametrize("space", [None, table().rows.space.as_dict()])
def test_without_a_table_the_features_are_those_of_the_point_that_was_run(space: Any) -> None:
    study = new_study(compute, space=space)
    study.optimize(both, n_trials=4)
    study.enqueue_trial({"b": 1.25})
    study.optimize(both, n_trials=1)
    last = study.trials[-1]
    assert last.params["b"] == 1.25
    own = compute(np.array([[last.params["a"], 1.25]]))[0]
    assert last.user_attrs["features"] == pytest.approx(own)


def test_a_space_keeps_a_fixed_value_without_features() -> None:
    study = optuna.create_study(sampler=FeatureKernelSampler(seed=1))
    study.optimize(both, n_trials=5)
    study.enqueue_trial({"a": 0.75})
    study.optimize(both, n_trials=1)
    assert study.trials[-1].params["a"] == 0.75


def test_features_of_a_point_that_was_not_run_are_taken_back() -> None:
    """The range shrinks in one trial: one parameter is drawn independently."""
    space = table().rows.space.as_dict()
    study = new_study(compute, space=space, strict=False)
    study.optimize(both, n_trials=4)
    with pytest.warns(UserWarning, match="b: .* the independent sampler takes over"):
        study.optimize(
            lambda trial: trial.suggest_float("a", 0, 1) + trial.suggest_float("b", 4.99, 5),
            n_trials=1,
        )
    assert study.trials[-1].user_attrs["features"] is None
    study.optimize(both, n_trials=2)


def test_an_enqueued_row_is_noted_from_its_start() -> None:
    study = new_study()
    study.enqueue_trial(table().rows.as_parameters(7))
    study.enqueue_trial(table().rows.as_parameters(9) | {"other": 3})
    trial = study.ask()
    assert study.trials[0].user_attrs == {"row": 7, "features": [1.5, -0.5]}
    study.tell(trial, both(trial))
    study.optimize(lambda trial: both(trial) + trial.suggest_int("other", 1, 5), n_trials=1)
    study.optimize(both, n_trials=6)
    assert [trial.user_attrs["row"] for trial in study.trials[:2]] == [7, 9]
    assert_rows_were_run(study)


def test_an_enqueued_row_of_one_feature_has_its_score() -> None:
    one = FeatureTable.from_arrays({"a": A, "b": B}, A + B)
    study = new_study(one)
    study.enqueue_trial(one.rows.as_parameters(7))
    study.optimize(both, n_trials=1)
    assert study.trials[0].user_attrs == {"row": 7, "score": 1.5}


@pytest.mark.filterwarnings("ignore:FeatureTable")
def test_what_is_not_known_of_an_enqueued_row_is_none() -> None:
    gap = FeatureTable.from_arrays({"a": A, "b": B}, np.where(FEATURES == 1.5, np.nan, FEATURES))
    study = new_study(gap)
    study.enqueue_trial(gap.rows.as_parameters(7))
    study.optimize(both, n_trials=5)
    assert study.trials[0].user_attrs == {"row": 7, "features": [None, -0.5]}


def test_a_point_off_the_table_has_no_row() -> None:
    study = new_study()
    study.enqueue_trial({"a": 0.25, "b": 0.25})
    study.optimize(both, n_trials=1)
    assert study.trials[0].user_attrs == {}


def test_a_row_that_waits_is_not_proposed_to_another_worker() -> None:
    study = new_study()
    study.enqueue_trial({"a": 0.0, "b": 0.0})  # waits until the end
    for _ in range(17):
        waiting = study.trials[0]
        number = study._storage.create_new_trial(study._study_id)
        trial = study._storage.get_trial(number)
        values = study.sampler.sample_independent(
            study, trial, "a", table().rows.space.as_dict()["a"]
        )
        assert waiting.state is TrialState.WAITING
        assert isinstance(values, float)
    rows = [trial.user_attrs["row"] for trial in study.trials[1:]]
    assert sorted(rows) == list(range(1, 18))


def test_a_row_enqueued_by_another_process_is_taken(tmp_path: Path) -> None:
    def opened() -> optuna.Study:
        storage = JournalStorage(JournalFileBackend(str(tmp_path / "journal.log")))
        sampler = FeatureKernelSampler(table(), seed=1)
        return optuna.create_study(
            study_name="s", storage=storage, sampler=sampler, load_if_exists=True
        )

    first, second = opened(), opened()
    first.enqueue_trial({"a": 0.5, "b": 1.0})
    first.ask()
    asked = [second.ask(table().rows.space.as_dict()) for _ in range(17)]
    rows = {second.trials[trial.number].user_attrs["row"] for trial in asked}
    assert rows == set(range(18)) - {7}


def test_resumed_is_uninterrupted_with_enqueued_trials() -> None:
    def enqueue(study: optuna.Study) -> None:
        study.enqueue_trial(table().rows.as_parameters(4))
        study.enqueue_trial({"a": 0.5})
        study.enqueue_trial({"b": 2.0})

    whole = new_study()
    enqueue(whole)
    whole.optimize(both, n_trials=9)
    pieces = optuna.create_study()
    enqueue(pieces)
    for _ in range(9):
        pieces.sampler = FeatureKernelSampler(table(), seed=1)
        pieces.optimize(both, n_trials=1)
    told = [(trial.params, trial.user_attrs) for trial in whole.trials]
    assert told == [(trial.params, trial.user_attrs) for trial in pieces.trials]
    assert_rows_were_run(whole)


def test_a_killed_trial_that_was_partly_enqueued_is_run_again() -> None:
    study = new_study()
    study.enqueue_trial({"a": 0.5})
    trial = study.ask()
    both(trial)
    kill(study, 0)
    study.optimize(both, n_trials=1)
    assert study.trials[1].params == study.trials[0].params
    assert_rows_were_run(study)


def test_a_row_noted_by_an_earlier_version_counts_only_if_it_was_run() -> None:
    """Two trials that say row 3 and did something else: they teach nothing, and row 3 is free."""
    study = new_study()
    content = table().rows
    for params in ({"a": 0.25, "b": 3.0}, {"a": 0.0}):
        study.add_trial(
            optuna.create_trial(
                params=params,
                distributions={name: content.space.as_dict()[name] for name in params},
                value=1.0,
                user_attrs={"row": 3, "features": FEATURES[3].tolist()},
            )
        )
    assert [row_of(content, trial) for trial in study.trials] == [None, None]
    history = read_history(study, study.trials[0], content.space, content)
    assert not history.tried.any()
    with pytest.warns(UserWarning, match="no row of the table are ignored"):
        study.optimize(both, n_trials=18)
    assert 3 in [trial.user_attrs["row"] for trial in study.trials[2:]]
    assert len(features_learned_before_the_end(study)) == 17


def features_learned_before_the_end(study: optuna.Study) -> list[FrozenTrial]:
    content = table().rows
    return [t for t in study.trials[:-1] if row_of(content, t) is not None]


def test_a_value_that_was_not_left_to_the_sampler_takes_the_note_back() -> None:
    """A range of one value: Optuna asks no sampler."""

    def pinned(value: float) -> Callable[[optuna.Trial], float]:
        return lambda trial: trial.suggest_float("b", 0, 5) + trial.suggest_float("a", value, value)

    study = new_study()
    with pytest.raises(InputError, match=r"a: .*low=0.25.* a range that holds all rows"):
        study.optimize(pinned(0.25), n_trials=1)
    assert study.trials[0].user_attrs == {"row": -1, "features": None}
    study = new_study(strict=False)
    run_quietly(study, 3, pinned(0.5))
    assert {trial.params["a"] for trial in study.trials} == {0.5}
    assert_rows_were_run(study)


def test_a_range_of_one_value_that_comes_first_is_as_if_it_were_fixed() -> None:
    study = new_study()
    study.optimize(
        lambda trial: trial.suggest_float("a", 0.5, 0.5) + trial.suggest_float("b", 0, 5),
        n_trials=6,
    )
    assert sorted(trial.user_attrs["row"] for trial in study.trials) == list(range(6, 12))
    with pytest.raises(InputError, match=r"a: 0.5 .* a row that has not been tried"):
        study.optimize(
            lambda trial: trial.suggest_float("a", 0.5, 0.5) + trial.suggest_float("b", 0, 5),
            n_trials=1,
        )


def test_a_row_of_another_table_that_came_with_an_enqueued_trial_is_put_right() -> None:
    study = new_study()
    study.enqueue_trial({"a": 0.5, "b": 3.0}, user_attrs={"row": 2, "mood": "good"})
    study.enqueue_trial({"a": 0.25, "b": 3.0}, user_attrs={"row": 2})
    study.ask()
    assert study.trials[0].user_attrs == {"row": 9, "features": [3.5, -2.5], "mood": "good"}
    study.optimize(both, n_trials=1)
    assert study.trials[1].user_attrs["row"] == -1


def test_features_of_a_refused_point_near_the_table_are_taken_back() -> None:
    one = FeatureTable.from_arrays({"a": A, "b": B}, A + B)
    options = {"feature_function": lambda params: params.sum(axis=1), "off_grid": 50}
    study = new_study(one, strict=False, **options)
    for row in range(18):
        study.enqueue_trial(one.rows.as_parameters(row))
    study.optimize(both, n_trials=18)
    with pytest.warns(UserWarning, match="a: .* a range that holds all rows"):
        study.optimize(
            lambda trial: trial.suggest_float("b", 0, 5) + trial.suggest_float("a", 2, 3),
            n_trials=1,
        )
    assert study.trials[-1].user_attrs == {"row": -1, "score": None, "features": None}


def test_a_trial_that_is_refused_keeps_no_row() -> None:
    study = new_study()
    with pytest.raises(InputError):
        study.optimize(lambda trial: trial.suggest_float("a", 0, 1e-9), n_trials=1)
    study.optimize(both, n_trials=18)
    assert {trial.user_attrs["row"] for trial in study.trials[1:]} == set(range(18))


@pytest.mark.filterwarnings("ignore:PartialFixedSampler is experimental")
def test_a_fixed_parameter_where_the_table_need_not_fit_is_no_row() -> None:
    sampler = FeatureKernelSampler(table(), seed=1, strict=False)
    study = optuna.create_study(sampler=PartialFixedSampler({"a": 0.25}, sampler))
    run_quietly(study, 5)
    assert {trial.params["a"] for trial in study.trials} == {0.25}
    assert_rows_were_run(study)
