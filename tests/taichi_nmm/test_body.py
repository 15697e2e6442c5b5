"""Segments against the table of Geyer & Herr, and bodies drawn round them."""

import numpy as np
import pytest
from numpy.typing import NDArray

from taichi_nmm import body
from taichi_nmm.body import SEGMENT_NAMES, SEGMENTS, Bodies
from taichi_nmm.errors import InputError

LENGTH_M = np.array([segment.length_m for segment in SEGMENTS])


def test_segments_are_those_of_the_publication() -> None:
    table = {s.name: (s.mass_kg, s.inertia_kgm2, s.length_m, s.com_m) for s in SEGMENTS}
    assert table == {
        "hat": (53.5, 3.0, 0.80, 0.35),
        "thigh": (8.5, 0.15, 0.50, 0.20),
        "shank": (3.5, 0.05, 0.50, 0.20),
        "foot": (1.25, 0.005, 0.20, 0.02),
    }


def test_segments_go_down_the_left_leg_then_the_right() -> None:
    assert [name.split("_")[0] for name in SEGMENT_NAMES] == [s.name for s in SEGMENTS]
    assert SEGMENT_NAMES[1:4] == ("thigh_l", "shank_l", "foot_l")
    assert SEGMENT_NAMES[4:] == ("thigh_r", "shank_r", "foot_r")


def test_the_nominal_body_weighs_80_kg() -> None:
    bodies = Bodies.nominal(3)
    assert len(bodies) == 3
    np.testing.assert_allclose(bodies.mass_kg.sum(axis=1), 80.0)


def test_the_foot_reaches_from_heel_to_ball() -> None:
    length_m = body.BALL_OFFSET_M - body.HEEL_OFFSET_M
    assert length_m == pytest.approx(body.FOOT.length_m)
    assert body.BALL_OFFSET_M - body.FOOT.com_m == pytest.approx(0.14)


def relative_disturbances(bodies: Bodies) -> NDArray[np.float64]:
    """Of mass, inertia and centre of mass (in half lengths), [3, n, 7]."""
    nominal = Bodies.nominal(len(bodies))
    return np.array(
        [
            bodies.mass_kg / nominal.mass_kg - 1,
            bodies.inertia_kgm2 / nominal.inertia_kgm2 - 1,
            (bodies.com_m - nominal.com_m) / (0.5 * LENGTH_M),
        ]
    )


@pytest.mark.parametrize("fraction", [0.15, 0.05])
def test_disturbances_fill_their_range(fraction: float) -> None:
    disturbance = relative_disturbances(Bodies.disturbed(range(2000), fraction))
    assert np.max(np.abs(disturbance)) <= fraction * (1 + 1e-12)
    assert np.all(np.max(disturbance, axis=1) > 0.95 * fraction)
    assert np.all(np.min(disturbance, axis=1) < -0.95 * fraction)
    assert np.max(np.abs(np.mean(disturbance, axis=1))) < 0.05 * fraction


def test_disturbances_are_independent_of_each_other() -> None:
    columns = relative_disturbances(Bodies.disturbed(range(2000))).transpose(0, 2, 1)
    correlation = np.corrcoef(columns.reshape(21, 2000)) - np.eye(21)
    assert np.max(np.abs(correlation)) < 0.1  # 4.5 standard errors


def test_a_seed_makes_one_body_whatever_the_batch() -> None:
    batch = Bodies.disturbed([4, 5, np.random.SeedSequence(6)])
    for row, seed in enumerate([4, 5, 6]):
        alone = Bodies.disturbed([seed])
        np.testing.assert_array_equal(alone.mass_kg[0], batch.mass_kg[row])
        np.testing.assert_array_equal(alone.inertia_kgm2[0], batch.inertia_kgm2[row])
        np.testing.assert_array_equal(alone.com_m[0], batch.com_m[row])


def test_no_disturbance_and_no_seed_are_allowed() -> None:
    np.testing.assert_array_equal(Bodies.disturbed([1], 0.0).mass_kg, Bodies.nominal().mass_kg)
    assert len(Bodies.disturbed([])) == 0


def test_take_repeats_and_reorders() -> None:
    bodies = Bodies.disturbed(range(4))
    taken = bodies.take([2, 0, 2])
    np.testing.assert_array_equal(taken.com_m, bodies.com_m[[2, 0, 2]])
    np.testing.assert_array_equal(taken.mass_kg, bodies.mass_kg[[2, 0, 2]])
    np.testing.assert_array_equal(taken.inertia_kgm2, bodies.inertia_kgm2[[2, 0, 2]])


@pytest.mark.parametrize("fraction", [-0.01, 1.0, np.nan])
def test_a_disturbance_out_of_range_is_named(fraction: float) -> None:
    with pytest.raises(InputError, match=r"body\.disturbance"):
        Bodies.disturbed([1], fraction)


def arrays() -> dict[str, NDArray[np.float64]]:
    nominal = Bodies.nominal(2)
    return {
        "mass_kg": nominal.mass_kg,
        "inertia_kgm2": nominal.inertia_kgm2,
        "com_m": nominal.com_m,
    }


@pytest.mark.parametrize("name", ["mass_kg", "inertia_kgm2", "com_m"])
def test_wrong_shapes_are_named(name: str) -> None:
    with pytest.raises(InputError, match=rf"bodies\.{name}\.shape"):
        Bodies(**{**arrays(), name: np.ones((2, 6))})


@pytest.mark.parametrize("name", ["mass_kg", "inertia_kgm2", "com_m"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_numbers_that_are_not_finite_are_named(name: str, value: float) -> None:
    values = arrays()
    values[name][1, 3] = value
    with pytest.raises(InputError, match=rf"bodies\.{name}\b"):
        Bodies(**values)


@pytest.mark.parametrize("name", ["mass_kg", "inertia_kgm2"])
@pytest.mark.parametrize("value", [0.0, -1.0])
def test_masses_and_inertias_must_be_positive(name: str, value: float) -> None:
    values = arrays()
    values[name][0, 6] = value
    with pytest.raises(InputError, match=rf"bodies\.{name}\b.*positive"):
        Bodies(**values)


def test_a_centre_of_mass_may_lie_behind_its_joint() -> None:
    values = arrays()
    values["com_m"][0, 3] = -0.01
    assert Bodies(**values).com_m[0, 3] == -0.01


def test_arrays_of_different_length_are_refused() -> None:
    with pytest.raises(InputError, match="bodies: 'arrays of different length'"):
        Bodies(**{**arrays(), "com_m": np.ones((3, 7))})


def test_what_is_no_number_is_refused() -> None:
    with pytest.raises(InputError, match=r"bodies\.mass_kg"):
        Bodies(**{**arrays(), "mass_kg": [["heavy"] * 7] * 2})  # type: ignore[arg-type]
