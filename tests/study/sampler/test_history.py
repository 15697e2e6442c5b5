"""Turns, rows and draws of trials, and parameters that a study suggests in its own way."""

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import optuna
import pytest
from optuna.distributions import FloatDistribution, IntDistribution
from optuna.trial import TrialState

from storage.inputs.errors import InputError
from study import FeatureKernelSampler, FeatureTable
from study.sampler import history
from study.sampler.draws import Purpose, ReproducibleRandomSampler, generator, turn
from study.sampler.history import OFF_TABLE, next_trial, read_history, row_of
from tests.study.sampler.studies import (
    kill,
    params_of,
    resumed,
    rows_of,
    study_of,
    without_warning,
)


def test_turns_are_counted_as_if_nothing_had_been_killed():
    study = optuna.create_study()
    turns = []
    for killed in (False, True, True, False, False, True, False, False):
        trial = study.ask()
        turns.append(turn(study, study.trials[trial.number]))
        if killed:
            kill(study, trial.number)
        else:
            study.tell(trial, 0.0)
    assert turns == [0, 1, 1, 1, 2, 3, 3, 4]


def test_random_search_repeats_what_was_killed():
    def parameters(killed):
        study = optuna.create_study(sampler=ReproducibleRandomSampler(seed=4))
        while len(params_of(study)) < 4:
            trial = study.ask()
            trial.suggest_float("x", 0, 1)
            if trial.number in killed:  # half its parameters suggested
                kill(study, trial.number)
            else:
                study.tell(trial, trial.suggest_float("y", 0, 1))
        return params_of(study)

    undisturbed = parameters(set())
    assert parameters({1, 2, 4}) == undisturbed
    assert len({params["x"] for params in undisturbed}) == 4
    assert all(params["x"] != params["y"] for params in undisturbed)
    key = 1, Purpose.TIE_BREAK, 5  # on which alone draws depend
    keys = [key, (1, Purpose.TIE_BREAK, 6), (2, *key[1:]), (1, Purpose.TERRAIN, 5), key]
    *draws, again = [generator(*each).random() for each in keys]
    assert again == draws[0] and len(set(draws)) == 4


def test_history_takes_finished_trials_and_counts_all_rows(table):
    study = optuna.create_study(direction="maximize")
    for row, state in enumerate(
        (TrialState.COMPLETE, TrialState.FAIL, TrialState.PRUNED)
    ):
        study.enqueue_trial(table.rows.as_parameters(row))
        trial = study.ask()
        trial.suggest_float("a", -1, 1), trial.suggest_float("b", 0, 5)
        study.tell(trial, 2.5 if state is TrialState.COMPLETE else None, state=state)
    number = study.ask().number
    history = read_history(study, study.trials[number], table.rows.space, table.rows)
    assert np.flatnonzero(history.tried).tolist() == [0, 1, 2]
    assert history.done.rows.tolist() == [0]
    assert history.cost.tolist() == [-2.5]
    assert history.unplaced == ()


def test_a_finished_trial_is_looked_up_once_and_another_of_its_number_anew(
    table, monkeypatch
):
    rows, looked_up, known = table.rows, [], {}

    def counted(*given):
        looked_up.append(given)
        return row_of(*given)

    monkeypatch.setattr(history, "row_of", counted)
    one, other = optuna.create_study(), optuna.create_study(storage="sqlite://")
    foreign = {"a": 0.123, "b": 2.0}
    space = rows.space.as_dict()
    for study, order in ((one, 1), (other, -1)):
        for params in [rows.as_parameters(3), foreign][::order]:
            study.add_trial(
                optuna.create_trial(params=params, distributions=space, value=1.0)
            )
    for study, counts in ((one, [2, 2]), (other, [4, 4]), (one, [6, 6])):
        for count in counts:
            before = next_trial(study)
            found = read_history(
                study, before, rows.space, rows, lambda *_: OFF_TABLE, known
            )
            assert sorted(found.done.rows.tolist()) == [-1, 3]
            assert (
                np.flatnonzero(found.tried).tolist() == [3] and len(looked_up) == count
            )


# A table's parameters, suggested otherwise: it works where the values fit.
RATE = np.geomspace(1e-4, 1.0, 12)
COLUMNS = {
    "rate": RATE,
    "units": np.tile([16, 32, 64, 128], 3),
    "kind": np.array(["relu", "tanh", "gelu"] * 4),
    "depth": np.array([2.0, 4.0, 8.0] * 4),
}


def new_table(**options: Any) -> FeatureTable:
    features = np.column_stack([np.log(RATE), COLUMNS["units"]])
    return FeatureTable.from_arrays(COLUMNS, features, **options)


TABLE = new_table()
Suggest = Callable[[optuna.Trial], Any]
AS_THE_TABLE: dict[str, Suggest] = {
    "rate": lambda trial: trial.suggest_float("rate", 1e-5, 1),
    "units": lambda trial: trial.suggest_int("units", 1, 500),
    "kind": lambda trial: trial.suggest_categorical("kind", ["relu", "tanh", "gelu"]),
    "depth": lambda trial: trial.suggest_float("depth", 1, 10),
}
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
    "integers as floats": (
        "units",
        lambda trial: trial.suggest_float("units", 16, 128),
    ),
    "floats as integers": ("depth", lambda trial: trial.suggest_int("depth", 1, 8)),
    "floats as choices": (
        "depth",
        lambda trial: trial.suggest_categorical("depth", [8, 4, 2]),
    ),
    "another order of choices": (
        "kind",
        lambda trial: trial.suggest_categorical("kind", ["gelu", "relu", "tanh"]),
    ),
    "more choices": (
        "kind",
        lambda trial: trial.suggest_categorical(
            "kind", ["elu", "gelu", "relu", "tanh", None]
        ),
    ),
    "a step": ("depth", lambda trial: trial.suggest_float("depth", 0, 8, step=0.5)),
}


def objective(name: str, suggest: Suggest) -> Callable[[optuna.Trial], float]:
    """With one parameter suggested first, and otherwise than the table has it."""

    def cost(trial: optuna.Trial) -> float:
        suggest(trial)
        others = (ask for other, ask in AS_THE_TABLE.items() if other != name)
        return float(len(str([ask(trial) for ask in others])))

    return cost


@pytest.mark.parametrize("strict", [True, False])
@pytest.mark.parametrize("how", OTHERWISE)
def test_what_holds_the_rows_works_also_where_it_is_resumed(how, strict):
    name, suggest = OTHERWISE[how]
    study = study_of(TABLE, strict=strict)
    without_warning(study, objective(name, suggest), 12)
    assert sorted(rows_of(study)) == list(range(12))
    for trial, row in zip(study.trials, rows_of(study), strict=True):
        assert trial.params == TABLE.rows.as_parameters(row)
        distribution = trial.distributions[name]
        expected = {IntDistribution: int, FloatDistribution: float}.get(
            type(distribution)
        )
        assert expected is None or type(trial.params[name]) is expected
    new_sampler = lambda: FeatureKernelSampler(TABLE, seed=1, strict=strict)  # noqa: E731
    pieces = resumed(new_sampler, objective(name, suggest), 8, optuna.create_study())
    assert params_of(pieces) == params_of(study)[:8]


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
def test_what_does_not_hold_them_is_one_line_before_the_objective_or_one_warning(how):
    name, suggest, message = MISFITS[how]
    done: list[float] = []
    cost = objective(name, suggest)
    with pytest.raises(InputError, match=message):
        study_of(TABLE, lambda trial: done.append(cost(trial)) or 0.0, 1)
    assert not done
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        study = study_of(TABLE, cost, 6, strict=False)
    assert sum("independent sampler takes over" in str(w.message) for w in said) == 1
    assert all(trial.state is TrialState.COMPLETE for trial in study.trials)
    assert all(row in (None, -1) for row in rows_of(study))


@pytest.mark.parametrize(
    ("how", "distribution"),
    [
        ("a float on a logarithmic scale", FloatDistribution(1e-4, 1, log=True)),
        ("an integer on a logarithmic scale", IntDistribution(16, 128, log=True)),
    ],
)
def test_a_logarithmic_scale_is_the_kernels_too(how, distribution):
    """As if the table had been given it."""
    name, suggest = OTHERWISE[how]
    tables, options = (
        (TABLE, new_table(space={name: distribution})),
        {"kernel": "euclidean"},
    )
    cost = objective(name, suggest)
    found, expected = (study_of(table, cost, 8, seed=2, **options) for table in tables)
    assert params_of(found) == params_of(expected)
    plain = study_of(
        TABLE, objective(name, AS_THE_TABLE[name]), 8, kernel="euclidean", seed=2
    )
    assert params_of(plain) != params_of(found)


def test_points_near_the_table_are_on_the_logarithmic_scale_and_within_the_range():
    rate = np.geomspace(1e-4, 1.0, 30)
    table = FeatureTable.from_arrays({"rate": rate}, np.log(rate))

    def cost(trial):
        return abs(np.log(trial.suggest_float("rate", 1e-4, 1, log=True)) + 3.3)

    study = study_of(table, cost, 15, feature_function=np.log, off_grid=50)
    assert -1 in rows_of(study)
    assert study.best_value < 0.1


def test_trials_off_the_table_are_learned_from_whatever_they_are_suggested_as():
    own = {"rate": 0.002, "units": 64, "kind": "relu", "depth": 2.0}
    study = study_of(
        TABLE, enqueued=[own], feature_function=lambda params: params[:, :2]
    )
    without_warning(study, objective(*OTHERWISE["integers as choices"]), 5)
    assert study.trials[0].params["rate"] == 0.002
    first, *others = rows_of(study)
    assert first is None and None not in others
