"""What proposals of a bench may risk: falls, and limits of columns, as worlds and trials tell."""

import re

import numpy as np
import pytest
from numpy.testing import assert_allclose

from storage import make_store
from study.bench.bench import Bench
from tests.cases import refused
from tests.storage import robot as own
from tests.study.bench import robot
from tests.study.bench.robot import change

FALL = "\n[limit]\nfall = {risk}\n"


def falling(folder, share=0.5, more="", columns=None):
    """A bench whose worlds fall where damping is below a place of each, and cost 3 there."""
    path = robot.write(folder, more=more)
    file = folder / "candidates.csv"
    head, *lines = file.read_text().splitlines()
    rows = np.array([[float(cell) for cell in line.split(",")] for line in lines])
    places = share + 0.05 * np.arange(6)
    rows[:, 2:] = np.where(rows[:, [1]] < places, 3.0, np.minimum(rows[:, 2:], 2.9))
    for name, column in (columns or {}).items():
        head += f",{name}"
        rows = np.column_stack([rows, column(rows)])
    np.savetxt(file, rows, "%.17g", ",", header=head, comments="")
    return path


def run(bench, trials=8, place=0.6):
    """Trials of a machine that falls where damping is below a place; how many fell."""
    fell = 0
    for _ in range(trials):
        (trial,) = bench.next()
        if trial.params["damping"] < place:
            bench.record(trial.number, failed_s=10.0)
            fell += 1
        else:
            bench.record(trial.number, robot.cost(trial.params))
    return fell


def risk_said(trial):
    return int(re.search(r"a fall (\d+) %", trial.why)[1])


def test_proposals_keep_to_the_risk_of_a_fall_and_the_sheet_says_it(tmp_path):
    path = falling(tmp_path, more=FALL.format(risk=0.1))
    bench = Bench.new(path)
    assert run(bench) == 0
    for trial in bench.state.trials.values():
        assert trial.params["damping"] > 0.75 and risk_said(trial) <= 10
    change(path, "fall = 0.1", "fall = 0.9")  # it may change
    bench = Bench(path)
    (trial,) = bench.next()
    assert "a fall " in trial.why


def test_without_it_nothing_is_said_of_falls(tmp_path):
    (trial,) = Bench.new(falling(tmp_path)).next()
    assert "a fall" not in trial.why


def test_where_all_worlds_fall_next_says_the_least_risk_and_how_to_go_on(tmp_path):
    path = falling(tmp_path, share=3.0, more=FALL.format(risk=0.1))
    bench = Bench.new(path)
    with refused(
        r"^limit\.fall: 0\.1 .* from 0\.9\d on, the least .*`taichi-nmm bench add`"
    ):
        bench.next()
    assert not bench.state.trials and len(bench.entries) == 1


def test_a_fall_elsewhere_counts_here(tmp_path):
    bench = Bench.new(falling(tmp_path, more=FALL.format(risk=0.3)))
    (trial,) = bench.next()
    bench.record(trial.number, failed_s=1.0)
    before = bench.expected([trial.params])
    bench.context("gravel")
    (other,) = bench.next()
    assert other.params != trial.params
    (after,) = bench.expected([trial.params])
    assert "a fall" in after and "a fall" in before[0]
    risk = int(re.search(r"a fall (\d+) %", after)[1])
    assert risk >= 15


def test_with_features_trials_have_to_tell_first(tmp_path):
    path = robot.write(tmp_path, robot.FEATURES, FALL.format(risk=0.2))
    bench = Bench.new(path)
    with refused(r"limit\.fall: 0\.2 .* neither worlds nor 3 trials tell of it"):
        bench.next()
    rows = bench.candidates.rows
    bench.add([(rows.as_parameters(row), 0.5) for row in range(3)])
    (trial,) = bench.next()
    assert risk_said(trial) == 20


def test_worlds_that_tell_of_a_column_certify_it(tmp_path):
    more = 'worlds = ["force*"]\n[limit]\ntorque = 0.1\n'
    columns = {f"force{world}": lambda rows: 40.0 * rows[:, 1] for world in range(6)}
    path = falling(tmp_path, share=0.0, more=more, columns=columns)
    bench = Bench.new(path)
    for _ in range(5):
        (trial,) = bench.next()
        torque = 42.0 * trial.params["damping"]
        assert torque <= 100.0
        assert "all limits kept" in trial.why
        bench.record(trial.number, robot.cost(trial.params), columns={"torque": torque})
    assert 40.0 * bench.candidates.rows.parameters[:, 1].max() < 90.0


def test_two_limits_of_a_column_share_its_risk(tmp_path):
    path = robot.write(tmp_path, more="least = 10\n[limit]\ntorque = 0.1\n")
    bench = Bench.new(path)
    with refused(r"limit\.torque: 0\.1 .* neither worlds nor 3 trials"):
        bench.next()
    sampler = bench.plan.sampler(bench.candidates)
    shared = {"torque at least": 0.05, "torque at most": 0.05}
    assert sampler._policy.options.allowed_risk == shared


BAD = {
    "fall = 0": r"limit\.fall: 0\.0 .* above 0 and below 1",
    "fall = 1": r"limit\.fall: 1\.0 .* above 0 and below 1",
    'fall = "low"': r"limit\.fall: 'low'",
    "force = 0.1": r"limit\.force: 0\.1 .* the chance of fall, torque: no other column",
    "speed = 0.1\n[columns.speed]": r"limit\.speed: 0\.1 .* no other column has a limit",
    "fall = 0.1\n[columns.fall]": r"limit\.fall: 0\.1 .* none beside a column",
}


@pytest.mark.parametrize("line", BAD)
def test_a_limit_that_cannot_be_used_is_one_line(tmp_path, line):
    path = robot.write(tmp_path, more=f"\n[limit]\n{line}\n")
    with refused(BAD[line]):
        Bench.new(path)


def test_a_fall_needs_to_be_defined_and_worlds_to_be_there(tmp_path):
    path = robot.write(tmp_path, more=FALL.format(risk=0.1))
    change(path, "failed_at_once = 6\nfailed_at_end = 3\n", "")
    with refused(r"limit\.fall: 0\.1 .* failed_at_end .*: they say what a fall is"):
        Bench.new(path)
    path = robot.write(tmp_path, more='worlds = ["forse*"]\n')
    with refused(r"columns\.torque\.worlds: 'forse\*' .* some of stiffness"):
        Bench.new(path)


STORE = """
[candidates]
store = "cart"
cost = "speed_mps"
[goal]
duration_s = 8
failed_at_once = 6
failed_at_end = 3
[columns.speed]
most = 1
worlds = [{worlds}]
[limit]
fall = 0.9999
"""


@pytest.mark.filterwarnings("ignore:.* rows lasted")
def test_a_row_of_a_store_falls_where_its_run_ended_early(tmp_path):
    run = {"settings": 3, "seed": 1, "horizon_s": 8.0}
    winds = {"gale": [1.0, 3.0], "calm": 0.0}
    store = tmp_path / "cart"
    families = {name: run | {"world": {"wind": wind}} for name, wind in winds.items()}
    made = make_store(own.Cart, store, workers=1, samples=9, seed=3, families=families)
    path = tmp_path / "bench.toml"
    path.write_text(STORE.format(worlds='"speed_mps"'))
    bench = Bench.new(path)
    limits = bench.candidates.rows.limits
    ran = bench.candidates.rows.worlds.known
    lasted = made.all_outcomes("survived_fraction", made.families)
    fell = np.hstack([lasted[family] < 1.0 for family in made.families])[ran]
    assert_allclose(limits["fall"].costs[ran], fell)
    assert 0.4 < fell.mean() < 0.6
    speed = made.all_outcomes("speed_mps", made.families)
    fast = np.hstack([speed[family] > 1.0 for family in made.families])[ran]
    assert_allclose(limits["speed at most"].costs[ran], fast)
    assert 0.0 < fast.mean() < 1.0
    (trial,) = bench.next()
    assert "a fall " in trial.why and "all limits kept" in trial.why
    for worlds, said in (
        ('"speed_mps", "cost"', "one column that the worlds keep"),
        ('"sped"', r"columns\.speed\.worlds: 'sped' .* speed_mps"),
    ):
        path.write_text(STORE.format(worlds=worlds).replace("cart", "./cart"))
        path.with_suffix(".db").unlink(missing_ok=True)
        with refused(said):
            Bench.new(path)
