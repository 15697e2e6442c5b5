"""Points that climb: slopes of the utility by differences, and where a known one is largest."""

from dataclasses import replace

import numpy as np
import optuna
import pytest
from numpy.testing import assert_allclose

from study import FeatureKernelSampler, FeatureTable
from study.sampler.ascent import Plain, climbed
from study.sampler.covariance import EUCLIDEAN, WITH_WORLDS
from study.sampler.transforms import Points
from tests.study.sampler.studies import by_differences, model_after

RNG = np.random.default_rng(4)
UNIT = RNG.uniform(size=(60, 2))
AWAY = ((UNIT[:, None] - RNG.uniform(size=(4, 2))) ** 2).sum(axis=2)
COSTS = 0.1 + AWAY + 0.3 * RNG.random((60, 4))
WORST = np.argsort(-COSTS[:, 2])  # first: there is much to find
UNIT, COSTS = UNIT[WORST], COSTS[WORST]
FEATURES = np.sin(5.0 * UNIT)
LIMITS = np.column_stack([UNIT[:9, 0] - 0.7, np.where(UNIT[:9, 1] < 0.4, np.nan, -1.0)])
FORMS = {"plain": None, "worlds": {}, "ranking": {"better": "lower"}}
KNOWN = {
    "improvement": {},
    "success": {"success": 0.9999 * COSTS[:9, 2].min()},
    "limits": {"limits": LIMITS},
}


def model_of(form):
    """After nine trials, and what it sees of a point."""
    if form == "plain":
        points = Points(UNIT[:, :0], UNIT)
        return model_after(points.take(np.arange(9)), COSTS[:9, 2], EUCLIDEAN), Plain()
    columns = dict(zip("xy", UNIT.T, strict=True))
    table = FeatureTable.from_arrays(columns, FEATURES, outcomes=COSTS, **FORMS[form])
    rows, ensemble = table.rows, table.rows.ensemble(np.ones(1))
    points = rows.points(by_order=True, coordinates=True, ensemble=ensemble)
    chart = rows.emulator(ensemble).around(UNIT[:2])
    seen = points.take(np.arange(9))
    return model_after(seen, COSTS[:9, 2], WITH_WORLDS, ensemble), chart


@pytest.mark.parametrize("known", KNOWN)
@pytest.mark.parametrize("form", FORMS)
def test_the_slopes_of_the_utility_are_those_of_differences(form, known):
    plain, chart = model_of(form)
    model, unit = replace(plain, **KNOWN[known]), RNG.uniform(0.1, 0.9, (20, 2))
    points, pull = chart.placed(unit)
    found, slopes = model.slopes(points)
    same = np.array_equal(found, plain.slopes(points)[0])
    assert same == (known == "improvement")
    again = model.utility(points, np.ones(20, dtype=bool), RNG)
    assert_allclose(found, again, rtol=1e-3, atol=1e-3)
    expected = by_differences(lambda u: model.slopes(chart.placed(u)[0])[0], unit)
    worst = np.abs(pull(slopes) - expected) / (1.0 + np.abs(expected))
    assert worst.max() < 1e-3


class Hill:
    """A utility with its top beyond an edge, and steeper in some directions than in others."""

    top, steep = np.array([0.3, 1.4, 0.6, -1.0]), np.array([1.0, 30.0, 5.0, 0.2])

    def slopes(self, points):
        away = points.coordinates - self.top
        return -self.steep @ away.T**2, -2.0 * self.steep * away


def test_points_climb_to_the_top_each_alone_and_stay_in_the_cube_and_where_they_are_fixed():
    starts, movable = RNG.uniform(size=(9, 4)), np.array([True, True, False, True])
    ends = climbed(Hill(), Plain(), starts, movable)
    expected = np.where(movable, [0.3, 1.0, 0.0, 0.0], starts)
    assert_allclose(ends, expected, atol=1e-3)
    assert ends.min() >= 0.0 and ends.max() <= 1.0
    alone = [climbed(Hill(), Plain(), start[None], movable)[0] for start in starts]
    assert_allclose(alone, ends, atol=1e-3)
    assert climbed(Hill(), Plain(), starts, ~movable & False) is starts


SMOOTH = {
    "bowl": lambda u: ((u - 0.65) ** 2).sum(),
    "waves": lambda u: -np.cos(2.0 * u - 0.6).prod(),
    "curve": lambda u: (np.sin(3.0 * u + 1.0) * np.cumsum(u)).sum(),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SMOOTH)
def test_the_plain_process_is_better_than_random_search_and_tpe(name):
    """In nine of ten studies of 30 trials: of equal samplers one is in a hundred."""

    def objective(trial):
        unit = [trial.suggest_float(f"x{place}", 0, 1) for place in range(4)]
        return float(SMOOTH[name](np.array(unit)))

    def best(sampler):
        study = optuna.create_study(sampler=sampler)
        study.optimize(objective, n_trials=30)
        return study.best_value

    ours = [best(FeatureKernelSampler(seed=seed)) for seed in range(10)]
    for other in (optuna.samplers.RandomSampler, optuna.samplers.TPESampler):
        theirs = [best(other(seed=seed)) for seed in range(10)]
        assert np.less(ours, theirs).sum() >= 9
