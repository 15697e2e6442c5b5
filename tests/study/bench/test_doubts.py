"""Numbers that were perhaps entered wrongly are named; what nothing speaks against is not."""

import math

import numpy as np
import pytest

from storage.databases.studies import open_studies
from study.bench.bench import Bench
from study.bench.doubts import doubts, odd_failures, odd_value
from study.bench.journal import Journal, State, Trial
from study.bench.plan import read_plan
from tests.cases import cases, refused
from tests.study.bench import robot

AMONG = (5.0, 7.0, 9.0, 13.0)


@cases("odd-values.toml", "value", "others", "odd")
def test_without_worlds_a_value_is_compared_with_the_other_trials(value, others, odd):
    assert bool(odd_value(value, None, others)) is odd


@pytest.mark.parametrize(
    ("value", "odd"), [(0.000276, True), (0.0, True), (0.0276, False)]
)
def test_a_value_of_another_order_than_all_worlds_is_far_from_them(value, odd):
    """0.000276 was typed for 0.276, and nobody said a word."""
    assert bool(odd_value(value, (0.1376, 4.796), ())) is odd
    assert bool(odd_value(-value, (-4.796, -0.1376), ())) is odd
    assert not odd_value(value, (0.0, 4.796), ())


def state_of(*told):
    """Trials with these values and torques; NaN: none was entered."""
    trials = {}
    for number, (value, torque) in enumerate(told):
        columns = {} if math.isnan(torque) else {"torque": torque}
        trials[number] = Trial(
            number=number,
            params={},
            notes={},
            context="",
            operator="me",
            value=value,
            columns=columns,
        )
    return State(trials, "", len(trials), frozenset())


def test_the_trial_and_the_number_are_named(tmp_path):
    plan = read_plan(robot.write(tmp_path))
    usual = [(value, 60.0) for value in AMONG]
    wrong = (1e300, math.nan), (6.0, 60_000.0), (8.0, math.inf)
    found = doubts(plan, state_of(*usual, *wrong), None)
    assert list(found) == [4, 5, 6]
    assert "J/m 1e+300 is no measurement" in found[4]
    assert "torque 60000 is far from all other trials, 60 to" in found[5]
    assert "torque inf is no measurement" in found[6]


def test_a_bench_of_earlier_versions_names_wrong_numbers(tmp_path):
    """Its entries hold 1e300, and a falling clock's 1.357e9, which nobody has questioned."""
    path = robot.write(tmp_path, robot.FEATURES)
    bench = Bench.new(path)
    robot.run(bench, 4)
    plan = read_plan(path)
    journal = Journal(plan.url, plan.name)
    for number, value in ((4, 1e300), (5, 1.357e9)):
        bench.next()
        with journal.turn():
            data = {"trial": number, "value": value, "columns": {}, "note": ""}
            journal.append("record", data, "me")
    lines = Bench(path).doubts()
    assert [line.partition(":")[0] for line in lines] == ["trial 4", "trial 5"]
    assert Bench(path).doubts(5) == lines[1:] and Bench(path).doubts(0) == []


def test_a_walk_that_costs_less_than_its_time_was_a_log_with_clock_times(
    tmp_path,
):
    """1 / (1 + 30) is the least that 30 s can cost; nanoseconds gave 0.0211."""
    path = tmp_path / "walk.toml"
    path.write_text(
        '[candidates]\nstore = "store"\n[goal]\nsuccess = 0.5\nduration_s = 30\n'
    )
    state = state_of((0.0211, math.nan), (0.0414, math.nan))
    found = doubts(read_plan(path), state, (0.012, 1.0))
    assert list(found) == [0] and "was it a log with clock times?" in found[0]


GOAL = "success = 0.5\nduration_s = 30\nfailed_at_once = 6"


@pytest.mark.parametrize(
    ("goal", "said"),
    [
        (
            "success = 0.5\nduration_s = 30\nfailed_at_once = 0.0001",
            "worse than goal.success, 0.5",
        ),
        (
            "duration_s = 30\nfailed_at_once = 0.01",
            "goal.failed_at_once: 0.01 .* worse than the best one simulated",
        ),
    ],
)
def test_failures_that_are_worth_much_are_refused(tmp_path, goal, said):
    path = robot.write(tmp_path)
    robot.change(path, GOAL, goal)
    with refused(said):
        Bench.new(path)


def test_failures_in_another_unit_than_the_worlds_are_questioned(
    tmp_path,
):
    path = robot.write(tmp_path)
    robot.change(path, GOAL, "duration_s = 30\nfailed_at_once = 600")
    (line,) = Bench.new(path).doubts()
    assert line.startswith("goal.failed_at_once: 600 is far from all that was simul")
    robot.change(path, 'name = "walk"', 'name = "run"')
    robot.change(path, "600", "6")
    assert Bench.new(path).doubts() == []


def test_falls_of_a_store_that_prices_them_itself_are_compared(tmp_path):
    """A fall at once has a smooth cost of 1 + 0.3 + 0.013, wherever the bench says 2."""
    path = tmp_path / "walk.toml"
    toml = '[candidates]\nstore = "store"\n[goal]\nduration_s = 30\n'
    toml += "failed_at_once = {}\nfailed_at_end = 1\n"
    path.write_text(toml.format(2))
    (line,) = odd_failures(read_plan(path), (0.0122, 1.3))
    assert "failed_at_once: 2" in line and "1.313" in line
    path.write_text(toml.format(1.3))
    assert odd_failures(read_plan(path), (0.0122, 1.3)) == []


def test_a_copy_of_the_file_is_whole_while_a_server_holds_it(tmp_path):
    """SQLite writes its log down when the last program closes the file: a server never does."""
    path = robot.write(tmp_path)
    bench = Bench.new(path, "me")
    held = open_studies(bench.plan.url)
    with held.engine.connect():
        robot.run(bench, 2)
        (tmp_path / "copy").mkdir()
        copied = robot.write(tmp_path / "copy")
        copied.with_suffix(".db").write_bytes(path.with_suffix(".db").read_bytes())
        again = Bench(copied)
    assert again.entries == bench.entries and len(again.state.trials) == 2
    assert np.isfinite(again.best().value)
