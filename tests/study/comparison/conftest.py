"""The fake simulator, and a comparison in a folder of its own."""

from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import taichi_nmm
from study.comparison import command, lockstep
from study.comparison.command import Outcome, Request, compare
from study.comparison.experiment import Experiment
from tests.study.comparison import fake


@pytest.fixture
def fake_walker(monkeypatch: pytest.MonkeyPatch) -> None:
    # Not setattr: it would read the old value first, which loads Taichi.
    monkeypatch.setitem(vars(taichi_nmm), "simulate", fake.simulate)
    monkeypatch.setattr(lockstep, "Pool", fake.LocalPool)
    fake.calls.clear()


class Comparisons:
    """Comparisons of the toy experiment, each call in a folder by name."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.experiment = fake.experiment(folder)

    def run(self, out: str, *, experiment: Experiment | None = None, **request: Any) -> Outcome:
        """Run it, or what is missing of it."""
        options: dict[str, Any] = {
            "storage": None, "arms": None, "runs": None, "trials": None, "workers": 2,
            "artifacts": False,
        }  # fmt: skip
        made = Request(self.folder / out, **(options | request))
        return compare(experiment or self.experiment, made, lambda progress: None)

    def content(self, out: str) -> bytes:
        """The bytes of the results."""
        return (self.folder / out / "trials.parquet").read_bytes()

    def table(self, out: str) -> pa.Table:
        """The results."""
        return pq.read_table(self.folder / out / "trials.parquet")


@pytest.fixture
def comparisons(fake_walker: None, tmp_path: Path) -> Comparisons:
    return Comparisons(tmp_path)


@pytest.fixture(autouse=True)
def no_database(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """The database has tests of its own; here it would take most of the time."""
    if "database" not in request.module.__name__:
        monkeypatch.setattr(command, "check_database", lambda *_: None)
        monkeypatch.setattr(command, "export", lambda *_, **__: None)
