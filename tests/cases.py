"""Cases of tests that are data, in files of tests/assets."""

import tomllib
from pathlib import Path
from typing import Any

import pytest

ASSETS = Path(__file__).resolve().parent / "assets"


def asset(name: str) -> dict[str, Any]:
    """What a TOML file has."""
    return tomllib.loads((ASSETS / name).read_text(encoding="utf-8"))


def cases(name: str, *columns: str) -> pytest.MarkDecorator:
    """A test of each table of a TOML file, with these of its values; the table's name is its id."""
    rows = asset(name)
    values = [[row[column] for column in columns] for row in rows.values()]
    return pytest.mark.parametrize(columns, values, ids=rows)
