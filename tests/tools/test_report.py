"""`taichi-nmm report` as its users meet it: files, unfinished folders, refusals."""

import json
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO

import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

from tests.study.report import synthetic
from tests.tools.running import run_tool

pytestmark = pytest.mark.slow

ARMS = {"dog": (0.05, 0.01), "random": (0.01, 0.0), "worlds-stairs": (0.9, 0.0)}


def write(folder, cost="smooth"):
    return synthetic.write(folder, ARMS, runs=5, trials=12, cost=cost, name=folder.name)


@pytest.fixture(scope="module")
def reported(tmp_path_factory):
    """A finished and an unfinished folder, reported together; what was printed."""
    root = tmp_path_factory.mktemp("reported")
    write(root / "one")
    begun = write(root / "two", "walking")
    table = pq.read_table(begun / "trials.parquet")
    behind = pc.and_(
        pc.equal(table["arm"], "worlds-stairs"), pc.greater(table["trial"], 3)
    )
    (begun / "arms").mkdir()
    pq.write_table(table.filter(pc.invert(behind)), begun / "arms" / "all.parquet")
    (begun / "trials.parquet").unlink()
    out, err = StringIO(), StringIO()
    with (
        pytest.MonkeyPatch.context() as patch,
        redirect_stdout(out),
        redirect_stderr(err),
    ):
        words = root / "one", begun, "--out", root / "all"
        assert run_tool(patch, "report", *words) == 0
    (root / "out.txt").write_text(out.getvalue())
    (root / "err.txt").write_text(err.getvalue())
    return root


def test_a_report_has_its_figures_and_its_numbers(reported):
    folder = reported / "one" / "report"
    names = {"best-cost.png", "first-walker.png", "report.md", "summary.json"}
    assert {file.name for file in folder.iterdir()} == names
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["experiment"] == "one" and summary["complete"] is True
    assert {arm["arm"] for arm in summary["arms"]} == set(ARMS)
    assert (folder / "report.md").read_text().startswith("# one\n")
    assert f"{folder}: one\n" in (reported / "out.txt").read_text()


def test_an_unfinished_folder_is_reported_as_far_as_it_is(reported):
    assert "two (140 of 180 trials)" in (reported / "out.txt").read_text()
    assert (
        "Unfinished: 140 of 180"
        in (reported / "two" / "report" / "report.md").read_text()
    )
    assert (reported / "err.txt").read_text() == ""


def test_several_folders_share_an_overview(reported):
    folder = reported / "all"
    text = (folder / "overview.md").read_text()
    assert "| one |" in text and "| two |" in text
    assert "\n## one\n" in text and "\n## two\n" in text
    assert {file.name for file in folder.iterdir()} == {"overview.md", "overview.json"}
    known = json.loads((folder / "overview.json").read_text())
    assert [each["experiment"] for each in known["experiments"]] == ["one", "two"]


def test_bad_input_is_one_line(tmp_path, tool):
    folder = write(tmp_path / "rough8")
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").write_text("")
    for field, *arguments in (
        ("folder", tmp_path / "nowhere"),
        ("folder", tmp_path / "empty"),
        ("out", folder, "--out", tmp_path / "all"),
        ("folder", folder, tmp_path / "empty"),
        ("out", folder, folder, "--out", "/"),
    ):
        tool.refuses(f"{field}: ", "report", *arguments)
    assert not (tmp_path / "all").exists() and not (folder / "report").exists()
