"""The comparison on problems from outside, a few tiny runs: what it writes, keeps, and refuses."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from study.benchmarks import run_cache
from study.benchmarks.outside import outside_arms
from study.benchmarks.outside.outside_arms import ARMS, rows_by_ranking
from study.benchmarks.outside.outside_problem import outside_problem
from study.benchmarks.outside.outside_report import OutsideReport
from tests.tools.running import load_tool, run_tool

PROBLEM = "transport-solver"
TRIALS, SEEDS = 7, 2
RUN_ARMS = [arm for arm in ARMS if arm != "gp"]


def compare(patch: pytest.MonkeyPatch, folder: Path, *arguments: object) -> int:
    sizes = ("--seeds", SEEDS, "--trials", TRIALS, "--processes", 1, "--arms", ",".join(RUN_ARMS))
    where = ("--problems", PROBLEM, "--cache", folder / "cache", "--out", folder / "docs")
    return run_tool(patch, "compare_outside", *sizes, *where, *arguments)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The documents and the cache of one run of the command."""
    path = tmp_path_factory.mktemp("outside")
    with pytest.MonkeyPatch.context() as patch:
        assert compare(patch, path) == 0
    return path


def kept(folder: Path, arm: str, seed: int) -> dict[str, Any]:
    name = f"{TRIALS}-trials-seed-{seed:03d}.json"
    found: dict[str, Any] = json.loads((folder / "cache" / PROBLEM / arm / name).read_text())
    return found


@pytest.mark.slow
def test_the_document_has_the_problem_its_arms_and_its_tests(folder: Path) -> None:
    text = (folder / "docs" / "sampler-outside.md").read_text()
    assert text.startswith("# Samplers on problems from outside")
    assert f"## {PROBLEM} (tuning)" in text
    for arm in RUN_ARMS:
        assert f"| {ARMS[arm].label} | {ARMS[arm].sees} |" in text
    for name in outside_problem(PROBLEM).feature_names:
        assert f"| {name} |" in text
    assert "never behind a sampler without features" in text
    assert "| ours, seeds won : lost, p | after 5 | after 7 |" in text
    assert "![Rank" in text and "](sampler-outside.png)" in text
    assert (folder / "docs" / "sampler-outside.png").stat().st_size > 10_000


@pytest.mark.slow
def test_every_arm_shows_costs_of_the_pool(folder: Path) -> None:
    for arm in RUN_ARMS:
        for seed in range(SEEDS):
            costs = kept(folder, arm, seed)["costs"]
            assert len(costs) == TRIALS
            assert set(costs) <= set(outside_problem(PROBLEM).drawn(seed).cost.tolist())
    problem = outside_problem(PROBLEM).drawn(1)
    first = problem.cost[rows_by_ranking(problem, 1)]
    np.testing.assert_array_equal(kept(folder, "ranking", 1)["costs"], first[:TRIALS])
    np.testing.assert_array_equal(kept(folder, "tpe-ranking", 1)["costs"][:3], first[:3])


@pytest.mark.slow
def test_the_same_command_takes_all_from_the_cache(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    before = {file: file.stat().st_mtime_ns for file in (folder / "cache").rglob("*.json")}
    assert len(before) == SEEDS * len(RUN_ARMS)
    assert compare(monkeypatch, folder, "--json") == 0
    assert {file: file.stat().st_mtime_ns for file in (folder / "cache").rglob("*.json")} == before
    said = json.loads(capsys.readouterr().out)
    assert said["seeds"] == SEEDS
    of_ranking = [row for row in said["medians"] if row["arm"] == "ranking"]
    assert [row["trial"] for row in of_ranking] == [5, TRIALS]
    costs = [kept(folder, "ranking", seed)["costs"] for seed in range(SEEDS)]
    assert of_ranking[-1]["median"] == np.median(np.min(costs, axis=1))


@pytest.mark.slow
def test_other_numbers_are_other_runs(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tool = load_tool("compare_outside")
    assert run_cache.is_current(tool.Run(PROBLEM, "random", 0, TRIALS), folder / "cache")
    monkeypatch.setattr(tool, "digest", lambda _: "other")
    tool.code_of.cache_clear()
    assert not run_cache.is_current(tool.Run(PROBLEM, "random", 0, TRIALS), folder / "cache")


def test_a_seed_draws_half_of_the_pool() -> None:
    whole = outside_problem(PROBLEM)
    one, again, other = whole.drawn(1), whole.drawn(1), whole.drawn(2)
    assert (
        len(one) == len(whole) // 2 == len(one.features) == len(one.columns[next(iter(one.space))])
    )
    np.testing.assert_array_equal(one.cost, again.cost)
    assert set(one.cost) <= set(whole.cost)
    assert set(one.cost) != set(other.cost)


def test_ties_of_the_ranking_are_broken_by_the_seed_and_nothing_else() -> None:
    problem = outside_problem(PROBLEM)
    first, second = rows_by_ranking(problem, 1), rows_by_ranking(problem, 2)
    for rows in (first, second):
        assert sorted(rows) == list(range(len(problem)))
        assert (np.diff(problem.ranking[rows]) >= 0).all()
    np.testing.assert_array_equal(first, rows_by_ranking(problem, 1))


def test_our_arms_get_the_pool_as_it_is() -> None:
    problem = outside_problem(PROBLEM)
    plain = outside_arms.table(problem, ranking=False)
    told = outside_arms.table(problem, ranking=True)
    assert len(plain) == len(told) == len(problem)
    assert told.rows.feature_names[-1] == "ranking"
    assert plain.rows.feature_names == problem.feature_names


def report(ours: list[float], tpe: list[float], ranking: list[float]) -> OutsideReport:
    """Of ten seeds: least cost after 5 and after 10 trials, more for each seed by a little."""
    seeds = 1.0 + 0.001 * np.arange(12)[:, None]
    after = {"ours": ours, "tpe": tpe, "ranking": ranking}
    return OutsideReport.of(
        {(PROBLEM, arm): np.repeat(costs, 5)[None] * seeds for arm, costs in after.items()}
    )


def test_bars_hold_where_ours_leads_and_name_where_it_does_not() -> None:
    good = report(ours=[2.0, 1.0], tpe=[3.0, 2.0], ranking=[1.5, 1.4])
    assert [bar.holds for bar in good.bars] == [True] * len(good.bars)
    bad = report(ours=[2.0, 1.9], tpe=[1.0, 1.0], ranking=[1.5, 1.4])
    assert not any(bar.holds for bar in bad.bars)
    assert bad.bars[0].fails[0] == f"{PROBLEM}, TPESampler, 5 (0 : 12)"
    test = bad.versus(PROBLEM, "ours", "tpe", 10)
    assert (test.wins, test.losses) == (0, 12) and test.is_behind and not test.is_ahead
    assert bad.median(PROBLEM, "tpe", 5) == pytest.approx(1.0055)


def test_runs_that_repeat_each_other_are_counted_once() -> None:
    costs = np.array([[3.0, 2.0, 5.0], [3.0, 2.0, 4.0], [3.0, 2.0, 5.0]])
    made = OutsideReport.of({(PROBLEM, "ours"): costs, (PROBLEM, "tpe"): costs[:1].repeat(3, 0)})
    assert made.different == {(PROBLEM, "ours"): 2, (PROBLEM, "tpe"): 1}


def test_equal_runs_are_neither_ahead_nor_behind() -> None:
    same = report(ours=[2.0, 1.0], tpe=[2.0, 1.0], ranking=[2.0, 1.0])
    test = same.versus(PROBLEM, "ours", "tpe", 10)
    assert (test.wins, test.losses, test.p) == (0, 0, 1.0)
    assert not test.is_ahead and not test.is_behind


@pytest.mark.parametrize(
    ("arguments", "field", "named"),
    [
        (("--arms", "random,best"), "arms", "best"),
        (("--problems", "easy"), "problems", "easy"),
        (("--trials", "1"), "trials", "1"),
        (("--seeds", "0"), "seeds", "0"),
    ],
)
def test_bad_arguments_are_one_line_and_exit_code_2(
    arguments: tuple[str, ...],
    field: str,
    named: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    where = ("--out", tmp_path / "docs", "--cache", tmp_path / "cache")
    assert run_tool(monkeypatch, "compare_outside", *arguments, *where) == 2
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1
    assert said[0].startswith(f"error: {field}: ") and named in said[0]
    assert not list(tmp_path.iterdir())
