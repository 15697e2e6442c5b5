"""What a bench says: next trials, expectations and recommendations, also where little is known."""

import re
from argparse import Namespace

import numpy as np
import pytest

from storage.inputs.errors import InputError
from study.bench.bench import Bench
from study.commands import bench as command
from study.sampler.acquisition import Aim
from tests.cases import refused
from tests.study.bench import robot
from tests.study.bench.robot import change, tell

MORE_LIMITS = "\n[columns.force]\nleast = 1"


def test_numbers_of_trials_are_those_of_the_bench(bench):
    """After an undone `next`, or in a second context, the model's study counts otherwise."""
    bench.next()
    bench.undo()
    assert tell(bench, 0.4) == 1
    assert bench.best().number == 1 and bench.repeat() == 1
    assert str(bench.best()).startswith("Trial 1")
    bench.context("gravel")
    assert tell(bench, 0.7) == 2
    best = bench.best()
    assert (best.number, bench.repeat()) == (2, 2)
    assert dict(best.params) == bench.state.trials[2].params


@pytest.mark.parametrize("safety", ["", "\n[safety]\nleast_kept = 0.9"])
@pytest.mark.parametrize("good", [3, 0])
def test_what_broke_a_limit_on_one_ground_is_not_proposed_on_another(
    path, safety, good
):
    bench = Bench.new(path)
    tell(bench, 0.3, torque=200.0)
    first = bench.state.trials[0].params
    for _ in range(good):
        tell(bench, 0.6, torque=60.0)
    path.write_text(path.read_text() + safety)  # it may change
    bench = Bench(path)
    bench.context("gravel")
    try:
        (trial,) = bench.next()
    except InputError as error:  # no row is known to be as safe as that
        assert safety and error.field == "safety"
        return
    assert trial.params != first
    (again,) = bench.expected([first])
    assert "limits kept 100 %" not in again


def test_limits_told_on_the_first_ground_are_known_on_the_second(bench):
    """The chance to keep them is the one that trials of both grounds let expect."""
    for number in range(6):
        (trial,) = bench.next()
        torque = 60.0 + 60.0 * (trial.params["damping"] > 1.0)
        bench.record(number, robot.cost(trial.params), columns={"torque": torque})
    bench.context("gravel")
    (trial,) = bench.next()
    assert "unknown" not in trial.why and "all limits kept" in trial.why


def test_limits_that_nobody_has_measured_are_unknown_by_name(tmp_path):
    bench = Bench.new(robot.write(tmp_path, more=MORE_LIMITS))
    (trial,) = bench.next()
    assert "limits unknown (torque, force)" in trial.why and "100 %" not in trial.why
    bench.record(0, 0.9)  # both columns left empty
    (trial,) = bench.next()
    assert "limits unknown (torque, force)" in trial.why
    assert "torque of trial 0; force of trial 0" in trial.why
    bench.record(1, 0.8, columns={"torque": 95.0})
    (trial,) = bench.next()
    assert "of force unknown" in trial.why and "torque of trial 0;" in trial.why


def test_a_trial_that_is_not_known_to_keep_its_limits_is_recommended_last(
    bench,
):
    tell(bench, 0.3)  # torque left empty
    assert "torque of trial 0" in str(bench.best())
    tell(bench, 0.9, torque=60.0)
    assert bench.best().number == 1 and "unknown" not in str(bench.best())
    told = "Trial 0 had better values. Not entered, .*: torque of trial 0."
    assert re.search(told, str(bench.best()))
    bench.correct(0, columns={"torque": 60.0})
    assert bench.best().number == 0 and "better values" not in str(bench.best())


def test_neither_failures_nor_broken_limits_are_recommended(bench):
    with refused("recommend: 'no trial yet'"):
        bench.best()
    bench.next()
    bench.record(0, failed_s=0.0)
    for _ in range(2):
        with refused(r"recommend: 'none of . trials' .* nor broke a limit"):
            bench.best()
        assert bench.repeat() is None
        tell(bench, 0.3, torque=200.0)
    number = tell(bench, 2.0, torque=60.0)
    assert (bench.best().number, bench.repeat()) == (number, number)


def test_a_failure_with_the_same_parameters_is_told(bench):
    tell(bench, 0.3, torque=60.0)
    bench.next(repeat=0)
    bench.record(1, failed_s=1.0, columns={"torque": 60.0})
    assert "But trial 1 of the same parameters failed" in str(bench.best())
    tell(bench, 0.5, torque=60.0)
    assert bench.best().number == 2


def test_the_sheet_of_a_pending_trial_says_what_is_expected_by_now(
    tmp_path,
):
    """One simulated world is sure of itself; then the machine costs seven times as much."""
    path = robot.write(tmp_path, 'outcomes = ["world0"]')
    mine, yours = Bench.new(path, "me"), Bench(path, "you")
    (first,) = mine.next()
    (other,) = yours.next()
    mine.record(first.number, 4.9, columns={"torque": 95.0})
    (now,) = yours.next()
    assert now.params == other.params and now.why != other.why
    assert [trial.why for trial in yours.pending()] == [now.why]
    yours.context("gravel")
    assert [trial.why for trial in yours.pending()] == [now.why]


def test_an_expectation_beyond_all_worlds_is_said_to_be_so(bench):
    for value in (0.01, 0.011, 0.01):
        tell(bench, value, torque=60.0)
    least, most = bench.entries[0].data["range"]
    (trial,) = bench.next()
    assert f"beyond all that was simulated, {least:.4g} to {most:.4g}" in trial.why


def test_a_sheet_says_why_it_was_chosen_then_and_what_is_expected_now(path):
    mine, yours = Bench.new(path, "me"), Bench(path, "you")
    tell(mine, 0.6)
    for _ in range(2):
        tell(mine, 0.6, torque=60.0)
    (waiting,) = yours.next()
    assert "no trial had succeeded when it was chosen" in waiting.why
    assert waiting.why.endswith("torque of trial 0.")
    tell(mine, 0.3, torque=60.0)
    mine.correct(0, columns={"torque": 60.0})
    (now,) = yours.next()
    assert "No trial has" not in now.why and "torque of trial" not in now.why
    assert now.params == waiting.params and now.why != waiting.why


def test_a_batch_is_the_next_ones_of_the_ranking(bench):
    whys = [trial.why.partition(".")[0] for trial in bench.next(batch=4)]
    assert whys == ["Next in the ranking by what was simulated in all worlds"] * 4
    bench.context("gravel")
    (trial,) = bench.next()
    assert trial.why.startswith(whys[0])  # nothing was told on other ground


def test_where_nobody_said_what_a_success_is_no_sheet_speaks_of_one(path):
    change(path, "success = 0.5\n", "")
    bench = Bench.new(path)
    why = bench._advice(bench.state)._why(Aim.SUCCESS)
    assert "succe" not in why and "good values" in why


def test_one_failure_beside_a_good_trial_leaves_the_expectation_where_the_worlds_are(
    bench,
):
    (trial,) = bench.next()
    bench.record(trial.number, failed_s=2.0)
    tell(bench, 0.4)
    (trial,) = bench.next()
    assert trial.why.count(" or better ") == 1  # several of a batch may look alike
    found = re.search(
        r"Expected: (\S+) or.* \((\S+) to (\S+) with .* success (\d+) %", trial.why
    )
    value, low, high, success = map(float, found.groups())
    least, _ = bench.entries[0].data["range"]
    assert value >= 0.999 * least and low < 0.4 < high < 60.0
    assert success < 90.0


def test_a_repeat_is_asked_for_once(bench):
    robot.run(bench, 2)
    (again,) = bench.next(repeat=0)
    assert bench.next(repeat=0) == [again] and len(bench.state.trials) == 3
    for _ in range(2):
        both = bench.next(repeat=0, batch=2)
        assert [trial.number for trial in both] == [2, 3]
    bench.record(2, 1.0)
    (third,) = bench.next(repeat=0)
    assert third.number == 4 and third.params == again.params


def test_no_points_off_the_table_where_the_file_says_so(tmp_path):
    path = robot.write(tmp_path)
    path.write_text("off_grid = 0\n" + path.read_text())
    bench = Bench.new(path)
    tried = robot.run(bench, 12)
    rows = bench.candidates.rows
    assert all(rows.find(params) is not None for params in tried)
    change(path, "off_grid = 0", "off_grid = 300")  # it may change
    (trial,) = Bench(path).next()
    assert trial.number == 12
    change(path, "off_grid = 300", "off_grid = -1")
    with refused("off_grid: -1"):
        Bench(path)


def test_steps_are_measured_from_trials_that_kept_their_limits(tmp_path):
    bench = Bench.new(robot.write(tmp_path, more="\n[safety]\nmost_step = 0.1"))
    bad = {"stiffness": 20.0, "damping": 1.8}
    good = {"stiffness": 149.0, "damping": 0.4}
    bench.add([(bad, 0.3, {"torque": 200.0}), (good, 0.4, {"torque": 60.0})])
    for context in ("gravel", "sand"):
        params = bench.next()[0].params
        assert abs(params["damping"] - 0.4) <= 0.1 * 1.9 + 1e-9
        softer = abs(np.log(params["stiffness"] / 149.0))
        assert softer <= 0.1 * np.log(100.0) + 1e-9
        bench.context(context)  # nothing has succeeded there: steps are from the first


def test_a_machine_unlike_all_worlds_is_called_so_while_it_is_true(bench, capsys):
    """`status` quoted a sheet that was printed before the reading was corrected."""
    tell(bench, 60.0)
    (trial,) = bench.next()
    line = "Unlike all 6 worlds after 1 trial: 60 was read where they say"
    assert line in trial.why and trial.why.count("Unlike") == 1
    (again,) = bench.next()
    assert again.why.count("Unlike") == 1
    assert line in str(bench.best())
    bench.correct(0, 0.6)
    command.status(bench, Namespace())
    assert "Unlike" not in capsys.readouterr().err + str(bench.best())
    (trial,) = bench.next()
    assert "Unlike" not in trial.why
