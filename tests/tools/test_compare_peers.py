"""The comparison with peers on a few tiny runs: what it writes, keeps, and refuses."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from study.benchmarks import comparison_report, peers, regret, run_cache, synthetic
from tests.tools.running import load_tool

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]
ARMS = "random,random-rows,score-first,euclidean-rows,ours,paper"
TRIALS, SEEDS = 8, 2


def compare(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "tools/compare_peers.py", *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


def tiny(folder: Path, *arguments: str) -> tuple[str, ...]:
    sizes = ("--seeds", str(SEEDS), "--trials", str(TRIALS), "--arms", ARMS)
    problems = ("--problems", "informative,misleading")
    return (*sizes, *problems, "--cache", str(folder / "cache"), *arguments)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The documents and the cache of one run of the command."""
    path = tmp_path_factory.mktemp("peers")
    done = compare(*tiny(path, "--out", str(path / "docs")))
    assert done.returncode == 0, done.stderr
    return path


def runs(folder: Path) -> dict[str, dict[str, Any]]:
    found = sorted((folder / "cache").rglob("*.json"))
    return {str(file.relative_to(folder)): json.loads(file.read_text()) for file in found}


def test_the_document_has_a_row_an_arm_and_its_bars(folder: Path) -> None:
    text = (folder / "docs" / "sampler-comparison.md").read_text()
    assert text.startswith("# Samplers on synthetic problems")
    assert "python tools/compare_peers.py --seeds 2" in text
    for arm in ARMS.split(","):
        assert text.count(f"| {peers.PEERS[arm].label} | {peers.PEERS[arm].sees} |") == 2
    assert "| informative: ours after 4 / RandomSampler after 8 |" in text
    assert "mean regret of ours" not in text  # that bar is of 60 trials
    assert (folder / "docs" / "sampler-comparison.png").stat().st_size > 10_000


def test_runs_that_see_no_feature_are_shared_by_problems_of_one_cost(folder: Path) -> None:
    names = runs(folder)
    assert f"cache/rastrigin/random/{TRIALS}-trials-seed-001.json" in names
    assert f"cache/misleading/ours/{TRIALS}-trials-seed-001.json" in names
    assert len(names) == 2 * SEEDS * len(ARMS.split(","))


def test_costs_are_those_of_the_problem(folder: Path) -> None:
    """The control's runs can be made again by hand; every row of the table is proposed once."""
    names = runs(folder)
    problem = synthetic.problem("informative", 1)
    costs = problem.cost(problem.rows())
    order = np.argsort(problem.features(problem.rows())[:, 0], kind="stable")[:TRIALS]
    kept = names[f"cache/informative/score-first/{TRIALS}-trials-seed-001.json"]["costs"]
    np.testing.assert_allclose(kept, costs[order])
    for arm in ("ours", "paper"):
        proposed = names[f"cache/informative/{arm}/{TRIALS}-trials-seed-001.json"]["costs"]
        assert len(set(proposed)) == TRIALS
        distance = np.abs(costs - np.array(proposed)[:, None]).min(axis=1)
        assert distance.max() < 1e-6


def test_a_second_run_takes_everything_from_the_cache(folder: Path) -> None:
    before = {file: file.stat().st_mtime_ns for file in (folder / "cache").rglob("*.json")}
    done = compare(*tiny(folder, "--json"))
    assert done.returncode == 0, done.stderr
    assert {file: file.stat().st_mtime_ns for file in (folder / "cache").rglob("*.json")} == before
    report = json.loads(done.stdout)
    assert report["seeds"] == SEEDS
    rows = {(row["problem"], row["arm"], row["trial"]): row for row in report["regret"]}
    assert len(rows) == 2 * len(ARMS.split(",")) * 2
    costs = [run["costs"] for name, run in runs(folder).items() if "informative/ours" in name]
    best = np.min(costs, axis=1).mean()
    assert rows["informative", "ours", TRIALS]["mean"]["value"] == pytest.approx(best)


def test_a_run_of_other_code_or_a_broken_file_is_not_current(folder: Path, tmp_path: Path) -> None:
    run = load_tool("compare_peers").Run("informative", "random", 0, TRIALS)
    assert run_cache.is_current(run, folder / "cache")
    assert not run_cache.is_current(run, tmp_path)
    file = run.file(tmp_path)
    file.parent.mkdir(parents=True)
    kept = json.loads(run.file(folder / "cache").read_text())
    file.write_text(json.dumps({**kept, "code": "other"}))
    assert not run_cache.is_current(run, tmp_path)
    file.write_text("{")
    assert not run_cache.is_current(run, tmp_path)


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        (("--arms", "random,best"), "arms: 'best'"),
        (("--problems", "easy"), "problems: 'easy'"),
        (("--trials", "1"), "trials: 1"),
        (("--seeds", "0"), "seeds: 0"),
    ],
)
def test_bad_arguments_are_one_line_and_exit_code_2(
    arguments: tuple[str, ...], field: str, tmp_path: Path
) -> None:
    done = compare(*arguments, "--out", str(tmp_path / "docs"), "--cache", str(tmp_path / "cache"))
    assert done.returncode == 2
    assert done.stderr.startswith("error: ")
    assert field.split(":")[0] in done.stderr and field.split()[-1] in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_without_torch_gpsampler_is_left_out_with_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(run_cache, "torch_is_installed", lambda: False)
    assert run_cache.runnable(["random", "gp"]) == ["random"]
    assert capsys.readouterr().err == (
        "GPSampler is left out: it needs PyTorch (pip install torch)\n"
    )
    assert run_cache.runnable(["random"]) == ["random"]
    assert capsys.readouterr().err == ""


def test_regret_is_the_best_so_far_and_its_interval_holds_the_mean() -> None:
    costs = np.array([[3.0, 5.0, 1.0], [4.0, 2.0, 2.5]])
    np.testing.assert_array_equal(regret.simple_regret(costs), [[3, 3, 1], [4, 2, 2]])
    sample = np.random.default_rng(0).normal(10.0, 2.0, 30)
    mean = regret.mean_of(sample)
    half_width = 1.96 * sample.std() / np.sqrt(30)
    assert mean.value == pytest.approx(sample.mean())
    assert mean.high - mean.value == pytest.approx(half_width, rel=0.15)
    assert mean.value - mean.low == pytest.approx(half_width, rel=0.15)
    assert regret.median_of(sample).low < np.median(sample) < regret.median_of(sample).high


def test_a_ratio_is_resampled_in_pairs() -> None:
    theirs = np.array([1.0, 10.0, 100.0])
    ratio = regret.ratio_of_means(1.5 * theirs, theirs)
    assert (ratio.low, ratio.value, ratio.high) == pytest.approx((1.5, 1.5, 1.5))


def constant(first: float, second: float, trials: int = 60) -> np.ndarray:
    """Costs of three seeds: one in the first half of the trials, another in the second."""
    return np.tile(np.repeat([first, second], trials // 2), (3, 1))


def test_bars_are_of_the_arms_and_trials_that_they_name() -> None:
    costs = {
        ("informative", "random"): constant(9.0, 4.0),
        ("informative", "random-rows"): constant(1.0, 1.0),  # a control: no bar
        ("informative", "ours"): constant(6.0, 1.0),
        ("misleading", "ours"): constant(240.0, 203.5),
        ("useless", "ours"): constant(240.0, 204.5),
    }
    informative, misleading, useless = comparison_report.Report.of(costs).bars
    assert informative.what == "informative: ours after 30 / RandomSampler after 60"
    assert informative.measured.value == pytest.approx(6.0 / 4.0)
    assert (misleading.measured.value, misleading.at_most) == pytest.approx((203.5, 203.0))
    assert (useless.measured.value, useless.at_most) == pytest.approx((204.5, 205.0))
    assert [bar.holds for bar in (informative, misleading, useless)] == [False, False, True]


def test_what_was_measured_after_60_trials_is_no_bar_after_others() -> None:
    costs = {("misleading", "ours"): constant(240.0, 300.0, trials=40)}
    assert comparison_report.Report.of(costs).bars == ()
