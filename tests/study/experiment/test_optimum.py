"""CMA-ES until convergence: the same runs however they are cut and replayed."""

from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pytest

from storage.pool import IN_PROCESS, InProcess, Pool
from study.experiment import optimum
from study.experiment.experiment import CmaesOptions, Experiment
from study.experiment.optimum import EVALUATIONS, OptimumFolder, Stretch, evolve, run_cmaes
from taichi_nmm.terrain import Ground
from tests.study import fake_walker
from tests.study.experiment.fake_results import experiment

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


def test_runs_do_not_depend_on_the_cut(
    level: Experiment, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = run(level, tmp_path / "whole")
    assert len(whole[0]) == RUNS * 7 * 4 and whole[1] == ["max_generations"] * RUNS
    for block, stretch, slots in ((1, 1, 1), (2, 3, 2), (100, 100, 3)):
        monkeypatch.setattr(optimum, "BLOCK_RUNS", block)
        monkeypatch.setattr(optimum, "STRETCH_GENERATIONS", stretch)
        assert run(level, tmp_path / f"cut {block}", Pool(InProcess(), slots)) == whole


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


def test_progress_counts_up(level: Experiment, tmp_path: Path) -> None:
    told: list[str] = []
    with OptimumFolder.claim(tmp_path / "out", DOCUMENT) as folder:
        table, _ = run_cmaes(level, RUNS, folder, IN_PROCESS, told.append)
    best = f"best cost {min(table['cost'].to_pylist()):.5g}"
    assert told[0].startswith("cmaes: generation 5, 3 of 3 runs go on, 60 evaluations, best cost ")
    assert told[1:] == [f"cmaes: generation 7, 0 of 3 runs go on, 84 evaluations, {best}"]
