"""The table that shows an experiment in a row an arm."""

from pathlib import Path

import pytest

from study.report.markdown import condensed_table
from study.report.numbers import numbers
from study.report.runs import read_results
from tests.study.report import synthetic


def cells(text: str) -> dict[str, list[str]]:
    rows = [[cell.strip() for cell in line.strip("| ").split(" | ")] for line in text.splitlines()]
    return {row[0]: row for row in rows}


def test_what_it_says_is_what_the_numbers_are(tmp_path: Path) -> None:
    arms = {"dog": (0.05, 0.01), "random": (0.01, 0.0), "best": (0.9, 0.0)}
    synthetic.write(tmp_path, arms, runs=20, trials=40, cost="smooth", name="rough8")
    found = numbers(read_results(tmp_path))
    rows = cells(condensed_table(found))
    assert list(rows)[2] == "`best`"  # most walkers, the soonest
    best, dog = rows["`best`"], rows["`dog`"]
    arm = next(each for each in found.arms if each.arm == "best")
    assert best[1:3] == ["20", str(arm.walkers)] == ["20", "20"]
    assert best[3] == f"{100 * arm.share.low:.0f} to 100"
    assert best[4:6] == [f"{arm.first_walker.value:g}", "1 to 1"]
    assert best[6] == str(arm.within[1])
    assert best[10] == "20" and rows["`random`"][10] == "-"  # known without 60 trials
    assert best[11] == f"{arm.cost_after[30].value:.4g}"
    against = next(each for each in found.comparisons if each.arm == "best")
    assert best[12] == f"{against.difference.value:.3g}"
    assert best[13].startswith(f"{against.difference.low:.3g} to ")
    assert float(best[14]) == pytest.approx(against.cost_p_holm, rel=0.1)
    assert dog[12:] == ["-", "-", "-"]


def test_without_the_papers_method_or_30_trials_there_is_nothing_to_compare(tmp_path: Path) -> None:
    synthetic.write(tmp_path, {"best": (0.9, 0.0)}, runs=3, trials=12, cost="smooth", name="short")
    row = cells(condensed_table(numbers(read_results(tmp_path))))["`best`"]
    assert row[11:] == ["-", "-", "-", "-"]
