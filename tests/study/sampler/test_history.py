"""What trials say to the sampler, and how killed ones are counted."""

import math
import warnings

import numpy as np
import optuna
import pytest
from optuna.exceptions import ExperimentalWarning
from optuna.storages import RetryHeartbeatStaleTrialCallback
from optuna.trial import TrialState

from study import FeatureTable
from study.draws import Purpose, generator, turn
from study.sampler.history import read_history
from study.sampler.random_sampler import ReproducibleRandomSampler
from study.sampler.transforms import clip_infinities


def kill(study: optuna.Study, number: int) -> None:
    """Fail a running trial and queue its repetition, as Optuna's heartbeat does."""
    trial = study.trials[number]
    study.tell(number, state=TrialState.FAIL)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExperimentalWarning)
        RetryHeartbeatStaleTrialCallback()(study, trial)


def test_turns_are_counted_as_if_nothing_had_been_killed() -> None:
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


def test_random_search_repeats_what_was_killed() -> None:
    def parameters(killed: set[int]) -> list[dict[str, float]]:
        study = optuna.create_study(sampler=ReproducibleRandomSampler(seed=4))
        while len(study.get_trials(states=(TrialState.COMPLETE,))) < 4:
            trial = study.ask()
            trial.suggest_float("x", 0, 1)
            if trial.number in killed:  # half its parameters suggested
                kill(study, trial.number)
                continue
            study.tell(trial, trial.suggest_float("y", 0, 1))
        return [t.params for t in study.get_trials(states=(TrialState.COMPLETE,))]

    undisturbed = parameters(set())
    assert parameters({1, 2, 4}) == undisturbed
    assert len({params["x"] for params in undisturbed}) == 4
    assert all(params["x"] != params["y"] for params in undisturbed)


def test_history_takes_finished_trials_and_counts_all_rows(table: FeatureTable) -> None:
    study = optuna.create_study(direction="maximize")
    for row, state in enumerate((TrialState.COMPLETE, TrialState.FAIL, TrialState.PRUNED)):
        study.enqueue_trial(table.rows.as_parameters(row))
        trial = study.ask()
        trial.suggest_float("a", -1, 1), trial.suggest_float("b", 0, 5)
        study.tell(trial, 2.5 if state is TrialState.COMPLETE else None, state=state)
    number = study.ask().number
    history = read_history(study, study.trials[number], table.rows.space, table.rows)
    assert np.flatnonzero(history.tried).tolist() == [0, 1, 2]
    assert history.rows.tolist() == [0]
    assert history.cost.tolist() == [-2.5]
    assert history.unplaced == ()


def test_infinities_become_the_extremes() -> None:
    values = np.array([math.inf, 1.0, -math.inf, 3.0])
    assert clip_infinities(values).tolist() == [3.0, 1.0, 1.0, 3.0]
    assert clip_infinities(np.array([math.inf, -math.inf])).tolist() == [0.0, 0.0]


@pytest.mark.parametrize("purpose", [Purpose.BODY, Purpose.TIE_BREAK])
def test_draws_depend_on_purpose_and_key_alone(purpose: Purpose) -> None:
    first = generator(1, purpose, 5).random()
    assert generator(1, purpose, 5).random() == first
    others = [generator(1, purpose, 6), generator(2, purpose, 5), generator(1, Purpose.TERRAIN, 5)]
    assert all(other.random() != first for other in others)
