"""The report's figures on runs small enough to count by hand."""

from pathlib import Path

import numpy as np
import pytest

from study.experiment.arms import ARMS
from study.report.markdown import overview_text, report_text
from study.report.numbers import numbers
from study.report.runs import ArmRuns, Results, read_results
from study.report.writing import write_report
from tests.study.report import synthetic
from tests.study.report.synthetic import arm


def experiment(*arms: ArmRuns) -> Results:
    return Results(Path(), "counted", "smooth", {each.arm: each for each in arms}, {})


def test_walkers_are_counted() -> None:
    found = numbers(experiment(arm("dog", [1, 3, 11, 30, np.inf]))).arms[0]
    assert (found.walkers, found.runs, found.trials) == (4, 5, 40)
    assert found.share.value == 0.8
    assert found.first_walker.value == 11
    assert found.within == {1: 1, 3: 2, 10: 2, 30: 4}
    assert list(found.cost_after) == [10, 30]
    assert found.cost_after[30].value == pytest.approx(1.0 + 2 + 1.0 - 29 / 39)
    assert found.best_cost.value == pytest.approx(1.0 + 2)


def test_where_all_runs_have_a_walker_later_limits_are_known() -> None:
    found = numbers(experiment(arm("dog", [1, 2, 5], trials=8))).arms[0]
    assert found.within == {1: 1, 3: 2, 10: 3, 30: 3, 60: 3, 100: 3}
    assert 10 not in numbers(experiment(arm("dog", [1, np.inf], trials=8))).arms[0].within


def test_arms_are_compared_with_the_papers_method_on_the_same_runs() -> None:
    paper = arm("dog", [40] * 12, cost=2.0)
    better = arm("best", [1] * 10, cost=1.5)
    found = numbers(experiment(paper, better)).comparisons
    assert [each.arm for each in found] == ["best"]
    assert (found[0].after, found[0].cost.pairs) == (30, 10)
    assert found[0].difference.value == pytest.approx(-0.5)
    assert found[0].cost.p == pytest.approx(2 / 2**10, rel=0.2)  # ties: all differ by as much
    assert found[0].walkers.unequal == 0


def test_p_values_are_adjusted_over_all_arms() -> None:
    arms = [arm(name, [1] * 10, cost=1.5) for name in ("best", "tpe", "random")]
    found = numbers(experiment(arm("dog", [40] * 10, cost=2.0), *arms)).comparisons
    assert len(found) == 3
    for each in found:
        assert each.cost_p_holm == pytest.approx(3 * each.cost.p)


def test_without_the_papers_method_there_is_no_comparison() -> None:
    found = numbers(experiment(arm("tpe", [3, 4])))
    assert found.comparisons == ()
    assert found.peer == "tpe"
    assert "paper's method" not in report_text(experiment(arm("tpe", [3, 4])), found, None)


def test_the_document_says_what_was_counted_and_how(results: Results) -> None:
    found = numbers(results)
    text = report_text(results, found, 0.01)
    rows = [line for line in text.splitlines() if line.startswith("| random")]
    count = int(np.isfinite(results.arms["random"].first_walker).sum())
    assert f"| 50 | {count} | " in rows[0] and "> 100" in rows[0]
    assert "bootstrap" in text and "Wilson" in text and "Holm" in text and "SeedSequence" in text
    assert "estimated optimum: 0.01" in text
    assert "Best of the peers (most runs with a walker, then the earliest): cmaes-warm" in text
    assert text.count("| 50 | 50 |") >= 10  # no p without its n
    for name in synthetic.ARMS:
        assert ARMS[name].label in text


def test_an_unfinished_experiment_says_so() -> None:
    results = experiment(arm("dog", [1, 2]), arm("tpe", [1], trials=10))
    text = report_text(results, numbers(results), None)
    assert "Unfinished: 90 of 160 trials" in text
    assert "tpe 1 x 10" in text


def test_programs_get_null_for_never() -> None:
    plain = numbers(experiment(arm("dog", [np.inf, np.inf]))).as_dict()
    assert plain["arms"][0]["first_walker"]["value"] is None
    assert plain["arms"][0]["within"]["30"] == 0


def test_one_table_of_several_experiments(tmp_path: Path) -> None:
    first = synthetic.write(
        tmp_path / "a", {"dog": (0.9, 0.0), "best": (1.0, 0.0)}, 4, 10, name="a"
    )
    second = synthetic.write(
        tmp_path / "b", {"dog": (0.0, 0.0), "tpe": (1.0, 0.0)}, 4, 10, name="b"
    )
    lines = overview_text([numbers(read_results(each)) for each in (first, second)]).splitlines()
    assert lines.count("| experiment | DoG, as printed | best combination | TPE |") == 4
    rows = {name: [line for line in lines if line.startswith(f"| {name} | ")] for name in "ab"}
    assert [line.split(" | ")[2] for line in rows["a"]] == ["4", "4", "4", "1"]
    assert [line.split(" | ")[1] for line in rows["b"]] == ["0", "0", "0", "> 10"]
    assert all(line.split(" | ")[2] == "" for line in rows["b"])


def test_a_single_arm_of_a_single_run_is_reported(tmp_path: Path) -> None:
    results = experiment(arm("random", [np.inf], trials=2))
    write_report(results, None, folder=tmp_path)
    assert "| 1 | 0 | 0 to 79 | > 2 |" in (tmp_path / "report.md").read_text()
