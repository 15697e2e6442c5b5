"""The tool that holds a forecast beside what came of an experiment's robots."""

import shutil

import pytest

from tests.study import fake_walker


@pytest.fixture
def done(tool, simulator, tmp_path):
    """A comparison of three made-up robots, of which two trials each are known."""
    folder = tmp_path / "done"
    config = fake_walker.write_config(tmp_path)
    line = f"--config {config} --out {folder} --workers 1 --arms worlds --trials 2"
    assert tool("compare", *line.split()) == 0, tool.err
    return folder


@pytest.mark.slow
def test_a_line_an_experiment_and_a_count(tool, done):
    assert tool("compare_forecast", done) == 0, tool.err
    head, _, line, _, said = tool.out.splitlines()
    assert line[:8] == "| toy | " and line.count("|") == head.count("|")
    assert "first success within the forecast, of 1: all worlds: " in said


@pytest.mark.slow
def test_what_cannot_be_compared_is_refused_before_the_table(tool, done, tmp_path):
    tool.refuses("folder: .*none", "compare_forecast", done, tmp_path / "none")
    shutil.rmtree(tmp_path / "store")
    tool.refuses("folder: .* store of worlds", "compare_forecast", done)
