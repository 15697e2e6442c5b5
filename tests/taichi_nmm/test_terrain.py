"""Grounds: closed forms, seeds, and mistakes of a user."""

import pickle
from inspect import Parameter, signature
from typing import Annotated, get_args, get_origin, get_type_hints

import numpy as np
import pytest

from storage.inputs.config import Table, read_toml
from taichi_nmm import InputError, terrain
from taichi_nmm.terrain import (
    FLAT_START_M,
    GRID_X_M,
    KINDS,
    Ground,
    Terrain,
    read_ground,
)
from taichi_nmm.terrain import GRID_SPACING_M as CELL_M
from tests.cases import asset, cases, refused

SEED = 3


def test_the_grid_is_long_and_height_is_linear_between_nodes_and_clamped_outside():
    assert GRID_X_M[0] == -5.0
    assert GRID_X_M[-1] == pytest.approx(300.0)
    assert np.allclose(np.diff(GRID_X_M), CELL_M)
    assert not np.any(terrain.flat().height_m)
    slope = Terrain("slope", 2.0 * GRID_X_M)
    inside = np.array([[0.01, 0.12], [7.333, 299.99]])
    np.testing.assert_allclose(slope.height(inside), 2.0 * inside)
    np.testing.assert_allclose(slope.height([-100.0, 1000.0]), [-10.0, 600.0])


def test_rough_moves_up_to_the_amplitude_from_knot_to_knot_and_is_linear_between():
    ground = terrain.rough(3, amplitude_m=0.08)
    at = np.arange(FLAT_START_M, 300.0)
    knots = ground.height(at)
    steps = np.diff(knots)
    assert knots[0] == 0.0
    assert 0.075 < np.max(np.abs(steps)) <= 0.08
    assert abs(np.mean(steps)) < 0.01
    middle = 0.5 * (knots[:-1] + knots[1:])
    np.testing.assert_allclose(ground.height(at[:-1] + 0.5), middle, atol=1e-12)
    ground = terrain.rough(3, spacing_m=2.0, flat_start_m=4.0)
    assert not np.any(ground.height(np.linspace(-5.0, 4.0, 50)))
    assert ground.height(4.5) == pytest.approx(ground.height(6.0) / 4)


def test_blocks_are_level_but_for_their_risers_which_may_be_as_long_as_a_block():
    ground = terrain.blocks(5, riser_m=0.10)
    edges = np.arange(FLAT_START_M + 1.0, 299.0)
    on_block = ground.height(edges + 0.45)
    np.testing.assert_allclose(ground.height(edges), on_block, atol=1e-9)
    np.testing.assert_allclose(ground.height(edges + 0.85), on_block, atol=1e-9)
    assert np.all(np.diff(on_block) != 0.0)
    ground = terrain.blocks(5, riser_m=0.50)
    low, middle, high = ground.height(
        [FLAT_START_M + 0.5, FLAT_START_M + 0.75, FLAT_START_M + 1.0]
    )
    assert low == pytest.approx(0.0, abs=1e-9)
    assert middle == pytest.approx(0.5 * high)
    longest = terrain.blocks(5, riser_m=1.0)
    np.testing.assert_allclose(longest.height_m, terrain.rough(5).height_m, atol=1e-9)


@pytest.mark.parametrize("make", [terrain.rough, terrain.blocks])
def test_a_seed_makes_one_ground_and_no_amplitude_is_flat(make):
    np.testing.assert_array_equal(make(11).height_m, make(11).height_m)
    assert np.any(make(11).height_m != make(12).height_m)
    sequence = np.random.SeedSequence(11, spawn_key=(1, 2))
    again = np.random.SeedSequence(11, spawn_key=(1, 2))
    np.testing.assert_array_equal(make(sequence).height_m, make(again).height_m)
    assert not np.any(make(1, amplitude_m=0.0).height_m)


def test_ground_may_rise_as_a_whole_while_blocks_stay_level():
    for slope in (0.04, -0.1):
        level, rising = (
            terrain.rough(5, flat_start_m=3.0, slope=rise) for rise in (0.0, slope)
        )
        rise = slope * np.maximum(GRID_X_M - 3.0, 0.0)
        np.testing.assert_allclose(rising.height_m - level.height_m, rise, atol=1e-12)
    level, rising = terrain.blocks(5), terrain.blocks(5, slope=0.04)
    on_blocks = np.diff(level.height_m) == 0.0
    np.testing.assert_allclose(np.diff(rising.height_m)[on_blocks], 0.0, atol=1e-12)
    ends = np.arange(FLAT_START_M, 290.0)  # of risers
    rise = rising.height(ends) - level.height(ends)
    np.testing.assert_allclose(rise, 0.04 * (ends - FLAT_START_M), atol=1e-12)


@pytest.mark.parametrize(("direction", "sign"), [("up", 1.0), ("down", -1.0)])
def test_ramps_steepen_by_increments_and_stairs_step_at_runs(direction, sign):
    ground = terrain.ramp(0.04, 20.0, 0.20, direction)
    ends = sign * 20.0 * np.cumsum([0.0, 0.04, 0.08, 0.12, 0.16, 0.20, 0.20])
    np.testing.assert_allclose(ground.height(20.0 * np.arange(1, 8)), ends, atol=1e-9)
    assert ground.height(-3.0) == 0.0
    assert ground.height(30.0) == pytest.approx(sign * 0.4)
    ground = terrain.stairs(
        rise_m=0.15, run_m=0.30, flat_start_m=2.0, direction=direction
    )
    edges = 2.0 + 0.30 * np.arange(20)
    treads = sign * 0.15 * np.arange(1, 21)
    np.testing.assert_allclose(ground.height(edges), treads, atol=1e-9)
    np.testing.assert_allclose(ground.height(edges + 0.30 - CELL_M), treads, atol=1e-9)
    np.testing.assert_allclose(
        ground.height(edges - CELL_M), treads - sign * 0.15, atol=1e-9
    )
    assert not np.any(ground.height(np.linspace(-5.0, 1.9, 30)))


HILL_ROWS = [(0.0, 0.0), (10.0, 1.0), (20.0, 0.5)]
HEADS = ["", "x_m,height_m\n", " x , height \n", "# a hill\n\n  \nx,height\n", "\ufeff"]


@pytest.mark.parametrize("head", HEADS)
@pytest.mark.parametrize("between", [",", ", ", " ", "\t", "  "])
@pytest.mark.parametrize("end", ["\n", "\r\n", "  # a note, or none\n", "\n\n   \n"])
def test_headers_blanks_notes_of_a_file(tmp_path, head, between, end):
    path = tmp_path / "hill.csv"
    head = head if between.strip() else head.replace(",", between)
    path.write_text(
        head + "".join(f" {x}{between}{z}{end}" for x, z in HILL_ROWS), newline=""
    )
    ground = terrain.from_file(path)
    np.testing.assert_allclose(
        ground.height([-4, 5, 10, 15, 200]), [0, 0.5, 1, 0.75, 0.5]
    )
    assert ground.name == "file hill.csv"


def test_a_file_with_decimal_commas(tmp_path):
    path = tmp_path / "HILL.CSV"
    path.write_bytes("\ufeffx_m;height_m\r\n0,5;0\r\n1,500;0,25\r\n".encode())
    np.testing.assert_allclose(
        terrain.from_file(path).height([0, 1, 2]), [0, 0.125, 0.25]
    )


@pytest.mark.parametrize("height_m", [1e300, -1e300, 5001.0, -5001.0, 10**400])
def test_heights_have_bounds_and_fit_the_grid(tmp_path, height_m):
    path = tmp_path / "tower.csv"
    path.write_text(f"0,0\n100,{height_m}\n")
    with pytest.raises(InputError):
        terrain.from_file(path)
    with refused(r"terrain\.height_m"):
        Terrain("tower", [height_m] * len(GRID_X_M))
    with refused(r"terrain\.height_m\.shape: \(5,\)"):
        Terrain("short", np.zeros(5))
    with refused(r"terrain\.height_m: nan"):
        Terrain("hole", np.where(GRID_X_M > 10.0, np.nan, 0.0))


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "file"])
@pytest.mark.parametrize("end", ["low", "high"])
def test_every_configurable_ground_is_within_the_bounds(kind, end):
    hints = get_type_hints(KINDS[kind], include_extras=True)
    bounded = {
        name: hint for name, hint in hints.items() if get_origin(hint) is Annotated
    }
    options = {name: getattr(get_args(hint)[1], end) for name, hint in bounded.items()}
    steep = {"spacing_m": 0.1, "run_m": 0.1, "riser_m": 0.05, "flat_start_m": 0.0}
    for others in ({}, steep):
        chosen = options | {
            name: value for name, value in others.items() if name in options
        }
        if "riser_m" in chosen:
            chosen["riser_m"] = min(chosen["riser_m"], chosen["spacing_m"])
        ground = read_ground(Table({"kind": kind, **chosen}, "terrain")).draw(SEED)
        assert np.all(np.abs(ground.height_m) <= terrain.HIGHEST_M)


@pytest.mark.parametrize(
    ("text", "allowed"),
    [
        (text, allowed)
        for allowed, texts in asset("bad-ground-files.toml").items()
        for text in texts
    ],
)
@pytest.mark.filterwarnings("error")
def test_a_file_that_is_no_table_is_refused(tmp_path, text, allowed):
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with refused(allowed) as caught:
        terrain.from_file(path)
    assert caught.value.field == "terrain.file"
    assert str(path) in str(caught.value)
    with refused(allowed):  # an empty one, too, and not one in the working folder
        read_ground(Table({"kind": "file", "file": "bad.csv"}, "terrain", tmp_path))


@pytest.mark.parametrize(("kind", "bad"), asset("bad-ground-options.toml").items())
def test_settings_out_of_range_are_named(kind, bad):
    seed = (1,) if kind in ("rough", "blocks") else ()
    for option, values in bad.items():
        for value in values:
            with refused(rf"^terrain\.{option}: "):
                KINDS[kind](*seed, **{option: value})


@cases("sound-grounds.toml", "kind", "options")
def test_each_kind_is_read(kind, options):
    seed = {"seed": SEED} if kind in ("rough", "blocks") else {}
    expected = KINDS[kind](**seed, **options)
    found = read_ground(Table({"kind": kind, **options}, "terrain")).draw(SEED)
    np.testing.assert_array_equal(found.height_m, expected.height_m)
    assert found.name == expected.name


def test_a_file_lies_beside_the_configuration_and_is_kept_in_the_ground(tmp_path):
    """A result keeps its ground when it is moved, or when the file is gone."""
    (tmp_path / "hill.csv").write_text("x_m,height_m\n0,0\n1,0.5\n")
    (tmp_path / "walk.toml").write_text('[terrain]\nkind = "file"\nfile = "hill.csv"\n')
    ground = read_ground(read_toml(tmp_path / "walk.toml").table("terrain"))
    (tmp_path / "hill.csv").unlink()
    again = read_ground(Table({"kind": ground.kind, **ground.options}, "terrain"))
    assert again == ground
    assert again.draw(SEED).height(2.0) == 0.5
    assert again.draw(SEED).name == "file hill.csv"


@cases("bad-grounds.toml", "kind", "options", "message")
def test_a_bad_terrain_is_named(kind, options, message):
    with refused(rf"^terrain\.{message}"):
        read_ground(Table({"kind": kind, **options}, "terrain"))


@pytest.mark.parametrize("kind", KINDS)
def test_a_configuration_may_contain_the_defaults(kind):
    parameters = signature(KINDS[kind]).parameters.values()
    defaults = {
        p.name: p.default for p in parameters if p.default is not Parameter.empty
    }
    if kind != "file":  # which has no default
        found = read_ground(Table({"kind": kind, **defaults}, "terrain"))
        assert found == Ground(kind, defaults)
        np.testing.assert_array_equal(
            found.draw(1).height_m, Ground(kind).draw(1).height_m
        )


def test_a_ground_is_its_table_as_written_and_keeps_it_when_the_callers_changes():
    table = {"kind": "blocks", "spacing_m": 2, "amplitude_m": 0.05}
    ground = read_ground(Table(table, "terrain"))
    written = {"kind": ground.kind, **ground.options}
    assert written == table and type(written["spacing_m"]) is int
    assert read_ground(Table({}, "terrain")) == Ground("flat", {}) == Ground()
    one = Ground("rough", {"amplitude_m": 0.03, "spacing_m": 2.0})
    same = Ground("rough", {"spacing_m": 2.0, "amplitude_m": 0.03})
    assert one == same and hash(one) == hash(same)
    assert one != Ground("blocks", one.options)
    assert pickle.loads(pickle.dumps(one)) == one
    with refused(r"terrain\.kind: 'lava'"):
        Ground("lava")
    options = {"amplitude_m": 0.03}
    ground = Ground("rough", options)
    options["amplitude_m"] = 0.5
    np.testing.assert_array_equal(
        ground.draw(1).height_m, terrain.rough(1, 0.03).height_m
    )


def test_each_ground_draws_an_option_that_is_a_pair():
    pairs = {"slope": [-0.08, 0.08], "amplitude_m": [0.0, 0.0]}
    ground = read_ground(Table({"kind": "rough", **pairs}, "terrain"))
    slopes = []
    for seed in range(200):
        made = ground.draw(seed)
        slopes.append(float(made.height(59.0) - made.height(9.0)) / 50.0)
        np.testing.assert_array_equal(made.height_m, ground.draw(seed).height_m)
    assert -0.08 <= min(slopes) < -0.07 and 0.07 < max(slopes) <= 0.08
    # Three standard errors of a uniform distribution's mean.
    assert abs(np.mean(slopes)) < 3 * 0.16 / np.sqrt(12 * 200)
    assert len({hash(ground), hash(Ground("rough", {"slope": [-0.08, 0.07]}))}) == 2
    assert pickle.loads(pickle.dumps(ground)) == ground
    # A drawn option changes no other draw.
    level, tilted = (
        Ground("rough", {"slope": [slope] * 2}).draw(3) for slope in (0.0, 0.05)
    )
    np.testing.assert_array_equal(level.height_m, terrain.rough(3).height_m)
    np.testing.assert_allclose(tilted.height_m, terrain.rough(3, slope=0.05).height_m)
    both = Ground("rough", {"slope": [0.0, 0.1], "spacing_m": [1.0, 2.0]}).draw(3)
    one = Ground("rough", {"slope": [0.0, 0.1]}).draw(3)
    assert both.name.rpartition(", ")[2] == one.name.rpartition(", ")[2]  # the slope
    stairs = Ground("stairs", {"rise_m": [0.1, 0.9], "run_m": [0.1, 0.9]}).draw(3)
    rise, run = stairs.name.split()[2::3]
    assert rise != run  # each option has a stream of its own
