"""A bench: entries, what follows from them, and that nothing is lost, whoever writes and dies."""

import re
import sqlite3
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from datetime import datetime
from functools import partial
from itertools import count
from pathlib import Path
from signal import SIGKILL
from typing import Any, cast
from unittest.mock import Mock

import numpy as np
import optuna
import pytest
from optuna.trial import TrialState

from storage.inputs.errors import InputError
from study.bench import journal
from study.bench.bench import Bench, Own
from study.bench.plan import Goal, read_plan
from study.experiment.objective import Term
from study.sampler.table_policy import TableExhaustedError
from tests.cases import cases
from tests.study.bench import robot
from tests.tools.kills import DATABASE, FORK, Death, in_process


@pytest.fixture(params=[robot.WORLDS, robot.FEATURES], ids=["worlds", "features"])
def path(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    return robot.write(tmp_path, request.param)


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench.new(robot.write(tmp_path), "me")


def shown(bench: Bench) -> optuna.Study:
    """The dashboard's study agrees with the entries."""
    trials, study = bench.state.trials, bench.shown()
    for trial in study.trials:
        own = trials.get(trial.number)
        if own is None:
            assert trial.state is TrialState.FAIL
            continue
        assert (trial.params, trial.user_attrs["operator"]) == (
            own.params,
            own.operator,
        )
        assert trial.state is (
            TrialState.RUNNING if own.value is None else TrialState.COMPLETE
        )
        assert trial.values == (None if own.value is None else [own.value])
    assert len(study.trials) == bench.state.count
    return study


def test_who_asks_twice_gets_the_same_and_others_get_others(path: Path) -> None:
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


def test_what_was_mended_leaves_no_trace_in_later_proposals(
    path: Path, tmp_path: Path
) -> None:
    """Wrong values, wrong limits, breakdowns and needless trials, against a study without any."""
    (tmp_path / "right").mkdir()
    known = robot.WORLDS if "outcomes" in path.read_text() else robot.FEATURES
    right = Bench.new(robot.write(tmp_path / "right", known))
    expected = robot.run(right, 9)
    bench, found = Bench.new(path), list[Any]()
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
            bench.add([({"stiffness": 20.0, "damping": 0.2}, 5.0, {}, "")])
            bench.undo()
            bench.next()
            bench.undo()
        else:
            bench.record(trial.number, value)
    assert found == expected
    assert bench.best().value == right.best().value
    assert shown(bench).trials[7].user_attrs["note"] == "undone"


def test_a_failure_teaches_by_how_far_it_came_and_limits_are_learned(
    bench: Bench,
) -> None:
    for number, seconds in enumerate((0.0, 15.0, 30.0)):
        bench.next()
        bench.record(number, failed_s=seconds, columns={"torque": 100.0})
    trials = bench.state.trials
    assert [trials[number].value for number in range(3)] == [6.0, 4.5, 3.0]
    assert all(trial.failed for trial in trials.values())
    (trial,) = bench.next()
    assert (
        "all limits kept" in trial.why
        and "No trial has kept all limits yet" in trial.why
    )
    assert shown(bench).trials[0].constraints == {"torque at most": 10.0}


@pytest.mark.parametrize("sign", [1.0, -1.0], ids=["costs", "values"])
def test_simulated_runs_that_fell_are_worth_what_failures_are(sign: float) -> None:
    goal = Goal("J/m", sign < 0, None, (sign * 6.0, sign * 3.0), 30.0)
    given = {
        "effort": sign * np.array([[0.4, 0.1, 0.2, 5.0]]),
        "survived_fraction": np.array([[1.0, 0.0, 0.5, 1.0]]),
    }
    found = goal.in_worlds(Term("effort", 1.0))(given, 10.0)
    assert found.tolist() == (sign * np.array([[0.4, 6.0, 4.5, 3.0]])).tolist()
    plain = replace(goal, failed=None).in_worlds(Term("effort", 1.0))(given, 10.0)
    assert plain.tolist() == given["effort"].tolist()


def test_a_repeat_is_pooled_and_the_least_sure_one_is_recommended(bench: Bench) -> None:
    robot.run(bench, 6)
    best, repeat = bench.best(), bench.repeat()
    assert repeat in bench.state.trials and best.trials == 1
    (again,) = bench.next(repeat=best.number)
    assert again.params == dict(best.params) and again.number == 6
    bench.record(6, best.value)
    assert bench.best().trials == 2
    assert "world" in bench.worth()


def test_new_ground_begins_with_what_was_good_before(path: Path) -> None:
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


def test_trials_of_ones_own_are_learned_from_and_checked_by_name(path: Path) -> None:
    bench = Bench.new(path)
    assert bench.simulated() == {}
    rows, tried = bench.candidates.rows, robot.run(bench, 3)
    assert len(bench.simulated()) == (0 if rows.worlds is None else 3)
    for params, simulated in zip(tried, bench.simulated().values(), strict=False):
        row = rows.find(params)
        if row is not None and rows.worlds is not None:
            assert simulated == pytest.approx(np.mean(rows.worlds.costs[row]))
    near = {"stiffness": 149.0, "damping": 0.91}  # no row of the table
    assert bench.add([(near, robot.cost(near), {}, "")]) == [3]
    assert bench.best().number == 3
    bad = {"stiffness": 1e5}, {"damping": 57.3}, {"damping": "0.91"}, {"mass": 1.0}
    for change in bad:
        with pytest.raises(InputError, match=next(iter(change))):
            bench.add([(near | change, 1.0, {}, "")])
    assert len(bench.state.trials) == 4


def test_proposals_keep_within_the_limits_of_safety(tmp_path: Path) -> None:
    limits = "\n[safety]\nmost_step = 0.15\nleast_success = 0.05"
    bench = Bench.new(robot.write(tmp_path, more=limits))
    good = {"stiffness": 149.0, "damping": 0.91}
    bench.add([(good, robot.cost(good), {}, "")])
    for params in robot.run(bench, 4):
        assert abs(params["damping"] - 0.91) < 0.15 * 1.9 * 2
    (tmp_path / "walk.toml").write_text(
        (tmp_path / "walk.toml")
        .read_text()
        .replace("least_success = 0.05", "least_success = 1.0")
    )
    with pytest.raises(InputError, match="safety: 'no candidate within the limits'"):
        Bench(tmp_path / "walk.toml").next()


def test_what_cannot_be_entered_is_one_line_and_changes_nothing(bench: Bench) -> None:
    bench.next()
    before, wrong = bench.entries, list[tuple[Callable[[], object], str]]()
    wrong += [
        (lambda: bench.record(7, 1.0), r"trial: 7 .* pending: 0"),
        (lambda: bench.record(0, float("nan")), r"value: nan"),
        (
            lambda: bench.record(0, 1.0, columns={"speed": 3.0}),
            r"speed: 3.0 .* columns torque",
        ),
        (
            lambda: bench.record(0, 1.0, columns={"torque": float("inf")}),
            r"columns.torque: inf",
        ),
        (lambda: bench.correct(0, 1.0), r"trial: 0 .* a finished trial"),
        (lambda: bench.record(0, failed_s=31.0), r"seconds: 31.0 .* to 30"),
        (lambda: bench.abort(9), r"trial: 9"),
        (lambda: bench.undo(9), r"undo: 9 .* an entry that stands: 1"),
        (lambda: bench.context(""), r"context: ''"),
        (lambda: bench.next(repeat=0), r"trial: 0 .* finished"),
        (lambda: bench.next(batch=cast(Any, "two")), r"batch: 'two'"),
        (lambda: bench.record(0, cast(Any, None)), r"value: None"),
        (lambda: bench.abort(cast(Any, [])), r"number: \[\]"),
    ]
    for act, said in wrong:
        with pytest.raises(InputError, match=said):
            act()
    assert Bench(bench.plan.path).entries == before
    bench.record(0, 1.0)
    with pytest.raises(InputError, match=r"undo: 1 .* entry 2 first"):
        bench.undo(1)


def test_another_file_or_other_candidates_are_refused(
    bench: Bench, tmp_path: Path
) -> None:
    path, text = bench.plan.path, bench.plan.path.read_text()
    path.write_text(text.replace("success = 0.5", "success = 0.6"))
    with pytest.raises(
        InputError, match=r"walk.toml: goal.success: 0.6 .* 0.5, with which"
    ):
        Bench(path)
    path.write_text(text.replace("10 m of treadmill", "12 m"))  # words may change
    rows = (tmp_path / "candidates.csv").read_text()
    (tmp_path / "candidates.csv").write_text(rows.rsplit("\n", 2)[0] + "\n")
    again = Bench(path, "me")
    with pytest.raises(InputError, match=r"candidates: .* digest differs"):
        again.next()
    optuna.create_study(storage=bench.plan.url, study_name="mine")
    path.write_text(text.replace('name = "walk"', 'name = "mine"'))
    with pytest.raises(InputError, match=r"name: 'mine' .* no other study has"):
        Bench(path)


@cases("bad-benches.toml", "old", "new", "said")
def test_a_file_that_cannot_be_used_is_one_line(
    tmp_path: Path, old: str, new: str, said: str
) -> None:
    path = robot.write(tmp_path)
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(InputError, match=said):
        Bench.new(path)


def test_no_entry_is_made_where_the_study_that_shows_it_was_edited(
    bench: Bench,
) -> None:
    robot.run(bench, 2)
    with closing(sqlite3.connect(bench.plan.path.with_suffix(".db"))) as database:
        database.execute("UPDATE trial_values SET objective = 0.5")
        database.commit()
    later, entries = Bench(bench.plan.path), len(bench.entries)
    with pytest.raises(InputError, match=r"^storage: .*walk\.db"):
        later.next()
    assert len(Bench(bench.plan.path).entries) == entries


def test_all_rows_may_have_been_tried(tmp_path: Path) -> None:
    path = robot.write(tmp_path, robot.FEATURES)
    rows = (tmp_path / "candidates.csv").read_text().splitlines()
    (tmp_path / "candidates.csv").write_text("\n".join(rows[:4]) + "\n")
    bench = Bench.new(path)
    robot.run(bench, 3)
    with pytest.raises(InputError, match=r"all 3 rows .* a row that nobody has tried"):
        bench.next()
    assert issubclass(TableExhaustedError, RuntimeError)


# An operator's day: each of these makes one entry.
DAY: tuple[Callable[[Bench], object], ...] = (
    lambda bench: bench.next(),
    lambda bench: bench.record(0, 0.9, columns={"torque": 81.0}),
    lambda bench: bench.next(batch=2),
    lambda bench: bench.record(1, failed_s=2.1),
    lambda bench: bench.abort(2),
    lambda bench: bench.record(2, 3.1),
    lambda bench: bench.correct(2, 0.31),
    lambda bench: bench.undo(),
    lambda bench: bench.correct(2, 0.41),
    lambda bench: bench.add([({"stiffness": 150.0, "damping": 1.0}, 0.6, {}, "")]),
    lambda bench: bench.context("gravel"),
)


def go_on(path: Path, entries: int) -> list[Any]:
    """Make those of the first entries of the day that are not there; what was entered."""
    bench = Bench.new(path, "me")
    for act in DAY[len(bench.entries) - 1 : entries]:
        act(bench)
    shown(bench)
    return [(one.number, one.kind, one.operator, one.data) for one in bench.entries]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("entries", "step"),
    [
        (2, 4),
        pytest.param(len(DAY), 3, marks=pytest.mark.campaign),
    ],
)
def test_a_command_that_is_killed_at_a_commit_has_done_it_or_not(
    entries: int, step: int, tmp_path: Path
) -> None:
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
    assert last > 20 * entries


@pytest.mark.slow
def test_two_operators_at_once_lose_nothing_and_get_different_trials(
    tmp_path: Path,
) -> None:
    path = robot.write(tmp_path)
    Bench.new(path)

    def operate(name: str) -> None:
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


def test_a_clock_that_goes_back_decides_nothing(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    (trial,) = bench.next()
    bench.record(trial.number, 1.0)
    monkeypatch.setattr(journal, "datetime", Mock(now=lambda _: datetime(1999, 1, 1)))
    bench.correct(trial.number, 2.0)
    assert (
        bench.entries[-1].time.startswith("1999") and bench.state.trials[0].value == 2.0
    )


def test_undo_takes_back_the_operators_own_last_entry(path: Path) -> None:
    mine, yours = Bench.new(path, "me"), Bench(path, "you")
    mine.next()
    yours.next()
    yours.record(1, 0.9)
    assert mine.undo().operator == "me" and sorted(mine.state.trials) == [1]
    third = Bench(path, "somebody")
    with pytest.raises(
        InputError, match=r"undo: 'the last' .* number .* you: record 1: 0.9"
    ):
        third.undo()
    assert third.undo(3).operator == "you" and third.state.trials[1].value is None


def test_a_correction_that_is_undone_leaves_the_columns_as_they_were(
    bench: Bench,
) -> None:
    good = {"stiffness": 149.0, "damping": 0.91}
    bench.add([(good, 0.4, {"torque": 60.0}, "")])
    bench.correct(0, columns={"torque": 95.0})
    assert bench.state.trials[0].columns == {"torque": 95.0}
    bench.undo()
    assert (
        bench.state.trials[0].columns
        == {"torque": 60.0}
        == bench.look().trials[0].columns
    )


def test_an_undoing_is_undone_only_while_its_trial_is_as_it_was(bench: Bench) -> None:
    bench.next()
    bench.record(0, 0.4)
    bench.undo()
    bench.record(0, 0.9)
    with pytest.raises(
        InputError, match=r"undo: 3 .* entry 4 first, .* the same trial"
    ):
        bench.undo(3)
    bench.undo()
    bench.undo(3)
    assert bench.state.trials[0].value == 0.4
    bench.undo()
    bench.undo()  # the trial itself
    with pytest.raises(
        InputError, match=r"undo: 7 .* entry 8 first, .* the same trial"
    ):
        bench.undo(7)
    bench._add(
        "undo", {"entry": 7}
    )  # as version 0.3.0 did, which could then read it no more
    assert not Bench(bench.plan.path).state.trials


def test_numbers_of_numpy_are_numbers(bench: Bench) -> None:
    bench.next()
    bench.record(
        cast(int, np.int64(0)),
        np.float32(0.5),
        columns={"torque": cast(int, np.int8(81))},
    )
    trial = Bench(bench.plan.path).state.trials[0]
    assert (trial.value, trial.columns) == (0.5, {"torque": 81})
    with pytest.raises(InputError, match="time"):
        bench.add([Own(trial.params, 0.4, time=cast(str, datetime.now()))])


def test_a_limit_that_is_exceeded_beyond_all_floats_is_broken(tmp_path: Path) -> None:
    plan = read_plan(robot.write(tmp_path, more="[columns.heat]\nmost = -1e308\n"))
    assert plan.limits({"heat": 1e308}) == {"heat at most": np.inf}


def test_a_relative_database_lies_beside_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "old").mkdir()
    path = robot.write(tmp_path, more='\n[storage]\nurl = "sqlite:///trials.db"')
    Bench.new(path).next()
    assert (tmp_path / "trials.db").exists()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert len(Bench(path).state.trials) == 1 and not list(Path().iterdir())
    # What version 0.3.0 began in the working folder is found there, and nothing else
    # is.
    monkeypatch.chdir(tmp_path / "old")
    for file in [*tmp_path.glob("trials.db*")]:  # SQLite's log belongs to it
        file.rename(file.name)
    assert len(Bench(path).state.trials) == 1
    path.write_text(path.read_text().replace('name = "walk"', 'name = "run"'))
    assert Bench.new(path).plan.url.endswith(str(tmp_path / "trials.db"))


def test_numbers_of_a_sheet_can_be_typed_in_again(bench: Bench) -> None:
    """With eight digits, also at the ends of the ranges."""
    (trial,) = bench.next()
    bench.record(0, 0.9)
    printed = {name: float(f"{value:.8g}") for name, value in trial.params.items()}
    bench.add([(printed, 1.1, {}, "")])
    assert bench.state.trials[1].params == trial.params and bench.best().trials == 2
    lows = {name: float(f"{of.low:.8g}") for name, of in cast(Any, bench.space).items()}
    highs = {
        name: float(f"{of.high:.8g}") for name, of in cast(Any, bench.space).items()
    }
    assert bench.add([(lows, 2.0, {}, ""), (highs, 3.0, {}, "")]) == [2, 3]
    for name, of in cast(Any, bench.space).items():
        assert of.low <= bench.state.trials[2].params[name] == pytest.approx(of.low)
        assert of.high >= bench.state.trials[3].params[name] == pytest.approx(of.high)
    with pytest.raises(InputError, match="damping"):
        bench.add([(highs | {"damping": highs["damping"] * (1.0 + 1e-6)}, 1.0, {}, "")])


def test_messages_name_what_exists_and_what_helps(tmp_path: Path) -> None:
    path = robot.write(tmp_path)
    text = path.read_text()
    path.write_text(re.sub(r"duration_s.*\n|failed_at.*\n", "", text))
    bench = Bench.new(path)
    bench.next()
    with pytest.raises(
        InputError, match=r"failed_at_once, failed_at_end and duration_s .* value"
    ):
        bench.record(0, failed_s=2.0)
    rows = (tmp_path / "candidates.csv").read_text()
    (tmp_path / "candidates.csv").write_text(rows.rsplit("\n", 2)[0] + "\n")
    with pytest.raises(
        InputError, match=r"`export` the trials, begin a new bench .* `import`"
    ):
        Bench(path).next()
