"""Cases of tests that are data, in files of tests/assets."""

import tomllib
from pathlib import Path

import pytest

from storage.inputs.errors import InputError

ASSETS = Path(__file__).resolve().parent / "assets"


def asset(name):
    """What a TOML file has."""
    return tomllib.loads((ASSETS / name).read_text(encoding="utf-8"))


def cases(name, *columns):
    """A test of each table of a TOML file, with these of its values; the table's name is its id."""
    rows = asset(name)
    values = [[row[column] for column in columns] for row in rows.values()]
    return pytest.mark.parametrize(columns, values, ids=rows)


def refused(message):
    """As an error of the user's, which is always one line."""
    return pytest.raises(InputError, match=message)
