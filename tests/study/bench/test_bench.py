"""A bench: entries, what follows from them, and that nothing is lost, whoever writes and dies."""

import re
import sqlite3
from contextlib import closing
from dataclasses import replace
from datetime import datetime
from functools import partial
from itertools import count
from pathlib import Path
from signal import SIGKILL
from unittest.mock import Mock

import numpy as np
import optuna
import pytest
from optuna.trial import TrialState

from study.bench import journal
from study.bench.bench import Bench, Own
from study.bench.journal import Trial
from study.bench.plan import Goal, read_plan
from study.experiment.objective import Term
from study.sampler.table_policy import TableExhaustedError
from tests.cases import asset, cases, refused
from tests.study.bench import robot
from tests.study.bench.robot import change
from tests.tools.kills import DATABASE, FORK, Death, in_process

ENTRIES = asset("bench-entries.toml")


def shown(bench):
    """The dashboard's study agrees with the entries."""
    trials, study = bench.state.trials, bench.shown()
    assert len(study.trials) == bench.state.count
    for trial in study.trials:
        own = trials.get(trial.number)
        if own is None:
            assert trial.state is TrialState.FAIL
            continue
        assert trial.params == own.params
        assert trial.user_attrs["operator"] == own.operator
        assert trial.value == own.value
        assert trial.state.is_finished() == (own.value is not None)
    return study


def test_who_asks_twice_gets_the_same_and_others_get_others(path):
    mine, yours = Bench.new(path, "me"), Bench(path, "you")
    (first,) = mine.next()
    assert mine.next() == [first] == Bench(path, "me").next()
    (other,) = yours.next()
    assert other.number == 1 and other.params != first.params
    three = mine.next(batch=3)
    assert [trial.number for trial in three] == [0, 2, 3] and three[0] == first
    assert len({str(trial.params) for trial in [*three, other]}) == 4
    mine.record(0, 1.0)
    assert [trial.number for trial in mine.next()] == [2]
    yours.abort(2)  # who breaks a trial off has it again
    assert [trial.number for trial in yours.next(batch=2)] == [1, 2]
    assert [trial.number for trial in mine.next()] == [3]
    assert shown(mine).trials[0].value == 1.0


def test_what_was_mended_leaves_no_trace_in_later_proposals(path, tmp_path):
    """Wrong values, wrong limits, breakdowns and needless trials, against a study without any."""
    (tmp_path / "right").mkdir()
    known = robot.WORLDS if "outcomes" in path.read_text() else robot.FEATURES
    right = Bench.new(robot.write(tmp_path / "right", known))
    expected = robot.run(right, 9)
    bench, found = Bench.new(path), []
    for place in range(9):
        (trial,) = bench.next()
        found.append(trial.params)
        value = robot.cost(trial.params)
        if place == 1:
            bench.record(trial.number, -value, columns={"torque": 99.0})
            bench.correct(trial.number, value)
            bench.correct(trial.number, columns={"torque": 80.0})
            bench.undo()
            bench.undo()
            bench.undo()  # of the record itself
            bench.record(trial.number, value)
        elif place == 3:
            bench.abort(trial.number, "a cable")
            assert bench.next()[0].params == trial.params
            bench.record(trial.number, value)
        elif place == 5:
            bench.record(trial.number, failed_s=3.0)
            bench.correct(trial.number, value)
            assert not bench.state.trials[trial.number].failed
        elif place == 6:
            bench.record(trial.number, value)
            bench.add([Own({"stiffness": 20.0, "damping": 0.2}, 5.0)])
            bench.undo()
            bench.next()
            bench.undo()
        else:
            bench.record(trial.number, value)
    assert found == expected
    assert bench.best().value == right.best().value
    assert shown(bench).trials[7].user_attrs["note"] == "undone"


def test_a_failure_teaches_by_how_far_it_came_and_limits_are_learned(
    bench,
):
    for number, seconds in enumerate((0.0, 15.0, 30.0)):
        bench.next()
        bench.record(number, failed_s=seconds, columns={"torque": 100.0})
    trials = bench.state.trials
    assert [trial.value for trial in trials.values()] == [6.0, 4.5, 3.0]
    assert all(trial.failed for trial in trials.values())
    (trial,) = bench.next()
    assert "all limits kept" in trial.why
    assert "no trial had when it was chosen" in trial.why
    assert shown(bench).trials[0].constraints == {"torque at most": 10.0}


@pytest.mark.parametrize("sign", [1.0, -1.0], ids=["costs", "values"])
def test_simulated_runs_that_fell_are_worth_what_failures_are(sign):
    goal = Goal(
        value="J/m",
        maximise=sign < 0,
        success=None,
        failed=(sign * 6.0, sign * 3.0),
        duration_s=30.0,
    )
    effort = sign * np.array([[0.4, 0.1, 0.2, 5.0]])
    lasted = np.array([[1.0, 0.0, 0.5, 1.0]])
    given = {"effort": effort, "survived_fraction": lasted}
    term = Term("effort", 1.0)
    found = goal.in_worlds(term)(given, 10.0)
    assert found.tolist() == (sign * np.array([[0.4, 6.0, 4.5, 3.0]])).tolist()
    plain = replace(goal, failed=None).in_worlds(term)(given, 10.0)
    assert plain.tolist() == effort.tolist()


def test_a_repeat_is_pooled_and_the_least_sure_one_is_recommended(bench):
    robot.run(bench, 6)
    best, repeat = bench.best(), bench.repeat()
    assert repeat in bench.state.trials and best.trials == 1
    (again,) = bench.next(repeat=best.number)
    assert again.params == dict(best.params) and again.number == 6
    bench.record(6, best.value)
    assert bench.best().trials == 2
    assert "world" in bench.worth()


def test_new_ground_begins_with_what_was_good_before(path):
    """On ground that is as before, the first trial is as good as the best so far."""
    bench = Bench.new(path)
    robot.run(bench, 12)
    best = min(trial.value or 0.0 for trial in bench.state.trials.values())
    bench.context("gravel")
    assert "as before" in bench.next()[0].why
    (params,) = robot.run(bench, 1)
    assert robot.cost(params) <= best + 0.3
    robot.run(bench, 2, stiffness=60.0)
    assert {trial.context for trial in bench.state.trials.values()} == {"", "gravel"}
    bench.context("")
    assert bench.best().number < 12  # of the present context alone
    assert shown(bench).trials[13].user_attrs["context"] == "gravel"


def test_trials_of_ones_own_are_learned_from_and_checked_by_name(path):
    bench = Bench.new(path)
    assert bench.simulated() == {}
    rows, tried = bench.candidates.rows, robot.run(bench, 3)
    assert len(bench.simulated()) == (0 if rows.worlds is None else 3)
    for params, simulated in zip(tried, bench.simulated().values(), strict=False):
        row = rows.find(params)
        if row is not None and rows.worlds is not None:
            assert simulated == pytest.approx(np.mean(rows.worlds.costs[row]))
    near = {"stiffness": 149.0, "damping": 0.91}  # no row of the table
    assert bench.add([Own(near, robot.cost(near))]) == [3]
    assert bench.best().number == 3
    bad = {"stiffness": 1e5}, {"damping": 57.3}, {"damping": "0.91"}, {"mass": 1.0}
    for wrong in bad:
        with refused("|".join(wrong)):
            bench.add([Own(near | wrong, 1.0)])
    assert len(bench.state.trials) == 4


def test_proposals_keep_within_the_limits_of_safety(tmp_path):
    limits = "\n[safety]\nmost_step = 0.15\nleast_success = 0.05"
    path = robot.write(tmp_path, more=limits)
    bench = Bench.new(path)
    good = {"stiffness": 149.0, "damping": 0.91}
    bench.add([Own(good, robot.cost(good))])
    for params in robot.run(bench, 4):
        assert abs(params["damping"] - 0.91) < 0.15 * 1.9 * 2
    change(path, "least_success = 0.05", "least_success = 1.0")
    with refused("safety: 'no candidate within the limits'"):
        Bench(path).next()


def test_what_cannot_be_entered_is_one_line_and_changes_nothing(bench):
    bench.next()
    before = bench.entries
    for case in ENTRIES["refused"].values():
        said = case.pop("said")
        with refused(said):
            robot.enter(bench, **case)
    assert Bench(bench.plan.path).entries == before
    bench.record(0, 1.0)
    with refused(r"undo: 1 .* entry 2 first"):
        bench.undo(1)


def test_another_file_or_other_candidates_are_refused(bench, tmp_path):
    path = bench.plan.path
    change(path, "success = 0.5", "success = 0.6")
    with refused(r"walk.toml: goal.success: 0.6 .* begun, with 0.5; or"):
        Bench(path)
    change(path, "success = 0.6", "success = 0.5")
    change(path, "10 m of treadmill", "12 m")  # words may change
    drop_last_row(tmp_path)
    again = Bench(path, "me")
    with refused(
        r"candidates: .* digest differs.* `export` the trials, .* new bench .* `import`"
    ):
        again.next()
    optuna.create_study(storage=bench.plan.url, study_name="mine")
    change(path, 'name = "walk"', 'name = "mine"')
    with refused(r"name: 'mine' .* no other study has"):
        Bench(path)


def drop_last_row(folder):
    """Of the candidates."""
    file = folder / "candidates.csv"
    file.write_text(file.read_text().rsplit("\n", 2)[0] + "\n")


@cases("bad-benches.toml", "old", "new", "said")
def test_a_file_that_cannot_be_used_is_one_line(tmp_path, old, new, said):
    path = robot.write(tmp_path)
    change(path, old, new)
    with refused(said):
        Bench.new(path)


def test_no_entry_is_made_where_the_study_that_shows_it_was_edited(
    bench,
):
    robot.run(bench, 2)
    with closing(sqlite3.connect(bench.plan.path.with_suffix(".db"))) as database:
        database.execute("UPDATE trial_values SET objective = 0.5")
        database.commit()
    later, entries = Bench(bench.plan.path), len(bench.entries)
    with refused(r"^storage: .*walk\.db"):
        later.next()
    assert len(Bench(bench.plan.path).entries) == entries


def test_all_rows_may_have_been_tried(tmp_path):
    path = robot.write(tmp_path, robot.FEATURES)
    rows = (tmp_path / "candidates.csv").read_text().splitlines()
    (tmp_path / "candidates.csv").write_text("\n".join(rows[:4]) + "\n")
    bench = Bench.new(path)
    robot.run(bench, 3)
    with refused(r"all 3 rows .* a row that nobody has tried"):
        bench.next()
    assert issubclass(TableExhaustedError, RuntimeError)


DAY = [*ENTRIES["day"].values()]


def go_on(path, entries):
    """Make those of the first entries of the day that are not there; what was entered."""
    bench = Bench.new(path, "me")
    for entry in DAY[len(bench.entries) - 1 : entries]:
        robot.enter(bench, **entry)
    shown(bench)
    return [(one.number, one.kind, one.operator, one.data) for one in bench.entries]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("entries", "step"),
    [(2, 2), pytest.param(len(DAY), 1, marks=pytest.mark.campaign)],
)
def test_a_command_that_is_killed_at_a_commit_has_done_it_or_not(
    entries, step, tmp_path
):
    """The operator looks at the entries, and repeats what is not there."""
    expected = go_on(robot.write(tmp_path), entries)
    for last in count(1, step):
        (folder := tmp_path / str(last)).mkdir()
        path = robot.write(folder)
        work, death = partial(go_on, path, entries), Death(DATABASE, last)
        ended = in_process(work, folder, tmp_path / "log.txt", death)
        assert go_on(path, entries) == expected
        if ended.code == 0:
            break
        assert ended.code == -SIGKILL
    assert last > 2 * entries  # each is one, and what shows it another


@pytest.mark.slow
def test_two_operators_at_once_lose_nothing_and_get_different_trials(
    tmp_path,
):
    path = robot.write(tmp_path)
    Bench.new(path)

    def operate(name):
        robot.run(Bench(path, name), 8)

    both = [FORK.Process(target=operate, args=(name,)) for name in ("me", "you")]
    for process in both:
        process.start()
    for process in both:
        process.join(120)
    assert [process.exitcode for process in both] == [0, 0]
    bench = Bench(path)
    assert [entry.number for entry in bench.entries] == list(range(1 + 2 * 16))
    trials = shown(bench).trials
    assert len({str(trial.params) for trial in trials}) == 16
    assert {trial.user_attrs["operator"] for trial in trials} == {"me", "you"}


def test_a_clock_that_goes_back_decides_nothing(bench, monkeypatch):
    (trial,) = bench.next()
    bench.record(trial.number, 1.0)
    monkeypatch.setattr(journal, "datetime", Mock(now=lambda _: datetime(1999, 1, 1)))
    bench.correct(trial.number, 2.0)
    assert bench.entries[-1].time.startswith("1999")
    assert bench.state.trials[0].value == 2.0


def test_undo_takes_back_the_operators_own_last_entry(path):
    mine, yours = Bench.new(path, "me"), Bench(path, "you")
    mine.next()
    yours.next()
    yours.record(1, 0.9)
    assert mine.undo().operator == "me" and sorted(mine.state.trials) == [1]
    third = Bench(path, "somebody")
    with refused(r"undo: 'the last' .* number .* you: record 1: 0.9"):
        third.undo()
    assert third.undo(3).operator == "you" and third.state.trials[1].value is None


def test_a_correction_that_is_undone_leaves_the_columns_as_they_were(
    bench,
):
    bench.add([({"stiffness": 149.0, "damping": 0.91}, 0.4, {"torque": 60.0}, "")])
    bench.correct(0, columns={"torque": 95.0})
    assert bench.state.trials[0].columns == {"torque": 95.0}
    bench.undo()
    assert bench.state.trials[0].columns == {"torque": 60.0}
    assert bench.look().trials[0].columns == {"torque": 60.0}


def test_an_undoing_is_undone_only_while_its_trial_is_as_it_was(bench):
    bench.next()
    bench.record(0, 0.4)
    bench.undo()
    bench.record(0, 0.9)
    with refused(r"undo: 3 .* entry 4 first, .* the same trial"):
        bench.undo(3)
    bench.undo()
    bench.undo(3)
    assert bench.state.trials[0].value == 0.4
    bench.undo()
    bench.undo()  # the trial itself
    with refused(r"undo: 7 .* entry 8 first, .* the same trial"):
        bench.undo(7)
    # As version 0.3.0 did, which could then read it no more.
    bench._add("undo", {"entry": 7})
    assert not Bench(bench.plan.path).state.trials


def test_numbers_of_numpy_are_numbers(bench):
    bench.next()
    number = np.int64(0)
    torque = np.int8(81)
    bench.record(number, np.float32(0.5), columns={"torque": torque})
    trial = Bench(bench.plan.path).state.trials[0]
    assert (trial.value, trial.columns) == (0.5, {"torque": 81})
    moment = datetime.now()
    with refused("time"):
        Own(trial.params, 0.4, time=moment)


def test_a_limit_that_is_exceeded_beyond_all_floats_is_broken(tmp_path):
    plan = read_plan(robot.write(tmp_path, more="[columns.heat]\nmost = -1e308\n"))
    assert plan.limits(Trial(0, {}, {}, "", "", columns={"heat": 1e308})) == {
        "heat at most": np.inf
    }


def test_a_relative_database_lies_beside_the_file(tmp_path, monkeypatch):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "old").mkdir()
    path = robot.write(tmp_path, more='\n[storage]\nurl = "sqlite:///trials.db"')
    Bench.new(path).next()
    assert (tmp_path / "trials.db").exists()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert len(Bench(path).state.trials) == 1 and not list(Path().iterdir())
    # What version 0.3.0 began in the working folder is found there; nothing else is.
    monkeypatch.chdir(tmp_path / "old")
    for file in [*tmp_path.glob("trials.db*")]:  # SQLite's log belongs to it
        file.rename(file.name)
    assert len(Bench(path).state.trials) == 1
    change(path, 'name = "walk"', 'name = "run"')
    assert Bench.new(path).plan.url.endswith(str(tmp_path / "trials.db"))


def test_numbers_of_a_sheet_can_be_typed_in_again(bench):
    """With eight digits, also at the ends of the ranges."""
    (trial,) = bench.next()
    bench.record(0, 0.9)
    bench.add([Own(as_printed(trial.params), 1.1)])
    assert bench.state.trials[1].params == trial.params and bench.best().trials == 2
    space = bench.space
    lows = {name: of.low for name, of in space.items()}
    highs = {name: of.high for name, of in space.items()}
    for number, ends in ((2, lows), (3, highs)):
        assert bench.add([Own(as_printed(ends), 2.0)]) == [number]
        params = bench.state.trials[number].params
        assert params == pytest.approx(ends)
        assert all(of.low <= params[name] <= of.high for name, of in space.items())
    beyond = as_printed(highs) | {"damping": highs["damping"] * (1.0 + 1e-6)}
    with refused("damping"):
        bench.add([Own(beyond, 1.0)])


def as_printed(params):
    """Numbers as a sheet has them."""
    return {name: float(f"{value:.8g}") for name, value in params.items()}


def test_without_a_price_a_failure_is_entered_by_its_value(tmp_path):
    path = robot.write(tmp_path)
    path.write_text(re.sub(r"duration_s.*\n|failed_at.*\n", "", path.read_text()))
    bench = Bench.new(path)
    bench.next()
    with refused(r"failed_at_once, failed_at_end and duration_s .* value"):
        bench.record(0, failed_s=2.0)


def test_a_trial_that_was_undone_is_not_said_to_be_one_of_those_allowed(bench):
    robot.run(bench, 1)
    bench.next()
    bench.undo()
    with refused("trial: 1 .* a trial whose entry stands; pending: none"):
        bench.record(1, 0.5)
    with refused("trial: 7 .* 0 to 1; pending: none"):
        bench.record(7, 0.5)
