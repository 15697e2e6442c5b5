"""What a comparison prints at its end."""

from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from study.report.markdown import arms_documents, arms_text
from study.report.numbers import Numbers, numbers
from study.report.runs import read_results
from tests.study.report import synthetic


def made(folder: Path) -> Numbers:
    arms = {"random": (0.0, 0.0), "dog": (1.0, 0.0), "older": (1.0, 0.0)}
    synthetic.write(folder, arms, runs=3, trials=4)
    times = {"arm": ["dog", "dog", "dog"], "proposal_s": [0.01, 0.02, 0.9]}
    pq.write_table(pa.table(times), folder / "proposal_times.parquet")
    return numbers(read_results(folder))


def test_a_line_an_arm(tmp_path: Path) -> None:
    header, *lines = arms_text(made(tmp_path)).splitlines()
    assert [line.split()[0] for line in lines] == ["dog", "older", "random"]
    assert lines[0].split()[1:4] == ["3", "3", "1"] and lines[0].split()[-1] == "20.0"
    assert lines[1].split()[-1] == "-"
    assert lines[2].split()[1:5] == ["3", "0", ">", "4"]
    assert {len(line) for line in lines} == {len(header)}


def test_programs_get_the_same(tmp_path: Path) -> None:
    found = made(tmp_path)
    dog, older, random = arms_documents(found, {})
    best = next(arm for arm in found.arms if arm.arm == "dog").best_cost.value
    assert dog == {
        "arm": "dog", "saw": "base setting of the store flat", "runs": 3, "trials": 12,
        "walkers": 3, "first_walker": 1.0, "best_cost": best, "proposal_ms": 20.0,
    }  # fmt: skip
    assert (older["saw"], older["proposal_ms"]) == ("", None)
    assert (random["walkers"], random["first_walker"]) == (0, None)
