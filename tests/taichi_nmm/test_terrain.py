"""Grounds against their closed forms, their seeds, and what a user can get wrong."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from taichi_nmm import terrain
from taichi_nmm.errors import InputError
from taichi_nmm.terrain import FLAT_START_M, GRID_SPACING_M, GRID_X_M, Terrain

CELL_M = GRID_SPACING_M


def test_grid_covers_a_hundred_seconds_of_the_fastest_gait() -> None:
    assert GRID_X_M[0] == -5.0
    assert GRID_X_M[-1] == pytest.approx(300.0)
    assert np.allclose(np.diff(GRID_X_M), CELL_M)


def test_flat_is_level() -> None:
    assert not np.any(terrain.flat().height_m)


def test_height_is_linear_between_nodes_and_clamped_outside() -> None:
    slope = Terrain("slope", 2.0 * GRID_X_M)
    inside = np.array([[0.01, 0.12], [7.333, 299.99]])
    np.testing.assert_allclose(slope.height(inside), 2.0 * inside)
    np.testing.assert_allclose(slope.height([-100.0, 1000.0]), [-10.0, 600.0])


def test_rough_moves_up_to_the_amplitude_from_knot_to_knot() -> None:
    ground = terrain.rough(3, amplitude_m=0.08)
    knots = ground.height(np.arange(FLAT_START_M, 300.0))
    steps = np.diff(knots)
    assert knots[0] == 0.0
    assert 0.075 < np.max(np.abs(steps)) <= 0.08
    assert abs(np.mean(steps)) < 0.01


def test_rough_is_linear_between_knots() -> None:
    ground = terrain.rough(3)
    knots = np.arange(FLAT_START_M, 299.0)
    middle = 0.5 * (ground.height(knots) + ground.height(knots + 1.0))
    np.testing.assert_allclose(ground.height(knots + 0.5), middle, atol=1e-12)


def test_rough_spacing_and_flat_start_are_settings() -> None:
    ground = terrain.rough(3, spacing_m=2.0, flat_start_m=4.0)
    assert not np.any(ground.height(np.linspace(-5.0, 4.0, 50)))
    assert ground.height(4.5) == pytest.approx(ground.height(6.0) / 4)


def test_blocks_are_level_but_for_their_risers() -> None:
    ground = terrain.blocks(5, riser_m=0.10)
    edges = np.arange(FLAT_START_M + 1.0, 299.0)
    on_block = ground.height(edges + 0.45)
    np.testing.assert_allclose(ground.height(edges), on_block, atol=1e-9)
    np.testing.assert_allclose(ground.height(edges + 0.85), on_block, atol=1e-9)
    assert np.all(np.diff(on_block) != 0.0)


def test_a_riser_rises_over_its_length_to_the_next_block() -> None:
    ground = terrain.blocks(5, riser_m=0.50)
    low, middle, high = ground.height([FLAT_START_M + 0.5, FLAT_START_M + 0.75, FLAT_START_M + 1.0])
    assert low == pytest.approx(0.0, abs=1e-9)
    assert middle == pytest.approx(0.5 * high)


def test_blocks_with_risers_as_long_as_blocks_are_the_rough_ground() -> None:
    longest = terrain.blocks(5, riser_m=1.0)
    np.testing.assert_allclose(longest.height_m, terrain.rough(5).height_m, atol=1e-9)


@pytest.mark.parametrize("make", [terrain.rough, terrain.blocks])
def test_a_seed_makes_one_ground(make: Callable[..., Terrain]) -> None:
    np.testing.assert_array_equal(make(11).height_m, make(11).height_m)
    assert np.any(make(11).height_m != make(12).height_m)
    sequence = np.random.SeedSequence(11, spawn_key=(1, 2))
    again = np.random.SeedSequence(11, spawn_key=(1, 2))
    np.testing.assert_array_equal(make(sequence).height_m, make(again).height_m)


@pytest.mark.parametrize("make", [terrain.rough, terrain.blocks])
def test_no_amplitude_is_flat(make: Callable[..., Terrain]) -> None:
    assert not np.any(make(1, amplitude_m=0.0).height_m)


@pytest.mark.parametrize(("direction", "sign"), [("up", 1.0), ("down", -1.0)])
def test_ramp_steepens_by_the_increment_each_segment(direction: str, sign: float) -> None:
    ground = terrain.ramp(0.04, 20.0, 0.20, direction)
    ends = sign * 20.0 * np.cumsum([0.0, 0.04, 0.08, 0.12, 0.16, 0.20, 0.20])
    np.testing.assert_allclose(ground.height(20.0 * np.arange(1, 8)), ends, atol=1e-9)
    assert ground.height(-3.0) == 0.0
    assert ground.height(30.0) == pytest.approx(sign * 0.4)


@pytest.mark.parametrize(("direction", "sign"), [("up", 1.0), ("down", -1.0)])
def test_stairs_step_at_each_run(direction: str, sign: float) -> None:
    ground = terrain.stairs(rise_m=0.15, run_m=0.30, flat_start_m=2.0, direction=direction)
    edges = 2.0 + 0.30 * np.arange(20)
    treads = sign * 0.15 * np.arange(1, 21)
    np.testing.assert_allclose(ground.height(edges), treads, atol=1e-9)
    np.testing.assert_allclose(ground.height(edges + 0.30 - CELL_M), treads, atol=1e-9)
    np.testing.assert_allclose(ground.height(edges - CELL_M), treads - sign * 0.15, atol=1e-9)
    assert not np.any(ground.height(np.linspace(-5.0, 1.9, 30)))


def test_a_file_is_read_and_joined_by_straight_lines(tmp_path: Path) -> None:
    path = tmp_path / "hill.csv"
    path.write_text("# x_m,height_m\n0,0\n10,1\n20,0.5\n")
    ground = terrain.from_file(path)
    np.testing.assert_allclose(ground.height([-4, 5, 10, 15, 200]), [0, 0.5, 1, 0.75, 0.5])
    assert ground.name == "file hill.csv"


@pytest.mark.parametrize(
    ("text", "allowed"),
    [
        ("0,zero\n1,2\n", "a readable table"),
        ("0,1\n", "at least two rows"),
        ("0,1,2\n1,1,2\n", "two columns"),
        ("0,1\n0,2\n", "strictly increasing"),
        ("0,1\n1,nan\n", "finite numbers"),
        ("0,1\ninf,2\n", "finite numbers"),
        ("", "at least two rows"),
    ],
)
@pytest.mark.filterwarnings("error")
def test_a_file_that_is_no_table_is_refused(tmp_path: Path, text: str, allowed: str) -> None:
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=allowed) as caught:
        terrain.from_file(path)
    assert caught.value.field == "terrain.file"
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["missing.csv", "."])
def test_a_file_that_cannot_be_read_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=r"terrain\.file"):
        terrain.from_file(tmp_path / name)


def test_a_height_table_must_fit_the_grid() -> None:
    with pytest.raises(InputError, match=r"terrain\.height_m\.shape: \(5,\)"):
        Terrain("short", np.zeros(5))
    with pytest.raises(InputError, match=r"terrain\.height_m: 'nan or inf'"):
        Terrain("hole", np.where(GRID_X_M > 10.0, np.nan, 0.0))


BAD_SETTINGS: list[tuple[Callable[[], Terrain], str]] = [
    (lambda: terrain.rough(1, amplitude_m=-0.1), "amplitude_m"),
    (lambda: terrain.rough(1, amplitude_m=np.nan), "amplitude_m"),
    (lambda: terrain.rough(1, amplitude_m=np.inf), "amplitude_m"),
    (lambda: terrain.rough(1, spacing_m=0.0), "spacing_m"),
    (lambda: terrain.rough(1, spacing_m=np.inf), "spacing_m"),
    (lambda: terrain.rough(1, flat_start_m=np.nan), "flat_start_m"),
    (lambda: terrain.rough(1, flat_start_m=400.0), "flat_start_m"),
    (lambda: terrain.blocks(1, spacing_m=-1.0), "spacing_m"),
    (lambda: terrain.blocks(1, riser_m=0.04), "riser_m"),
    (lambda: terrain.blocks(1, riser_m=1.1), "riser_m"),
    (lambda: terrain.blocks(1, riser_m=np.nan), "riser_m"),
    (lambda: terrain.ramp(increment=0.0), "increment"),
    (lambda: terrain.ramp(segment_m=np.nan), "segment_m"),
    (lambda: terrain.ramp(largest_slope=-0.2), "largest_slope"),
    (lambda: terrain.ramp(direction="sideways"), "direction"),
    (lambda: terrain.stairs(rise_m=0.0), "rise_m"),
    (lambda: terrain.stairs(rise_m=np.inf), "rise_m"),
    (lambda: terrain.stairs(run_m=0.05), "run_m"),
    (lambda: terrain.stairs(flat_start_m=np.nan), "flat_start_m"),
    (lambda: terrain.stairs(direction="Up"), "direction"),
]


@pytest.mark.parametrize(("make", "field"), BAD_SETTINGS)
def test_settings_out_of_range_are_named(make: Callable[[], Terrain], field: str) -> None:
    with pytest.raises(InputError) as caught:
        make()
    assert caught.value.field == f"terrain.{field}"
