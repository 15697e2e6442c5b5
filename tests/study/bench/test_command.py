"""`taichi-nmm bench`: the sheet, results by hand, files in and out, one line for what is wrong."""

import json
import re
import shlex
from pathlib import Path

import pytest

from study.bench.bench import Bench
from study.cli import main
from study.commands.bench import ACTIONS
from tests.study.bench import robot
from tests.tools.running import ROOT


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    robot.write(tmp_path)
    (tmp_path / "other.toml").write_text("[tool]\n")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def bench(line: str, capsys: pytest.CaptureFixture[str], code: int = 0) -> str:
    """What a command line prints, on either stream."""
    if code:
        with pytest.raises(SystemExit) as left:
            main(["bench", *line.split()])
        assert left.value.code == code
    else:
        main(["bench", *line.split()])
    said = capsys.readouterr()
    return said.out + said.err


def test_trials_go_out_and_come_in(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    robot.run(Bench.new("walk.toml"), 4)
    Bench("walk.toml").next()
    assert "5 trials: trials.csv" in bench("export trials.csv", capsys)
    (folder / "second").mkdir()
    robot.write(folder / "second")
    bench("new second/walk.toml", capsys)
    assert "trials 0, 1, 2, 3" in bench("import trials.csv --bench second/walk.toml", capsys)
    told, again = Bench("walk.toml").state.trials, Bench("second/walk.toml").state.trials
    assert [(told[n].params, told[n].value) for n in again] == [
        (trial.params, trial.value) for trial in again.values()
    ]
    (folder / "trials.csv").write_text("stiffness,value\n1,2\n")
    said = bench("import trials.csv --bench second/walk.toml", capsys, 2)
    assert (
        said.startswith("error: import: 'damping'") and len(Bench("second/walk.toml").entries) == 2
    )


def test_a_log_of_a_walk_gives_the_cost(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "begun by me" in bench("new walk.toml --operator me", capsys)
    bench("next", capsys)
    for seconds, name in ((30, "whole"), (10, "short")):
        rows = "\n".join(f"{t},{1.2 * t}" for t in range(seconds + 1))
        (folder / f"{name}.csv").write_text(f"time,position\n{rows}\n")
    assert "record 0" in bench("record 0 --log whole.csv", capsys)
    whole = Bench("walk.toml").state.trials[0].value
    bench("correct 0 --log short.csv", capsys)
    short = Bench("walk.toml").state.trials[0].value
    assert whole is not None and short is not None and whole < short
    assert "warning: -31 is far from all" in bench("correct 0 --cost -31", capsys)


@pytest.mark.parametrize(("line", "said"), [
    ("dance", "action: 'dance'"),
    ("new", "what: 'missing' cannot be used; allowed: the TOML file of the bench"),
    ("status --bench nothing.toml", "bench: 'nothing.toml'"),
    ("record one --cost 1", "what: 'one' cannot be used; allowed: a number"),
    (f"undo {'9' * 5000}", "what: '999"),
    ("record 0", "cost: 'missing'"),
    ("record 0 --cost 1 --torque much", "torque: 'much' cannot be used; allowed: a number"),
    ("fail 0", "seconds: 'missing'"),
    ("add --cost 1", "gains: 'missing'"),
])  # fmt: skip
def test_what_is_wrong_is_one_line(
    folder: Path, line: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    bench("new walk.toml", capsys)
    bench("next", capsys)
    found = bench(line, capsys, 2)
    assert found.startswith(f"error: {said}") and found.count("\n") == 1
    assert len(Bench("walk.toml").entries) == 2


def test_a_folder_needs_one_bench_that_was_begun(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "a bench that was begun: taichi-nmm bench new" in bench("next", capsys, 2)
    assert not (folder / "walk.db").exists() or not Bench("walk.toml").entries
    robot.write(folder).rename(folder / "second.toml")
    robot.write(folder)
    assert "bench: 'second.toml, walk.toml'" in bench("next", capsys, 2)


def test_the_page_runs_from_top_to_bottom(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "docs" / "bench.md").read_text()
    toml, *_ = re.findall(r"^```toml\n(.*?)^```$", page, re.DOTALL | re.MULTILINE)
    (tmp_path / "walk.toml").write_text(toml)
    for language, code in re.findall(
        r"^```(python|sh)\n(.*?)^```$", page, re.DOTALL | re.MULTILINE
    ):
        if language == "python":
            exec(compile(code, "bench.md", "exec"), {})
            continue
        for line in code.splitlines():
            program, *words = shlex.split(line)
            if program == "echo":
                Path(words[2]).write_text(words[0])
            else:
                assert (program, words[0]) == ("taichi-nmm", "bench")
                main(words)
    said = capsys.readouterr()
    assert "warning" not in said.err
    for words in (
        "walk: FeatureTable(300 rows", "trial 0 | walk\n", "Expected: ",
        "enter: taichi-nmm bench record 1 --cost ... --torque ...", "again: broken off 1 times",
        "trial   0  0.92        torque 81  slipped on the mat\n", "correct 2 (undone)", "undone: ",
        "\ntrial 6\n", "trial   3  simulated", "worlds the robot is like", "trial 8 | walk | gravel"
    ):  # fmt: skip
        assert words in said.out
    assert re.search(r"^Trial \d.*\n\{.*\}\nA repeat of trial \d", said.out, re.MULTILINE)
    asked = json.loads((tmp_path / "next.json").read_text())
    assert [trial["trial"] for trial in asked] == [3, 4, 5] and len(asked[0]["params"]) == 2
    assert (tmp_path / "walk-simulator.png").stat().st_size > 5000
    assert set(re.findall(r"taichi-nmm bench ([a-z-]+)", page)) >= set(ACTIONS) - {"import"}
