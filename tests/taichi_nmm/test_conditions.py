"""The tables [simulation], [body] and [terrain]: what they become, and what is refused."""

import pickle
from typing import Any

import numpy as np
import pytest

from taichi_nmm import terrain
from taichi_nmm.body import Bodies
from taichi_nmm.conditions import Conditions, read_conditions, read_disturbance, read_settings
from taichi_nmm.config import Table
from taichi_nmm.errors import InputError
from taichi_nmm.settings import Settings
from taichi_nmm.terrain import Ground

SEED = 3
ALL: dict[str, Any] = {
    "simulation": {
        "duration_s": 20,
        "physics_step_s": 0.5e-3,
        "contact_relaxation_speed_mps": 0.03,
        "precision": "float64",
        "arch": "cpu",
    },
    "body": {"disturbance": 0.15},
    "terrain": {"kind": "rough", "amplitude_m": 0.03},
}


def read(data: dict[str, Any], arch: str | None = None) -> Conditions:
    table = Table(data)
    conditions = read_conditions(table, duration_s=5.0, shortest_s=1.0, longest_s=100.0, arch=arch)
    table.done()
    return conditions


def test_the_three_tables_become_conditions() -> None:
    settings = Settings(0.5e-3, 0.03, "float64", "cpu")
    expected = Conditions(20.0, settings, 0.15, Ground("rough", {"amplitude_m": 0.03}))
    assert read(ALL) == expected
    assert pickle.loads(pickle.dumps(expected)) == expected
    assert hash(read(ALL)) == hash(expected)


def test_missing_tables_are_a_nominal_body_on_level_ground() -> None:
    assert read({}) == Conditions(5.0, Settings(), 0.0, Ground())


def test_body_and_terrain_follow_their_seeds() -> None:
    conditions = read(ALL)
    seed = np.random.SeedSequence(SEED, spawn_key=(1,))
    body = Bodies.disturbed([seed], 0.15)
    np.testing.assert_array_equal(conditions.body(seed).mass_kg, body.mass_kg)
    ground = terrain.rough(seed, 0.03)
    np.testing.assert_array_equal(conditions.terrain(seed).height_m, ground.height_m)


def test_a_body_without_disturbance_is_the_nominal_one() -> None:
    found, nominal = read({}).body(SEED), Bodies.nominal()
    assert found.mass_kg.tobytes() == nominal.mass_kg.tobytes()
    assert found.inertia_kgm2.tobytes() == nominal.inertia_kgm2.tobytes()
    assert found.com_m.tobytes() == nominal.com_m.tobytes()


def test_the_document_of_a_simulation_leaves_the_machine_out() -> None:
    document = read(ALL).simulation_document()
    # Stores hash these keys in this order.
    assert list(document.items()) == [
        ("duration_s", 20.0),
        ("physics_step_s", 0.5e-3),
        ("contact_relaxation_speed_mps", 0.03),
        ("precision", "float64"),
    ]


def test_the_command_line_overrides_the_files_architecture() -> None:
    assert read({"simulation": {"arch": "cuda"}}, arch="cpu").settings.arch == "cpu"
    assert read_settings(Table({"arch": "cuda"}), arch="cpu").arch == "cpu"


@pytest.mark.parametrize(
    ("table", "key", "value"),
    [
        ("simulation", "duration_s", 0.5),
        ("simulation", "duration_s", 101.0),
        ("simulation", "physics_step_s", 2e-3),
        ("simulation", "precision", "half"),
        ("simulation", "precision", 64),
        ("simulation", "arch", "tpu"),
        ("simulation", "threads", 2),
        ("body", "disturbance", 0.95),
        ("body", "mass", 80),
        ("terrain", "kind", "lava"),
        ("terrain", "amplitude_m", 0.1),
    ],
)
def test_a_bad_condition_is_named(table: str, key: str, value: object) -> None:
    with pytest.raises(InputError) as caught:
        read({table: {key: value}})
    assert caught.value.field == f"{table}.{key}"
    assert "\n" not in str(caught.value)


def test_the_body_table_may_be_read_alone() -> None:
    assert read_disturbance(Table({"disturbance": 0.15}, "body")) == 0.15
    assert read_disturbance(Table({}, "body")) == 0.0
    with pytest.raises(InputError, match=r"^body\.disturbance: 0\.95 .* a number from 0 to 0\.9$"):
        read_disturbance(Table({"disturbance": 0.95}, "body"))
