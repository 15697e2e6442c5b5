"""A machine that is like none of the worlds is called so by its first trials."""

import numpy as np
import optuna
import pytest
from optuna.distributions import FloatDistribution

from study import FeatureKernelSampler, FeatureTable
from study.sampler import prediction
from study.sampler.acquisition import FAMILIAR
from study.sampler.calibration import COST, COST_UNLIKE
from study.sampler.unlike import FALSE_ALARMS, LEAST_WORLDS
from tests.study.sampler.campaigns import machine_of
from tests.study.sampler.studies import told

LINE = np.linspace(0.0, 1.0, 41)
SPACE = {"x": FloatDistribution(0.0, 1.0)}
RNG = np.random.default_rng(3)
PLACES = RNG.uniform(0.3, 0.7, 24)
COSTS = 0.3 + (LINE[:, None] - PLACES) ** 2


def said(readings, costs=COSTS, direction="minimize", **options):
    """What is said after readings at every fourth row."""
    table = FeatureTable.from_arrays({"x": LINE}, outcomes=costs, **options)
    sampler = FeatureKernelSampler(table, seed=1)
    study = optuna.create_study(sampler=sampler, direction=direction)
    for place, value in enumerate(readings):
        told(study, SPACE, {"x": LINE[4 * place]}, value)
    return sampler.predict(study)


def test_a_machine_beyond_all_worlds_is_called_so_after_one_trial():
    found = said([2.0])
    least, most = COSTS[0].min(), COSTS[0].max()
    assert found.unlike.startswith(
        "Unlike all 24 worlds after 1 trial: 2 was read where"
    )
    assert f"say {least:.4g} to {most:.4g}." in found.unlike
    assert str(found).endswith(found.unlike) and "\n" not in found.unlike
    assert said([2.0, 0.4, 0.35, 0.31, 0.3]).unlike == found.unlike
    many = [2.0, *np.linspace(0.5, 0.3, FAMILIAR)]
    assert said(many).unlike == found.unlike  # costs in units of the trials by now


def test_a_machine_that_is_one_of_the_worlds_is_not():
    for world in range(5):
        assert not said(COSTS[::4, world][:6]).unlike
    assert not said([]).unlike


def test_readings_may_go_together_as_in_no_world():
    """Each reading is within the worlds, both are not: a world that is steep nowhere."""
    readings = np.array([COSTS[0].max(), COSTS[4].min(), COSTS[8].max()])
    found = said(readings).unlike
    assert "its readings go together as in none of them" in found


def test_of_values_that_are_maximised_the_readings_are_said_as_they_were():
    found = said([-2.0], costs=-COSTS, direction="maximize").unlike
    least, most = (-COSTS[0]).min(), (-COSTS[0]).max()
    assert f"-2 was read where they say {least:.4g} to {most:.4g}" in found


@pytest.mark.parametrize(
    ("costs", "options"),
    [
        (COSTS[:, : LEAST_WORLDS - 1], {}),
        (COSTS, {"better": "lower"}),
    ],
)
def test_few_worlds_and_other_units_do_not_tell(costs, options):
    assert not said([20.0, 30.0, 40.0], costs=costs, **options).unlike


def test_worlds_that_agree_call_a_machine_unlike_only_beyond_the_noise():
    """The spread of the table is what a reading may be off by."""
    same = np.tile(COSTS[:, :1], 12)
    assert not said(same[::4, 0][:3] * 1.001, costs=same).unlike
    assert said([3.0], costs=same).unlike


def test_intervals_are_wider():
    near = said([COSTS[0].max() + 0.02, *COSTS[4::4, 0][:3]])
    far = said([2.0, *COSTS[4::4, 0][:3]])
    assert far.unlike and COST_UNLIKE.scale > COST.scale
    width = far.high - far.low
    assert np.median(width) > np.median(near.high - near.low)


def test_false_alarms_are_about_as_many_as_were_chosen():
    """Of 240 made-up machines, which have one trial each at the best row of all worlds."""
    called = {True: 0, False: 0}
    for is_like in called:
        for seed in range(120):
            machine = machine_of("worlds", is_like=is_like, seed=40_000 + seed)
            sampler = FeatureKernelSampler(machine.table, seed=1)
            study = optuna.create_study(sampler=sampler)
            trial = study.ask(dict(machine.space))
            u = np.array([[*trial.params.values()]])
            study.tell(trial, float(machine.truth.costs(u)[0]))
            called[is_like] += bool(sampler.predict(study, [trial.params]).unlike)
    assert called[True] <= 120 * (FALSE_ALARMS[0] + 3.0 * np.sqrt(0.04 * 0.96 / 120))
    assert called[False] >= 120 * 0.25


def test_what_is_recommended_on_an_unlike_machine_has_a_wider_interval(monkeypatch):
    table = FeatureTable.from_arrays({"x": LINE}, outcomes=COSTS)
    study = optuna.create_study(sampler=FeatureKernelSampler(table, seed=1))
    for place, value in enumerate([2.0, 1.9, 2.1]):
        told(study, SPACE, {"x": LINE[4 * place]}, value)
    found = study.sampler.best(study)
    assert found.unlike and str(found).endswith(found.unlike)
    monkeypatch.setattr(prediction, "unlike", lambda *_: None)
    other = study.sampler.best(study)
    assert not other.unlike and not str(other).endswith(" ")
    assert found.high - found.low > 1.1 * (other.high - other.low)
