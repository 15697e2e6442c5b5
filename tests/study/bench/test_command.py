"""`taichi-nmm bench`: the sheet, results by hand, files in and out, one line for what is wrong."""

import json
import os
import re
import shlex
from pathlib import Path

import pytest

from study.bench.bench import Bench
from study.cli import main
from study.commands.bench import ACTIONS
from tests.cases import asset
from tests.study.bench import robot
from tests.tools.running import ROOT, finish, start
from tests.tools.test_hostile import without_the_rights_of_root

MODULE = ("-m", "taichi_nmm")


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


def test_trials_go_out_and_come_in(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    robot.run(Bench.new("walk.toml"), 4)
    Bench("walk.toml").next()
    assert "5 trials: trials.csv" in bench("export trials.csv", capsys)
    (folder / "second").mkdir()
    robot.write(folder / "second")
    bench("new second/walk.toml", capsys)
    assert "trials 0, 1, 2, 3" in bench(
        "import trials.csv --bench second/walk.toml", capsys
    )
    told, again = (
        Bench("walk.toml").state.trials,
        Bench("second/walk.toml").state.trials,
    )
    assert [(told[n].params, told[n].value) for n in again] == [
        (trial.params, trial.value) for trial in again.values()
    ]
    (folder / "trials.csv").write_text("stiffness,value\n1,2\n")
    said = bench("import trials.csv --bench second/walk.toml", capsys, 2)
    assert (
        said.startswith("error: import: 'damping'")
        and len(Bench("second/walk.toml").entries) == 2
    )


def test_a_log_of_a_walk_gives_the_cost(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
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
    assert "warning: trial 0: J/m -31 is far from all" in bench(
        "correct 0 --cost -31", capsys
    )


@pytest.mark.parametrize(("line", "said"), asset("bench-refusals.toml").items())
def test_what_is_wrong_is_one_line(
    folder: Path, line: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    bench("new walk.toml", capsys)
    bench("next", capsys)
    found = bench(line.replace("NINES", 5000 * "9"), capsys, 2)
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


def toml_with(folder: Path, more: str) -> None:
    """The bench, whose file has more tables."""
    robot.write(folder, more=more)


@pytest.mark.parametrize(
    "name",
    [
        "cost",
        "value",
        "Value",
        "note",
        "log",
        "seconds",
        "help",
        "h",
        "bench",
        "port",
        "operator",
        "trial",
        "context",
        "failed",
        "why",
        "row",
        "stiffness",
        "Stiffness",
        "TORQUE",
        "a=b",
        " ",
        "-x",
        "",
    ],
)
def test_a_column_whose_name_has_another_meaning_is_refused(
    folder: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    toml_with(folder, f"[columns.{json.dumps(name)}]\nmost = 1\n")
    assert f"error: columns: {name!r} cannot be used; allowed: another name" in bench(
        "new walk.toml", capsys, 2
    )
    assert Bench("walk.toml").entries == ()


def test_names_that_differ_in_dashes_alone_are_one(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    toml_with(folder, '[columns."step length"]\n[columns.Step-Length]\n')
    said = bench("new walk.toml", capsys, 2)
    assert "columns: 'Step-Length'" in said and "step length is another column" in said
    text = (
        (folder / "walk.toml")
        .read_text()
        .replace('"damping"', '"note"')
        .partition("[columns.")[0]
    )
    (folder / "walk.toml").write_text(text)
    rows = (folder / "candidates.csv").read_text().replace("damping", "note")
    (folder / "candidates.csv").write_text(rows)
    assert "candidates.parameters: 'note'" in bench("new walk.toml", capsys, 2)


def test_the_line_of_a_sheet_can_be_typed_as_it_is_printed(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """With blanks in names, umlauts, and a file in another folder."""
    (folder / "my bench").mkdir()
    toml_with(folder / "my bench", '[columns."time limit"]\n[columns."größe"]\n')
    said = bench("new", capsys, 2)
    main(["bench", "new", "my bench/walk.toml"])
    begun = capsys.readouterr().out.splitlines()[-1].removeprefix("next: ")
    main(shlex.split(begun)[1:])
    said = capsys.readouterr().out
    (line,) = (each for each in said.splitlines() if each.startswith("enter: "))
    words = shlex.split(line.removeprefix("enter: "))
    assert words.count("...") == 4
    numbers = iter(("0.5", "81", "7", "-1e-2"))
    main([next(numbers) if word == "..." else word for word in words][1:])
    trial = Bench("my bench/walk.toml").state.trials[0]
    assert (trial.value, trial.columns) == (
        0.5,
        {"torque": 81.0, "time limit": 7.0, "größe": -0.01},
    )
    assert (
        "record 0: 0.5, torque 81, time limit 7, größe -0.01\n"
        in capsys.readouterr().out
    )


def test_an_old_bench_with_such_a_column_opens_and_says_so(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    toml_with(folder, "[columns.cost]\n")
    with monkeypatch.context() as patch:
        patch.setattr("study.bench.bench.require_names", lambda *_: None)
        bench("new walk.toml", capsys)
    said = bench("next", capsys)
    assert "record 0 --value ... --torque ...\n" in said and "alone: cost\n" in said
    assert "value: '2.0'" in bench("record 0 --cost 1 --cost 2", capsys, 2)
    assert "warning: columns cost: --cost is an option" in bench("status", capsys)


def test_what_a_correction_does_to_a_failure_is_said(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bench("new walk.toml", capsys)
    bench("next", capsys)
    assert "fail 0: failed after 2.1 s, 5.79\n" in bench("fail 0 --seconds 2.1", capsys)
    said = bench("correct 0 --seconds 21", capsys)
    assert "correct 0: failed after 21 s, 3.9\n" in said
    trial = Bench("walk.toml").state.trials[0]
    assert (trial.value, trial.failed) == (pytest.approx(3.9), True)
    assert "correct 0: torque 70\n" in bench("correct 0 --torque 70", capsys)
    assert Bench("walk.toml").state.trials[0].failed
    said = bench("correct 0 --value 0.4", capsys)
    assert "correct 0: 0.4, no longer a failure\n" in said
    assert not Bench("walk.toml").state.trials[0].failed
    bench("undo", capsys)
    assert Bench("walk.toml").state.trials[0].failed
    bench("next", capsys)
    assert "record 1: 0.92\n" in bench("record 1 --value 0.92", capsys)
    bench("correct 1 --seconds 30", capsys)
    assert Bench("walk.toml").state.trials[1].failed


def test_nothing_is_recommended_before_a_trial_is_finished(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bench("new walk.toml", capsys)
    nothing = "Nothing to recommend yet: no trial is finished"
    assert bench("recommend", capsys) == f"{nothing}.\n"
    bench("next", capsys)
    bench("record 0 --value 1", capsys)
    assert "without the noise" in bench("recommend", capsys)
    bench("context gravel", capsys)
    assert bench("recommend", capsys) == f"{nothing} in gravel.\n"


def test_words_of_a_sheet(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    robot.write(folder, robot.FEATURES)
    bench("new walk.toml", capsys)
    assert "simulated" not in bench("next", capsys)
    for times in ("once", "twice", "3 times"):
        bench("abort 0", capsys)
        assert f"(again: broken off {times})" in bench("next", capsys)
    bench("record 0 --value 1", capsys)
    assert "Expected: 1 (interval unknown)" in bench("next", capsys)  # of one value
    bench("record 1 --value 2", capsys)
    assert "the mean without noise)" in bench("next", capsys)


def test_who_has_no_entry_among_the_users_is_a_number(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("LOGNAME", "USER", "LNAME", "USERNAME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("pwd.getpwuid", lambda number: {}[number])
    monkeypatch.setattr("socket.gethostname", lambda: "")
    assert f"begun by uid-{os.getuid()}@localhost\n" in bench("new walk.toml", capsys)


@pytest.mark.slow
def test_what_is_only_read_needs_no_place_to_write(folder: Path) -> None:
    """A folder that is read-only, also for root."""
    folder.joinpath("own").mkdir()
    began = Bench.new(robot.write(folder / "own"))
    robot.run(began, 3)
    del began
    os.chdir(folder / "own")
    rights = without_the_rights_of_root()
    for file in ("walk.db", "walk.toml", "candidates.csv"):
        Path(file).chmod(0o444)
    Path().chmod(0o555)
    try:
        before = sorted(Path().iterdir())
        for line in ("status", "recommend", f"export {folder}/trials.csv"):
            done = finish(start("bench", *line.split(), shell=rights, program=MODULE))
            assert (done.code, done.error) == (0, ""), done
        done = finish(start("bench", "next", shell=rights, program=MODULE))
        assert done.code == 2 and len(done.lines) == 1 and "storage: " in done.error
        assert sorted(Path().iterdir()) == before
    finally:
        Path().chmod(0o755)
    assert (folder / "trials.csv").read_text().count("\n") == 4


@pytest.mark.slow
def test_a_terminal_without_umlauts_gets_escapes_and_nothing_is_lost(
    folder: Path,
) -> None:
    rows = (folder / "candidates.csv").read_text().replace("damping", "dämpfung")
    (folder / "candidates.csv").write_text(rows)
    toml = (folder / "walk.toml").read_text().replace("damping", "dämpfung")
    (folder / "walk.toml").write_text(toml.replace("torque", "'größe'"))
    ascii_alone = 'export PYTHONIOENCODING=ascii PYTHONUTF8=0 LC_ALL=C; exec "$@"'
    for line in (
        "new walk.toml",
        "next",
        "record 0 --value 1",
        "status",
        "recommend",
        "undo 9",
    ):
        done = finish(start("bench", *line.split(), shell=ascii_alone, program=MODULE))
        assert (
            done.code == (2 if line == "undo 9" else 0)
            and "Traceback" not in done.error
        )
        if line == "next":
            assert "d\\xe4mpfung" in done.out
        elif line == "recommend":
            assert "dämpfung" in json.loads(done.out.splitlines()[1])
    assert [entry.kind for entry in Bench("walk.toml").entries] == [
        "begin",
        "next",
        "record",
    ]


@pytest.mark.slow
def test_status_loads_little(folder: Path) -> None:
    robot.run(Bench.new("walk.toml"), 2)
    code = """
import sys
from study.cli import main
main(["bench", "status"])
found = set(sys.modules) & {
    "alembic", "sqlalchemy.orm", "matplotlib", "taichi", "quadrants", "sklearn", "scipy.special",
    "scipy.stats", "bottle", "optuna_dashboard", "mujoco",
}
assert not found, found
"""
    done = finish(start("-c", code, program=()))
    assert done.code == 0, done.error


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
        "walk: FeatureTable(300 rows",
        "trial 0 | walk\n",
        "Expected: ",
        "enter: taichi-nmm bench record 1 --value ... --torque ...",
        "again: broken off once",
        "trial   0  0.92        torque 81  slipped on the mat\n",
        "correct 2: 0.51 (undone)",
        "undone: ",
        "\ntrial 6\n",
        "trial   3  simulated",
        "worlds the robot is like",
        "trial 8 | walk | gravel",
    ):
        assert words in said.out
    assert re.search(
        r"^Trial \d.*\n\{.*\}\nThe interval .*\nA repeat of trial \d",
        said.out,
        re.MULTILINE,
    )
    asked = json.loads((tmp_path / "next.json").read_text())
    assert [trial["trial"] for trial in asked] == [3, 4, 5] and len(
        asked[0]["params"]
    ) == 2
    assert (tmp_path / "walk-simulator.png").stat().st_size > 5000
    assert set(re.findall(r"taichi-nmm bench ([a-z-]+)", page)) >= set(ACTIONS) - {
        "import"
    }


def test_decimal_commas_are_typed_and_numbers_that_may_be_two_are_refused(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bench("new walk.toml", capsys)
    bench("next", capsys)
    bench("record 0 --cost 0,92 --torque 80,5", capsys)
    trial = Bench("walk.toml").state.trials[0]
    assert (trial.value, trial.columns) == (0.92, {"torque": 80.5})
    for line in ("correct 0 --cost 1,234", "correct 0 --torque 1,234"):
        said = bench(line, capsys, 2)
        assert (
            "'1,234' cannot be used; allowed: 1234 or 1.234" in said
            and said.count("\n") == 1
        )


def test_an_export_that_a_spreadsheet_has_saved_comes_in_as_it_was(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    robot.run(Bench.new("walk.toml"), 4)
    bench("export trials.csv", capsys)
    lines = (folder / "trials.csv").read_text().splitlines()
    european = [line.replace(",", ";").replace(".", ",") for line in lines]
    (folder / "trials.csv").write_bytes(
        ("\ufeff" + "\r\n".join(european) + "\r\n").encode()
    )
    (folder / "second").mkdir()
    robot.write(folder / "second")
    bench("new second/walk.toml", capsys)
    bench("import trials.csv --bench second/walk.toml", capsys)
    told, again = (
        Bench("walk.toml").state.trials,
        Bench("second/walk.toml").state.trials,
    )
    assert len(again) == 4 and all(trial.note == "" for trial in again.values())
    for number, trial in again.items():
        assert (trial.params, trial.value) == (told[number].params, told[number].value)
