"""TOML read strictly: each value is checked, each mistake named with its key."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from taichi_nmm import terrain
from taichi_nmm.body import Bodies
from taichi_nmm.config import Table, read_bodies, read_settings, read_terrain, read_toml
from taichi_nmm.errors import InputError
from taichi_nmm.settings import Settings

SEED = 3


def refused(call: Callable[[], object]) -> InputError:
    with pytest.raises(InputError) as caught:
        call()
    assert "\n" not in str(caught.value)
    return caught.value


def test_a_file_is_read_into_tables(tmp_path: Path) -> None:
    path = tmp_path / "config.toml"
    path.write_text('name = "x"\n[body]\ndisturbance = 0.1\n[[trial]]\nseed = 1\n[[trial]]\n')
    table = read_toml(path)
    assert table.text("name") == "x"
    assert table.table("body").number("disturbance") == 0.1
    trials = table.tables("trial")
    assert [trial.integer("seed", 0) for trial in trials] == [1, 0]
    table.done()


@pytest.mark.parametrize("content", [b"name = ", b"a = 1\na = 2\n", b"\xff\xfe"])
def test_a_file_that_is_not_toml_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "bad.toml"
    path.write_bytes(content)
    error = refused(lambda: read_toml(path))
    assert error.field == "config"
    assert "readable TOML file" in error.allowed


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    error = refused(lambda: read_toml(tmp_path / "none.toml"))
    assert "none.toml" in str(error)


def test_values_within_range_are_returned() -> None:
    table = Table({"a": 1, "b": 2, "c": "up", "d": False})
    number = table.number("a", low=0, high=1)
    assert (number, type(number)) == (1.0, float)
    assert table.integer("b", low=2, high=2) == 2
    assert table.text("c", choices=("up", "down")) == "up"
    assert table.boolean("d") is False
    table.done()


def test_defaults_stand_in_for_missing_keys() -> None:
    table = Table({})
    assert table.number("a", 0.5) == 0.5
    assert table.integer("b", 7) == 7
    assert table.text("c", "x") == "x"
    assert table.boolean("d", True) is True
    table.table("e").done()
    assert table.tables("f") == []
    table.done()


BAD_VALUES: list[tuple[object, Callable[[Table], object], str]] = [
    ("1", lambda t: t.number("key"), "a number"),
    (True, lambda t: t.number("key"), "a number"),
    (float("nan"), lambda t: t.number("key"), "a number"),
    (float("inf"), lambda t: t.number("key"), "a number"),
    (-0.1, lambda t: t.number("key", low=0.0, high=1.0), "a number from 0 to 1"),
    (1.1, lambda t: t.number("key", low=0.0, high=1.0), "a number from 0 to 1"),
    (1.0, lambda t: t.integer("key"), "a whole number"),
    (True, lambda t: t.integer("key"), "a whole number"),
    (0, lambda t: t.integer("key", low=1, high=9), "a whole number from 1 to 9"),
    (10, lambda t: t.integer("key", low=1, high=9), "a whole number from 1 to 9"),
    (3, lambda t: t.text("key"), "a string"),
    ("left", lambda t: t.text("key", choices=("up", "down")), "up or down"),
    (1, lambda t: t.boolean("key"), "true or false"),
    (1, lambda t: t.table("key"), "a table"),
    ({}, lambda t: t.tables("key"), "an array of tables"),
    ([1], lambda t: t.tables("key"), "an array of tables"),
]


@pytest.mark.parametrize(("value", "read", "allowed"), BAD_VALUES)
def test_a_value_of_wrong_type_or_range_is_named(
    value: object, read: Callable[[Table], object], allowed: str
) -> None:
    error = refused(lambda: read(Table({"key": value}, "outer")))
    assert error.field == "outer.key"
    assert error.value is value
    assert error.allowed.startswith(allowed)


REQUIRED: list[Callable[[Table], object]] = [
    lambda t: t.number("key"),
    lambda t: t.integer("key"),
    lambda t: t.text("key"),
    lambda t: t.boolean("key"),
]


@pytest.mark.parametrize("read", REQUIRED)
def test_a_required_key_that_is_missing_is_named(read: Callable[[Table], object]) -> None:
    error = refused(lambda: read(Table({}, "outer")))
    assert (error.field, error.value) == ("outer.key", "missing")


def test_an_unknown_key_is_named_with_the_known_ones() -> None:
    table = Table({"seed": 1, "sed": 2}, "body")
    table.integer("seed")
    error = refused(table.done)
    assert error.field == "body.sed"
    assert "seed" in error.allowed


def test_inner_tables_are_named_by_their_path() -> None:
    outer = Table({"a": {"b": {"c": 1}}, "list": [{}, {"x": 1}]})
    assert refused(outer.table("a").table("b").done).field == "a.b.c"
    assert refused(outer.tables("list")[1].done).field == "list[1].x"


def test_the_simulation_table_becomes_settings() -> None:
    data = {"physics_step_s": 0.5e-3, "precision": "float64", "arch": "cpu"}
    data["contact_relaxation_speed_mps"] = 0.03
    assert read_settings(Table(data, "simulation")) == Settings(0.5e-3, 0.03, "float64", "cpu")
    assert read_settings(Table({}, "simulation")) == Settings()


def test_the_command_line_overrides_the_files_architecture() -> None:
    assert read_settings(Table({"arch": "cuda"}), arch="cpu").arch == "cpu"


@pytest.mark.parametrize(
    ("key", "value"),
    [("physics_step_s", 2e-3), ("precision", "half"), ("arch", "tpu"), ("precision", 64)],
)
def test_a_bad_simulation_setting_is_named(key: str, value: object) -> None:
    error = refused(lambda: read_settings(Table({key: value}, "simulation")))
    assert error.field == f"simulation.{key}"


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        ({}, terrain.flat()),
        ({"kind": "flat"}, terrain.flat()),
        ({"kind": "rough"}, terrain.rough(SEED)),
        (
            {"kind": "rough", "amplitude_m": 0.06, "spacing_m": 2, "flat_start_m": 5},
            terrain.rough(SEED, 0.06, 2.0, 5.0),
        ),
        (
            {"kind": "blocks", "amplitude_m": 0.03, "riser_m": 0.25},
            terrain.blocks(SEED, 0.03, riser_m=0.25),
        ),
        (
            {"kind": "ramp", "increment": 0.025, "direction": "down"},
            terrain.ramp(0.025, direction="down"),
        ),
        (
            {"kind": "ramp", "segment_m": 10, "largest_slope": 0.1},
            terrain.ramp(0.04, 10.0, 0.1),
        ),
        (
            {"kind": "stairs", "rise_m": 0.15, "run_m": 0.4, "flat_start_m": 3},
            terrain.stairs(0.15, 0.4, 3.0),
        ),
    ],
)
def test_each_kind_of_terrain_is_read(data: dict[str, object], expected: terrain.Terrain) -> None:
    found = read_terrain(Table(data, "terrain"), SEED)
    np.testing.assert_array_equal(found.height_m, expected.height_m)
    assert found.name == expected.name


def test_a_terrain_is_read_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "ground.csv"
    path.write_text("0,0\n1,0.5\n")
    found = read_terrain(Table({"kind": "file", "file": str(path)}, "terrain"), SEED)
    assert found.height(2.0) == 0.5


@pytest.mark.parametrize(
    ("data", "field"),
    [
        ({"kind": "lava"}, "kind"),
        ({"kind": "flat", "amplitude_m": 0.1}, "amplitude_m"),
        ({"kind": "rough", "riser_m": 0.1}, "riser_m"),
        ({"kind": "rough", "amplitude_m": -0.1}, "amplitude_m"),
        ({"kind": "rough", "spacing_m": 0.0}, "spacing_m"),
        ({"kind": "blocks", "riser_m": 0.01}, "riser_m"),
        ({"kind": "blocks", "riser_m": 2.0}, "riser_m"),
        ({"kind": "ramp", "increment": "steep"}, "increment"),
        ({"kind": "ramp", "direction": "left"}, "direction"),
        ({"kind": "stairs", "run_m": 0.01}, "run_m"),
        ({"kind": "stairs", "rise": 0.1}, "rise"),
        ({"kind": "file"}, "file"),
        ({"kind": "file", "file": "no/such/table.csv"}, "file"),
    ],
)
def test_a_bad_terrain_is_named(data: dict[str, object], field: str) -> None:
    error = refused(lambda: read_terrain(Table(data, "terrain"), SEED))
    assert error.field == f"terrain.{field}"


def test_the_body_table_becomes_one_body() -> None:
    found = read_bodies(Table({"disturbance": 0.15}, "body"), SEED)
    np.testing.assert_array_equal(found.mass_kg, Bodies.disturbed([SEED]).mass_kg)
    np.testing.assert_array_equal(read_bodies(Table({}), SEED).com_m, Bodies.nominal().com_m)


@pytest.mark.parametrize(
    ("data", "field"),
    [({"disturbance": 0.95}, "disturbance"), ({"mass": 80}, "mass")],
)
def test_a_bad_body_is_named(data: dict[str, object], field: str) -> None:
    error = refused(lambda: read_bodies(Table(data, "body"), SEED))
    assert error.field == f"body.{field}"
