"""The words of a report and of the dashboard's note: numbers in their cells, folders escaped."""

import json
import time
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from study.experiment.arms import ARMS
from study.experiment.experiment import study_name
from study.report import markdown
from study.report.markdown import condensed_table, facts, overview_text, report_text
from study.report.numbers import numbers
from study.report.runs import Results, read_facts, read_results
from tests.study.report import synthetic
from tests.study.report.synthetic import arm, counted


def rows(text):
    """The rows of the first table in a text, by their first cell."""
    lines = [
        line for line in text.split("\n\n")[0].splitlines() if line.startswith("|")
    ]
    cells = [[cell.strip() for cell in line[1:-1].split(" | ")] for line in lines]
    return {row[0]: row for row in cells}


def test_the_document_has_what_was_counted_and_how(results):
    found = numbers(results)
    text = report_text(results, found, {})
    reached = rows(text[text.index("| arm | runs") :])["random"]
    count = int(np.isfinite(results.arms["random"].first_walker).sum())
    assert reached[1:3] == ["50", str(count)] and reached[5].endswith("> 100")
    tests = rows(text[text.index("| arm | trials") :])
    assert len(tests) == 1 + len(results.arms)  # with the rule; the reference has none
    against = found.comparisons[-1]
    assert against.after == 30 and found.reference == "worlds"
    row = next(row for name, row in tests.items() if name.split()[0] == against.arm)
    gain = against.difference
    between = f"{gain.low:+.3g} to {gain.high:+.3g}"
    assert row[1:5] == ["30", f"{gain.value:+.3g}", between, "50"]
    for first, test in ((4, against.cost), (8, against.walkers)):  # no p without its n
        assert row[first : first + 2] == [str(test.pairs), str(test.unequal)]
        assert row[first + 3] == ("< 1e-4" if test.p < 1e-4 else f"{test.p:.2g}")
    assert (
        "bootstrap" in text
        and "Wilson" in text
        and "Holm" in text
        and "SeedSequence" in text
    )
    assert all(ARMS[name].label in text for name in synthetic.ARMS)


def test_few_trials_a_missing_paper_and_an_unfinished_experiment():
    results = counted(
        arm("dog", [1, 2], trials=4), arm("random", [np.inf, 3], trials=4)
    )
    text = report_text(results, numbers(results), {})
    costs = rows(text.partition("## Best cost\n\n")[2])
    assert costs["arm"][1:] == [
        "median best smooth cost after the last trial",
        "interval",
        "ms",
    ]
    assert len(costs["dog (DoG, as printed)"]) == 4
    results = counted(arm("tpe", [3, 4]))
    found = numbers(results)
    assert found.comparisons == () and found.peer == "tpe"
    assert "## Against" not in report_text(results, found, {})
    results = counted(arm("dog", [1, 2]), arm("tpe", [1], trials=10))
    text = report_text(results, numbers(results), {})
    assert "Unfinished: 90 of 160 trials" in text and "tpe 1 x 10" in text


def test_facts_of_several_sessions(tmp_path):
    folder = synthetic.write(tmp_path, {"dog": (0.1, 0.0)}, 2, 3)
    machine = {"system": "Linux", "cores": 2}
    session = {"trials": 3, "wall_s": 90.0, "machine": machine}
    sessions = [
        session | {"started": f"2026-11-{day}T10:00:00+00:00"} for day in (21, 22)
    ]
    (folder / "run.json").write_text(json.dumps({"sessions": sessions}))
    found = facts(read_results(folder))
    assert found["date"] == "2026-11-21 to 2026-11-22"
    assert found["wall time"] == "3.0 min for 6 trials in 2 sessions"
    assert found["machine"] == "system Linux, cores 2"
    (folder / "run.json").unlink()
    assert "date" not in facts(read_results(folder))
    said = {"machine": {"system": "<script>alert(1)</script>\n# b | c"}}
    (folder / "run.json").write_text(json.dumps({"sessions": [said]}))
    assert read_facts(folder)["sessions"] == [said]
    words = facts(read_results(folder))["machine"]
    assert words == "system &lt;script&gt;alert(1)&lt;/script&gt; # b \\| c"


def test_facts_say_what_a_goal_weighs_and_what_is_searched():
    known = {"searched": ["exo_peak"], "objective": {"terms": {"mean_speed_mps": 2.0}}}
    for more, where in (
        ({}, "beside the 16 gains"),
        ({"fixed_gains": {"K_GAS": 1.0}}, "alone"),
    ):
        found = facts(Results(Path(), "exo", "weighted", {}, known | more))
        assert found["what it weighs"] == "mean_speed_mps 2.0"
        assert found[f"searched {where}"] == "exo_peak"


def test_one_table_a_quantity_of_several_experiments():
    stairs = arm("worlds-stairs", [1, 1, 1, 4], trials=10)
    first = counted(arm("dog", [2] * 4, trials=10), stairs, name="a")
    second = counted(
        arm("dog", [np.inf] * 4, trials=10), arm("tpe", [1] * 4, trials=10), name="b"
    )
    text = overview_text([numbers(first), numbers(second)])
    tables = [rows(part) for part in text.split("\n\n") if part.startswith("|")]
    assert len(tables) == 4
    for found in tables:
        assert found["experiment"][1:] == [
            "DoG, as printed",
            "TPE",
            "worlds, stairs' store",
        ]
    assert [found["a"][3] for found in tables] == ["4", "3", "3", "1"]
    assert [found["b"][1:] for found in tables] == [["0", "4", ""]] * 3 + [
        ["> 10", "1", ""]
    ]


def test_the_condensed_table_has_the_numbers():
    dog, best = arm("dog", [9] * 20, cost=2.0), arm("worlds-stairs", [1] * 20, cost=1.5)
    found = numbers(counted(dog, best, arm("random", [30.0] + [np.inf] * 19, cost=3.0)))
    table = rows(condensed_table(found))
    # most walkers, the soonest
    assert list(table)[2:] == ["`worlds-stairs`", "`dog`", "`random`"]
    cost = found.arms[0].cost_after[30]
    assert table["`worlds-stairs`"] == [
        "`worlds-stairs`",
        "20",
        "20",
        "84 to 100",
        "1",
        "1 to 1",
        "20",
        "20",
        "20",
        "20",
        "20",
        f"{found.arms[0].cost_after[10].value:.4g}",
        "-0.5",
        "< 1e-4",
        f"{cost.value:.4g}",
        "-0.5",
        "< 1e-4",
    ]
    # known without 60 trials
    assert table["`dog`"][10] == "20" and table["`random`"][10] == "-"
    assert table["`dog`"][12:14] == table["`dog`"][15:] == ["-", "-"]
    short = rows(
        condensed_table(numbers(counted(arm("worlds-stairs", [1, 1], trials=12))))
    )
    # one arm, 12 trials
    assert short["`worlds-stairs`"][12:] == ["-", "-", "-", "-", "-"]


def test_a_comparison_ends_with_a_line_an_arm(tmp_path):
    arms = {"random": (0.0, 0.0), "dog": (1.0, 0.0), "older": (1.0, 0.0)}
    synthetic.write(tmp_path, arms, runs=3, trials=4)
    times = {"arm": ["dog", "dog", "dog"], "proposal_s": [0.01, 0.02, 0.9]}
    pq.write_table(pa.table(times), tmp_path / "proposal_times.parquet")
    made = numbers(read_results(tmp_path))
    header, *lines = markdown.arms_text(made).splitlines()
    assert [line.split()[0] for line in lines] == ["dog", "older", "random"]
    assert lines[0].split()[1:4] == ["3", "3", "1"] and lines[0].split()[-1] == "20.0"
    assert lines[1].split()[-1] == "-"
    assert lines[2].split()[1:5] == ["3", "0", ">", "4"]
    assert {len(line) for line in lines} == {len(header)}
    dog, older, random = markdown.arms_documents(made, {})
    best = next(arm for arm in made.arms if arm.arm == "dog").best_cost.value
    assert dog == {
        "arm": "dog",
        "saw": "base setting of the store flat",
        "runs": 3,
        "trials": 12,
        "walkers": 3,
        "first_walker": 1.0,
        "best_cost": best,
        "proposal_ms": 20.0,
    }
    assert (older["saw"], older["proposal_ms"]) == ("", None)
    assert (random["walkers"], random["first_walker"]) == (0, None)


# The note that the dashboard shows of an experiment.


def trials(best, walked_below):
    """The best costs of each arm's runs, so far; a trial that costs less than that walked."""
    rows = [
        {
            "experiment": "tiny",
            "arm": arm,
            "run": run,
            "trial": trial,
            "cost": cost,
            "best_cost": cost,
            "walked": cost < walked_below,
        }
        for arm, runs in best.items()
        for run, costs in enumerate(runs)
        for trial, cost in enumerate(costs)
    ]
    return pa.Table.from_pylist(rows)


def test_a_row_has_medians_over_runs():
    best = {
        "random": [[290.0, 280.0]] * 2,
        "dog": [[300.0, 90.0], [290.0, 280.0], [90.0, 80.0]],
    }
    note = markdown.dashboard_summary("tiny", trials(best, 100.0), True, {})
    assert "10 trials (all trials)" in note
    rows = [line for line in note.splitlines() if line.startswith("| ")][2:4]
    assert rows == [
        "| dog | 3 | 2 | 67 | 2 | 90 |",
        "| random | 2 | 0 | 0 | > 2 | 280 |",
    ]
    best = {"dog": [[300.0, 90.0, 90.0], [290.0, 280.0]]}
    note = markdown.dashboard_summary("tiny", trials(best, 100.0), False, {})
    assert "5 trials (so far" in note
    assert "| dog | 2 | 1 | 50 | > 2 | 185 |" in note


def test_a_table_leads_to_every_study():
    best = {"random": [[290.0, 280.0]], "dog": [[300.0, 90.0], [290.0, 280.0]]}
    ids = {"dog/run-000": 4, "random/run-000": 7, "dog/run-001": 5, "summary": 9}
    ids = {f"tiny/{name}": number for name, number in ids.items()}
    note = markdown.dashboard_summary("tiny", trials(best, 100.0), True, ids)
    table = note[note.index("| run |") :].splitlines()
    assert table[0] == "| run | dog | random | all arms |"
    both = "[compare](/dashboard/compare-studies?ids=4,7)"
    studies = "[**90**](/dashboard/studies/4) | [280](/dashboard/studies/7)"
    assert table[2] == f"| 0 | {studies} | {both} |"
    assert table[3] == "| 1 | [280](/dashboard/studies/5) |  |  |"


def test_every_arm_can_be_renewed_once_a_minute():
    """25 arms, 50 runs, 100 trials: 2 s are allowed, of the process that compares."""
    table = pa.table(
        synthetic.columns(dict.fromkeys(ARMS, (0.05, 0.0)), 50, 100, "smooth")
    )
    ids = {study_name("all", arm, run): run for arm in ARMS for run in range(50)}
    before = time.process_time()
    note = markdown.dashboard_summary("all", table, False, ids)
    assert time.process_time() - before < 2.0
    assert note.count("/dashboard/studies/") == len(ids)
