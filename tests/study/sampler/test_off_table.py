"""Points off a table: what is proposed there is new, and within the risk that is allowed."""

from collections import Counter

import numpy as np
import optuna
import pytest
from optuna.distributions import FloatDistribution
from optuna.trial import TrialState

from study import FeatureKernelSampler, FeatureTable
from study.sampler.history import OFF_TABLE
from tests.study.conftest import refused
from tests.study.sampler.studies import rows_of, told

SIDE = np.arange(6)
X, Y = (column.ravel() for column in np.meshgrid(SIDE, SIDE))
AWAY = (X - 3.0) ** 2 + (Y - 2.0) ** 2  # of a row from (3, 2)
WORLDS = 1.0 + AWAY[:, None] * np.linspace(0.5, 1.5, 6)


def grid_table(**options):
    return FeatureTable.from_arrays({"x": X, "y": Y}, **options)


def steps_away(points):
    return ((points - [3.0, 2.0]) ** 2).sum(axis=1)[:, None]


def at_work(trial, state):
    """Costs least at (3, 2), where it ends in this state."""
    x, y = trial.suggest_int("x", 0, 5), trial.suggest_int("y", 0, 5)
    if (x, y) == (3, 2) and state is TrialState.FAIL:
        raise ValueError
    if (x, y) == (3, 2) and state is TrialState.PRUNED:
        raise optuna.TrialPruned
    return 1.0 + (x - 3) ** 2 + (y - 2) ** 2


SAMPLERS = {
    "worlds": lambda: FeatureKernelSampler(grid_table(outcomes=WORLDS), seed=1),
    "function": lambda: FeatureKernelSampler(
        grid_table(features=AWAY), feature_function=steps_away, off_grid=64, seed=1
    ),
    "plain": lambda: FeatureKernelSampler(seed=1),
}


@pytest.mark.parametrize("state", [TrialState.FAIL, TrialState.PRUNED])
@pytest.mark.parametrize("name", SAMPLERS)
def test_what_did_not_end_well_is_not_proposed_again(name, state):
    study = optuna.create_study(sampler=SAMPLERS[name]())
    study.optimize(lambda t: at_work(t, state), n_trials=16, catch=ValueError)
    tried = Counter(tuple(trial.params.values()) for trial in study.trials)
    assert max(tried.values()) == 1
    assert tried[3, 2] == 1  # it was worth a trial


def test_what_waits_in_the_queue_is_not_proposed_before_its_turn():
    sampler = FeatureKernelSampler(grid_table(outcomes=WORLDS), seed=1)
    study = optuna.create_study(sampler=sampler)
    space = sampler.infer_relative_search_space(study, None)
    for x, y in [(0, 0), (3, 3), (2, 2)]:
        told(study, space, {"x": x, "y": y}, 1.0 + (x - 3) ** 2 + (y - 2) ** 2)
    asked = study.ask()
    study.enqueue_trial({"x": 3, "y": 2})
    assert (asked.suggest_int("x", 0, 5), asked.suggest_int("y", 0, 5)) != (3, 2)


def test_a_row_that_is_not_offered_is_not_proposed_as_a_point_either():
    worlds = np.where(AWAY[:, None] == 0.0, np.nan, WORLDS)  # (3, 2) is not known
    table = grid_table(outcomes=worlds)
    study = optuna.create_study(sampler=FeatureKernelSampler(table, seed=1))
    study.optimize(lambda trial: at_work(trial, None), n_trials=14)
    assert {"x": 3, "y": 2} not in [trial.params for trial in study.trials]
    assert OFF_TABLE not in rows_of(study)  # all points of this space are rows


def test_a_step_that_is_another_by_rounding_is_the_same():
    """Optuna's steps end in 0.30000000000000004, a person writes 0.3."""
    steps = np.linspace(0.0, 1.0, 11).round(1)
    space = {"x": FloatDistribution(0.0, 1.0, step=0.1)}
    study = optuna.create_study(sampler=FeatureKernelSampler(seed=1, space=space))
    for x in steps[:9]:
        told(study, space, {"x": float(x)}, abs(float(x) - 0.3))
    left = {round(study.ask(space).params["x"], 6) for _ in range(2)}
    assert left == {0.9, 1.0}


def test_a_trial_that_is_plain_on_a_machine_like_no_world_repeats_no_other():
    rng = np.random.default_rng(0)
    steps = np.linspace(-1.0, 1.0, 21).round(1)
    a, b = (column.ravel() for column in np.meshgrid(steps, steps))
    # Walkers fall by chance: in every world on most rows.
    falls = rng.random((len(a), 8)) < 0.6
    costs = np.where(falls, 20.0, 1.0) + rng.random((len(a), 8))
    space = dict.fromkeys("ab", FloatDistribution(-1.0, 1.0, step=0.1))
    table = FeatureTable.from_arrays({"a": a, "b": b}, outcomes=costs, space=space)
    study = optuna.create_study(
        sampler=FeatureKernelSampler(table, seed=0, success=1.5)
    )

    def fails(trial):
        at = [trial.suggest_float(name, -1.0, 1.0, step=0.1) for name in "ab"]
        return 500.0 + (at[0] - 0.3) ** 2 + (at[1] - 0.1) ** 2

    study.optimize(fails, n_trials=32)
    tried = Counter(
        tuple(round(value, 6) for value in trial.params.values())
        for trial in study.trials
    )
    assert max(tried.values()) == 1


# What is allowed to be risked.
def striped(seed):
    """A machine and its worlds: in stripes along a the limit is broken."""
    rng = np.random.default_rng(seed)
    x = rng.random((4000, 2))
    best = rng.uniform(0.75, 0.95, (12, 2))
    costs = np.column_stack([1.0 + 3.0 * ((x - at) ** 2).sum(axis=1) for at in best])

    def stripe(a, shift=0.0):
        return np.sin(6.0 * np.pi * a + shift) - 0.2

    limit = np.column_stack([stripe(x[:, 0], at) for at in rng.normal(0.0, 0.1, 12)])
    table = FeatureTable.from_arrays(
        {"a": x[:, 0], "b": x[:, 1]},
        outcomes=costs,
        limits={"fall": limit},
        space=dict.fromkeys("ab", FloatDistribution(0.0, 1.0)),
    )

    def machine(trial):
        a, b = (trial.suggest_float(name, 0.0, 1.0) for name in "ab")
        trial.set_constraint("fall", float(stripe(a)))
        return 1.0 + 3.0 * ((a - 0.2) ** 2 + (b - 0.2) ** 2)

    return table, machine


@pytest.mark.parametrize("seed", [2, 3])
def test_no_point_is_proposed_that_the_sampler_itself_says_is_riskier(seed):
    """Between many rows a point's own neighbours tell, not those of the best trial."""
    table, machine = striped(seed)
    sampler = FeatureKernelSampler(table, seed=seed, allowed_risk=0.1)
    study = optuna.create_study(sampler=sampler)
    for _ in range(12):
        before = optuna.create_study(sampler=sampler)
        before.add_trials(study.trials)
        study.optimize(machine, n_trials=1)
        said = sampler.predict(before, [study.trials[-1].params]).risks["fall"][0]
        assert said <= 0.1 + 1e-9
    assert OFF_TABLE in rows_of(study)


@pytest.mark.parametrize("off_grid", [0, 64])
def test_the_rest_of_a_fixed_part_is_never_drawn_beside_an_allowed_risk(off_grid):
    table, machine = striped(0)
    sampler = FeatureKernelSampler(
        table, seed=0, allowed_risk=0.1, off_grid=off_grid, strict=True
    )
    study = optuna.create_study(sampler=sampler)
    study.enqueue_trial({"b": 0.123456})
    with refused("b: 0.123456 cannot be used; allowed: a value that a row"):
        study.optimize(machine, n_trials=1)
