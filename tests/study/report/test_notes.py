"""The note that the dashboard shows of an experiment."""

import time

import pyarrow as pa

from study.experiment.arms import ARMS
from study.experiment.experiment import study_name
from study.report.markdown import dashboard_summary
from tests.study.report import synthetic


def trials(best: dict[str, list[list[float]]], walked_below: float) -> pa.Table:
    """The best costs of each arm's runs, so far; a trial that costs less than that walked."""
    rows = [
        {
            "experiment": "tiny", "arm": arm, "run": run, "trial": trial,
            "cost": cost, "best_cost": cost, "walked": cost < walked_below,
        }
        for arm, runs in best.items()
        for run, costs in enumerate(runs)
        for trial, cost in enumerate(costs)
    ]  # fmt: skip
    return pa.Table.from_pylist(rows)


def test_a_row_has_medians_over_runs() -> None:
    best = {"random": [[290.0, 280.0]] * 2, "dog": [[300.0, 90.0], [290.0, 280.0], [90.0, 80.0]]}
    note = dashboard_summary("tiny", trials(best, 100.0), True, {})
    assert "10 trials (all trials)" in note
    rows = [line for line in note.splitlines() if line.startswith("| ")][2:4]
    assert rows == ["| dog | 3 | 2 | 67 | 2 | 90 |", "| random | 2 | 0 | 0 | > 2 | 280 |"]
    best = {"dog": [[300.0, 90.0, 90.0], [290.0, 280.0]]}
    note = dashboard_summary("tiny", trials(best, 100.0), False, {})
    assert "5 trials (so far" in note
    assert "| dog | 2 | 1 | 50 | > 2 | 185 |" in note


def test_a_table_leads_to_every_study() -> None:
    best = {"random": [[290.0, 280.0]], "dog": [[300.0, 90.0], [290.0, 280.0]]}
    ids = {"dog/run-000": 4, "random/run-000": 7, "dog/run-001": 5, "summary": 9}
    ids = {f"tiny/{name}": number for name, number in ids.items()}
    note = dashboard_summary("tiny", trials(best, 100.0), True, ids)
    table = note[note.index("| run |") :].splitlines()
    assert table[0] == "| run | dog | random | all arms |"
    both = "[compare](/dashboard/compare-studies?ids=4,7)"
    studies = "[**90**](/dashboard/studies/4) | [280](/dashboard/studies/7)"
    assert table[2] == f"| 0 | {studies} | {both} |"
    assert table[3] == "| 1 | [280](/dashboard/studies/5) |  |  |"


def test_every_arm_can_be_renewed_once_a_minute() -> None:
    """25 arms, 50 runs, 100 trials: 2 s are allowed, of the process that compares."""
    table = pa.table(synthetic.columns(dict.fromkeys(ARMS, (0.05, 0.0)), 50, 100, "smooth"))
    ids = {study_name("all", arm, run): run for arm in ARMS for run in range(50)}
    before = time.process_time()
    note = dashboard_summary("all", table, False, ids)
    assert time.process_time() - before < 2.0
    assert note.count("/dashboard/studies/") == len(ids)
