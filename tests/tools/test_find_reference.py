"""tools/find_reference.py: what it searches by, and that it searches the same way twice."""

import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from study.cli import run_command
from taichi_nmm.body import Bodies
from taichi_nmm.parameters import GAIN_NAMES, K_T, load_gains, lower_bounds, upper_bounds
from taichi_nmm.result import RESULT_DTYPE
from tests.study import synthetic_gait
from tests.tools.running import load_tool


@pytest.fixture
def tool(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.setattr(sys, "path", [*sys.path])
    return load_tool("find_reference")


def test_the_shipped_gait_lies_in_the_bounds() -> None:
    gains = load_gains("reference")
    assert gains.shape == (len(GAIN_NAMES),)
    assert np.all((lower_bounds() <= gains) & (gains <= upper_bounds()))


def test_people_are_not_unlike_people(tool: ModuleType) -> None:
    assert tool.unlikeness(synthetic_gait.walk()) < 0.1
    assert tool.unlikeness(synthetic_gait.walk(0.3)) == tool.NO_STRIDES_SD


def test_habits_are_paid_for_outside_their_range_only(tool: ModuleType) -> None:
    rows = np.zeros(3, RESULT_DTYPE)
    rows["trunk_mean_rad"] = np.deg2rad([5.0, 18.0, -2.0])
    rows["step_length_mean_m"] = [0.70, 0.70, 0.56]
    np.testing.assert_allclose(tool.habits(rows), [0.0, 3.0, 0.6 + 3.0])


def test_the_first_trial_is_the_nominal_walker_on_level_ground(tool: ModuleType) -> None:
    bodies = tool.trial_bodies()
    assert len(bodies) == len(tool.TRIAL_TERRAINS) == len(tool.TRIAL_BODIES)
    np.testing.assert_array_equal(bodies.mass_kg[0], Bodies.nominal().mass_kg[0])
    assert np.ptp(tool.TERRAINS[tool.TRIAL_TERRAINS[0]].height_m) == 0


def test_the_same_seed_searches_the_same_way(
    tool: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    def distance(gains: np.ndarray, arch: str) -> np.ndarray:
        return np.sum(((gains - K_T) / tool.RANGE) ** 2, axis=1)

    monkeypatch.setattr(tool, "costs", distance)
    start = np.full(len(K_T), 0.5)
    first, again, other = (tool.search(start, 1, restart, 30, "cpu") for restart in (0, 0, 1))
    np.testing.assert_array_equal(first, again)
    assert np.any(first != other)
    assert distance(first, "")[1] < 0.1 * distance(tool.LOW + tool.RANGE * start[None], "")[0]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--restarts", "0"], "restarts: 0"),
        (["--generations", "-1"], "generations: -1"),
        (["--seed", "-1"], "seed: -1"),
        (["--out", "no/such/folder/gains.json"], "a place that can be written"),
    ],
)
def test_bad_input(
    tool: ModuleType,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    arguments: list[str],
    says: str,
) -> None:
    out = str(tmp_path / "gains.json")
    monkeypatch.setattr(sys, "argv", ["find_reference.py", "--out", out, *arguments])
    with pytest.raises(SystemExit) as stop:
        run_command(tool.main)
    said = capsys.readouterr().err
    assert stop.value.code == 2 and says in said and said.count("\n") == 1
    assert not list(tmp_path.iterdir())
