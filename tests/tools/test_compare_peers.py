"""The comparison with peers on a few tiny runs: what it writes, keeps, and refuses."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.tools.running import load_tool, run_tool
from tools import benchmark, synthetic
from tools.synthetic import ARMS

pytestmark = pytest.mark.slow

TOOL = load_tool("compare_peers")
RUN_ARMS = ("random", "random-rows", "score-first", "euclidean-rows", "ours", "paper")
TRIALS, SEEDS = 8, 2


def compare(patch: pytest.MonkeyPatch, folder: Path, *arguments: object) -> int:
    sizes = ("--seeds", SEEDS, "--trials", TRIALS, "--arms", ",".join(RUN_ARMS))
    where = ("--problems", "informative,misleading", "--cache", folder / "cache")
    return run_tool(patch, "compare_peers", *sizes, *where, "--out", folder / "docs", *arguments)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The documents and the cache of one run of the command."""
    path = tmp_path_factory.mktemp("peers")
    with pytest.MonkeyPatch.context() as patch:
        assert compare(patch, path) == 0
    return path


def written(folder: Path) -> dict[Path, int]:
    """Files of the cache, and when they were written."""
    return {file: file.stat().st_mtime_ns for file in (folder / "cache").rglob("*.json")}


def costs_of(folder: Path, trials: int, seed: int) -> list[float]:
    file = folder / f"{trials}-trials-seed-{seed:03d}.json"
    found: list[float] = json.loads(file.read_text())["costs"]
    return found


def kept(folder: Path, problem: str, arm: str, seed: int) -> list[float]:
    return costs_of(folder / "cache" / problem / arm, TRIALS, seed)


def test_the_document_has_a_row_an_arm_and_its_bars(folder: Path) -> None:
    text = (folder / "docs" / "sampler-comparison.md").read_text()
    assert text.startswith("# Samplers on synthetic problems")
    assert "python tools/compare_peers.py --seeds 2" in text
    rows = [text.count(f"| {ARMS[arm].label} | {ARMS[arm].sees} |") for arm in RUN_ARMS]
    assert rows == [2] * len(RUN_ARMS)
    assert "| informative: ours after 4 / RandomSampler after 8 |" in text
    assert "mean regret of ours" not in text  # that bar is of 60 trials
    assert (folder / "docs" / "sampler-comparison.png").stat().st_size > 10_000


def test_costs_are_those_of_the_problem(folder: Path) -> None:
    """The control's runs can be made again by hand; every row of the table is proposed once."""
    problem = synthetic.problem("informative", 1)
    costs = problem.cost(problem.rows())
    order = np.argsort(problem.features(problem.rows())[:, 0], kind="stable")[:TRIALS]
    np.testing.assert_allclose(kept(folder, "informative", "score-first", 1), costs[order])
    for arm in ("ours", "paper"):
        proposed = kept(folder, "informative", arm, 1)
        assert len(set(proposed)) == TRIALS
        assert np.abs(costs - np.array(proposed)[:, None]).min(axis=1).max() < 1e-6


def test_a_second_run_takes_everything_from_the_cache(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Problems of one cost share the runs that see no feature."""
    before = written(folder)
    assert len(before) == 2 * SEEDS * len(RUN_ARMS)
    assert len(kept(folder, "rastrigin", "random", 1)) == TRIALS
    assert len(kept(folder, "misleading", "ours", 1)) == TRIALS
    assert compare(monkeypatch, folder, "--json") == 0
    assert written(folder) == before
    report = json.loads(capsys.readouterr().out)
    rows = {(row["problem"], row["arm"], row["trial"]): row for row in report["regret"]}
    assert report["seeds"] == SEEDS and len(rows) == 2 * len(RUN_ARMS) * 2
    best = [min(kept(folder, "informative", "ours", seed)) for seed in range(SEEDS)]
    mean = rows["informative", "ours", TRIALS]["mean"]["value"]
    assert mean == pytest.approx(np.mean(best))


def test_a_run_of_other_code_or_a_broken_file_is_not_current(folder: Path, tmp_path: Path) -> None:
    run = benchmark.Run("synthetic", "informative", "random", 0, TRIALS)
    assert run.is_current(folder / "cache")
    assert not run.is_current(tmp_path)
    run.file(tmp_path).parent.mkdir(parents=True)
    kept = json.loads(run.file(folder / "cache").read_text())
    for text in (json.dumps({**kept, "code": "other"}), "{"):
        run.file(tmp_path).write_text(text)
        assert not run.is_current(tmp_path)


def test_without_torch_gpsampler_is_left_out_with_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(benchmark.importlib.util, "find_spec", lambda _: None)
    left_out = "GPSampler is left out: it needs PyTorch (pip install torch)\n"
    for arms, said in ((["random", "gp"], left_out), (["random"], "")):
        assert (benchmark.runnable(arms), capsys.readouterr().err) == (["random"], said)


def test_an_interval_holds_the_mean_and_regret_is_the_best_so_far() -> None:
    sample = np.random.default_rng(0).normal(10.0, 2.0, 30)
    mean = TOOL.over_seeds(TOOL.mean, sample)
    half_width = 1.96 * sample.std() / np.sqrt(30)
    assert mean.value == pytest.approx(sample.mean())
    assert mean.high - mean.value == pytest.approx(half_width, rel=0.15)
    assert mean.value - mean.low == pytest.approx(half_width, rel=0.15)
    median = TOOL.over_seeds(TOOL.median, sample)
    assert median.low < np.median(sample) < median.high
    theirs = np.array([1.0, 10.0, 100.0])
    ratio = TOOL.over_seeds(TOOL.ratio, 1.5 * theirs, theirs)  # resampled in pairs
    assert (ratio.low, ratio.value, ratio.high) == pytest.approx((1.5, 1.5, 1.5))
    costs = np.array([[3.0, 5.0, 1.0, 2.0], [4.0, 2.0, 2.5, 3.0]])
    report = TOOL.Report.of({("useless", "random"): costs})
    np.testing.assert_array_equal(report.best["useless", "random"], [[3, 3, 1, 1], [4, 2, 2, 2]])


def constant(first: float, second: float, trials: int = 60) -> Any:
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
    report = TOOL.Report.of(costs)
    assert report.markdown().partition("| measured | holds |\n")[2].splitlines()[1:] == [
        "| informative: ours after 30 / RandomSampler after 60 | 1.50 (1.50 to 1.50), at most 1"
        " | **no** |",
        "| misleading: mean regret of ours after 60 | 203.50 (203.50 to 203.50), at most 203"
        " | **no** |",
        "| useless: mean regret of ours after 60 | 204.50 (204.50 to 204.50), at most 205 | yes |",
    ]
    other = {("misleading", "ours"): constant(240.0, 300.0, trials=40)}
    assert TOOL.Report.of(other).bars == []  # the bar is of 60 trials
