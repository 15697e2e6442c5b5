"""A repair: whose experiment it is, which arm it takes, and that it goes on as the same study."""

from dataclasses import replace

import optuna
import pytest

import taichi_nmm
from storage.store import open_store
from study.experiment.arms import find_arm
from study.experiment.experiment import study_name
from study.experiment.live_study import run_study
from study.experiment.repair import TRIALS, repair_of, repaired
from taichi_nmm.world import Exoskeleton
from tests.cases import refused
from tests.study import fake_walker


def study_in(out, arm):
    """Parameters and costs of the finished trials of the one repair in a folder."""
    (database,) = out.glob("repair-*/study.db")
    name = study_name("repair", arm, 2)  # the last of three runs
    study = optuna.load_study(study_name=name, storage=f"sqlite:///{database}")
    done = study.get_trials(states=(optuna.trial.TrialState.COMPLETE,))
    return [(trial.params, trial.values) for trial in done]


def test_a_repair_is_a_study_of_thirty_trials_also_when_it_was_interrupted(
    toy, tmp_path, monkeypatch
):
    experiment, arm = repair_of(toy, open_store(toy.stores["worlds"]))
    assert (arm, experiment.trial_s, experiment.runs) == ("worlds", 100.0, 3)
    plain = optuna.storages.InMemoryStorage()
    study = run_study(experiment, find_arm(arm), 2, TRIALS, plain)
    found = repaired(experiment, arm, tmp_path)
    assert (found.trials, found.best) == (1, 0)
    stopped = fake_walker.stopped_in_call(2)
    monkeypatch.setitem(vars(taichi_nmm), "simulate", stopped)
    repaired(experiment, arm, tmp_path)
    with pytest.raises(KeyboardInterrupt):
        repaired(experiment, arm, tmp_path)
    monkeypatch.setitem(vars(taichi_nmm), "simulate", fake_walker.simulate)
    counts = [repaired(experiment, arm, tmp_path).trials for _ in range(TRIALS)]
    assert counts == [*range(3, TRIALS + 1), TRIALS, TRIALS]
    expected = [(trial.params, trial.values) for trial in study.trials]
    assert study_in(tmp_path, arm) == expected and len(expected) == TRIALS
    best = repaired(experiment, arm, tmp_path)
    gains = best.gains.by_name()
    assert {name: gains[name] for name in experiment.names} == study.best_params
    assert f"at {study.best_trial.user_attrs['mean_speed_mps']:.2f} m/s" in best.words


def test_another_walker_is_another_repair(toy, tmp_path):
    store = open_store(toy.stores["worlds"])
    weak = replace(toy, seed=6)
    assert repair_of(toy, store) == repair_of(toy, store) != repair_of(weak, store)
    for setting in (toy, weak, toy):
        repaired(*repair_of(setting, store), tmp_path)
    assert len(list(tmp_path.glob("repair-*"))) == 2


def test_what_is_searched_is_the_stores_and_the_device_of_the_setting(toy, tmp_path):
    store = open_store(toy.stores["worlds"])
    device = replace(
        toy.conditions.world_ranges, exoskeleton=Exoskeleton(motion="knee_flexion")
    )
    worn = replace(toy, conditions=replace(toy.conditions, world_ranges=device))
    searched = repair_of(worn, store)[0].searched
    assert searched == ("exo_torque", "exo_peak", "exo_rise", "exo_fall")
    fake_walker.fill(tmp_path / "leaning", {"samples": 40, "searched": ["theta_ref"]})
    experiment, arm = repair_of(toy, open_store(tmp_path / "leaning"))
    assert (experiment.searched, arm) == (("theta_ref",), "dog")  # it has no worlds
    assert repaired(experiment, arm, tmp_path).gains.by_name()["theta_ref"] != 0.105


def test_a_store_of_too_few_rows_is_refused(toy, tmp_path):
    fake_walker.write_plain_store(tmp_path / "few", samples=20)
    experiment, arm = repair_of(toy, open_store(tmp_path / "few"))
    with refused("^trials: 30 .*at most 20"):
        repaired(experiment, arm, tmp_path / "out")
    assert not (tmp_path / "out").exists()
