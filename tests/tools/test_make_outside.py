"""The maker of the files of problems from outside: what it writes and refuses."""

from pathlib import Path

import numpy as np
import pytest

from study.benchmarks.outside.outside_problem import outside_problem, read
from tests.tools.running import run_tool

PROBLEM = "transport-solver"


@pytest.mark.slow
def test_the_first_rows_are_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "made" / "some.parquet"
    given = ("--problem", PROBLEM, "--rows", 6, "--out", path)
    assert run_tool(monkeypatch, "make_outside", *given) == 0
    made, kept = read(path), outside_problem(PROBLEM)
    assert len(made) == 6
    for row in range(6):
        assert made.settings(row) == kept.settings(row)
    np.testing.assert_allclose(made.features, kept.features[:6], rtol=1e-3)
    np.testing.assert_allclose(made.cost, kept.cost[:6], rtol=1e-3)
    first = path.read_bytes()
    assert run_tool(monkeypatch, "make_outside", *given) == 0
    assert path.read_bytes() == first


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--problem", "easy"), "problem: 'easy'"),
        (("--problem", PROBLEM, "--rows", 5), "--out as well"),
        (("--problem", PROBLEM, "--rows", 0, "--out", "some.parquet"), "rows: 0"),
    ],
)
def test_bad_arguments_are_one_line_and_exit_code_2(
    arguments: tuple[object, ...],
    said: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert run_tool(monkeypatch, "make_outside", *arguments) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("error: ") and said in lines[0]
