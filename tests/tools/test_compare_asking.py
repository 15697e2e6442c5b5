"""The tool that says what it brings to ask a store's simulator."""

import pytest

from tests.storage import robot

STORE = """
samples = 60
seed = 3
simulation.duration_s = 4.0
world.wind = 0.0
families.still = {settings = 3, world = {wind = 0.0, mass_kg = [0.5, 2.0]}}
"""
ROBOTS = """
simulator = "windy_carts.py:Cart"
store = "STORE"
seed = 5
runs = 2
trials = 6
simulation.duration_s = 9.0
objective = {cost = "speed_mps", fell_cost = 4.0}
world = {wind = [0.0, 0.001], mass_kg = [1.0, 2.0]}
"""


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """The configurations of a comparison and of its store."""
    folder = tmp_path_factory.mktemp("windy")
    store, config = robot.written_store(folder, "windy_carts", STORE)
    robots = folder / "robots.toml"
    robots.write_text(ROBOTS.replace("STORE", str(store)))
    return robots, config


@pytest.mark.slow
def test_both_arms_have_tried_the_same_robots(tool, files, tmp_path):
    robots, store = files
    words = ("--config", robots, "--simulator", store, "--out", tmp_path / "out")
    assert tool("compare_asking", *words) == 0, tool.err
    head, after = tool.out.splitlines()
    assert head.startswith("2 robots; asked against guessed")
    assert after.startswith("after  5: ")
    assert tool("compare_asking", *words) == 0  # nothing is left to do
    assert tool.out.splitlines() == [head, after]


def test_another_configuration_than_the_stores_is_refused(tool, files, tmp_path):
    robots, other = files[0], files[1].with_name("other.toml")
    other.write_text(files[1].read_text().replace("seed = 3", "seed = 4"))
    tool.refuses(
        "config: .*other.toml.* allowed: one with 'seed' as the store ",
        "compare_asking",
        *("--config", robots, "--simulator", other, "--out", tmp_path / "out"),
    )
