"""Segments against the table of Geyer & Herr, and bodies drawn round them."""

import numpy as np
import pytest

from storage.inputs.config import Table
from taichi_nmm import body
from taichi_nmm.body import SEGMENT_NAMES, SEGMENTS, Bodies, Build, read_body
from tests.cases import cases, refused

LENGTH_M = np.array([segment.length_m for segment in SEGMENTS])
NAMES = ("mass_kg", "inertia_kgm2", "com_m")


def test_segments_are_those_of_the_publication_in_order_and_weigh_80_kg():
    table = {s.name: (s.mass_kg, s.inertia_kgm2, s.length_m, s.com_m) for s in SEGMENTS}
    assert table == {
        "hat": (53.5, 3.0, 0.80, 0.35),
        "thigh": (8.5, 0.15, 0.50, 0.20),
        "shank": (3.5, 0.05, 0.50, 0.20),
        "foot": (1.25, 0.005, 0.20, 0.02),
    }
    assert [name.split("_")[0] for name in SEGMENT_NAMES] == [s.name for s in SEGMENTS]
    assert SEGMENT_NAMES[1:4] == ("thigh_l", "shank_l", "foot_l")
    assert SEGMENT_NAMES[4:] == ("thigh_r", "shank_r", "foot_r")
    bodies = Bodies.nominal(3)
    assert len(bodies) == 3
    np.testing.assert_allclose(bodies.mass_kg.sum(axis=1), 80.0)
    length_m = body.BALL_OFFSET_M - body.HEEL_OFFSET_M
    assert length_m == pytest.approx(body.FOOT.length_m)
    assert body.BALL_OFFSET_M - body.FOOT.com_m == pytest.approx(0.14)
    with pytest.raises(AttributeError):  # a body that was checked stays as it is
        bodies.mass_kg = bodies.mass_kg


def relative_disturbances(bodies):
    """Of mass, inertia and centre of mass (in half lengths), [3, n, 7]."""
    nominal = Bodies.nominal(len(bodies))
    mass, inertia = (
        getattr(bodies, name) / getattr(nominal, name) - 1 for name in NAMES[:2]
    )
    return np.array([mass, inertia, (bodies.com_m - nominal.com_m) / (0.5 * LENGTH_M)])


@pytest.mark.parametrize("fraction", [0.15, 0.05])
def test_disturbances_fill_their_range(fraction):
    disturbance = relative_disturbances(Bodies.disturbed(range(2000), fraction))
    assert np.max(np.abs(disturbance)) <= fraction * (1 + 1e-12)
    assert np.all(np.max(disturbance, axis=1) > 0.95 * fraction)
    assert np.all(np.min(disturbance, axis=1) < -0.95 * fraction)
    assert np.max(np.abs(np.mean(disturbance, axis=1))) < 0.05 * fraction


def test_disturbances_are_independent_of_each_other():
    columns = relative_disturbances(Bodies.disturbed(range(2000))).transpose(0, 2, 1)
    correlation = np.corrcoef(columns.reshape(21, 2000)) - np.eye(21)
    assert np.max(np.abs(correlation)) < 0.1  # 4.5 standard errors


def test_a_seed_makes_one_body_whatever_the_batch_and_take_reorders():
    batch = Bodies.disturbed([4, 5, np.random.SeedSequence(6)])
    for row, seed in enumerate([4, 5, 6]):
        for name, values in vars(Bodies.disturbed([seed])).items():
            np.testing.assert_array_equal(values[0], getattr(batch, name)[row])
    np.testing.assert_array_equal(
        Bodies.disturbed([1], 0.0).mass_kg, Bodies.nominal().mass_kg
    )
    assert len(Bodies.disturbed([])) == 0
    bodies = Bodies.disturbed(range(4))
    for name, values in vars(bodies.take([2, 0, 2])).items():
        np.testing.assert_array_equal(values, getattr(bodies, name)[[2, 0, 2]])


@pytest.mark.parametrize("fraction", [-0.01, 1.0, np.nan])
def test_a_disturbance_out_of_range_is_named(fraction):
    with refused(r"body\.disturbance"):
        Bodies.disturbed([1], fraction)


def nominal_but(row, segment, value):
    """Masses (or inertias, or centres of mass) of two bodies, but for one."""
    values = np.ones((2, 7))
    values[row, segment] = value
    return values


@pytest.mark.parametrize(
    ("names", "value", "message"),
    [
        (NAMES, np.ones((2, 6)), r"bodies\.NAME\.shape"),
        (NAMES, nominal_but(1, 3, np.nan), r"bodies\.NAME: nan"),
        (NAMES, nominal_but(1, 3, np.inf), r"bodies\.NAME: inf"),
        (NAMES[:2], nominal_but(0, 6, 0.0), r"bodies\.NAME\b.*positive"),
        (NAMES[:2], nominal_but(0, 6, -1.0), r"bodies\.NAME\b.*positive"),
        (NAMES, np.ones((3, 7)), "bodies: 'arrays of different length'"),
        (NAMES, [["heavy"] * 7] * 2, r"bodies\.NAME"),
    ],
)
def test_arrays_of_no_use_are_named(names, value, message):
    for name in names:
        with refused(f"^{message.replace('NAME', name)}"):
            Bodies(**{**vars(Bodies.nominal(2)), name: value})
    # But a centre of mass may lie behind its joint.
    behind = nominal_but(0, 3, -0.01)
    assert Bodies(**{**vars(Bodies.nominal(2)), "com_m": behind}).com_m[0, 3] == -0.01


def test_a_build_of_other_masses_is_drawn_and_read_back():
    """The narrowest name counts; an inertia that is not named grows with its mass."""
    mass = {"all": 1.2, "shank": 1.1, "foot_left": 0.5}
    build = read_body(
        Table({"disturbance": 0.1, "mass": mass, "inertia": {"hat": 2.0}}, "body")
    )
    assert build.mass == (1.2, 1.2, 1.1, 0.5, 1.2, 1.1, 1.2)
    assert build.inertia == (2.0, *build.mass[1:])
    drawn, plain = build.draw([5]), Bodies.disturbed([5], 0.1)
    np.testing.assert_allclose(drawn.mass_kg / plain.mass_kg, [build.mass])
    np.testing.assert_allclose(drawn.inertia_kgm2 / plain.inertia_kgm2, [build.inertia])
    np.testing.assert_array_equal(drawn.com_m, plain.com_m)
    for each in (
        build,
        Build(),
        Build(0.1, build.mass, build.mass),
        Build(inertia=build.mass),
    ):
        assert read_body(Table(each.document(), "body")) == each
    # What is not said changes no digest.
    assert Build(0.15).document() == {"disturbance": 0.15}


@cases("bad-bodies.toml", "table", "message")
def test_builds_that_the_model_does_not_have_are_refused(table, message):
    with refused(message):
        read_body(Table(table, "body"))
