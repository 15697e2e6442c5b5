"""CMA-ES until convergence: the same runs however they are cut, interrupted and replayed."""

from dataclasses import replace
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pytest

import taichi_nmm
from storage.pool import IN_PROCESS, InProcess, Pool
from study.comparison import optimum
from study.comparison.optimum import (
    EVALUATIONS,
    OptimumFolder,
    Stretch,
    estimate,
    evolve,
    run_cmaes,
)  # fmt: skip
from study.experiment.experiment import CmaesOptions, Experiment
from taichi_nmm.terrain import Ground
from tests.study import fake_walker
from tests.study.comparison.fake_results import experiment
from tests.study.conftest import refused

RUNS = 3
DOCUMENT = {"arms": {}, "stores": {}, "ground": {}}
NOTHING = EVALUATIONS.empty_table()
Found = tuple[list[dict[str, object]], list[str]]


@pytest.fixture
def level(fake_simulator: None) -> Experiment:
    """Level ground, the undisturbed body, and a CMA-ES of seven generations of four."""
    cmaes = CmaesOptions(population=4, max_generations=7)
    return experiment(ground=Ground("flat"), disturbance=0.0, cmaes=cmaes)


def run(of: Experiment, out: Path, pool: Pool = IN_PROCESS) -> Found:
    """Evaluations without their order of columns in memory, and why each run ended."""
    with OptimumFolder.claim(out, DOCUMENT) as folder:
        table, stops = run_cmaes(of, RUNS, folder, pool, lambda line: None)
        assert folder.evaluations().equals(table)
    return table.to_pylist(), stops


def test_runs_do_not_depend_on_the_cut_and_go_on_when_interrupted(
    level: Experiment, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = run(level, tmp_path / "whole")
    assert len(whole[0]) == RUNS * 7 * 4 and whole[1] == ["max_generations"] * RUNS
    for block, stretch, slots in ((1, 1, 1), (2, 3, 2), (100, 100, 3)):
        monkeypatch.setattr(optimum, "BLOCK_RUNS", block)
        monkeypatch.setattr(optimum, "STRETCH_GENERATIONS", stretch)
        assert run(level, tmp_path / f"cut {block}", Pool(InProcess(), slots)) == whole
    monkeypatch.setattr(optimum, "BLOCK_RUNS", 2)
    monkeypatch.setattr(optimum, "STRETCH_GENERATIONS", 2)
    for call in (3, 6):
        monkeypatch.setitem(vars(taichi_nmm), "simulate", fake_walker.stopped_in_call(call))
        with pytest.raises(KeyboardInterrupt):
            run(level, tmp_path / "out")
    monkeypatch.setitem(vars(taichi_nmm), "simulate", fake_walker.simulate)
    calls = len(fake_walker.calls)
    assert run(level, tmp_path / "out") == whole
    assert 0 < len(fake_walker.calls) - calls < 14  # what was finished is not tried again
    shorter = replace(level, cmaes=replace(level.cmaes, max_generations=3))
    run(shorter, tmp_path / "longer")
    assert run(level, tmp_path / "longer") == whole


def test_a_block_is_told_what_is_known_and_gives_what_is_new(level: Experiment) -> None:
    first, stops = evolve(Stretch(level, (0, 2), NOTHING, "out"))
    assert first["generation"].to_pylist() == [n for n in range(5) for _ in range(8)] and not stops
    assert fake_walker.calls[-1]["gains"].shape == (8, 16)  # a generation of both, one batch
    rest, stops = evolve(Stretch(level, (0, 2), first, "out"))
    assert set(rest["generation"].to_pylist()) == {5, 6}
    assert stops == {0: "max_generations", 2: "max_generations"}
    both = pa.concat_tables([first, rest])
    alone, _ = evolve(Stretch(level, (2,), first.filter(pc.equal(first["run"], 2)), "out"))
    assert alone.to_pylist() == rest.filter(pc.equal(rest["run"], 2)).to_pylist()
    assert len(evolve(Stretch(level, (0, 2), both, "out"))[0]) == 0


def test_evaluations_of_other_settings_are_refused(level: Experiment) -> None:
    tried, _ = evolve(Stretch(level, (0,), NOTHING, "out"))
    with refused("out: 'run 0 in here' .* these settings"):
        evolve(Stretch(replace(level, seed=8), (0,), tried, "here"))


def test_progress_counts_up(level: Experiment, tmp_path: Path) -> None:
    told: list[str] = []
    with OptimumFolder.claim(tmp_path / "out", DOCUMENT) as folder:
        table, _ = run_cmaes(level, RUNS, folder, IN_PROCESS, told.append)
    best = f"best cost {min(table['cost'].to_pylist()):.5g}"
    assert told[0].startswith("cmaes: generation 5, 3 of 3 runs go on, 60 evaluations, best cost ")
    assert told[1:] == [f"cmaes: generation 7, 0 of 3 runs go on, 84 evaluations, {best}"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"ground": Ground("rough")}, r"terrain\.kind: 'rough' .* flat, for the optimum"),
        ({"disturbance": 0.1}, r"body\.disturbance: 0\.1 .* 0, for the optimum"),
        ({"searched": ("theta_ref",)}, "searched: .* none, for the optimum"),
    ],
)
def test_only_the_easiest_setting_has_an_optimum(
    change: dict[str, object], message: str, tmp_path: Path
) -> None:
    easiest: dict[str, object] = {"ground": Ground("flat"), "disturbance": 0.0}
    with refused(message):
        estimate(experiment(**(easiest | change)), tmp_path / "out", 2, 1, print)
    assert not (tmp_path / "out").exists()
