"""tools/report.py as its users meet it: files, unfinished folders, refusals."""

import json
import runpy
import sys
from pathlib import Path

import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

from tests.study.report import synthetic

ROOT = Path(__file__).resolve().parents[2]
ARMS = {"dog": (0.05, 0.01), "random": (0.01, 0.0), "best": (0.9, 0.0)}
FILES = {
    "best-cost.png", "best-cost.svg", "walkers.png", "walkers.svg", "first-walker.png",
    "first-walker.svg", "report.md", "summary.json",
}  # fmt: skip


def report(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    monkeypatch.setattr(sys, "argv", ["report.py", *map(str, arguments)])
    monkeypatch.setattr(sys, "path", list(sys.path))
    try:
        runpy.run_path(str(ROOT / "tools" / "report.py"), run_name="__main__")
    except SystemExit as end:
        return int(end.code or 0)
    return 0


def write(folder: Path, cost: str = "smooth") -> Path:
    return synthetic.write(folder, ARMS, runs=5, trials=12, cost=cost, name=folder.name)


def test_a_report_has_its_figures_and_its_numbers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write(tmp_path / "rough8")
    assert report(monkeypatch, folder) == 0
    assert {file.name for file in (folder / "report").iterdir()} >= FILES
    summary = json.loads((folder / "report" / "summary.json").read_text())
    assert summary["experiment"] == "rough8" and summary["complete"] is True
    assert {arm["arm"] for arm in summary["arms"]} == set(ARMS)
    assert (folder / "report" / "report.md").read_text().startswith("# rough8\n")
    assert "rough8" in capsys.readouterr().out


def test_an_unfinished_folder_is_reported_as_far_as_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write(tmp_path / "begun")
    table = pq.read_table(folder / "trials.parquet")
    behind = pc.and_(pc.equal(table["arm"], "best"), pc.greater(table["trial"], 3))
    (folder / "arms").mkdir()
    pq.write_table(table.filter(pc.invert(behind)), folder / "arms" / "all.parquet")
    (folder / "trials.parquet").unlink()
    assert report(monkeypatch, folder) == 0
    assert "140 of 180 trials" in capsys.readouterr().out
    assert "Unfinished: 140 of 180" in (folder / "report" / "report.md").read_text()


def test_several_folders_share_an_overview(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folders = [write(tmp_path / "one"), write(tmp_path / "two", "walking")]
    assert report(monkeypatch, *folders, "--out", tmp_path / "all") == 0
    text = (tmp_path / "all" / "overview.md").read_text()
    assert "| one |" in text and "| two |" in text
    assert "\n## one\n" in text and "\n## two\n" in text
    assert (tmp_path / "all" / "overview.png").stat().st_size > 5_000
    assert (tmp_path / "all" / "overview.svg").exists()
    known = json.loads((tmp_path / "all" / "overview.json").read_text())
    assert [each["experiment"] for each in known["experiments"]] == ["one", "two"]


def test_the_optimum_of_the_same_cost_is_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = write(tmp_path / "rough8")
    for cost, best in (("walking", 5.0), ("smooth", 0.011)):
        (tmp_path / f"{cost}.json").write_text(json.dumps({"cost": cost, "best_cost": best}))
    given = [
        word for cost in ("walking", "smooth") for word in ("--optimum", tmp_path / f"{cost}.json")
    ]
    assert report(monkeypatch, folder, *given) == 0
    assert json.loads((folder / "report" / "summary.json").read_text())["optimum"] == 0.011
    assert "estimated optimum: 0.011" in (folder / "report" / "report.md").read_text()


def test_a_configuration_that_is_anothers_costs_the_strips(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(ROOT)  # its configs/rough8.toml is a study's, not a comparison's
    folder = write(tmp_path / "rough8")
    assert report(monkeypatch, folder) == 0
    assert "rough8: no strips (" in capsys.readouterr().err
    assert not (folder / "report" / "strips.png").exists()
    assert report(monkeypatch, folder, "--configs", "configs") == 2
    assert report(monkeypatch, folder, "--no-strips") == 0
    assert capsys.readouterr().err.count("\n") == 1  # of the refusal


def test_bad_input_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write(tmp_path / "rough8")
    broken = tmp_path / "broken.json"
    broken.write_text(json.dumps({"best": 1}))
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").write_text("")
    configs = tmp_path / "configs"
    configs.mkdir()
    (configs / "rough8.toml").write_text('name = "rough8"\nseed = 1\n[terrain]\nsteepness = 3\n')
    cases: list[tuple[tuple[object, ...], str]] = [
        ((tmp_path / "nowhere",), "folder"),
        ((tmp_path / "empty",), "folder"),
        ((folder, "--optimum", tmp_path / "none.json"), "optimum"),
        ((folder, "--optimum", broken), "optimum"),
        ((folder, "--out", tmp_path / "all"), "out"),
        ((folder, folder, "--out", tmp_path / "file", "--no-strips"), "out"),
        ((folder, "--configs", configs), "terrain.steepness"),
    ]
    for arguments, field in cases:
        assert report(monkeypatch, *arguments) == 2
        lines = capsys.readouterr().err.strip().splitlines()
        assert len(lines) == 1 and lines[0].startswith(f"error: {field}: "), lines
    assert not (tmp_path / "all").exists()
