"""The one document: all that decides trials is in it, nothing else is. Tables are read back."""

import json
from dataclasses import fields, replace
from pathlib import Path

import pytest

from storage.inputs.config import Table
from storage.tables import difference
from study.experiment.arms import find_arm
from study.experiment.folder import document, fingerprint, versions
from study.experiment.objective import Objective
from study.experiment.walker import WalkerExperiment, as_written, experiment_of
from taichi_nmm.body import Build
from taichi_nmm.conditions import Conditions
from taichi_nmm.kernel_cache import COMPILER
from taichi_nmm.parameters import PUBLISHED_GAINS
from taichi_nmm.settings import MujocoSettings, Settings
from taichi_nmm.terrain import KINDS, Ground, read_ground
from taichi_nmm.world import WorldRanges
from tests.study import fake_walker
from tests.study.experiment.fake_results import experiment

TINY = experiment()

# Another value of every field there is. A new field is missing here until somebody
# says, by its place, whether it decides trials; that it then does, or does not, is
# tested.
DECIDING = {
    WalkerExperiment: {
        "name": "other",
        "seed": 8,
        "searched": ("theta_ref",),
        "objective": Objective("walking"),
        "noise": 0.1,
        "until_walker": True,
        "fixed": tuple(PUBLISHED_GAINS.tolist()),
    },
    Conditions: {
        "duration_s": 3.0,
        "build": Build(0.2),
        "ground": Ground("rough"),
        "world_ranges": WorldRanges(friction=(0.5, 0.5)),
    },
    Settings: {
        "physics_step_s": 0.5e-3,
        "contact_relaxation_speed_mps": 0.2,
        "precision": "float64",
        "engine": "mujoco",
    },
}
IDLE = {
    WalkerExperiment: {
        "runs": 9,
        "trials": 50,
        "arms": ("worlds",),
        "stores": {"flat": Path("elsewhere")},
    },
    Conditions: {},
    # Of another engine than the tiny experiment's.
    Settings: {
        "arch": "cuda",
        "threads": 1,
        "wide_registers": False,
        "mujoco": MujocoSettings(limits="mujoco"),
    },
}
PARTS = {WalkerExperiment: "", Conditions: "conditions", Settings: "settings"}


def changed(kind, name, value):
    """The tiny experiment with one field of itself or of one of its parts changed."""
    change, conditions = {name: value}, TINY.conditions
    if kind is WalkerExperiment:
        # something must be
        searched = {"searched": ("exo_peak",)} if name == "fixed" else {}
        return replace(TINY, **searched | change)
    if kind is Settings:
        change = {"settings": replace(conditions.settings, **change)}
    return replace(TINY, conditions=replace(conditions, **change))


def named(table):
    return [
        pytest.param(changed(kind, name, value), id=f"{kind.__name__}.{name}")
        for kind, values in table.items()
        for name, value in values.items()
    ]


def read_back(of):
    """The experiment of its tables, as a file holds them."""
    return experiment_of(Table(json.loads(json.dumps(as_written(of)))), "")


@pytest.mark.parametrize("kind", PARTS, ids=lambda kind: kind.__name__)
def test_every_field_either_decides_trials_or_does_not(kind):
    known = {each.name for each in fields(kind)} - set(PARTS.values())
    assert known == set(DECIDING[kind]) | set(IDLE[kind])


@pytest.mark.parametrize("other", named(DECIDING))
def test_what_decides_trials_changes_the_document_and_is_read_back(other):
    assert difference(document(other, ()), document(TINY, ())) is not None
    assert fingerprint(other) != fingerprint(TINY)
    assert document(read_back(other), ()) == document(other, ())


@pytest.mark.parametrize("other", named(IDLE))
def test_what_decides_nothing_changes_nothing(other):
    assert other != TINY
    assert document(other, ()) == document(TINY, ())
    assert fingerprint(other) == fingerprint(TINY)


def test_the_document_is_json_and_says_the_versions_and_the_space():
    ours = document(TINY, ())
    assert json.loads(json.dumps(ours)) == ours
    assert ours["versions"] == versions(
        COMPILER, "optuna", "cma", "cmaes", "numpy", "scipy"
    )
    assert list(ours["parameters"]) == list(TINY.names)
    assert ours["terrain"]["name"] == "rough +-0.02 m every 1 m"
    assert ours["ground"] == {"kind": "rough", "amplitude_m": 0.02}
    # it is off: folders of before there was one go on
    assert "until_walker" not in ours


@pytest.mark.parametrize(
    "own",
    [
        MujocoSettings(0.01),
        MujocoSettings(damping_ratio=0.5),
        MujocoSettings(limits="mujoco"),
    ],
)
def test_an_experiment_on_mujoco_says_so_and_with_which_version(own):
    assert "mujoco" not in json.dumps(document(TINY, ()))
    usual = changed(Settings, "engine", "mujoco")
    settings = replace(usual.conditions.settings, mujoco=own)
    other = replace(usual, conditions=replace(usual.conditions, settings=settings))
    ours = document(other, ())
    assert ours["versions"] == document(TINY, ())["versions"] | versions("mujoco")
    assert fingerprint(other) != fingerprint(usual)
    read = read_back(other)
    assert read.conditions.settings.mujoco == own and document(read, ()) == ours


def test_arms_and_the_stores_that_they_read_are_those_of_the_call(toy):
    ours = document(toy, (find_arm("dog"), find_arm("worlds"), find_arm("random")))
    assert list(ours["arms"]) == ["dog", "random", "worlds"]
    assert ours["arms"]["dog"] == json.loads(json.dumps(find_arm("dog").definition))
    assert list(ours["stores"]) == ["flat", "worlds"]
    assert len(set(ours["stores"].values())) == 1  # they are one store
    assert document(toy, ())["arms"] == document(toy, ())["stores"] == {}


def test_a_store_is_known_by_its_content(toy, tmp_path):
    arm = find_arm("dog")
    before = document(toy, (arm,))
    (tmp_path / "store").rename(tmp_path / "moved")
    moved = replace(toy, stores=dict.fromkeys(toy.stores, tmp_path / "moved"))
    assert document(moved, (arm,)) == before
    fake_walker.write_store(tmp_path / "other", seed=4)
    other = replace(toy, stores=dict.fromkeys(toy.stores, tmp_path / "other"))
    found = difference(document(other, (arm,)), before)
    assert found[0] == "stores.flat"


@pytest.mark.parametrize("kind", KINDS)
def test_an_experiment_that_was_read_back_draws_alike(kind, tmp_path):
    (tmp_path / "ground.csv").write_text("0,0\n3,0.1\n60,0\n")
    file = {"file": str(tmp_path / "ground.csv")} if kind == "file" else {}
    ground = read_ground(Table({"kind": kind, **file}, "terrain"))
    changes = {
        "ground": ground,
        "searched": ("theta_ref",),
        "objective": Objective("walking"),
        "duration_s": 1.5,
    }
    ours = experiment(seed=8, **changes)
    read = read_back(ours)
    # of which tables say nothing
    machine = replace(read.conditions.settings, arch="cpu")
    assert replace(read.conditions, settings=machine) == ours.conditions
    for name in ("name", "seed", "searched", "objective", "parameters"):
        assert getattr(read, name) == getattr(ours, name)
    assert read.terrain(7).height_m.tobytes() == ours.terrain(7).height_m.tobytes()
