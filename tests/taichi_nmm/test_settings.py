"""Settings of a simulation and the tables of a configuration that set its conditions."""

import importlib.util
import pickle
from dataclasses import fields
from functools import partial
from pathlib import Path

import pytest

import taichi_nmm
from storage.inputs.config import Table, read_toml
from taichi_nmm import PUBLISHED_GAINS, InputError, mujoco_engine
from taichi_nmm.body import Build
from taichi_nmm.conditions import Conditions, read_conditions, read_settings
from taichi_nmm.mujoco_engine import require_mujoco
from taichi_nmm.settings import PHYSICS_STEPS_S, MujocoSettings, Settings
from taichi_nmm.terrain import Ground
from taichi_nmm.walker_simulator import require_engine
from tests.cases import asset, cases

NAN, INF = float("nan"), float("inf")
ALL = asset("conditions.toml")
ON_MUJOCO = {"engine": "mujoco", "duration_s": 20.0}


def read(data, arch=None):
    table = Table(data)
    conditions = read_conditions(table, arch)
    table.done()
    return conditions


def refused(field, data):
    """The one line about a field."""
    with pytest.raises(InputError) as caught:
        read(data)
    assert caught.value.field == field
    return str(caught.value)


def refused_on_mujoco(field, **simulation):
    return refused(f"simulation.{field}", {"simulation": ON_MUJOCO | simulation})


def test_defaults_are_those_the_gaits_converge_with_and_steps_fill_a_tick():
    assert vars(Settings()) == {
        "physics_step_s": 1e-3,
        "contact_relaxation_speed_mps": 0.10,
        "precision": "float32",
        "arch": "auto",
        "threads": None,
        "engine": "taichi",
        "mujoco": MujocoSettings(0.02, 1.0, "stops"),
        "wide_registers": True,
    }
    assert Settings(contact_relaxation_speed_mps=0.03)  # the published one is allowed
    assert [Settings(physics_step_s=step_s).substeps for step_s in PHYSICS_STEPS_S] == [
        1,
        2,
        4,
    ]


@pytest.mark.parametrize(
    ("field", "value"),
    [
        (field, value)
        for field, values in asset("bad-settings.toml").items()
        for value in values
    ],
)
def test_settings_out_of_range_are_named(field, value):
    with pytest.raises(InputError) as caught:
        Settings(**{field: value})
    assert caught.value.field == f"simulation.{field}"
    assert field != "engine" or caught.value.allowed == "taichi or mujoco"


def test_tables_become_conditions_and_missing_ones_nominal():
    settings = Settings(0.5e-3, 0.03, "float64", "cpu")
    expected = Conditions(
        20.0, settings, Build(0.15), Ground("rough", {"amplitude_m": 0.03})
    )
    assert read(ALL) == expected
    assert pickle.loads(pickle.dumps(expected)) == expected
    assert hash(read(ALL)) == hash(expected)
    assert read({}) == Conditions(100.0, Settings(), Build(), Ground())


def test_mujoco_computes_on_the_processor_and_the_command_line_overrides_the_file():
    for arch in ("auto", "cpu"):
        assert read({"simulation": ON_MUJOCO | {"arch": arch}}).settings.arch == arch
    assert read({"simulation": {"arch": "cuda"}}, arch="cpu").settings.arch == "cpu"
    assert read_settings(Table({"arch": "cuda"}), arch="cpu").arch == "cpu"


@pytest.mark.parametrize(
    ("table", "key", "value"),
    [
        (table, key, value)
        for table, keys in asset("bad-conditions.toml").items()
        for key, values in keys.items()
        for value in values
    ],
)
def test_a_bad_condition_is_named(table, key, value):
    refused(f"{table}.{key}", {table: {key: value}})


@pytest.mark.parametrize("value", [0.0, -0.02, NAN, INF, -INF, "soft"])
@pytest.mark.parametrize("name", ["time_constant_s", "damping_ratio"])
def test_contact_numbers_that_mean_something_else(name, value):
    """Negative ones are MuJoCo's direct form, of other units."""
    with pytest.raises(InputError, match=rf"^simulation\.mujoco\.{name}: "):
        MujocoSettings(**{name: value})
    refused_on_mujoco(f"mujoco.{name}", mujoco={name: value})


@pytest.mark.parametrize("step_s", PHYSICS_STEPS_S)
def test_a_time_constant_of_some_steps_only(step_s):
    shortest_s = 5 * step_s
    own = {"time_constant_s": shortest_s * 0.99}
    line = refused_on_mujoco(
        "mujoco.time_constant_s", physics_step_s=step_s, mujoco=own
    )
    assert f"{shortest_s:g} or more" in line and "physics_step_s smaller" in line
    shortest = MujocoSettings(time_constant_s=shortest_s)
    assert (
        Settings(engine="mujoco", physics_step_s=step_s, mujoco=shortest).mujoco
        == shortest
    )


@cases("bad-mujoco.toml", "field", "simulation", "allowed")
def test_bad_settings_of_mujoco(field, simulation, allowed):
    assert allowed in refused_on_mujoco(field, **simulation)


@pytest.mark.parametrize("missing", ["mujoco", "mujoco.batch"])
def test_mujoco_is_not_installed_or_too_old(monkeypatch, missing):
    def find_spec(name, *_):
        return None if name == missing else importlib.util.find_spec(name)

    monkeypatch.setattr(mujoco_engine, "find_spec", find_spec)
    says = r"^simulation\.engine: 'mujoco' .* 4\.0 or newer: pip install 'taichi-nmm\[mujoco\]'$"
    settings = Settings(engine="mujoco")
    simulate = partial(taichi_nmm.simulate, PUBLISHED_GAINS, settings=settings)
    for call in (require_mujoco, simulate, partial(require_engine, settings)):
        with pytest.raises(InputError, match=says):
            call()


def test_configurations_with_three_contacts():
    """MuJoCo's default, half of it, and a quarter at half the step; all else is equal."""
    configs = Path(__file__).resolve().parents[2] / "configs"
    contacts = {"soft": (0.02, 1e-3), "middle": (0.01, 1e-3), "hard": (0.005, 0.5e-3)}
    grounds = {path.stem for path in configs.glob("mujoco-*.toml")}
    assert len(grounds) == 5
    for ground in grounds:
        others = []
        for contact, (time_constant_s, step_s) in contacts.items():
            data = read_toml(configs / f"{ground}-{contact}.toml").unread
            simulation = dict(data.pop("simulation"))
            assert simulation.pop("mujoco") == {"time_constant_s": time_constant_s}
            assert simulation.pop("physics_step_s") == step_s
            assert (
                simulation["engine"] == "mujoco"
                and data.pop("name") == f"{ground}-{contact}"
            )
            assert (
                data["runs"] == 50
                and data["trials"] == 40
                and data["until_walker"] is True
            )
            others.append((data, simulation))
        assert others[0] == others[1] == others[2]


# Stores hash the keys of documents in this order.
def test_the_document_leaves_the_machine_and_the_other_engine_out():
    assert list(read(ALL).as_written()["simulation"].items()) == [
        ("duration_s", 20.0),
        ("physics_step_s", 0.5e-3),
        ("contact_relaxation_speed_mps", 0.03),
        ("precision", "float64"),
    ]
    for simulation in ({}, {"engine": "taichi"}):
        assert list(
            read({"simulation": simulation}).as_written()["simulation"].items()
        ) == [
            ("duration_s", 100.0),
            ("physics_step_s", 1e-3),
            ("contact_relaxation_speed_mps", 0.1),
            ("precision", "float32"),
        ]

    # Every setting but the machine's is in one of the documents.
    documents = (Settings(threads=1).document(), Settings(engine="mujoco").document())
    found = {name for document in documents for name in document}
    of_the_machine = {"arch", "threads", "wide_registers"}
    assert found == {field.name for field in fields(Settings)} - of_the_machine


def test_the_document_of_mujoco_comes_back():
    own = {"time_constant_s": 0.005, "damping_ratio": 0.8, "limits": "mujoco"}
    simulation = ON_MUJOCO | {"physics_step_s": 0.5e-3, "mujoco": own, "arch": "cpu"}
    conditions = read({"simulation": simulation})
    document = conditions.as_written()["simulation"]
    assert document == {
        "duration_s": 20.0,
        "physics_step_s": 0.5e-3,
        "precision": "float32",
        "engine": "mujoco",
        "mujoco": own,
    }
    again = read({"simulation": document})
    assert again.as_written()["simulation"] == document
    assert again.settings.mujoco == conditions.settings.mujoco
    assert pickle.loads(pickle.dumps(conditions)) == conditions
    assert hash(pickle.loads(pickle.dumps(conditions))) == hash(conditions)
