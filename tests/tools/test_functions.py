"""Standard functions: their least values, what a study is told, and how samplers are compared."""

import numpy as np
import pytest

from tests.tools.running import load_tool
from tools.runs import Batches

TOOL = load_tool("compare_functions")
# Where each is least, and its value there (Surjanovic, Bingham 2013).
LEAST = {
    "branin": ([np.pi, 2.275 - 5.0], 0.397887),
    "camel": ([0.0898, -0.7126], -1.0316),
    "goldstein": ([0.0, -1.0], 3.0),
    "hartmann3": ([0.114614, 0.555649, 0.852547], -3.86278),
    "rosenbrock": ([1.0] * 4, 0.0),
    "michalewicz": ([2.202906, 1.570796, 1.284992, 1.923058, 1.720470], -4.687658),
    "hartmann6": (
        [0.20169, 0.150011, 0.476874, 0.275332, 0.311652, 0.6573],
        -3.32237,
    ),
    "ackley": ([0.0] * 8, 0.0),
    "styblinski": ([-2.903534] * 8, -39.16617 * 8),
    "levy": ([1.0] * 10, 0.0),
    "dixon": ([2.0 ** (2.0 ** (1 - i) - 1.0) for i in range(1, 16)], 0.0),
    "ellipsoid": ([0.0] * 20, 0.0),
}


@pytest.mark.parametrize("name", TOOL.FUNCTIONS)
def test_a_function_is_least_where_books_say(name):
    function = TOOL.Function.of(f"{name}-exact")
    point, least = LEAST[name]
    settings = dict(zip(function.space, point, strict=True))
    assert function.cost_at(settings) == pytest.approx(least, abs=1e-4)
    low, high = function.box
    assert all(low <= value <= high for value in point)
    rng = np.random.default_rng(1)
    for other in rng.uniform(low, high, (50, len(point))):
        settings = dict(zip(function.space, other.tolist(), strict=True))
        assert function.cost_at(settings) > least


def test_a_seed_moves_a_function_and_draws_its_noise():
    function = TOOL.Function.of("levy-noisy")
    moved = function.drawn(3)
    assert moved.move.tolist() == function.drawn(3).move.tolist()
    assert 0.0 < np.abs(moved.move).max() <= 1.0
    settings = dict(zip(moved.space, (1.0 - moved.move).tolist(), strict=True))
    assert moved.cost_at(settings) == pytest.approx(0.0, abs=1e-9)
    first, noise = moved.draws(3, 400)
    assert first.shape == (3, 10) and function.noise > 0.0
    assert noise.std() == pytest.approx(function.noise, rel=0.1)
    exact = TOOL.Function.of("levy-exact")
    assert exact.noise == 0.0 and not exact.draws(3, 9)[1].any()
    np.testing.assert_array_equal(exact.draws(3, 9)[0], first)


def test_a_study_begins_with_the_points_of_its_seed():
    """And costs are told without noise."""
    exact, noisy = (TOOL.Function.of(f"branin-{each}").drawn(5) for each in TOOL.NOISES)
    first, _ = noisy.draws(5, 6)
    costs = TOOL.ARMS["plain"].costs(noisy, 5, Batches(6))
    for point, cost in zip(first.tolist(), costs, strict=False):
        assert cost == exact.cost_at(dict(zip(exact.space, point, strict=True)))
    assert len(costs) == 6 and len(set(costs)) == 6
    again = TOOL.ARMS["plain"].costs(noisy, 5, Batches(6))
    assert again.tolist() == costs.tolist()
    other = TOOL.ARMS["plain"].costs(exact, 5, Batches(6))
    assert other[:3].tolist() == costs[:3].tolist() and set(other) != set(costs)


def test_the_command_writes_a_page(tmp_path, tool):
    words = ("--out", tmp_path, "--cache", tmp_path, "--processes", 1, "--seeds", 2)
    words = (*words, "--functions", "branin,camel", "--trials", 5)
    assert tool("compare_functions", *words, "--arms", "plain") == 0, tool.err
    text = (tmp_path / "sampler-functions.md").read_text()
    assert "A run of ours took" in text and "| camel, noisy |" in text


def test_won_and_lost_are_counted_by_seed_and_function():
    best = np.ones((2, 4, 3, 10))
    best[:, :, 0] = 0.5  # ours is lowest, but on one function with noise
    best[:, 3, 0] = 2.0
    problems = ["branin-exact", "branin-noisy", "camel-exact", "camel-noisy"]
    options = TOOL.Namespace(trials=10, seeds=2, arms=["plain", "gp", "botorch"])
    found = TOOL.Figures(options, problems, best, np.ones((2, 4, 3)))
    assert found.versus(1, 10, "")[:2] == (6, 2)
    assert found.versus(2, 10, "noisy")[:2] == (2, 2)
    assert found.versus(2, 10, "noisy", "camel-")[:2] == (0, 2)
    lines = found.lines()
    assert "| GPSampler | exact | 4:0 | 0.12 | 1 |" in lines
    assert "| camel, noisy | 0:2 | 0.5 | 0:2 | 0.5 |" in lines
