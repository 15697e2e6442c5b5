"""A fake simulator, stores made with it, a table of synthetic rows, and toy comparisons."""

import numpy as np
import optuna
import pyarrow.parquet as pq
import pytest

import taichi_nmm
from study import FeatureTable
from study.experiment import compare as comparing
from study.experiment.compare import Request, compare
from tests.cases import refused as refused  # where others look for it
from tests.study import fake_walker

optuna.logging.set_verbosity(optuna.logging.ERROR)


@pytest.fixture
def fake_simulator(monkeypatch):
    # Not setattr: it would read the old value first, which loads Taichi.
    monkeypatch.setitem(vars(taichi_nmm), "simulate", fake_walker.simulate)
    fake_walker.calls.clear()


@pytest.fixture
def store(fake_simulator, tmp_path):
    """200 rows, scored on level ground."""
    path = tmp_path / "plain-store"
    fake_walker.write_plain_store(path)
    return path


@pytest.fixture
def table():
    """60 rows of two parameters; the score says how good a row is."""
    rng = np.random.default_rng(0)
    a, b = rng.uniform(-1, 1, 60), rng.uniform(0, 5, 60)
    return FeatureTable.from_arrays(
        {"a": a, "b": b}, np.abs(a), bounds={"a": (-1, 1), "b": (0, 5)}
    )


@pytest.fixture
def toy(fake_simulator, tmp_path):
    """The toy experiment, with a store on which every arm can run."""
    return fake_walker.experiment(tmp_path)


class Comparisons:
    """Comparisons of the toy experiment, each call in a folder by name."""

    def __init__(self, folder):
        self.folder = folder
        self.experiment = fake_walker.experiment(folder)

    def run(self, out, *, experiment=None, **request):
        """Run it, or what is missing of it, in this process."""
        made = Request(self.folder / out, **request)
        return compare(experiment or self.experiment, made, lambda progress: None)

    def stop_and_run(self, out, call, **request):
        """Run it to its end, and return how often Ctrl-C stopped it, in that call each time."""
        stops = 0
        with pytest.MonkeyPatch.context() as patch:
            while True:
                patch.setitem(
                    vars(taichi_nmm), "simulate", fake_walker.stopped_in_call(call)
                )
                try:
                    self.run(out, **request)
                    return stops
                except KeyboardInterrupt:
                    stops += 1

    def content(self, out):
        """The bytes of the results."""
        return (self.folder / out / "trials.parquet").read_bytes()

    def table(self, out):
        """The results."""
        return pq.read_table(self.folder / out / "trials.parquet")


@pytest.fixture
def no_database(monkeypatch):
    """It has tests of its own; with comparisons it would take most of the time."""
    for name in ("check_database", "export", "note_worths"):
        monkeypatch.setattr(comparing, name, lambda *_, **__: None)


@pytest.fixture
def comparisons(fake_simulator, no_database, tmp_path):
    return Comparisons(tmp_path)
