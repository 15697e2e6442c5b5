"""The comparison with peers on a few tiny runs: what it writes, keeps, and refuses."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.tools.running import load_tool, run_tool
from tools.benchmarks import runs, synthetic
from tools.benchmarks.runs import Run
from tools.benchmarks.synthetic import ARMS

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]
TOOL = load_tool("compare_peers")
RUN_ARMS = "random,random-rows,score-first,euclidean-rows,ours,paper"
TRIALS, SEEDS = 8, 2


def tiny(folder: Path, *arguments: str) -> tuple[str, ...]:
    sizes = ("--seeds", str(SEEDS), "--trials", str(TRIALS), "--arms", RUN_ARMS)
    problems = ("--problems", "informative,misleading")
    return (*sizes, *problems, "--cache", str(folder / "cache"), *arguments)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The documents and the cache of one run of the command."""
    path = tmp_path_factory.mktemp("peers")
    with pytest.MonkeyPatch.context() as patch:
        assert run_tool(patch, "compare_peers", *tiny(path, "--out", str(path / "docs"))) == 0
    return path


def kept_runs(folder: Path) -> dict[str, dict[str, Any]]:
    found = sorted((folder / "cache").rglob("*.json"))
    return {str(file.relative_to(folder)): json.loads(file.read_text()) for file in found}


def test_the_document_has_a_row_an_arm_and_its_bars(folder: Path) -> None:
    text = (folder / "docs" / "sampler-comparison.md").read_text()
    assert text.startswith("# Samplers on synthetic problems")
    assert "python tools/compare_peers.py --seeds 2" in text
    for arm in RUN_ARMS.split(","):
        assert text.count(f"| {ARMS[arm].label} | {ARMS[arm].sees} |") == 2
    assert "| informative: ours after 4 / RandomSampler after 8 |" in text
    assert "mean regret of ours" not in text  # that bar is of 60 trials
    assert (folder / "docs" / "sampler-comparison.png").stat().st_size > 10_000


def test_runs_that_see_no_feature_are_shared_by_problems_of_one_cost(folder: Path) -> None:
    names = kept_runs(folder)
    assert f"cache/rastrigin/random/{TRIALS}-trials-seed-001.json" in names
    assert f"cache/misleading/ours/{TRIALS}-trials-seed-001.json" in names
    assert len(names) == 2 * SEEDS * len(RUN_ARMS.split(","))


def test_costs_are_those_of_the_problem(folder: Path) -> None:
    """The control's runs can be made again by hand; every row of the table is proposed once."""
    names = kept_runs(folder)
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


def test_a_second_run_takes_everything_from_the_cache(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    before = {file: file.stat().st_mtime_ns for file in (folder / "cache").rglob("*.json")}
    assert run_tool(monkeypatch, "compare_peers", *tiny(folder, "--json")) == 0
    assert {file: file.stat().st_mtime_ns for file in (folder / "cache").rglob("*.json")} == before
    report = json.loads(capsys.readouterr().out)
    assert report["seeds"] == SEEDS
    rows = {(row["problem"], row["arm"], row["trial"]): row for row in report["regret"]}
    assert len(rows) == 2 * len(RUN_ARMS.split(",")) * 2
    costs = [run["costs"] for name, run in kept_runs(folder).items() if "informative/ours" in name]
    best = np.min(costs, axis=1).mean()
    assert rows["informative", "ours", TRIALS]["mean"]["value"] == pytest.approx(best)


def test_a_run_of_other_code_or_a_broken_file_is_not_current(folder: Path, tmp_path: Path) -> None:
    run = Run("synthetic", "informative", "random", 0, TRIALS)
    assert run.is_current(folder / "cache")
    assert not run.is_current(tmp_path)
    file = run.file(tmp_path)
    file.parent.mkdir(parents=True)
    kept = json.loads(run.file(folder / "cache").read_text())
    file.write_text(json.dumps({**kept, "code": "other"}))
    assert not run.is_current(tmp_path)
    file.write_text("{")
    assert not run.is_current(tmp_path)


def test_without_torch_gpsampler_is_left_out_with_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(runs.importlib.util, "find_spec", lambda _: None)
    assert runs.runnable(["random", "gp"]) == ["random"]
    assert capsys.readouterr().err == (
        "GPSampler is left out: it needs PyTorch (pip install torch)\n"
    )
    assert runs.runnable(["random"]) == ["random"]
    assert capsys.readouterr().err == ""


def test_an_interval_holds_the_mean() -> None:
    sample = np.random.default_rng(0).normal(10.0, 2.0, 30)
    mean = TOOL.over_seeds(TOOL.mean, sample)
    half_width = 1.96 * sample.std() / np.sqrt(30)
    assert mean.value == pytest.approx(sample.mean())
    assert mean.high - mean.value == pytest.approx(half_width, rel=0.15)
    assert mean.value - mean.low == pytest.approx(half_width, rel=0.15)
    median = TOOL.over_seeds(TOOL.median, sample)
    assert median.low < np.median(sample) < median.high


def test_regret_is_the_best_so_far() -> None:
    costs = np.array([[3.0, 5.0, 1.0, 2.0], [4.0, 2.0, 2.5, 3.0]])
    report = TOOL.Report.of({("useless", "random"): costs})
    np.testing.assert_array_equal(report.regret["useless", "random"], [[3, 3, 1, 1], [4, 2, 2, 2]])


def test_a_ratio_is_resampled_in_pairs() -> None:
    theirs = np.array([1.0, 10.0, 100.0])
    ratio = TOOL.over_seeds(TOOL.ratio, 1.5 * theirs, theirs)
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
    informative, misleading, useless = TOOL.Report.of(costs).bars
    assert informative.what == "informative: ours after 30 / RandomSampler after 60"
    assert informative.measured == "1.50 (1.50 to 1.50), at most 1"
    assert misleading.measured == "203.50 (203.50 to 203.50), at most 203"
    assert useless.measured == "204.50 (204.50 to 204.50), at most 205"
    assert [bar.holds for bar in (informative, misleading, useless)] == [False, False, True]


def test_what_was_measured_after_60_trials_is_no_bar_after_others() -> None:
    costs = {("misleading", "ours"): constant(240.0, 300.0, trials=40)}
    assert TOOL.Report.of(costs).bars == ()
