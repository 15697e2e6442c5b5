"""Folders of which no report can be made: one line each, and nothing is written."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from storage.commit import together
from study.report import writing
from study.report.markdown import facts, report_text
from study.report.numbers import numbers
from study.report.runs import Results, known_stores, read_facts, read_results
from study.report.writing import write_report
from taichi_nmm.errors import InputError
from tests.study.report import synthetic

TWO = {"dog": (0.02, 0.002), "random": (0.01, 0.0)}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return synthetic.write(tmp_path / "small", TWO, runs=3, trials=4)


def refusal(folder: Path) -> str:
    with pytest.raises(InputError) as caught:
        read_results(folder)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("text", ["[]", "5", "null", '"a"', "true", "{", "[" * 100_000])
@pytest.mark.parametrize("name", ["experiment.json", "run.json"])
def test_documents_that_are_no_objects(folder: Path, name: str, text: str) -> None:
    (folder / name).write_text(text)
    assert refusal(folder).startswith(f"{name}: ")


@pytest.mark.parametrize(
    ("name", "part"),
    [
        ("experiment.json", {"objective": 5}), ("experiment.json", {"objective": {"cost": "<b>"}}),
        ("experiment.json", {"simulation": []}), ("experiment.json", {"searched": [1]}),
        ("experiment.json", {"simulation": {"duration_s": "long"}}),
        ("experiment.json", {"simulation": {"duration_s": 10**400}}),
        ("experiment.json", {"until_walker": "no"}), ("experiment.json", {"stores": {"flat": 3}}),
        ("experiment.json", {"terrain": "rough"}), ("experiment.json", {"versions": ["1"]}),
        ("experiment.json", {"body": 0.15}), ("experiment.json", {"ground": "rough"}),
        ("run.json", {"sessions": 5}), ("run.json", {"sessions": [5]}),
        ("run.json", {"sessions": [{"machine": "fast"}]}),
        ("run.json", {"sessions": [{"wall_s": float("nan")}]}),
        ("run.json", {"sessions": [{"trials": 10**400}]}), ("run.json", {"sessions": [None]}),
        ("run.json", {"sessions": [{"stores": {"flat": 5}}]}),
    ],
)  # fmt: skip
def test_parts_of_another_form(folder: Path, name: str, part: dict[str, Any]) -> None:
    (folder / name).write_text(json.dumps(part))
    assert refusal(folder).startswith(f"{name}: {next(iter(part))}")


@pytest.mark.parametrize(
    ("name", "part"),
    [
        ("run.json", {"sessions": None}), ("run.json", {"sessions": [{"stores": None}]}),
        ("run.json", {"sessions": [{"stores": {"flat": None}}]}),
        ("run.json", {"sessions": [{"wall_s": None, "machine": None, "started": None}]}),
        ("experiment.json", {"simulation": {"duration_s": None}, "objective": {"cost": None}}),
        ("experiment.json", {"terrain": None, "searched": None, "stores": None, "body": None}),
    ],
)  # fmt: skip
def test_what_is_null_is_not_there(folder: Path, name: str, part: dict[str, Any]) -> None:
    (folder / name).write_text(json.dumps({}))
    without = facts(read_results(folder))
    (folder / name).write_text(json.dumps(part))
    results = read_results(folder)
    found = facts(results)
    assert known_stores(results) == {}
    assert {key: value for key, value in found.items() if key != "wall time"} == without


def with_column(folder: Path, name: str, values: Any) -> None:
    table = pq.read_table(folder / "trials.parquet")
    place = table.schema.get_field_index(name)
    pq.write_table(table.set_column(place, name, pa.array(values)), folder / "trials.parquet")


COUNT = 2 * 3 * 4
ODD = [None, *["dog"] * (COUNT - 1)]


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("arm", ODD), ("arm", ["<script>"] * COUNT), ("arm", ["a|b"] * COUNT),
        ("arm", ["$\\frac$"] * COUNT), ("arm", [1] * COUNT), ("arm", [None] * COUNT),
        ("experiment", ["a\nb"] * COUNT), ("run", [None, *[0] * (COUNT - 1)]),
        ("run", [-1] * COUNT), ("trial", [0.5] * COUNT), ("walked", [1] * COUNT),
        ("cost", [np.nan] * COUNT), ("best_cost", [np.nan, *[1.0] * (COUNT - 1)]),
        ("best_cost", [np.inf] * COUNT), ("best_cost", ["cheap"] * COUNT),
        ("cost", [1e308] * COUNT),
    ],
)  # fmt: skip
def test_columns_of_something_else(folder: Path, name: str, values: Any) -> None:
    with_column(folder, name, values)
    assert refusal(folder).startswith(f"trials.parquet: {name}: ")


def test_a_table_without_trials(folder: Path) -> None:
    table = pq.read_table(folder / "trials.parquet")
    pq.write_table(table.slice(0, 0), folder / "trials.parquet")
    assert "with trials" in refusal(folder)


def test_what_a_folder_says_is_escaped(folder: Path) -> None:
    said = {"machine": {"system": "<script>alert(1)</script>\n# b | c"}}
    (folder / "run.json").write_text(json.dumps({"sessions": [said]}))
    assert read_facts(folder)["sessions"] == [said]
    words = facts(read_results(folder))["machine"]
    assert words == "system &lt;script&gt;alert(1)&lt;/script&gt; # b \\| c"


def test_a_few_trials_have_a_table_of_costs(folder: Path) -> None:
    results = read_results(folder)
    text = report_text(results, numbers(results), None)
    table = text.partition("## Best cost\n\n")[2].splitlines()
    assert table[0] == "| arm | median best smooth cost after the last trial | interval | ms |"
    assert table[2].startswith("| dog (DoG, as printed) | ") and len(table[2].split("|")) == 6


def test_a_report_that_fails_leaves_what_was_there(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(new: Path, results: Results) -> None:
        (new / "walkers.png").touch()
        raise InputError("disk", "full", "space")

    monkeypatch.setattr(writing, "write_walkers", fails)
    results = read_results(folder)
    before = sorted(folder.iterdir())
    with pytest.raises(InputError, match="disk"):
        write_report(results, None)
    assert sorted(folder.iterdir()) == before


def test_files_appear_together(tmp_path: Path) -> None:
    folder = tmp_path / "deep" / "report"
    (tmp_path / "deep" / ".report.new").mkdir(parents=True)  # of a process that was killed
    (tmp_path / "deep" / ".report.new" / "old").touch()
    for text in ("1", "2"):
        with together(folder) as new:
            (new / "a").write_text(text)
            (new / text).touch()
            assert not (folder / text).exists()
        assert (folder / "a").read_text() == text
    assert sorted(path.name for path in folder.iterdir()) == ["1", "2", "a"]
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=r"out: .*file"), together(tmp_path / "file"):
        pass
    assert [path.name for path in folder.parent.iterdir()] == ["report"]
