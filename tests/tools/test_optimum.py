"""taichi-nmm optimum: convergence on a known problem, resuming, results, refusals."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

import taichi_nmm
from storage.tables import write_stamped
from study.experiment import compare, optimum
from study.experiment.experiment import CmaesOptions
from study.experiment.optimum import CUT, asked_gains, ended, new_run
from taichi_nmm.parameters import GAIN_NAMES, lower_bounds, upper_bounds
from taichi_nmm.result import COMPLETED, FELL, RESULT_DTYPE, Result
from tests.study import fake_walker
from tests.tools.conftest import Command, Simulator, Tool

pytestmark = pytest.mark.slow

OPTIONS = CmaesOptions(sigma=0.3, population=0, tolerance=1e-3, max_generations=300)
CONFIG = """
name = "tiny"
seed = 5
runs = 3
trials = 4
arms = ["dog"]
[objective]
cost = "walking"
[simulation]
duration_s = 100.0
[cmaes]
tolerance = 1e-2
max_generations = 300
[stores]
flat = "{store}"
"""


def bowl(gains: Any) -> np.ndarray:
    """Distance from the point at 0.3 of every range, 0 to about 2."""
    unit = (np.asarray(gains) - lower_bounds()) / (upper_bounds() - lower_bounds())
    return np.mean((unit - 0.3) ** 2, axis=1) / 0.1


def simulate(gains: Any, *, duration_s: float, **_: Any) -> Result:
    """Walks at human speed near the bowl's bottom; the cost of transport is the depth."""
    depth = bowl(gains)
    rows = np.zeros(len(gains), RESULT_DTYPE)
    rows["end_reason"] = np.where(depth < 0.5, COMPLETED, FELL)
    rows["duration_s"] = np.where(depth < 0.5, duration_s, 1.0)
    rows["mean_speed_mps"] = 1.3
    rows["distance_m"] = rows["duration_s"] * 1.3 - depth
    rows["cost_of_transport_jpkgpm"] = 4.0 + depth
    return Result(rows, metadata={"engine": "fake"})


class Search(Command):
    """The command, with the fake simulator."""

    def files(self, out: str = "out", **changes: object) -> dict[str, bytes]:
        """What it has made when it has ended."""
        assert self.run(out=self.folder / out, **changes) == 0
        return files(self.folder / out)


def files(folder: Path) -> dict[str, bytes]:
    names = ("runs.parquet", "evaluations.parquet", "dog/trials.parquet", "search.json")
    return {name: (folder / name).read_bytes() for name in names}


@pytest.fixture
def command(
    tmp_path: Path, tool: Tool, simulator: Simulator, monkeypatch: pytest.MonkeyPatch
) -> Search:
    # The database is the comparison's; the last test has it.
    monkeypatch.setattr(compare, "check_database", lambda *_: None)
    monkeypatch.setattr(compare, "export", lambda *_, **__: None)
    fake_walker.write_plain_store(tmp_path / "store")
    simulator(simulate)
    config = tmp_path / "tiny.toml"
    config.write_text(CONFIG.format(store=tmp_path / "store"))
    return Search(tool, tmp_path, "optimum", workers=1, config=config)


def test_a_run_ends_by_its_own_criteria_or_is_cut() -> None:
    search = new_run(OPTIONS, 1, 0)
    assert ended(search, 1) == ""
    search.tell(bowl(asked_gains(search)))
    assert (ended(search, 1), ended(search, 2)) == (CUT, "")
    best = np.inf
    while not ended(search, OPTIONS.max_generations):
        costs = bowl(asked_gains(search))
        best = min(best, float(costs.min()))
        search.tell(costs)
    assert best < 1e-3
    assert ended(search, OPTIONS.max_generations) == "tolfun"
    assert 30 < search.generation < 300


def test_runs_differ_by_number_and_seed_and_by_nothing_else() -> None:
    def first(seed: int, run: int) -> np.ndarray:
        np.random.seed(seed + run)  # the global state must not matter
        search = new_run(OPTIONS, seed, run)
        search.tell(bowl(asked_gains(search)))
        return asked_gains(search)

    np.testing.assert_array_equal(first(1, 0), first(1, 0))
    assert not np.array_equal(first(1, 0), first(1, 1))
    assert not np.array_equal(first(1, 0), first(2, 0))


def test_points_are_within_the_bounds_and_population_is_the_librarys() -> None:
    search = new_run(CmaesOptions(1.0, 0, 1e-3, 10), 3, 0)
    for _ in range(5):
        points = asked_gains(search)
        assert points.shape == (12, 16)
        assert np.all((lower_bounds() <= points) & (points <= upper_bounds()))
        search.tell(bowl(points))
    assert new_run(CmaesOptions(0.3, 30, 1e-3, 10), 3, 0).ask().shape == (30, 16)


def test_the_result_is_the_best_of_both_methods(command: Search) -> None:
    out = command.out
    optuna.logging.set_verbosity(optuna.logging.INFO)
    document = command.json()
    assert optuna.logging.get_verbosity() == optuna.logging.WARNING  # its lines are not among ours
    assert json.loads((out / "optimum.json").read_text()) == document
    assert "cmaes: generation 5, 3 of 3 runs go on, 180 evaluations" in command.tool.err
    runs = pq.read_table(out / "runs.parquet")
    assert runs["method"].to_pylist() == ["cmaes"] * 3 + ["dog"] * 3
    assert document["best_cost"] == min(runs["cost"].to_pylist()) < 4.01
    assert document["method"] == "cmaes" and document["cost"] == "walking"
    gains = np.array([[document["gains"][name] for name in GAIN_NAMES]])
    assert document["best_cost"] == pytest.approx(4.0 + bowl(gains)[0])
    assert document["methods"]["dog"]["evaluations"] == 12
    assert document["methods"]["cmaes"]["stops"] == {"tolfun": 3}
    evaluations = pq.read_table(out / "evaluations.parquet")
    assert document["methods"]["cmaes"]["evaluations"] == len(evaluations)
    for run in range(3):
        own = evaluations.filter(pc.equal(evaluations["run"], run))
        assert runs["cost"][run].as_py() == min(own["cost"].to_pylist())
    assert {"date", "machine", "wall_s", "config"} <= document.keys()


def test_stopped_and_resumed_is_bit_equal(command: Search, simulator: Simulator) -> None:
    whole = command.files("whole", max_generations=40)

    def simulate_or_stop(gains: Any, **options: Any) -> Result:
        if next(left, None) is None:
            raise KeyboardInterrupt
        return simulate(gains, **options)

    simulator(simulate_or_stop)
    for calls in (2, 9):  # in the sampler's trials, then in the generations
        left = iter(range(calls))
        assert command.run(max_generations=40) == 130
        assert not (command.out / "optimum.json").exists()
    simulator(simulate)
    assert command.files(max_generations=40) == whole


def test_more_runs_and_generations_can_be_asked_for_later(command: Search) -> None:
    at_once = command.files("at-once", max_generations=9)
    assert command.run(runs=1, max_generations=5) == 0
    assert "1 by max_generations" in command.tool.out
    assert command.files(max_generations=9) == at_once


@pytest.mark.parametrize(("field", "old", "new"), [
    ("cmaes.sigma", "tolerance = 1e-2", "sigma = 2.0"), ("store", "/store", "/no-store"),
    ("cmaes.population", "tolerance = 1e-2", "population = 2"),
    ("cmaes.patience", "tolerance = 1e-2", "patience = 2"), ("name", '"tiny"', '"a/b"'),
    ("objective.cost", '"walking"', '"fast"'), ("stores.flat", "flat =", "diverse ="),
    ("terrain.kind", "[cmaes]", '[terrain]\nkind = "rough"\n[cmaes]'),
    ("body.disturbance", "[cmaes]", "[body]\ndisturbance = 0.15\n[cmaes]"),
    ("searched", "seed = 5", 'seed = 5\nsearched = ["theta_ref"]'),
    ("trials", "trials = 4", "trials = 100000"),
])  # fmt: skip
def test_a_bad_configuration_makes_nothing(field: str, old: str, new: str, command: Search) -> None:
    config = command.folder / "tiny.toml"
    assert old in config.read_text()
    config.write_text(config.read_text().replace(old, new))
    command.refuses(f"{field}: ")
    assert not command.out.exists()


def test_a_folder_of_somebody_else_or_of_another_process(command: Search) -> None:
    command.out.mkdir()
    (command.out / "thesis.tex").write_text("")
    command.refuses("out: ")
    assert [path.name for path in command.out.iterdir()] == ["thesis.tex"]
    filled = command.folder / "filled"
    with optimum.OptimumFolder.claim(filled, {key: {} for key in optimum.GROWING}):
        command.refuses(".*no other process", out=filled)


def test_another_configuration_or_a_damaged_evaluation_is_refused(command: Search) -> None:
    before = command.files(max_generations=3)
    other = command.folder / "other.toml"
    other.write_text((command.folder / "tiny.toml").read_text().replace("seed = 5", "seed = 6"))
    command.refuses("seed: 6", config=other, max_generations=3)
    assert files(command.out) == before
    evaluations = command.out / "evaluations.parquet"
    table = pq.read_table(evaluations)
    place = table.schema.get_field_index("K_GAS")
    table = table.set_column(place, table.schema.field(place), pc.add(table["K_GAS"], 1e-9))
    pq.write_table(table, evaluations)
    command.refuses(".*does not fit the digest", max_generations=3)
    document = json.loads((command.out / "search.json").read_text())
    write_stamped(evaluations, table.replace_schema_metadata(None), document)
    assert command.run(max_generations=3) == 2
    assert "out: 'run 0 in" in command.tool.err and "these settings" in command.tool.err
    evaluations.write_bytes(b"PAR1")
    command.refuses("", max_generations=3)  # before the comparison says how far it is


def test_what_a_kill_leaves_behind_goes_on_to_the_same_end(
    command: Search, simulator: Simulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A process killed in the third generation leaves the checkpoint of the second."""
    monkeypatch.setattr(compare, "CHECKPOINT_S", 0.0)
    monkeypatch.setattr(optimum, "STRETCH_GENERATIONS", 1)
    seen: list[int] = []
    out, killed = command.out, command.folder / "killed"

    def simulate_and_look(gains: Any, **options: Any) -> Result:
        path = out / "evaluations.parquet"
        seen.append(pq.read_metadata(path).num_rows if path.exists() else 0)
        if seen[-1] == 72:
            shutil.copytree(out, killed)
            (killed / ".evaluations.parquet.1.tmp").write_bytes(b"half")
        return simulate(gains, **options)

    simulator(simulate_and_look)
    whole = command.files(max_generations=3)
    assert seen == [0] * 4 + [0, 36, 72]  # four trials, three generations
    simulator(simulate)
    assert command.files("killed", max_generations=3) == whole
    assert not list(killed.glob(".*.tmp"))


def test_with_the_real_simulator(command: Search, monkeypatch: pytest.MonkeyPatch) -> None:
    """One generation of two short runs: what it costs is what a walk of these gains costs."""
    monkeypatch.undo()
    config = command.folder / "tiny.toml"
    config.write_text(config.read_text().replace("100.0", "1.0"))
    assert command.run(runs=2, max_generations=1) == 0
    table = pq.read_table(command.out / "evaluations.parquet")
    gains = np.column_stack([table[name].to_numpy() for name in GAIN_NAMES])
    rows = taichi_nmm.simulate(gains, duration_s=1.0).rows
    np.testing.assert_array_equal(table["cost"].to_numpy(), taichi_nmm.walking_cost(rows))
