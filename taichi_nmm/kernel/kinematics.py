"""Where everything is: directions of the links, contact points, joint angles, leg angle and length.

World x forward, z up; all angles clockwise positive. Thigh and shank point along D(th)
= (-sin th, -cos th) from their proximal joint, the foot along F(th) = (cos th, -sin
th).
"""

from taichi_nmm.body import BALL_OFFSET_M, HEEL_OFFSET_M, SHANK_LENGTH_M, THIGH_LENGTH_M
from taichi_nmm.kernel.backend import Rows, Static, ti
from taichi_nmm.kernel.elementary import (
    HALF_PI,
    arctangent2,
    sine_cosine,
    square_root,
)
from taichi_nmm.kernel.layout import LEGS, SEGMENT_COUNT


@ti.func
def directions(lane, state: Rows, work: Rows):
    """Sine and cosine of the seven segment angles."""
    for i in ti.static(range(SEGMENT_COUNT)):
        s, c = sine_cosine(state.q[2 + i, lane])
        work.sine[i, lane] = s
        work.cosine[i, lane] = c


@ti.func
def slope_vector(lane, i: Static, work: Rows):
    """e_i, the derivative of link i's direction; feet (3, 6) lie a quarter turn ahead."""
    s, c = work.sine[i, lane], work.cosine[i, lane]
    x = 0.0 - c
    z = s
    if ti.static(i in (3, 6)):
        x = 0.0 - s
        z = 0.0 - c
    return x, z


@ti.func
def contact_points(lane, state: Rows, work: Rows):
    """Positions of ankles, heels and balls in the world, and each leg's length and angle.

    They are those of the line hip - ankle; 90 deg is vertical, less is in front of the
    hip.
    """
    for leg in ti.static(range(LEGS)):
        thigh, shank, foot = ti.static(1 + 3 * leg, 2 + 3 * leg, 3 + 3 * leg)
        ankle_x = (
            state.q[0, lane]
            - THIGH_LENGTH_M * work.sine[thigh, lane]
            - SHANK_LENGTH_M * work.sine[shank, lane]
        )
        ankle_z = (
            state.q[1, lane]
            - THIGH_LENGTH_M * work.cosine[thigh, lane]
            - SHANK_LENGTH_M * work.cosine[shank, lane]
        )
        work.ankle_x[leg, lane] = ankle_x
        dx, dz = state.q[0, lane] - ankle_x, state.q[1, lane] - ankle_z
        work.leg_length[leg, lane] = square_root(dx * dx + dz * dz)
        work.leg_angle[leg, lane] = 2.0 * HALF_PI - arctangent2(dz, dx)
        for end in ti.static(range(2)):
            offset = ti.static((HEEL_OFFSET_M, BALL_OFFSET_M)[end])
            work.point_x[2 * leg + end, lane] = (
                ankle_x + offset * work.cosine[foot, lane]
            )
            work.point_z[2 * leg + end, lane] = ankle_z - offset * work.sine[foot, lane]


@ti.func
def joints(lane, state: Rows, work: Rows):
    """Joint angles (child minus parent), their rates, and sine and cosine of knee and ankle."""
    for leg in ti.static(range(LEGS)):
        for joint in ti.static(range(3)):
            child = ti.static(1 + 3 * leg + joint)
            parent = ti.static(0 if joint == 0 else child - 1)
            work.joint[3 * leg + joint, lane] = (
                state.q[2 + child, lane] - state.q[2 + parent, lane]
            )
            work.joint_rate[3 * leg + joint, lane] = (
                state.qdot[2 + child, lane] - state.qdot[2 + parent, lane]
            )
            if ti.static(joint > 0):
                sc, cc = work.sine[child, lane], work.cosine[child, lane]
                sp, cp = (
                    work.sine[parent, lane],
                    work.cosine[parent, lane],
                )
                row = ti.static(2 * leg + joint - 1)
                work.sine_joint[row, lane] = sc * cp - cc * sp
                work.cosine_joint[row, lane] = cc * cp + sc * sp


@ti.func
def centre_of_mass(lane, state: Rows, const: Rows, work: Rows):
    """Position of the whole body's centre of mass, and its forward velocity."""
    # Of the direction d of a link, of which e is the slope: d = (-e_z, e_x).
    e0x, e0z = slope_vector(lane, 0, work)
    x = const.a_hat[lane] * (0.0 - e0z)
    z = const.a_hat[lane] * e0x
    v = const.a_hat[lane] * (e0x * state.qdot[2, lane])
    for leg in ti.static(range(LEGS)):
        for link in ti.static(range(3)):
            i = ti.static(1 + 3 * leg + link)
            a = const.a_leg[3 * leg + link, lane]
            ex, ez = slope_vector(lane, i, work)
            x -= a * ez
            z += a * ex
            v += a * ex * state.qdot[2 + i, lane]
    mass = const.total_mass[lane]
    work.com_x[lane] = state.q[0, lane] + x / mass
    work.com_z[lane] = state.q[1, lane] + z / mass
    work.com_speed[lane] = state.qdot[0, lane] + v / mass
