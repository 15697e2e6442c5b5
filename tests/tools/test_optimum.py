"""taichi-nmm optimum: convergence on a known problem, resuming, results, refusals."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

import taichi_nmm
from storage.folder import claimed
from storage.tables import write_stamped
from study.comparison import compare, optimum
from study.comparison.optimum import CUT, asked_gains, ended, new_run
from study.experiment.experiment import CmaesOptions, read_experiment
from taichi_nmm.parameters import GAIN_NAMES, lower_bounds, upper_bounds
from taichi_nmm.result import COMPLETED, FELL, RESULT_DTYPE, Result
from tests.study import fake_walker
from tests.tools.running import ROOT, run_tool

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
duration_s = {duration}
[cmaes]
tolerance = 1e-2
max_generations = {generations}
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


class Command:
    """The command in this process, with the fake simulator."""

    def __init__(self, folder: Path, patch: pytest.MonkeyPatch) -> None:
        self.folder = folder
        self.patch = patch

    def config(self, generations: int = 300, duration: float = 100.0) -> Path:
        path = self.folder / f"tiny-{generations}.toml"
        store = self.folder / "store"
        text = CONFIG.format(store=store, generations=generations, duration=duration)
        path.write_text(text)
        return path

    def run(self, *arguments: object) -> int:
        return run_tool(self.patch, "optimum", "--workers", 1, *arguments)


@pytest.fixture
def command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Command:
    # Not setattr: it would read the old value first, which loads Taichi.
    monkeypatch.setitem(vars(taichi_nmm), "simulate", fake_walker.simulate)
    fake_walker.write_plain_store(tmp_path / "store")
    monkeypatch.setitem(vars(taichi_nmm), "simulate", simulate)
    # The database is the comparison's; the last test has it.
    monkeypatch.setattr(compare, "check_database", lambda *_: None)
    monkeypatch.setattr(compare, "export", lambda *_, **__: None)
    return Command(tmp_path, monkeypatch)


def test_a_run_converges_to_the_optimum_by_its_own_criteria() -> None:
    search = new_run(OPTIONS, 1, 0)
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


def test_a_run_that_does_not_converge_is_cut() -> None:
    search = new_run(OPTIONS, 1, 0)
    assert ended(search, 1) == ""
    search.tell(bowl(asked_gains(search)))
    assert ended(search, 1) == CUT
    assert ended(search, 2) == ""


def test_the_result_is_the_best_of_both_methods(
    command: Command, capsys: pytest.CaptureFixture[str]
) -> None:
    out = command.folder / "out"
    optuna.logging.set_verbosity(optuna.logging.INFO)
    assert command.run("--config", command.config(), "--out", out, "--json") == 0
    assert optuna.logging.get_verbosity() == optuna.logging.WARNING  # its lines are not among ours
    printed = capsys.readouterr()
    document = json.loads((out / "optimum.json").read_text())
    assert json.loads(printed.out) == document
    assert "cmaes: generation 5, 3 of 3 runs go on, 180 evaluations" in printed.err
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


def files(folder: Path) -> dict[str, bytes]:
    names = ("runs.parquet", "evaluations.parquet", "dog/trials.parquet", "search.json")
    return {name: (folder / name).read_bytes() for name in names}


def stopping_after(calls: int) -> Callable[..., Result]:
    """The simulator until somebody presses Ctrl-C."""
    left = iter(range(calls))

    def simulate_or_stop(gains: Any, **options: Any) -> Result:
        if next(left, None) is None:
            raise KeyboardInterrupt
        return simulate(gains, **options)

    return simulate_or_stop


def test_stopped_and_resumed_is_bit_equal(command: Command) -> None:
    whole, parts = command.folder / "whole", command.folder / "parts"
    config = command.config(generations=40)
    assert command.run("--config", config, "--out", whole) == 0
    for calls in (2, 9):  # in the sampler's trials, then in the generations
        command.patch.setitem(vars(taichi_nmm), "simulate", stopping_after(calls))
        assert command.run("--config", config, "--out", parts) == 130
        assert not (parts / "optimum.json").exists()
    command.patch.setitem(vars(taichi_nmm), "simulate", simulate)
    assert command.run("--config", config, "--out", parts) == 0
    assert files(parts) == files(whole)


def test_more_runs_and_generations_can_be_asked_for_later(
    command: Command, capsys: pytest.CaptureFixture[str]
) -> None:
    at_once, later = command.folder / "at-once", command.folder / "later"
    many = command.config(generations=9)
    assert command.run("--config", many, "--out", at_once) == 0
    assert command.run("--config", many, "--out", later, "--runs", 1, "--max-generations", 5) == 0
    assert "1 by max_generations" in capsys.readouterr().out
    assert command.run("--config", many, "--out", later) == 0
    assert files(later) == files(at_once)


def test_results_do_not_depend_on_how_work_is_cut(
    command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    config, whole, cut = command.config(generations=9), command.folder / "a", command.folder / "b"
    assert command.run("--config", config, "--out", whole) == 0
    for module, name, size in (
        (optimum, "BLOCK_RUNS", 2), (optimum, "STRETCH_GENERATIONS", 2),
        (compare, "BLOCK_STUDIES", 2), (compare, "STRETCH_TRIALS", 3),
    ):  # fmt: skip
        monkeypatch.setattr(module, name, size)
    assert command.run("--config", config, "--out", cut) == 0
    assert files(cut) == files(whole)


def test_bad_input_is_one_line_and_nothing_is_made(
    command: Command, capsys: pytest.CaptureFixture[str]
) -> None:
    config, out = command.config(), command.folder / "out"
    foreign = command.folder / "foreign"
    foreign.mkdir()
    (foreign / "thesis.tex").write_text("")
    variants = {
        "cmaes.sigma": ("tolerance = 1e-2", "sigma = 2.0"),
        "cmaes.population": ("tolerance = 1e-2", "population = 2"),
        "cmaes.patience": ("tolerance = 1e-2", "patience = 2"),
        "objective.cost": ('"walking"', '"fast"'),
        "store": (str(command.folder / "store"), str(command.folder / "no-store")),
        "stores.flat": ("flat =", "diverse ="),
        "terrain.kind": ("[cmaes]", '[terrain]\nkind = "rough"\n[cmaes]'),
        "body.disturbance": ("[cmaes]", "[body]\ndisturbance = 0.15\n[cmaes]"),
        "searched": ("seed = 5", 'seed = 5\nsearched = ["theta_ref"]'),
        "trials": ("trials = 4", "trials = 100000"),
        "name": ('"tiny"', '"a/b"'),
    }
    cases: list[tuple[str, tuple[object, ...]]] = [
        ("config", ("--config", command.folder / "none.toml", "--out", out)),
        ("runs", ("--config", config, "--out", out, "--runs", 0)),
        ("out", ("--config", config, "--out", foreign)),
        ("max-generations", ("--config", config, "--out", out, "--max-generations", 0)),
    ]
    for number, (field, (old, new)) in enumerate(variants.items()):
        path = command.folder / f"bad-{number}.toml"
        path.write_text(config.read_text().replace(old, new))
        cases.append((field, ("--config", path, "--out", out)))
    for field, arguments in cases:
        assert command.run(*arguments) == 2, field
        lines = capsys.readouterr().err.strip().splitlines()
        assert len(lines) == 1, lines
        assert lines[0].startswith(f"error: {field}: "), lines
    assert not out.exists()


def test_another_configuration_or_a_foreign_evaluation_is_refused(
    command: Command, capsys: pytest.CaptureFixture[str]
) -> None:
    config, out = command.config(generations=3), command.folder / "out"
    assert command.run("--config", config, "--out", out) == 0
    before = files(out)
    other = command.folder / "other.toml"
    other.write_text(config.read_text().replace("seed = 5", "seed = 6"))
    capsys.readouterr()
    assert command.run("--config", other, "--out", out) == 2
    assert "error: seed: 6" in capsys.readouterr().err
    assert files(out) == before
    table = pq.read_table(out / "evaluations.parquet")
    moved = pc.add(table["K_GAS"], 1e-9)
    table = table.set_column(
        table.schema.get_field_index("K_GAS"), table.schema.field("K_GAS"), moved
    )
    pq.write_table(table, out / "evaluations.parquet")
    assert command.run("--config", config, "--out", out) == 2
    assert "does not fit the digest" in capsys.readouterr().err
    document = json.loads((out / "search.json").read_text())
    write_stamped(out / "evaluations.parquet", table.replace_schema_metadata(None), document)
    assert command.run("--config", config, "--out", out) == 2
    assert "run 0 in" in capsys.readouterr().err
    (out / "evaluations.parquet").write_bytes(b"PAR1")
    assert command.run("--config", config, "--out", out) == 2
    assert capsys.readouterr().err.count("\n") == 1  # before the comparison says how far it is


def test_two_processes_do_not_share_a_folder(
    command: Command, capsys: pytest.CaptureFixture[str]
) -> None:
    config, out = command.config(), command.folder / "out"
    with claimed(out, "search.json", "one of this command"):
        assert command.run("--config", config, "--out", out) == 2
    assert "no other process" in capsys.readouterr().err


def test_what_a_kill_leaves_behind_goes_on_to_the_same_end(
    command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A process killed in the third generation leaves the checkpoint of the second."""
    monkeypatch.setattr(compare, "CHECKPOINT_S", 0.0)
    monkeypatch.setattr(optimum, "STRETCH_GENERATIONS", 1)
    seen: list[int] = []
    killed = command.folder / "killed"
    config, out = command.config(generations=3), command.folder / "out"

    def simulate_and_look(gains: Any, **options: Any) -> Result:
        path = out / "evaluations.parquet"
        seen.append(pq.read_metadata(path).num_rows if path.exists() else 0)
        if seen[-1] == 72:
            shutil.copytree(out, killed)
            (killed / ".evaluations.parquet.1.tmp").write_bytes(b"half")
        return simulate(gains, **options)

    command.patch.setitem(vars(taichi_nmm), "simulate", simulate_and_look)
    assert command.run("--config", config, "--out", out) == 0
    assert seen == [0] * 4 + [0, 36, 72]  # four trials, three generations
    command.patch.setitem(vars(taichi_nmm), "simulate", simulate)
    assert command.run("--config", config, "--out", killed) == 0
    assert files(killed) == files(out)
    assert not list(killed.glob(".*.tmp"))


@pytest.mark.parametrize("cost", ["smooth", "walking"])
def test_the_configurations_that_ship_are_read(cost: str) -> None:
    experiment = read_experiment(ROOT / "configs" / f"optimum-{cost}.toml")
    assert experiment.cost == cost
    assert (experiment.runs, experiment.trials) == (50, 100)
    assert experiment.conditions.disturbance == 0.0
    assert np.ptp(experiment.terrain(0).height_m) == 0.0


def test_with_the_real_simulator(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One generation of two short runs: what it costs is what a walk of these gains costs."""
    monkeypatch.setitem(vars(taichi_nmm), "simulate", fake_walker.simulate)
    fake_walker.write_plain_store(tmp_path / "store")
    monkeypatch.delitem(vars(taichi_nmm), "simulate")
    command = Command(tmp_path, monkeypatch)
    config = command.config(generations=1, duration=1.0)
    out = tmp_path / "out"
    assert command.run("--config", config, "--out", out, "--runs", 2) == 0
    table = pq.read_table(out / "evaluations.parquet")
    gains = np.column_stack([table[name].to_numpy() for name in GAIN_NAMES])
    rows = taichi_nmm.simulate(gains, duration_s=1.0).rows
    np.testing.assert_array_equal(table["cost"].to_numpy(), taichi_nmm.walking_cost(rows))
