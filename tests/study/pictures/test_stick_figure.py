"""Joints and muscles are drawn where the pose has them; the shown part of a walk."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.image import imread

from study.pictures import stick_figure, style
from study.pictures.scene import motion_of
from study.pictures.stick_figure import (
    LEFT,
    RIGHT,
    finite,
    leg,
    muscle_outlines,
)
from study.pictures.strip import SHOWN_M, Shown, last_stretch, write_strip
from taichi_nmm import PUBLISHED_GAINS, Prosthesis, WorldRanges, simulate
from taichi_nmm.result import MUSCLES
from taichi_nmm.terrain import flat
from tests.cases import refused
from tests.study.synthetic_gait import GLIMPSE, SPEED_MPS, WALK

TURNS = [(3, "knee", (-1, 1)), (4, "ankle", (-1, 1)), (5, "ball", (-1, -1))]


def test_standing_upright_is_drawn_upright():
    q = np.array([2.0, 1.0, 0, 0, 0, 0, 0, 0, 0])
    shoulder, head = stick_figure.trunk(q)
    expected = [[2.0, 1.0], [2.0, 0.5], [2.0, 0.0], [1.96, 0.0], [2.16, 0.0]]
    np.testing.assert_allclose(leg(q, 0).chain(), expected, atol=1e-12)
    np.testing.assert_allclose(shoulder, [2.0, 1.5])
    assert head[1] > shoulder[1]


@pytest.mark.parametrize(("column", "point", "moves"), TURNS)
def test_positive_angles_turn_clockwise(column, point, moves):
    q = np.zeros(9)
    before = getattr(leg(q, 0), point)
    q[column] = 0.3
    assert tuple(np.sign(getattr(leg(q, 0), point) - before)) == moves


def test_muscles_lie_along_their_bones():
    standing = np.array([0, 1.0, 0, 0, 0, 0, 0, 0, 0])
    outlines = dict(zip(MUSCLES, muscle_outlines(standing, 1), strict=True))
    assert outlines["TA"][:, 0].max() > 0 > outlines["SOL"][:, 0].min()
    assert outlines["VAS"][:, 0].max() > 0 > outlines["HAM"][:, 0].min()
    assert outlines["HFL"][:, 1].min() > 0.8 and outlines["SOL"][:, 1].max() < 0.5
    assert all(np.isfinite(outline).all() for outline in outlines.values())


def poses_of(walk):
    return last_stretch(Shown("", "", walk), flat(), "black").poses_s


def test_the_end_of_the_walk_is_shown():
    poses_s = poses_of(WALK)
    assert poses_s[-1] == WALK.time_s[-1]
    assert np.ptp(poses_s) == pytest.approx(SHOWN_M / SPEED_MPS, abs=0.03)
    assert poses_of(GLIMPSE).tolist() == [GLIMPSE.time_s[0], GLIMPSE.time_s[-1]]
    assert np.ptp(motion_of(WALK, flat(), 2.0, 20).time_s) == pytest.approx(2.0)
    assert motion_of(GLIMPSE, flat(), 2.0, 20).time_s[0] == GLIMPSE.time_s[0]
    q = WALK.q.copy()
    q[700:, 3] = np.nan
    shown = finite(replace(WALK, q=q))
    assert len(shown.time_s) == len(shown.q) == len(shown.activation) == 700
    with refused("no finite sample"):
        finite(replace(WALK, q=np.full_like(q, np.nan)))


class Drawn:
    """A surface that keeps its bones, by colour."""

    def __init__(self):
        self.kept: dict[str, list[stick_figure.Bone]] = {}
        self.bellies: list[int] = []  # of each leg

    def bones(self, parts, colour):
        self.kept.setdefault(colour, []).extend(parts)

    def muscles(self, outlines, activation, edge):
        assert len(outlines) == len(activation)
        self.bellies.append(len(outlines))

    def disc(self, centre_m, radius_m, colour):
        """Not kept."""

    def joints(self, points_m):
        """Not kept."""


def test_an_arrow_turns_clockwise_and_is_as_long_as_its_torque():
    torques_nm = np.array([0.0, 1.0, 20.0, 40.0, 80.0, -40.0])
    middle = np.tile([0.0, 2.0], (6, 1))
    arrows = stick_figure.torque_arrows(np.zeros((6, 2)), middle, torques_nm)
    assert np.isnan(arrows[:2]).all()
    for torque_nm, line in zip(torques_nm[2:], arrows[2:], strict=True):
        points = line[: stick_figure.ARC_POINTS]  # without its tip
        angles = np.unwrap(np.arctan2(points[:, 0], points[:, 1]))  # clockwise from up
        assert np.ptp(angles) == pytest.approx(3.0 * abs(torque_nm) / 80.0)
        assert np.sign(angles[-1] - angles[0]) == np.sign(torque_nm)
        assert angles.mean() == pytest.approx(0.0, abs=1e-9)
        assert np.hypot(*points.T) == pytest.approx(stick_figure.ARC_RADIUS_M)


def test_a_device_is_drawn_where_it_turns_a_joint():
    times_s = WALK.time_s[100:103]
    assert stick_figure.device_at(WALK, times_s) is None
    torque_nm = np.zeros((len(WALK.time_s), 6))
    torque_nm[100, 2] = 40.0  # the left ankle, at one moment
    device = stick_figure.device_at(replace(WALK, device_torque_nm=torque_nm), times_s)
    struts, arrows = (
        np.isfinite(lines).all(axis=(2, 3)) for lines in vars(device).values()
    )
    assert struts.tolist() == 3 * [[False] * 4 + [True] * 2 + [False] * 6]
    assert np.argwhere(arrows).tolist() == [[0, 2]]
    surface = Drawn()
    poses = WALK.q[100:101], WALK.activation[100:101]
    stick_figure.Walker(*poses, device).draw(surface, 0)
    ankle = leg(WALK.q[100], LEFT).ankle
    for bones in (surface.kept[style.DEVICE], surface.kept[style.TORQUE]):
        ends = np.array([end for *both, _ in bones for end in both])
        assert np.hypot(*(ends - ankle).T).max() < 0.35
    limbs = {style.NEAR_LIMB, style.FAR_LIMB}
    assert surface.kept.keys() - limbs == {style.DEVICE, style.TORQUE}


def test_a_prosthesis_takes_the_place_of_shank_foot_and_their_muscles():
    for prosthesis, bellies in (((False, False), [7, 7]), ((False, True), [4, 7])):
        surface = Drawn()
        poses = WALK.q[100:101], WALK.activation[100:101]
        stick_figure.Walker(*poses, prosthesis=prosthesis).draw(surface, 0)
        assert surface.bellies == bellies  # the far leg, which is the right one, first
    joints = leg(WALK.q[100], RIGHT)
    pylon, foot = surface.kept[style.DEVICE]
    np.testing.assert_allclose(
        pylon[:2], [0.5 * (joints.knee + joints.ankle), joints.ankle]
    )
    np.testing.assert_allclose(foot[:2], [joints.heel, joints.ball])
    _, shank = surface.kept[style.FAR_LIMB]
    np.testing.assert_allclose(shank[:2], [joints.knee, pylon[0]])


def test_a_strip_of_a_walker_with_a_prosthesis_has_it_in_its_colour(tmp_path):
    worlds = WorldRanges(prosthesis=Prosthesis("right", 350.0, 1.0)).draw([0])
    words = {"duration_s": 1.0, "record": [0], "worlds": worlds}
    trajectory = simulate(PUBLISHED_GAINS, **words).trajectories[0]
    assert trajectory.prosthesis.tolist() == [False, True]
    assert finite(trajectory).prosthesis.tolist() == [False, True]
    green = np.array([0x26, 0x59, 0x4C])
    found = []
    for without in (trajectory, replace(trajectory, prosthesis=np.zeros(2, bool))):
        picture = imread(write_strip(tmp_path / "strip.png", without, flat()))
        found.append((np.abs(255 * picture[..., :3] - green) < 8).all(axis=-1).sum())
    assert found[0] > 200 and found[1] == 0
