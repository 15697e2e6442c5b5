"""Studies with several goals: the one cost of a trial, and the fronts that are found."""

import numpy as np
import optuna
import pytest
from numpy.testing import assert_allclose
from optuna.distributions import FloatDistribution
from optuna.samplers import RandomSampler
from optuna.study import StudyDirection
from optuna.trial import TrialState

from study import FeatureKernelSampler, FeatureTable
from study.sampler.goals import Goals
from tests.study.conftest import refused

SPACE = {"x": FloatDistribution(0, 1), "y": FloatDistribution(0, 1)}
ROWS = np.random.default_rng(8).random((400, 2))
COLUMNS = dict(zip(SPACE, ROWS.T, strict=True))
MAXIMISED = np.array([1.0, -1.0])


def goals_of(points, bend=0.0):
    """Two goals, [n, 2]: near the left end, and near the right one; y is best at 0.3 for both."""
    x, y = points.T
    off = 4.0 * (y - 0.3) ** 2
    return np.column_stack([(x - bend) ** 2 + off, (1.0 - x) ** 2 + off])


def table(**known):
    return FeatureTable.from_arrays(COLUMNS, space=SPACE, **known)


WORLDS = np.stack([goals_of(ROWS, bend) for bend in (-0.1, 0.0, 0.1)], axis=1)
FORMS = {
    "worlds": table(outcomes=WORLDS),
    "worlds, second maximised": table(outcomes={"all": WORLDS * MAXIMISED}),
    "features": table(features=goals_of(ROWS)),
    "function": goals_of,
    "none": None,
}


def studied(form, trials, sampler=None, seed=3):
    signs = MAXIMISED if "maximised" in form else np.ones(2)
    directions = ["minimize" if sign > 0 else "maximize" for sign in signs]
    sampler = sampler or FeatureKernelSampler(FORMS[form], seed=seed)
    study = optuna.create_study(directions=directions, sampler=sampler)

    def objective(trial):
        point = [trial.suggest_float(name, 0, 1) for name in SPACE]
        return tuple((signs * goals_of(np.array([point]), 0.05)[0]).tolist())

    study.optimize(objective, n_trials=trials)
    return study


def volume(study):
    """The area that the trials dominate, up to a cost of 2 each."""
    minimised = [each is StudyDirection.MINIMIZE for each in study.directions]
    costs = np.array([trial.values for trial in study.trials])
    costs = np.where(minimised, costs, -costs)
    area, reach = 0.0, 2.0
    for first, second in costs[np.lexsort(costs.T[::-1])]:
        if second < reach and first < 2.0:
            area += (2.0 - first) * (reach - second)
            reach = second
    return area


def test_the_one_cost_is_the_largest_weighted_excess_and_a_twentieth_of_the_sum():
    goals = Goals(np.array([0.25, 0.75]), np.array([1.0, 10.0]), np.array([2.0, 5.0]))
    costs = np.array([[3.0, 10.0], [1.0, 20.0], [np.inf, 10.0]])
    found = goals.cost(costs)
    assert_allclose(found[:2], [1 + 0.25 * 1.05, 1 + 1.5 * 1.05])
    assert np.isfinite(found).all() and found[2] > 1e100
    known = np.array([[1.0, 4.0], [5.0, 4.0], [3.0, np.nan], [2.0, 8.0]])
    drawn = Goals.drawn(known, np.random.default_rng(0))
    assert drawn.weights.sum() == pytest.approx(1.0) and (drawn.weights > 0).all()
    assert drawn.least.tolist() == [1.0, 4.0] and drawn.typical.tolist() == [2.0, 4.0]


@pytest.mark.parametrize("form", FORMS)
def test_fronts_are_better_than_those_of_random_trials(form):
    """Nearer to the whole front than to them; where nothing is known, just better."""
    study = studied(form, 25)
    random = np.median(
        [volume(studied("none", 25, RandomSampler(seed=s))) for s in range(5)]
    )
    share = 0.0 if form == "none" else 0.5
    assert volume(study) > random + share * (volume_of_the_front() - random)
    firsts = [trial.params["x"] for trial in study.best_trials]
    assert max(firsts) - min(firsts) > 0.5  # from one end to the other


def volume_of_the_front():
    study = optuna.create_study(directions=["minimize"] * 2)
    for x in np.linspace(0.05, 1.0, 400):
        values = goals_of(np.array([[x, 0.3]]), 0.05)[0].tolist()
        study.add_trial(optuna.create_trial(values=values))
    return volume(study)


def test_a_trial_of_worlds_begins_at_the_front():
    """The worlds know it before any trial."""
    (trial,) = studied("worlds", 1).trials
    assert trial.params["y"] == pytest.approx(0.3, abs=0.1)


@pytest.mark.parametrize(
    ("outcomes", "goals", "message"),
    [
        (WORLDS, 1, "table.outcomes: 'costs of 2' .* 1 goals"),
        (WORLDS, 3, "table.outcomes: 'costs of 2' .* 3 goals"),
        (WORLDS[..., 0], 2, "table.outcomes: 'costs of 1' .* 2 goals"),
    ],
)
def test_worlds_have_as_many_goals_as_the_study(outcomes, goals, message):
    def ask(strict):
        sampler = FeatureKernelSampler(table(outcomes=outcomes), seed=1, strict=strict)
        directions = ["minimize"] * goals
        return optuna.create_study(directions=directions, sampler=sampler).ask(SPACE)

    with refused(message):
        ask(strict=True)
    with pytest.warns(UserWarning, match="the independent sampler takes over"):
        assert ask(strict=False).params


def test_what_needs_one_goal_is_refused():
    study = studied("features", 3)
    for look in (study.sampler.best, study.sampler.worth, study.sampler.predict):
        with pytest.raises(ValueError, match="multi-objective"):
            look(study)
    sampler = FeatureKernelSampler(table(outcomes=WORLDS), success=0.5)
    study = optuna.create_study(directions=["minimize"] * 2, sampler=sampler)
    with refused(r"success: 0.5 .* none in a study of 2 goals"):
        study.ask(SPACE)
    for outcomes, better in (
        (WORLDS, "lower"),
        ({"a": WORLDS, "b": WORLDS[..., 0]}, None),
    ):
        with refused(r"table.outcomes.*shape"):
            table(outcomes=outcomes, better=better)


def test_rows_are_noted_and_infinite_costs_are_learned_from():
    study = studied("features", 3)
    assert all(trial.user_attrs["row"] >= 0 for trial in study.trials)
    study.tell(study.ask(SPACE), (np.inf, 1.0))
    study.tell(study.ask(SPACE), (1.0, np.inf))
    study.ask(SPACE)
    assert study.trials[-1].state is TrialState.RUNNING and study.trials[-1].params
