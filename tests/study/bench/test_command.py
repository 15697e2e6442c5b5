"""`taichi-nmm bench`: the sheet, results by hand, files in and out, one line for what is wrong."""

import json
import os
import re
import shlex
from contextlib import nullcontext
from pathlib import Path

import pytest

from study.bench import forecasts
from study.bench.bench import Bench
from study.cli import ProgressBar, main
from study.commands.bench import ACTIONS
from study.sampler import calibration
from tests.cases import asset
from tests.study.bench import robot
from tests.study.sampler.studies import run_code
from tests.tools.running import ROOT, Done, finish, start
from tests.tools.test_hostile import without_the_rights_of_root


@pytest.fixture
def folder(tmp_path, monkeypatch):
    robot.write(tmp_path)
    (tmp_path / "other.toml").write_text("[tool]\n")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def bench(folder, capsys):
    """What a command line prints, on either stream."""

    def say(line, code=0):
        left = pytest.raises(SystemExit, check=lambda end: end.code == code)
        with left if code else nullcontext():
            main(["bench", *line.split()])
        said = capsys.readouterr()
        return said.out + said.err

    return say


@pytest.fixture
def asked(bench):
    """The same, once trial 0 was asked for."""
    bench("new walk.toml")
    bench("next")
    return bench


def of_walk():
    """What the entries come to."""
    return Bench("walk.toml").state


def test_a_log_of_a_walk_gives_the_cost(folder, asked):
    costs = []
    for seconds, action in ((30, "record"), (10, "correct")):
        rows = "\n".join(f"{t},{1.2 * t}" for t in range(seconds + 1))
        (folder / "log.csv").write_text(f"time,position\n{rows}\n")
        assert f"{action} 0" in asked(f"{action} 0 --log log.csv")
        costs.append(of_walk().trials[0].result)
    assert costs[0] < costs[1]
    assert "warning: trial 0: J/m -31 is far from all" in asked("correct 0 --cost -31")


@pytest.mark.parametrize(("line", "said"), asset("bench-refusals.toml").items())
def test_what_is_wrong_is_one_line(asked, line, said):
    found = asked(line.replace("NINES", 5000 * "9"), 2)
    assert found.startswith(f"error: {said}") and found.count("\n") == 1
    assert len(Bench("walk.toml").entries) == 2


def test_options_stand_before_a_trial_as_the_usage_line_has_them(asked):
    said = asked("record --bench walk.toml --torque 60 0 --value -3")
    assert "record 0: -3, torque 60" in said


def test_a_folder_needs_one_bench_that_was_begun(folder, bench):
    assert "a bench that was begun: taichi-nmm bench new" in bench("next", 2)
    assert not (folder / "walk.db").exists() or not Bench("walk.toml").entries
    robot.write(folder).rename(folder / "second.toml")
    robot.write(folder)
    assert "bench: 'second.toml, walk.toml'" in bench("next", 2)


TAKEN = """
cost value Value note log seconds help h bench port operator trial context failed why row
stiffness Stiffness TORQUE a=b -x
"""


@pytest.mark.parametrize("name", [*TAKEN.split(), " ", ""])
def test_a_column_whose_name_has_another_meaning_is_refused(folder, bench, name):
    robot.write(folder, more=f"[columns.{json.dumps(name)}]\nmost = 1\n")
    refused = f"error: columns: {name!r} cannot be used; allowed: another name"
    assert refused in bench("new walk.toml", 2)
    assert Bench("walk.toml").entries == ()


def test_names_that_differ_in_dashes_alone_are_one(folder, bench):
    robot.write(folder, more='[columns."step length"]\n[columns.Step-Length]\n')
    said = bench("new walk.toml", 2)
    assert "columns: 'Step-Length'" in said and "step length is another column" in said
    robot.write(folder)
    rename(folder, "damping", "note")
    assert "candidates.parameters: 'note'" in bench("new walk.toml", 2)


def rename(folder, old, new):
    """Call a parameter, or a column, otherwise, in all files of a bench."""
    for name in ("walk.toml", "candidates.csv"):
        file = folder / name
        file.write_text(file.read_text().replace(old, new))


def test_the_line_of_a_sheet_can_be_typed_as_it_is_printed(folder, capsys):
    """With blanks in names, umlauts, and a file in another folder."""

    def typed(words, after):
        """The words of a line that a command prints, without the program."""
        main(words)
        lines = capsys.readouterr().out.splitlines()
        (line,) = (each for each in lines if each.startswith(after))
        return shlex.split(line.removeprefix(after))[1:]

    (folder / "my bench").mkdir()
    columns = '[columns."time limit"]\n[columns."größe"]\n'
    robot.write(folder / "my bench", more=columns)
    begun = typed(["bench", "new", "my bench/walk.toml"], "next: ")
    words = typed(begun, "enter: ")
    assert words.count("...") == 4
    numbers = iter(("0.5", "81", "7", "-1e-2"))
    main([next(numbers) if word == "..." else word for word in words])
    trial = Bench("my bench/walk.toml").state.trials[0]
    columns_of = {"torque": 81.0, "time limit": 7.0, "größe": -0.01}
    assert (trial.value, trial.columns) == (0.5, columns_of)
    said = "record 0: 0.5, torque 81, time limit 7, größe -0.01\n"
    assert said in capsys.readouterr().out


def test_an_old_bench_with_such_a_column_opens_and_says_so(folder, bench, monkeypatch):
    robot.write(folder, more="[columns.cost]\n")
    with monkeypatch.context() as patch:
        patch.setattr("study.bench.bench.require_names", lambda *_: None)
        bench("new walk.toml")
    said = bench("next")
    assert "record 0 --value ... --torque ...\n" in said and "alone: cost\n" in said
    assert "value: '2.0'" in bench("record 0 --cost 1 --cost 2", 2)
    assert "warning: columns cost: --cost is an option" in bench("status")


def test_what_a_correction_does_to_a_failure_is_said(asked):
    for line, said, is_failure in (
        ("fail 0 --seconds 2.1", "fail 0: failed after 2.1 s, 5.79\n", True),
        ("correct 0 --seconds 21", "correct 0: failed after 21 s, 3.9\n", True),
        ("correct 0 --torque 70", "correct 0: torque 70\n", True),
        ("correct 0 --value 0.4", "correct 0: 0.4, no longer a failure\n", False),
        ("undo", "undone: ", True),
        ("correct 0 --value 0.92", "correct 0: 0.92, no longer a failure\n", False),
        ("correct 0 --seconds 30", "correct 0: failed after 30 s, 3\n", True),
    ):
        assert said in asked(line)
        trial = of_walk().trials[0]
        assert trial.failed == is_failure
        assert trial.result < 1.0 or is_failure


def test_nothing_is_recommended_before_a_trial_is_finished(bench):
    bench("new walk.toml")
    nothing = "Nothing to recommend yet: no trial is finished"
    assert bench("recommend") == f"{nothing}.\n"
    bench("next")
    bench("record 0 --value 1")
    assert "without the noise" in bench("recommend")
    bench("context gravel")
    assert bench("recommend") == f"{nothing} in gravel.\n"


def test_words_of_a_sheet(folder, bench):
    robot.write(folder, robot.FEATURES)
    bench("new walk.toml")
    assert "simulated" not in bench("next")
    for times in ("once", "twice", "3 times"):
        bench("abort 0")
        assert f"(again: broken off {times})" in bench("next")
    bench("record 0 --value 1")
    assert "Expected: 1 (interval unknown)" in bench("next")  # of one value
    bench("record 1 --value 2")
    assert " with 95 %)" in bench("next")


def test_trials_are_exported_to_standard_output(folder, asked):
    said = asked("export -")
    assert said.splitlines()[0].startswith("trial,context,value,failed,stiffness")
    assert said.count("\n") == 2 and not (folder / "-").exists()


def test_the_note_of_a_breakdown_is_not_that_of_the_trial_that_repeats_it(asked):
    asked("abort 0 --note cable")
    assert "cable" in asked("status").splitlines()[1]
    asked("next")
    asked("record 0 --value 0.9")
    assert "cable" not in asked("status").splitlines()[1]
    asked("correct 0 --note mat")
    asked("correct 0 --value 0.8")
    assert "mat" in asked("status").splitlines()[1]


def test_who_has_no_entry_among_the_users_is_a_number(bench, monkeypatch):
    for name in ("LOGNAME", "USER", "LNAME", "USERNAME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("pwd.getpwuid", lambda number: {}[number])
    monkeypatch.setattr("socket.gethostname", lambda: "")
    assert f"begun by uid-{os.getuid()}@localhost\n" in bench("new walk.toml")


# Runs lines of the command; after each it prints how that ended, on both streams.
EACH = """
import sys
from study.cli import main
for line in sys.argv[1:]:
    code = 0
    try:
        main(["bench", *line.split()])
    except SystemExit as end:
        code = end.code
    print(f"<{code}>", flush=True)
    print("<>", file=sys.stderr, flush=True)
"""


def run(shell, *lines):
    """How the command ends on each line, one after another, in a process of their own."""
    done = finish(start(*lines, shell=shell, program=("-c", EACH)))
    printed = re.findall(r"(.*?)<(\d+)>\n", done.out, re.DOTALL)
    errors = done.error.split("<>\n")[:-1]
    return [
        Done(int(code), out, error)
        for (out, code), error in zip(printed, errors, strict=True)
    ]


@pytest.mark.slow
def test_what_is_only_read_needs_no_place_to_write(folder):
    """A folder that is read-only, also for root."""
    robot.run(Bench.new("walk.toml"), 3)
    for file in ("walk.db", "walk.toml", "candidates.csv"):
        Path(file).chmod(0o444)
    folder.chmod(0o555)
    reading = ("status", "recommend", f"export {folder.parent}/trials.csv")
    try:
        before = sorted(folder.iterdir())
        *read, done = run(without_the_rights_of_root(), *reading, "next")
        assert [(each.code, each.error) for each in read] == [(0, "")] * len(reading)
        assert done.code == 2 and len(done.lines) == 1 and "storage: " in done.error
        assert sorted(folder.iterdir()) == before
    finally:
        folder.chmod(0o755)
    assert (folder.parent / "trials.csv").read_text().count("\n") == 4


@pytest.mark.slow
def test_a_terminal_without_umlauts_gets_escapes_and_nothing_is_lost(folder):
    rename(folder, "damping", "dämpfung")
    rename(folder, "torque", "'größe'")
    ascii_alone = 'export PYTHONIOENCODING=ascii PYTHONUTF8=0 LC_ALL=C; exec "$@"'
    lines = ("new walk.toml", "next", "record 0 --value 1", "status", "recommend")
    *done, refused = run(ascii_alone, *lines, "undo 9")
    assert [each.code for each in done] == [0] * len(lines)
    assert "d\\xe4mpfung" in done[1].out
    assert "dämpfung" in json.loads(done[4].out.splitlines()[1])
    assert refused.code == 2 and "Traceback" not in refused.error
    kinds = [entry.kind for entry in Bench("walk.toml").entries]
    assert kinds == ["begin", "next", "record"]


@pytest.mark.slow
def test_status_loads_little(folder):
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


BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
SAID = """
walk: FeatureTable(300 rows
trial 0 | walk
Expected:
enter: taichi-nmm bench record 1 --value ... --torque ...
again: broken off once
trial   0  0.92        torque 81  slipped on the mat
correct 2: 0.51 (undone)
undone:
trial 6
trial   3  simulated
worlds the robot is like
trial 8 | walk | gravel
"""


def test_the_page_runs_from_top_to_bottom(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "docs" / "bench.md").read_text()
    blocks = BLOCK.findall(page)
    tables = [code for language, code in blocks if language == "toml"]
    (tmp_path / "walk.toml").write_text(tables[0])
    for language, code in blocks:
        if language == "python":
            exec(compile(code, "bench.md", "exec"), {})
        for line in code.splitlines() if language == "sh" else ():
            program, *words = shlex.split(line)
            if program == "echo":
                Path(words[2]).write_text(words[0])
            else:
                assert (program, words[0]) == ("taichi-nmm", "bench")
                main(words)
    said = capsys.readouterr()
    assert "warning" not in said.err
    for line in SAID.strip().splitlines():
        assert line in said.out
    (promised,) = re.findall(r'"(Of 6 robots[^"]*)"', page)
    assert " ".join(promised.split()) in said.out
    best = r"^Trial \d.*\n\{.*\}\nThe interval .*\nA repeat of trial \d"
    assert re.search(best, said.out, re.MULTILINE)
    asked = json.loads((tmp_path / "next.json").read_text())
    assert [trial["trial"] for trial in asked] == [3, 4, 5]
    assert len(asked[0]["params"]) == 2
    assert (tmp_path / "walk-simulator.png").stat().st_size > 5000
    shown = set(re.findall(r"taichi-nmm bench ([a-z-]+)", page))
    assert shown >= set(ACTIONS) - {"import"}


def test_decimal_commas_are_typed_and_numbers_that_may_be_two_are_refused(
    asked,
):
    asked("record 0 --cost 0,92 --torque 80,5")
    trial = of_walk().trials[0]
    assert (trial.value, trial.columns) == (0.92, {"torque": 80.5})
    for option in ("--cost", "--torque"):
        said = asked(f"correct 0 {option} 1,234", 2)
        assert "'1,234' cannot be used; allowed: 1234 or 1.234" in said
        assert said.count("\n") == 1


@pytest.mark.parametrize("is_european", [False, True])
def test_trials_go_out_and_come_in(folder, bench, is_european):
    """Also as a spreadsheet has saved them."""
    robot.run(Bench.new("walk.toml"), 4)
    Bench("walk.toml").next()
    assert "5 trials: trials.csv" in bench("export trials.csv")
    if is_european:
        text = (folder / "trials.csv").read_text()
        text = text.replace(",", ";").replace(".", ",").replace("\n", "\r\n")
        (folder / "trials.csv").write_bytes(f"\ufeff{text}".encode())
    (folder / "second").mkdir()
    robot.write(folder / "second")
    bench("new second/walk.toml")
    said = bench("import trials.csv --bench second/walk.toml")
    assert "trials 0, 1, 2, 3" in said
    again = Bench("second/walk.toml").state
    assert list(again.trials) == [0, 1, 2, 3]
    for own, other in zip(of_walk().finished, again.finished, strict=True):
        assert (own.params, own.value, own.note) == (
            other.params,
            other.value,
            other.note,
        )


def test_a_new_bench_says_what_to_expect_and_computes_it_once(bench, monkeypatch):
    said = bench("new walk.toml")
    (line,) = [line for line in said.splitlines() if "robots like your worlds" in line]
    assert line.startswith("Of 6 robots like your worlds ") and "in the first" in line

    def never(*_, **__):
        raise AssertionError

    monkeypatch.setattr(forecasts, "forecast", never)
    assert line in bench("new walk.toml") and line in bench("forecast")
    begun = Bench("walk.toml")
    assert len(begun.entries) == 1
    begun.journal.keep(forecasts._key(begun), {"trials": 10, "like": [{"far": 1}]})
    assert bench("forecast", 2).startswith("error: storage: ")


def test_what_takes_long_is_asked_for(bench, monkeypatch):
    monkeypatch.setattr(forecasts, "QUICK", 10)
    said = bench("new walk.toml")
    assert "taichi-nmm bench forecast --bench walk.toml" in said
    assert "robots like" not in said
    assert "minute" not in said  # nobody has measured it
    assert "robots like your worlds" in bench("forecast")
    assert "robots like your worlds" in bench("new walk.toml")  # it is known by now


def test_a_forecast_that_is_interrupted_says_that_it_begins_anew(bench, monkeypatch):
    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(forecasts, "QUICK", 10)
    bench("new walk.toml")
    monkeypatch.setattr(ProgressBar, "move", stop)
    said = bench("forecast", 130)
    assert "begins anew" in said and "kept" not in said


@pytest.mark.parametrize("known", ['outcomes = ["world0"]', robot.FEATURES])
def test_where_nothing_can_be_forecast_one_line_says_so(folder, bench, known):
    robot.write(folder, known)
    assert "what to expect before the first trial is unknown: " in bench(
        "new walk.toml"
    )
    found = bench("forecast", 2)
    assert found.startswith("error: table.outcomes: ") and found.count("\n") == 1


HEAVY = ("sqlalchemy", "alembic", "pyarrow", "scipy.linalg", "pandas", "matplotlib")
LOADED = f"""
import sys
from study.cli import main
main(sys.argv[1:])
print(*(name for name in {HEAVY} if name in sys.modules))
"""


def test_entering_a_number_loads_nothing_that_takes_long(folder, asked):
    """SQLAlchemy alone is half of what a command that reads a number took."""
    for words in (["status"], ["record", "0", "--value", "0.9"], ["status"]):
        ended = run_code(LOADED, "bench", *words, "--bench", str(folder / "walk.toml"))
        assert ended.returncode == 0, ended.stderr
        assert ended.stdout.splitlines()[-1] == ""
    words = ["next", "--bench", str(folder / "walk.toml")]
    ended = run_code(LOADED, "bench", *words)
    assert "sqlalchemy" not in ended.stdout.splitlines()[-1]


def test_errors_of_past_predictions_are_computed_once(asked, monkeypatch):
    asked("record 0 --value 0.9")
    asked("next")
    asked("record 1 --value 0.8")
    said, errors_of = asked("next"), calibration._errors_of
    numbers = []

    def counted(model, of_turn, number):
        numbers.append(number)
        return errors_of(model, of_turn, number)

    monkeypatch.setattr(calibration, "_errors_of", counted)
    assert asked("next") == said and not numbers
    asked("record 2 --value 0.7")
    asked("next")
    assert numbers == [2]


def test_a_warning_of_the_sampler_is_one_line_and_is_not_repeated_by_the_forecast(
    folder,
):
    robot.change(folder / "walk.toml", "success = 0.5", "success = -25")
    robot.change(folder / "walk.toml", "about =", "# about =")
    commands = ("new walk.toml", "next --batch 2")
    told = [
        finish(start("bench", *words.split(), program=("-m", "taichi_nmm"))).error
        for words in commands
    ]
    line = "warning: success: -25 is better than all that any world has, "
    assert [text.count("success: -25 is") for text in told] == [0, 1]
    assert told[1].startswith(line) and told[1].count("\n") == 1
