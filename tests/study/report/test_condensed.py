"""The table that shows an experiment in a row an arm."""

from pathlib import Path

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
    assert best[1].startswith(f"{arm.walkers} of 20 (")
    assert best[2].startswith(f"{arm.first_walker.value:g} (")
    assert best[3].split(", ")[0] == str(arm.within[1])
    assert best[3].endswith(", 20") and best[1].startswith("20 of 20")  # known without 60 trials
    assert rows["`random`"][3].endswith(", -")
    assert float(best[4]) == float(f"{arm.cost_after[30].value:.4g}")
    against = next(each for each in found.comparisons if each.arm == "best")
    assert best[5].startswith(f"{against.difference.value:.3g} (")
    assert dog[5] == "-"


def test_without_the_papers_method_or_30_trials_there_is_nothing_to_compare(tmp_path: Path) -> None:
    synthetic.write(tmp_path, {"best": (0.9, 0.0)}, runs=3, trials=12, cost="smooth", name="short")
    row = cells(condensed_table(numbers(read_results(tmp_path))))["`best`"]
    assert row[4:] == ["-", "-"]
