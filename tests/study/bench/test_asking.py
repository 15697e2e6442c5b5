"""A bench that asks the simulator of its store about points off the candidates."""

import numpy as np
import pytest

from storage.precompute import score_rows
from study import Bench
from study.cli import main
from study.experiment import features
from tests.storage import robot
from tests.study.conftest import refused

STORE = """
samples = 80
seed = 3
simulation.duration_s = 8.0
world.wind = 0.0
families.heavy = {settings = 6, world = {wind = 0.0, mass_kg = [0.5, 2.0]}}
"""
BENCH = """
[candidates]
store = "bench_carts-store"
cost = "speed_mps"
asked = "bench_carts.toml"
[goal]
success = 0.5
duration_s = 8
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """With a store and the configuration that it was computed by."""
    folder = tmp_path_factory.mktemp("carts")
    robot.written_store(folder, "bench_carts", STORE)
    return folder


def tried(folder, name, trials):
    """A bench of a cart of 1.3 kg, after some trials."""
    path = folder / f"{name}.toml"
    path.write_text(BENCH)
    bench = Bench.new(path)
    for _ in range(trials):
        (trial,) = bench.next()
        run = robot.drive(trial.params, {"wind": 0.0, "mass_kg": 1.3}, 8.0)
        bench.record(trial.number, value=run["speed_mps"])
    return bench


def test_points_off_the_candidates_are_simulated_before_one_is_proposed(
    folder, monkeypatch
):
    simulated = []

    def noted(specification, rows, report, points):
        simulated.append(points)
        return score_rows(specification, rows, report, points)

    monkeypatch.setattr(features, "score_rows", noted)
    bench = tried(folder, "asks", 9)
    rows = bench.candidates.rows
    tries = [trial.params for trial in bench.state.trials.values()]
    off = [rows.space.row(params) for params in tries if rows.find(params) is None]
    assert off
    every = np.vstack(simulated)
    for point in off:
        assert (every == point).all(axis=1).any()


def test_another_simulator_than_the_stores_is_refused_before_the_first_trial(folder):
    path = folder / "other.toml"
    own = (folder / "bench_carts.toml").read_text()
    (folder / "heavier.toml").write_text(own.replace("2.0]", "2.5]"))
    path.write_text(BENCH.replace("bench_carts.toml", "heavier.toml"))
    with refused("^candidates.asked: 'heavier.toml' .* with 'families' as the store"):
        Bench.new(path)
    path.write_text(BENCH.replace("cost =", "features = ['speed_mps']\ncost ="))
    with refused("^candidates.asked: 'bench_carts.toml' .* none beside features"):
        Bench.new(path)
    path.write_text(BENCH.replace("bench_carts.toml", ""))
    with refused("^candidates.asked: '' .* a file"):
        Bench.new(path)


def test_the_command_says_that_points_are_simulated(folder, capsys):
    path = folder / "said.toml"
    path.write_text(BENCH)
    main(["bench", "new", str(path)])
    config = folder / "bench_carts.toml"
    assert f"points off the table are simulated: {config}" in capsys.readouterr().out


def test_a_bench_asks_or_does_not_as_it_was_begun(folder):
    path, silent = folder / "kept.toml", BENCH.replace('asked = "bench_carts.toml"', "")
    path.write_text(silent)
    Bench.new(path)
    path.write_text(BENCH)
    with refused(
        "candidates.asked: 'bench_carts.toml' .* begun, without it; or another"
    ):
        Bench(path)
    other = folder / "asking.toml"
    other.write_text(BENCH)
    Bench.new(other)
    other.write_text(silent)
    with refused(
        "candidates.asked: 'none' .* begun, with 'bench_carts.toml'; or another"
    ):
        Bench(other)
