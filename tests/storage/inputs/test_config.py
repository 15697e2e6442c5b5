"""TOML read strictly: each value is checked, each mistake named with its key."""

import re
from pathlib import Path

import pytest

from storage.inputs.config import Table, read_toml
from storage.inputs.errors import InputError
from tests.cases import ASSETS, cases


def refused(call):
    with pytest.raises(InputError) as caught:
        call()
    return caught.value


@pytest.mark.parametrize("content", [b"name = ", b"a = 1\na = 2\n", b"\xff\xfe"])
def test_a_file_that_is_not_toml_or_is_missing_is_refused(tmp_path, content):
    path = tmp_path / "bad.toml"
    path.write_bytes(content)
    error = refused(lambda: read_toml(path))
    assert error.field == "config" and "readable TOML file" in error.allowed
    assert "none.toml" in str(refused(lambda: read_toml(tmp_path / "none.toml")))


HILLS = (ASSETS / "hill.toml").read_text()


@pytest.mark.parametrize("name", [".", "..", ".-x", "-x", "..-x"])
def test_a_name_that_no_file_has_is_refused(name):
    with pytest.raises(InputError, match=r"^config: "):
        read_toml(Path(name))


@pytest.mark.parametrize(
    ("file", "terrain"),
    [
        ("hill", {"kind": "ramp", "increment": 0.04, "direction": "up"}),
        ("hill-steep", {"kind": "ramp", "increment": 0.08, "direction": "up"}),
        ("hill-rough", {"kind": "rough"}),
        ("hill-steep-down", {"kind": "ramp", "increment": 0.08, "direction": "down"}),
    ],
)
def test_variants_lie_over_a_file(tmp_path, file, terrain):
    (tmp_path / "hill.toml").write_text(HILLS)
    assert read_toml(tmp_path / f"{file}.toml").unread == {
        "name": file,
        "terrain": terrain,
    }
    (tmp_path / f"{file}.toml").write_text("seed = 3")
    assert read_toml(tmp_path / f"{file}.toml").unread == {"seed": 3}


@cases("refused-variants.toml", "text", "file", "message")
def test_variants_that_are_refused(tmp_path, text, file, message):
    (tmp_path / "hill.toml").write_text(text.replace("HILLS", HILLS))
    error = refused(lambda: read_toml(tmp_path / f"{file}.toml"))
    assert re.search(message, str(error))


def test_values_within_range_are_returned_and_defaults_of_missing_keys():
    table = Table({"a": 1, "b": 2, "c": "up", "d": False, "e": [1, 2], "f": ["x", "y"]})
    numbers = (table.number("a", low=0, high=1), *table.range("e", (0, 0), 1, 2))
    assert numbers == (1.0, 1.0, 2.0) and {type(number) for number in numbers} == {
        float
    }
    assert table.integer("b", low=2, high=2) == 2
    assert table.text("c", choices=("up", "down")) == "up"
    assert table.boolean("d") is False
    assert table.texts("f", ("x", "y", "z")) == ("x", "y")
    table.done()
    table = Table({})
    assert (table.number("a", 0.5), table.integer("b", 7), table.text("c", "x")) == (
        0.5,
        7,
        "x",
    )
    assert table.boolean("d", True) is True
    assert (table.range("e", (1, 2), 0, 9), table.texts("f")) == ((1.0, 2.0), ())
    table.table("g").done()
    table.done()


def test_a_key_that_may_be_missing_is_among_those_that_are_allowed():
    table = Table({"succes": 1.0, "most": 2.0})
    assert table.has("most") and not table.has("success")
    table.number("most")
    error = refused(table.done)
    assert (error.field, error.allowed) == ("succes", "only the keys most, success")


PAIR = "[lowest, highest], two numbers from 0 to 9"
NAN, INF = float("nan"), float("inf")
BAD_VALUES = [
    (["1", True, NAN, INF, 10**400], lambda t: t.number("key"), "a number"),
    ([-0.1, 1.1], lambda t: t.number("key", low=0.0, high=1.0), "a number from 0 to 1"),
    (
        [[1.0], [2, 1], [-1, 1], [0, 10**400], [0, NAN], "12"],
        lambda t: t.range("key", (0, 1), 0, 9),
        PAIR,
    ),
    ([1.0, True], lambda t: t.integer("key"), "a whole number"),
    ([0, 10], lambda t: t.integer("key", low=1, high=9), "a whole number from 1 to 9"),
    ([3], lambda t: t.text("key"), "a string"),
    (["left"], lambda t: t.text("key", choices=("up", "down")), "up or down"),
    ([1], lambda t: t.boolean("key"), "true or false"),
    (["x", ["x", "x"]], lambda t: t.texts("key"), "a list of names, each once"),
    ([1], lambda t: t.table("key"), "a table"),
]


@pytest.mark.parametrize(("values", "read", "allowed"), BAD_VALUES)
def test_wrong_values(values, read, allowed):
    for value in values:
        error = refused(lambda value=value: read(Table({"key": value}, "outer")))
        assert error.field == "outer.key"
        assert error.value is value
        assert error.allowed.startswith(allowed)


@pytest.mark.parametrize(
    "read", [Table.number, Table.integer, Table.text, Table.boolean]
)
def test_a_required_key_that_is_missing_is_named(read):
    error = refused(lambda: read(Table({}, "outer"), "key"))
    assert (error.field, error.value) == ("outer.key", "missing")


def test_an_unknown_key_is_named_by_its_path_with_the_known_ones():
    table = Table({"seed": 1, "sed": 2}, "body")
    table.integer("seed")
    error = refused(table.done)
    assert error.field == "body.sed"
    assert "seed" in error.allowed
    outer = Table({"a": {"b": {"c": 1}}})
    assert refused(outer.table("a").table("b").done).field == "a.b.c"
