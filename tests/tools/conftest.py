"""Commands in this process: what they print, and their refusals in one line."""

import json
import re
import sqlite3
from contextlib import closing
from itertools import chain

import pytest

import taichi_nmm
from storage.databases import studies
from tests.study import fake_walker
from tests.tools.running import run_tool


class Tool:
    """Runs commands; `out` and `err` are what the last one printed."""

    def __init__(self, patch, capture):
        self._patch, self._capture = patch, capture
        self.out = self.err = ""

    def __call__(self, name, *words):
        """The exit code."""
        self._capture.readouterr()
        code = run_tool(self._patch, name, *words)
        self.out, self.err = self._capture.readouterr()
        return code

    def json(self, name, *words):
        """The one object that --json prints."""
        assert self(name, *words, "--json") == 0, self.err
        return json.loads(self.out)

    def refuses(self, message, name, *words):
        """Exit code 2, and one line that begins with the message, a regular expression."""
        assert self(name, *words) == 2, self.out
        assert (self.out, self.err.count("\n")) == ("", 1), self.err
        assert re.match(f"error: {message}", self.err), self.err


class Command:
    """One command with its options, which a call may change, or leave out by ""."""

    def __init__(self, tool, folder, *words, **options):
        self.tool, self.folder, self.out = tool, folder, folder / "out"
        self.url = f"sqlite:///{folder / 'studies.db'}"
        self._words, self._options = words, {"out": self.out} | options

    def words(self, **changes):
        options = {
            key: value
            for key, value in (self._options | changes).items()
            if value != ""
        }
        pairs = (
            (f"--{key.replace('_', '-')}", str(value)) for key, value in options.items()
        )
        return [*self._words, *chain.from_iterable(pairs)]

    def run(self, **changes):
        """The exit code."""
        return self.tool(*self.words(**changes))

    def json(self, **changes):
        return self.tool.json(*self.words(**changes))

    def refuses(self, message, **changes):
        self.tool.refuses(message, *self.words(**changes))


@pytest.fixture
def tool(monkeypatch, capsys):
    return Tool(monkeypatch, capsys)


@pytest.fixture
def simulator(monkeypatch):
    """Replaces the simulator: by the fake walker, and later by whatever is given."""

    # Not setattr: it would read the old value first, which loads Taichi.
    def replace(simulate):
        monkeypatch.setitem(vars(taichi_nmm), "simulate", simulate)

    replace(fake_walker.simulate)
    fake_walker.calls.clear()
    return replace


@pytest.fixture
def database(tmp_path, monkeypatch):
    """Another program's connection to studies.db, for which nobody waits long."""
    monkeypatch.setattr(studies, "BUSY_TIMEOUT_S", 0.1)
    file = tmp_path / "studies.db"
    with closing(sqlite3.connect(file, isolation_level=None)) as connection:
        yield connection
