"""Turns, rows and draws of trials, and parameters that a study suggests in its own way."""

import warnings

import numpy as np
import optuna
import pytest
from optuna.distributions import (
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
)
from optuna.trial import TrialState

from study import FeatureKernelSampler, FeatureTable
from study.sampler import history
from study.sampler.draws import Purpose, ReproducibleRandomSampler, generator, turn
from study.sampler.history import OFF_TABLE, next_trial, read_history, row_of
from tests.study.conftest import refused
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


def new_table(**options):
    features = np.column_stack([np.log(RATE), COLUMNS["units"]])
    return FeatureTable.from_arrays(COLUMNS, features, **options)


TABLE = new_table()
AS_THE_TABLE = {
    "rate": FloatDistribution(1e-5, 1),
    "units": IntDistribution(1, 500),
    "kind": CategoricalDistribution(["relu", "tanh", "gelu"]),
    "depth": FloatDistribution(1, 10),
}
OTHERWISE = {
    "a float on a logarithmic scale": ("rate", FloatDistribution(1e-5, 1, log=True)),
    "an integer on a logarithmic scale": ("units", IntDistribution(1, 512, log=True)),
    "integers as choices": ("units", CategoricalDistribution([8, 16, 32, 64, 128])),
    "integers as floats": ("units", FloatDistribution(16, 128)),
    "floats as integers": ("depth", IntDistribution(1, 8)),
    "floats as choices": ("depth", CategoricalDistribution([8, 4, 2])),
    "another order": ("kind", CategoricalDistribution(["gelu", "relu", "tanh"])),
    "more choices": ("kind", CategoricalDistribution(["gelu", "relu", "tanh", None])),
    "a step": ("depth", FloatDistribution(0, 8, step=0.5)),
}


def objective(name, distribution):
    """With one parameter suggested first, and otherwise than the table has it."""

    def cost(trial):
        trial._suggest(name, distribution)
        for other, own in AS_THE_TABLE.items():
            trial._suggest(other, distribution if other == name else own)
        others = [value for other, value in trial.params.items() if other != name]
        return float(len(str(others)))

    return cost


@pytest.mark.parametrize("strict", [True, False])
@pytest.mark.parametrize("how", OTHERWISE)
def test_what_holds_the_rows_works_also_where_it_is_resumed(how, strict):
    name, distribution = OTHERWISE[how]
    cost = objective(name, distribution)
    study = study_of(TABLE, strict=strict)
    without_warning(study, cost, 12)
    assert sorted(rows_of(study)) == list(range(12))
    for trial, row in zip(study.trials, rows_of(study), strict=True):
        assert trial.params == TABLE.rows.as_parameters(row)
        if isinstance(distribution, IntDistribution | FloatDistribution):
            is_whole = isinstance(distribution, IntDistribution)
            assert type(trial.params[name]) is (int if is_whole else float)

    def new_sampler():
        return FeatureKernelSampler(TABLE, seed=1, strict=strict)

    pieces = resumed(new_sampler, cost, 8, optuna.create_study())
    assert params_of(pieces) == params_of(study)[:8]


RANGE, CHOICES = "a range that holds all rows: row", "choices that hold all rows: row"


@pytest.mark.parametrize(
    ("name", "distribution", "message"),
    [
        ("rate", FloatDistribution(0.01, 1, log=True), f".*True.*{RANGE} 0 has 0.0001"),
        ("rate", IntDistribution(0, 1), f"'IntDistr.*{RANGE} 0 has 0.0001 .*space="),
        ("rate", FloatDistribution(0, 0.5), f".*{RANGE} 11 has 1.0"),
        (
            "kind",
            CategoricalDistribution(["gelu", "relu"]),
            f".*{CHOICES} 1 has 'tanh'",
        ),
        ("units", CategoricalDistribution([16, 32, 64]), f".* {CHOICES} 3 has 128 "),
        ("kind", IntDistribution(0, 2), ".* row 0 has 'relu' .*space="),
        ("depth", FloatDistribution(0, 9, step=3), ".* row 0 has 2.0 .*space="),
    ],
)
def test_what_does_not_hold_them_is_one_line_before_the_objective_or_one_warning(
    name, distribution, message
):
    cost, done = objective(name, distribution), []
    with refused(f"^{name}: {message}"):
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
    name, suggested = OTHERWISE[how]
    cost, plain = objective(name, suggested), objective(name, AS_THE_TABLE[name])

    def proposed(table, objective):
        return params_of(study_of(table, objective, 8, seed=2, kernel="euclidean"))

    found = proposed(TABLE, cost)
    assert found == proposed(new_table(space={name: distribution}), cost)
    assert found != proposed(TABLE, plain)


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
