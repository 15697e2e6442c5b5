"""Trials that a user fixes or adds: no row is noted, or learned, that was not run."""

import warnings

import numpy as np
import optuna
import pytest
from optuna.samplers import PartialFixedSampler
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from optuna.trial import TrialState

from storage.inputs.errors import InputError
from study import FeatureKernelSampler, FeatureTable
from study.sampler.history import read_history, row_of
from tests.study.conftest import refused
from tests.study.sampler.studies import (
    kill,
    model_of,
    only_a,
    resumed,
    rows_of,
    study_of,
    summed,
)

A = np.repeat([0.0, 0.5, 1.0], 6)
B = np.tile(np.arange(6.0), 3)
FEATURES = np.column_stack([A + B, A - B])
TABLE = FeatureTable.from_arrays({"a": A, "b": B}, FEATURES)  # 18 rows on a grid
ONE = FeatureTable.from_arrays({"a": A, "b": B}, A + B)  # with one feature
ROWS = TABLE.rows
SPACE = ROWS.space.as_dict()


def row(number):
    return ROWS.as_parameters(number)


def compute(params):
    return np.column_stack([params[:, 0] + params[:, 1], params[:, 0] - params[:, 1]])


both = summed(a=(0, 1), b=(0, 5))


def run_quietly(study, trials, objective=both):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        study.optimize(objective, n_trials=trials)


def assert_rows_were_run(study):
    """What is noted in each trial is true of it."""
    for trial in study.trials:
        number = trial.user_attrs.get("row", -1)
        if number >= 0:
            assert trial.params | row(number) == trial.params
            assert trial.user_attrs["features"] == ROWS.features[number].tolist()
        else:
            assert ROWS.find(trial.params) is None


# Trials that are enqueued in part.
@pytest.mark.parametrize("finished", [0, 6])
def test_a_partly_enqueued_trial_is_a_row_that_has_the_fixed_values_the_best_one(
    finished,
):
    study = study_of(TABLE, both, finished)
    for _ in range(3):
        study.enqueue_trial({"a": 1.0})
    study.optimize(both, n_trials=5)
    assert [trial.params["a"] for trial in study.trials[finished : finished + 3]] == [
        1.0
    ] * 3
    assert len(set(rows_of(study))) == finished + 5
    assert_rows_were_run(study)
    enqueued = [*map(row, (0, 1, 3, 6, 8, 11)), {"a": 1.0}]
    study = study_of(TABLE, lambda trial: 10.0 * both(trial), 7, enqueued=enqueued)
    assert study.trials[-1].params == {"a": 1.0, "b": 0.0}


def test_where_no_row_has_the_fixed_values_it_is_an_error_before_the_objective():
    study = study_of(TABLE, enqueued=[{"a": 0.3}])
    done = []
    with refused(r"^a: 0.3 cannot be used; allowed: .* row .* 0.5; or"):
        study.optimize(lambda trial: done.append(both(trial)) or 0.0, n_trials=1)
    assert not done
    assert "row" not in study.trials[0].user_attrs
    study.optimize(both, n_trials=2)
    assert_rows_were_run(study)


def test_no_row_has_all_of_them():
    columns = {"a": [0.0, 1.0], "b": [0.0, 5.0], "c": [1.0, 2.0]}
    study = study_of(
        FeatureTable.from_arrays(columns, [1, 2]), enqueued=[{"a": 0.0, "b": 5.0}]
    )
    with refused(r"^a, b: \(0.0, 5.0\) cannot be used"):
        study.optimize(summed(a=(0, 1), b=(0, 5), c=(0, 5)), n_trials=1)


def learned(study):
    """Features of the trials that the next one is learned from, in standard units [n, 2]."""
    return model_of(study).trials.features


def test_where_the_table_need_not_fit_the_rest_is_drawn_and_not_learned():
    study = study_of(TABLE, both, 4, strict=False)
    study.enqueue_trial({"a": 0.25})
    message = r"a: 0.25 .* independent sampler takes over"
    with pytest.warns(UserWarning, match=message) as said:
        study.optimize(both, n_trials=1)
    assert len(said) == 1
    assert study.trials[-1].params["a"] == 0.25
    assert study.trials[-1].user_attrs == {}
    run_quietly(study, 3)
    assert_rows_were_run(study)
    assert len(learned(study)) == 7


def test_a_function_lets_a_point_off_the_table_be_learned():
    study = study_of(TABLE, enqueued=[{"a": 0.25}], feature_function=compute)
    with pytest.warns(UserWarning, match="a: 0.25"):
        study.optimize(both, n_trials=1)
    study.optimize(both, n_trials=3)
    own = compute(np.array([list(study.trials[0].params.values())]))
    assert learned(study)[0] == pytest.approx(ROWS.scores.standard(own)[0])


@pytest.mark.filterwarnings("ignore:PartialFixedSampler is experimental")
def test_a_fixed_parameter_is_drawn_around_where_the_table_need_not_fit():
    sampler = FeatureKernelSampler(TABLE, seed=1, strict=False)
    study = optuna.create_study(sampler=PartialFixedSampler({"a": 0.25}, sampler))
    run_quietly(study, 5)
    assert {trial.params["a"] for trial in study.trials} == {0.25}
    assert_rows_were_run(study)


# Some rows are tried, or all.
@pytest.mark.parametrize(("value", "tried"), [(0.25, 5), (0.5, 18)])
def test_points_near_the_table_keep_the_fixed_value(value, tried):
    enqueued = [*map(row, range(tried)), {"a": value}]
    options = {"feature_function": compute, "off_grid": 40}
    last = study_of(TABLE, both, tried + 1, enqueued=enqueued, **options).trials[-1]
    assert last.params["a"] == value
    # A point of the table is row 6 again.
    assert last.user_attrs["row"] == -1 or last.params["b"] == 0.0
    own = compute(np.array([[value, last.params["b"]]]))[0]
    assert last.user_attrs["features"] == pytest.approx(own)


@pytest.mark.parametrize("space", [None, SPACE])
@pytest.mark.parametrize("function", [None, compute])
def test_without_a_table_a_fixed_value_stays(space, function):
    study = study_of(function, both, 4, space=space)
    study.enqueue_trial({"b": 1.25})
    study.optimize(both, n_trials=1)
    last = study.trials[-1]
    assert last.params["b"] == 1.25
    if function is not None:
        own = compute(np.array([[last.params["a"], 1.25]]))[0]
        assert last.user_attrs["features"] == pytest.approx(own)


# Trials that are enqueued whole.
@pytest.mark.filterwarnings("ignore:FeatureTable")
def test_an_enqueued_row_is_noted_from_its_start():
    study = study_of(TABLE, enqueued=[row(7), row(9) | {"other": 3}])
    trial = study.ask()
    assert study.trials[0].user_attrs == {"row": 7, "features": [1.5, -0.5]}
    study.tell(trial, both(trial))
    study.optimize(
        lambda trial: both(trial) + trial.suggest_int("other", 1, 5), n_trials=1
    )
    study.optimize(both, n_trials=6)
    assert rows_of(study)[:2] == [7, 9]
    assert_rows_were_run(study)
    known = np.where(FEATURES == 1.5, np.nan, FEATURES)
    gap = FeatureTable.from_arrays({"a": A, "b": B}, known)
    for table, noted in ((ONE, {"score": 1.5}), (gap, {"features": [None, -0.5]})):
        study = study_of(table, both, 5, enqueued=[row(7)])
        assert study.trials[0].user_attrs == {"row": 7} | noted


@pytest.mark.parametrize("storage", [None, "sqlite://"])
def test_the_objective_sees_its_row(storage):
    seen = []

    def objective(trial):
        value = both(trial)
        seen.append(trial.user_attrs["row"])
        assert row(seen[-1]) == trial.params
        return value

    sampler = FeatureKernelSampler(TABLE, seed=1)
    study = optuna.create_study(sampler=sampler, storage=storage)
    study.enqueue_trial(row(7))
    study.optimize(objective, n_trials=5)
    assert seen == rows_of(study) and seen[0] == 7


def test_a_row_that_waits_is_not_proposed_to_another_worker():
    study = study_of(TABLE, enqueued=[row(0)])  # waits until the end
    for _ in range(17):
        trial = study._storage.get_trial(
            study._storage.create_new_trial(study._study_id)
        )
        value = study.sampler.sample_independent(study, trial, "a", SPACE["a"])
        assert isinstance(value, float)
    assert study.trials[0].state is TrialState.WAITING
    assert sorted(rows_of(study)[1:]) == list(range(1, 18))


def test_a_row_enqueued_by_another_process_is_taken(tmp_path):
    def opened():
        storage = JournalStorage(JournalFileBackend(str(tmp_path / "journal.log")))
        named = {"study_name": "s", "storage": storage, "load_if_exists": True}
        return optuna.create_study(sampler=FeatureKernelSampler(TABLE, seed=1), **named)

    first, second = opened(), opened()
    first.enqueue_trial(row(7))
    first.ask()
    asked = [second.ask(SPACE) for _ in range(17)]
    rows = {second.trials[trial.number].user_attrs["row"] for trial in asked}
    assert rows == set(range(18)) - {7}


def test_resumed_is_uninterrupted_with_enqueued_trials_and_killed_ones_are_run_again():
    enqueued = (row(4), {"a": 0.5}, {"b": 2.0})
    whole = study_of(TABLE, both, 9, enqueued=enqueued)
    pieces = study_of(TABLE, enqueued=enqueued)
    resumed(lambda: FeatureKernelSampler(TABLE, seed=1), both, 9, pieces)
    for one, other in zip(whole.trials, pieces.trials, strict=True):
        assert (one.params, one.user_attrs) == (other.params, other.user_attrs)
    study = study_of(TABLE, enqueued=[{"a": 0.5}])
    both(study.ask())
    kill(study, 0)
    study.optimize(both, n_trials=1)
    assert study.trials[1].params == study.trials[0].params
    for made in (whole, study):
        assert_rows_were_run(made)


# Notes that are not true, and what was run in place of a proposal.
def test_a_row_noted_by_an_earlier_version_counts_only_if_it_was_run():
    """Two trials that say row 3 and did something else: they teach nothing, and row 3 is free.

    One warning names the first of them, and the ways out.
    """
    study = study_of(TABLE)
    noted = {"value": 1.0, "user_attrs": {"row": 3, "features": FEATURES[3].tolist()}}
    for params in ({"a": 0.25, "b": 3.0}, {"a": 0.0}):
        space = {name: SPACE[name] for name in params}
        done = optuna.create_trial(params=params, distributions=space, **noted)
        study.add_trial(done)
    assert [row_of(ROWS, trial) for trial in study.trials] == [None, None]
    assert not read_history(study, study.trials[0], ROWS.space, ROWS).tried.any()
    ignored = "^trials whose parameters are no row of the table are ignored: such as trial 0; "
    ways_out = "enqueue rows .* outcomes in worlds, or the sampler a feature_function$"
    with pytest.warns(UserWarning, match=ignored + ways_out) as said:
        study.optimize(both, n_trials=18)
    assert len(said) == 1
    assert sorted(rows_of(study)[2:]) == list(range(18))


def test_a_value_that_was_not_left_to_the_sampler_takes_the_note_back():
    """A range of one value: Optuna asks no sampler."""

    study = study_of(TABLE)
    with refused(r"a: .*low=0.25.* a range that holds all rows"):
        study.optimize(summed(b=(0, 5), a=(0.25, 0.25)), n_trials=1)
    assert study.trials[0].user_attrs == {"row": -1, "features": None, "why": None}
    study = study_of(TABLE, strict=False)
    run_quietly(study, 3, summed(b=(0, 5), a=(0.5, 0.5)))
    assert {trial.params["a"] for trial in study.trials} == {0.5}
    assert_rows_were_run(study)

    half = summed(a=(0.5, 0.5), b=(0, 5))  # first, as if it were fixed
    study = study_of(TABLE, half, 6)
    assert sorted(rows_of(study)) == list(range(6, 12))
    with refused(r"a: 0.5 .* a row that has not been tried"):
        study.optimize(half, n_trials=1)


def test_a_row_of_another_table_that_came_with_an_enqueued_trial_is_put_right():
    study = study_of(TABLE)
    study.enqueue_trial({"a": 0.5, "b": 3.0}, user_attrs={"row": 2, "mood": "good"})
    study.enqueue_trial({"a": 0.25, "b": 3.0}, user_attrs={"row": 2})
    study.ask()
    assert study.trials[0].user_attrs == {
        "row": 9,
        "features": [3.5, -2.5],
        "mood": "good",
    }
    study.optimize(both, n_trials=1)
    assert study.trials[1].user_attrs["row"] == -1


def test_features_of_a_point_that_was_not_run_are_taken_back():
    """The range shrinks in one trial: one parameter is drawn independently."""
    options = {"feature_function": lambda params: params.sum(axis=1), "off_grid": 50}
    study = study_of(
        ONE, both, 18, enqueued=map(row, range(18)), strict=False, **options
    )
    with pytest.warns(UserWarning, match="a: .* a range that holds all rows"):
        study.optimize(summed(b=(0, 5), a=(2, 3)), 1)
    assert study.trials[-1].user_attrs == {
        "row": -1,
        "score": None,
        "features": None,
        "why": None,
    }
    study = study_of(compute, both, 4, space=SPACE, strict=False)
    with pytest.warns(UserWarning, match="b: .* the independent sampler takes over"):
        study.optimize(summed(a=(0, 1), b=(4.99, 5)), 1)
    assert study.trials[-1].user_attrs["features"] is None
    study.optimize(both, n_trials=2)


# A parameter of the table that the study does not always suggest.
def b_at_times(trial):
    return both(trial) if trial.number else only_a(trial)


@pytest.mark.parametrize("objective", [only_a, b_at_times])
@pytest.mark.parametrize("enqueued", [[], [row(3)]])
def test_it_is_an_error_of_the_very_trial_or_one_warning_and_no_row(
    objective, enqueued
):
    study = study_of(ONE, enqueued=enqueued)
    with refused(r"b: 'not suggested in trial 0' .* all of a, b"):
        study.optimize(objective, n_trials=1)
    assert study.trials[0].state is TrialState.COMPLETE  # what it cost is not lost
    why = {} if enqueued else {"why": None}
    assert study.trials[0].user_attrs == {"row": -1, "score": None} | why
    run_quietly(study, 2)  # the objective was mended
    assert len(set(rows_of(study)[1:])) == 2
    with pytest.warns(UserWarning, match="b: 'not suggested in trial 0'") as said:
        study = study_of(ONE, only_a, 4, enqueued=enqueued, strict=False)
    assert len(said) == 1 and "independent sampler takes over" in str(said[0].message)
    assert all(number in (None, -1) for number in rows_of(study))


def test_asked_and_told_too_also_where_nothing_of_the_table_was_suggested():
    study = study_of(ONE, extra_parameters=["n"])
    trial = study.ask()
    value = only_a(trial)
    with refused("b: 'not suggested in trial 0'"):
        study.tell(trial, value)
    with refused("a: 'not suggested in trial 1'"):
        study.optimize(lambda trial: trial.suggest_int("n", 1, 9), n_trials=1)
    with refused("a: 'not suggested in trial 2'"):
        study.tell(study.ask(), 1.0)


@pytest.mark.parametrize("error", [optuna.TrialPruned, RuntimeError])
def test_a_trial_that_ends_early_says_nothing_and_one_that_is_refused_keeps_no_row(
    error,
):
    def ends(trial):
        only_a(trial)
        raise error

    study = study_of(ONE)
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        study.optimize(ends, n_trials=2, catch=RuntimeError)
    assert len(set(rows_of(study))) == 2
    study = study_of(TABLE)
    with pytest.raises(InputError):
        study.optimize(summed(a=(0, 1e-9)), n_trials=1)
    study.optimize(both, n_trials=18)
    assert set(rows_of(study)[1:]) == set(range(18))


def test_an_earlier_study_may_have_suggested_otherwise():
    """Another scale and narrower ranges: Optuna's own samplers fail on the first."""
    rate = np.geomspace(1e-3, 1, 30)
    given = FeatureTable.from_arrays({"rate": rate}, np.log(rate))
    before = study_of(given, summed(rate=(1e-3, 1)), 3, seed=2)
    before.enqueue_trial({"rate": float(rate[25])})
    before.optimize(summed(rate=(0.3, 0.5)), n_trials=1)
    study = study_of(given)
    study.add_trials(before.trials)
    study.optimize(
        lambda trial: trial.suggest_float("rate", 1e-3, 1, log=True), n_trials=5
    )
    assert len({trial.user_attrs["row"] for trial in study.trials}) == 9
    assert study.best_value == rate[0]
