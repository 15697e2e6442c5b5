"""Equations of motion of the seven links, and their linearly implicit step with contacts and stops.

The mass matrix is an arrow: base (x, z), HAT, and two legs of three links that touch
only the base. Contacts and joint stops keep that form, so one step is two 3x3
factorisations and a 2x2 solve. With d_i the direction of link i and e_i = dd_i/dth_i:
M[xz, i] = A_i e_i, M[i, j] = B_ij e_i.e_j.
"""

from taichi_nmm.body import (
    BALL_OFFSET_M,
    GRAVITY_MPS2,
    HEEL_OFFSET_M,
    SHANK_LENGTH_M,
    THIGH_LENGTH_M,
)
from taichi_nmm.kernel.backend import Rows, Static, ti
from taichi_nmm.kernel.elementary import (
    FIRST_FACTOR,
    INCREMENT,
    TICK_FACTOR,
    larger,
    uniform,
)
from taichi_nmm.kernel.kinematics import slope_vector
from taichi_nmm.kernel.layout import (
    CONTACTS,
    COORDINATES,
    LEGS,
    STOPS,
    Layout,
    Signal,
)
from taichi_nmm.settings import CONTROL_TICK_S

# A leg's equations: m11, m22, m33, m12, m13, m23, coupling to the base in x, in z,
# right-hand side. They and the base's are local vectors, which the compiler keeps in
# registers: `layout.Work` is memory.
Leg = Layout(inertia=6, coupling=6, rhs=3)

CATCH_S = 0.02  # ours: short beside a swing of 0.4 s
CATCH_EVERY_S = 1.0  # of a leg; ours, about a stride (published gains: 1.14 s)
CATCH_TICKS, CATCH_EVERY_TICKS = (
    round(t / CONTROL_TICK_S) for t in (CATCH_S, CATCH_EVERY_S)
)
FIRST_CATCH_WORD = Signal.count + 1  # of the hash: after those of the noise


@ti.func
def leg_slopes(lane, leg: Static, work: Rows):
    """The vectors e of a leg's thigh, shank and foot: x1, z1, x2, z2, x3, z3."""
    x1, z1 = slope_vector(lane, 1 + 3 * leg, work)
    x2, z2 = slope_vector(lane, 2 + 3 * leg, work)
    x3, z3 = slope_vector(lane, 3 + 3 * leg, work)
    return x1, z1, x2, z2, x3, z3


@ti.func
def leg_inertia(lane, leg: Static, const: Rows, work: Rows):
    """B_ij e_i.e_j of a leg: m11, m22, m33, m12, m13, m23."""
    b = ti.static(6 * leg)
    x1, z1, x2, z2, x3, z3 = leg_slopes(lane, leg, work)
    return (
        const.b_leg[b + 0, lane],
        const.b_leg[b + 1, lane],
        const.b_leg[b + 2, lane],
        const.b_leg[b + 3, lane] * (x1 * x2 + z1 * z2),
        const.b_leg[b + 4, lane] * (x1 * x3 + z1 * z3),
        const.b_leg[b + 5, lane] * (x2 * x3 + z2 * z3),
    )


@ti.func
def momentum_after_free_step(
    lane, step_s, mass_scale, state: Rows, const: Rows, work: Rows
):
    """momentum = mass_scale M qdot + step Q: gravity, centrifugal terms and joint torques.

    (1, h) gives the right-hand side of a step; (0, 1) the generalised forces alone.
    """
    vx, vz, w0 = state.qdot[0, lane], state.qdot[1, lane], state.qdot[2, lane]
    mass = const.total_mass[lane]
    a0, b0 = const.a_hat[lane], const.b_hat[lane]
    e0x, e0z = slope_vector(lane, 0, work)
    # d is e turned back a quarter: d = (-e_z, e_x).
    force_x = 0.0 - a0 * e0z * w0 * w0
    force_z = a0 * e0x * w0 * w0 - mass * GRAVITY_MPS2
    base_x = mass * vx + a0 * e0x * w0
    base_z = mass * vz + a0 * e0z * w0
    torque_0 = 0.0 - GRAVITY_MPS2 * a0 * e0z
    for leg in ti.static(range(LEGS)):
        hip, knee, ankle = ti.static(3 * leg, 3 * leg + 1, 3 * leg + 2)
        w1 = state.qdot[3 + hip, lane]
        w2 = state.qdot[3 + knee, lane]
        w3 = state.qdot[3 + ankle, lane]
        x1, z1, x2, z2, x3, z3 = leg_slopes(lane, leg, work)
        a1 = const.a_leg[hip, lane]
        a2 = const.a_leg[knee, lane]
        a3 = const.a_leg[ankle, lane]
        base_x += a1 * x1 * w1 + a2 * x2 * w2 + a3 * x3 * w3
        base_z += a1 * z1 * w1 + a2 * z2 * w2 + a3 * z3 * w3
        force_x -= a1 * z1 * w1 * w1 + a2 * z2 * w2 * w2 + a3 * z3 * w3 * w3
        force_z += a1 * x1 * w1 * w1 + a2 * x2 * w2 * w2 + a3 * x3 * w3 * w3
        b = ti.static(6 * leg)
        cross_12 = const.b_leg[b + 3, lane] * (z1 * x2 - x1 * z2)  # B12 e1.d2
        cross_13 = const.b_leg[b + 4, lane] * (z1 * x3 - x1 * z3)
        cross_23 = const.b_leg[b + 5, lane] * (z2 * x3 - x2 * z3)
        hip_torque = work.joint_torque[hip, lane]
        knee_torque = work.joint_torque[knee, lane]
        ankle_torque = work.joint_torque[ankle, lane]
        torque_0 -= hip_torque
        torque_1 = (
            cross_12 * w2 * w2
            + cross_13 * w3 * w3
            - GRAVITY_MPS2 * a1 * z1
            + hip_torque
            - knee_torque
        )
        torque_2 = (
            cross_23 * w3 * w3
            - cross_12 * w1 * w1
            - GRAVITY_MPS2 * a2 * z2
            + knee_torque
            - ankle_torque
        )
        torque_3 = (
            0.0
            - cross_13 * w1 * w1
            - cross_23 * w2 * w2
            - GRAVITY_MPS2 * a3 * z3
            + ankle_torque
        )
        m11, m22, m33, m12, m13, m23 = leg_inertia(lane, leg, const, work)
        work.momentum[3 + hip, lane] = step_s * torque_1 + mass_scale * (
            a1 * (x1 * vx + z1 * vz) + m11 * w1 + m12 * w2 + m13 * w3
        )
        work.momentum[3 + knee, lane] = step_s * torque_2 + mass_scale * (
            a2 * (x2 * vx + z2 * vz) + m12 * w1 + m22 * w2 + m23 * w3
        )
        work.momentum[3 + ankle, lane] = step_s * torque_3 + mass_scale * (
            a3 * (x3 * vx + z3 * vz) + m13 * w1 + m23 * w2 + m33 * w3
        )
    work.momentum[0, lane] = mass_scale * base_x + step_s * force_x
    work.momentum[1, lane] = mass_scale * base_z + step_s * force_z
    work.momentum[2, lane] = step_s * torque_0 + mass_scale * (
        a0 * (e0x * vx + e0z * vz) + b0 * w0
    )


@ti.func
def catch_feet(lane, tick, step_s, const: Rows, work: Rows):
    """Add what holds the feet back at this tick to the momentum: step J^T f, as in `add_foot`.

    Time is cut into slots. In each, each leg catches once, wholly within: when, and
    which share of the largest impulse pulls its ball backwards, are hashes of walker,
    slot and leg.
    """
    slot = tick // CATCH_EVERY_TICKS
    within = ti.cast(tick - CATCH_EVERY_TICKS * slot, float)
    largest = const.catch_ns[lane] / CATCH_S  # N
    walker = ti.cast(const.noise_seed[lane], ti.u32)
    start = ti.cast(slot, ti.u32) * ti.u32(TICK_FACTOR) + walker * ti.u32(FIRST_FACTOR)
    for leg in ti.static(range(LEGS)):
        word = ti.static(FIRST_CATCH_WORD + 2 * leg)
        when = 0.5 + 0.5 * uniform(start + ti.u32(INCREMENT * word % 2**32))
        share = 0.5 + 0.5 * uniform(start + ti.u32(INCREMENT * (word + 1) % 2**32))
        since = within - ti.floor(when * (CATCH_EVERY_TICKS - CATCH_TICKS + 1.0))
        caught = (since >= 0.0) & (since < CATCH_TICKS)
        impulse = step_s * ti.select(caught, 0.0 - share * largest, 0.0)
        work.momentum[0, lane] += impulse
        for i in ti.static(range(3)):
            lever = ti.static((THIGH_LENGTH_M, SHANK_LENGTH_M, BALL_OFFSET_M)[i])
            x, _ = slope_vector(lane, 1 + 3 * leg + i, work)
            work.momentum[3 + 3 * leg + i, lane] += impulse * lever * x


@ti.func
def push_trunk(lane, tick, step_s, const: Rows, work: Rows):
    """Add a push at the trunk's centre of mass to the momentum; other friction while feet slip.

    Both last from their first tick to the one before their end.
    """
    now = ti.cast(tick, float)
    pushed = (now >= const.push_begin[lane]) & (now < const.push_end[lane])
    impulse = step_s * ti.select(pushed, const.push_n[lane], 0.0)
    # A of the trunk over its mass: how far its centre of mass is along d.
    lever = const.a_hat[lane] * GRAVITY_MPS2 / const.hat_weight[lane]
    x, _ = slope_vector(lane, 0, work)
    work.momentum[0, lane] += impulse
    work.momentum[2, lane] += impulse * lever * x
    slips = (now >= const.slip_begin[lane]) & (now < const.slip_end[lane])
    work.grip[lane] = ti.select(slips, const.slip_friction[lane], work.grip[lane])


@ti.func
def solve(lane, step_s, const: Rows, work: Rows):
    """New velocities: (M + h sum J^T C J) v = momentum + h sum J^T f0, over the active contacts.

    HAT and legs are eliminated one after another (Schur complement), which leaves two
    equations in the base's velocity; the rest follows from it.
    """
    base = without_hat(lane, const, work)
    left = eliminate_leg(lane, 0, step_s, base, const, work)
    right = eliminate_leg(lane, 1, step_s, base, const, work)
    hxx, hxz, hzz, px, pz = base[0], base[1], base[2], base[3], base[4]
    inverse_determinant = 1.0 / (hxx * hzz - hxz * hxz)
    vx = (px * hzz - pz * hxz) * inverse_determinant
    vz = (pz * hxx - px * hxz) * inverse_determinant
    e0x, e0z = slope_vector(lane, 0, work)
    coupling = const.a_hat[lane] * (e0x * vx + e0z * vz)
    work.new_qdot[0, lane] = vx
    work.new_qdot[1, lane] = vz
    work.new_qdot[2, lane] = (work.momentum[2, lane] - coupling) / const.b_hat[lane]
    for i in ti.static(range(3)):
        work.new_qdot[3 + i, lane] = left[6 + i] - left[i] * vx - left[3 + i] * vz
        work.new_qdot[6 + i, lane] = right[6 + i] - right[i] * vx - right[3 + i] * vz


@ti.func
def without_hat(lane, const: Rows, work: Rows):
    """The base's equations hxx, hxz, hzz, px, pz once the HAT is eliminated."""
    a0, mass = const.a_hat[lane], const.total_mass[lane]
    e0x, e0z = slope_vector(lane, 0, work)
    k = a0 / const.b_hat[lane]
    p0 = work.momentum[2, lane]
    return ti.Vector(
        [
            mass - k * a0 * e0x * e0x,
            0.0 - k * a0 * e0x * e0z,
            mass - k * a0 * e0z * e0z,
            work.momentum[0, lane] - k * e0x * p0,
            work.momentum[1, lane] - k * e0z * p0,
        ]
    )


@ti.func
def in_the_air(lane, leg: Static, const: Rows, work: Rows):
    """A leg's equations without contacts and stops."""
    m11, m22, m33, m12, m13, m23 = leg_inertia(lane, leg, const, work)
    x1, z1, x2, z2, x3, z3 = leg_slopes(lane, leg, work)
    hip, knee, ankle = ti.static(3 * leg, 3 * leg + 1, 3 * leg + 2)
    a1 = const.a_leg[hip, lane]
    a2 = const.a_leg[knee, lane]
    a3 = const.a_leg[ankle, lane]
    return ti.Vector(
        [
            m11,
            m22,
            m33,
            m12,
            m13,
            m23,
            a1 * x1,
            a2 * x2,
            a3 * x3,
            a1 * z1,
            a2 * z2,
            a3 * z3,
            work.momentum[3 + hip, lane],
            work.momentum[3 + knee, lane],
            work.momentum[3 + ankle, lane],
        ]
    )


@ti.func
def point_spring(lane, c: Static, step_s, work: Rows):
    """Damping matrix xx, xz, zz and force x, z of one point in the world, both times the step.

    Along normal n and tangent t = (n_z, -n_x); a slipping point's friction is a given
    force.
    """
    nx, nz = work.normal_x[c, lane], work.normal_z[c, lane]
    on, sticks = (
        step_s * work.normal_on[c, lane],
        work.slip[c, lane] == 0.0,
    )
    damping_n = on * work.normal_damping[c, lane]
    damping_t = ti.select(sticks, on * work.friction_damping[lane], 0.0)
    force_n = on * work.normal_force_0[c, lane]
    force_t = on * ti.select(sticks, work.friction_0[c, lane], work.friction[c, lane])
    return (
        damping_n * nx * nx + damping_t * nz * nz,
        (damping_n - damping_t) * nx * nz,
        damping_n * nz * nz + damping_t * nx * nx,
        force_n * nx + force_t * nz,
        force_n * nz - force_t * nx,
    )


@ti.func
def add_foot(lane, leg: Static, step_s, equations: Rows, base: Rows, work: Rows):
    """Heel and ball of a leg: J^T C J and J^T f, where J = (1, L1 e1, L2 e2, r e3) moves a point.

    They differ in r alone, so C, r C, r^2 C, f and r f are summed over both first.
    """
    hxx, hxz, hzz, hx, hz = point_spring(lane, 2 * leg, step_s, work)
    bxx, bxz, bzz, bx, bz = point_spring(lane, 2 * leg + 1, step_s, work)
    rh, rb = ti.static(HEEL_OFFSET_M, BALL_OFFSET_M)
    xx, xz, zz = hxx + bxx, hxz + bxz, hzz + bzz
    rxx, rxz, rzz = rh * hxx + rb * bxx, rh * hxz + rb * bxz, rh * hzz + rb * bzz
    fx, fz = hx + bx, hz + bz
    x1, z1, x2, z2, x3, z3 = leg_slopes(lane, leg, work)
    lx1, lz1 = THIGH_LENGTH_M * x1, THIGH_LENGTH_M * z1
    lx2, lz2 = SHANK_LENGTH_M * x2, SHANK_LENGTH_M * z2
    # Columns C L1 e1, C L2 e2 and r C e3 couple the links to the base.
    ux1, uz1 = xx * lx1 + xz * lz1, xz * lx1 + zz * lz1
    ux2, uz2 = xx * lx2 + xz * lz2, xz * lx2 + zz * lz2
    ux3, uz3 = rxx * x3 + rxz * z3, rxz * x3 + rzz * z3
    m, g, r = ti.static(Leg.inertia, Leg.coupling, Leg.rhs)
    equations[m + 0] += ux1 * lx1 + uz1 * lz1
    equations[m + 1] += ux2 * lx2 + uz2 * lz2
    equations[m + 2] += (
        (rh * rh * hxx + rb * rb * bxx) * x3 * x3
        + 2.0 * (rh * rh * hxz + rb * rb * bxz) * x3 * z3
        + (rh * rh * hzz + rb * rb * bzz) * z3 * z3
    )
    equations[m + 3] += ux1 * lx2 + uz1 * lz2
    equations[m + 4] += ux3 * lx1 + uz3 * lz1
    equations[m + 5] += ux3 * lx2 + uz3 * lz2
    equations[g + 0] += ux1
    equations[g + 1] += ux2
    equations[g + 2] += ux3
    equations[g + 3] += uz1
    equations[g + 4] += uz2
    equations[g + 5] += uz3
    equations[r + 0] += fx * lx1 + fz * lz1
    equations[r + 1] += fx * lx2 + fz * lz2
    equations[r + 2] += (rh * hx + rb * bx) * x3 + (rh * hz + rb * bz) * z3
    base[0] += xx
    base[1] += xz
    base[2] += zz
    base[3] += fx
    base[4] += fz


@ti.func
def point_velocity(lane, c: Static, work: Rows):
    """Velocity x, z of contact point c after the step: hip + L1 e1 w1 + L2 e2 w2 + r e3 w3."""
    leg = ti.static(c // 2)
    lever = ti.static(
        (THIGH_LENGTH_M, SHANK_LENGTH_M, (HEEL_OFFSET_M, BALL_OFFSET_M)[c % 2])
    )
    vx, vz = work.new_qdot[0, lane], work.new_qdot[1, lane]
    for i in ti.static(range(3)):
        x, z = slope_vector(lane, 1 + 3 * leg + i, work)
        speed = lever[i] * work.new_qdot[3 + 3 * leg + i, lane]
        vx += speed * x
        vz += speed * z
    return vx, vz


@ti.func
def add_stops(lane, leg: Static, step_s, equations: Rows, work: Rows):
    """Active stops of knee and ankle: J = +1 on the child, -1 on the parent."""
    m, r = ti.static(Leg.inertia, Leg.rhs)
    knee, ankle = ti.static(2 * leg, 2 * leg + 1)
    knee_on = step_s * work.stop_on[knee, lane]
    ankle_on = step_s * work.stop_on[ankle, lane]
    knee_weight = knee_on * work.stop_damping[knee, lane]
    ankle_weight = ankle_on * work.stop_damping[ankle, lane]
    knee_torque = knee_on * work.stop_torque_0[knee, lane]
    ankle_torque = ankle_on * work.stop_torque_0[ankle, lane]
    equations[m + 0] += knee_weight
    equations[m + 1] += knee_weight + ankle_weight
    equations[m + 2] += ankle_weight
    equations[m + 3] -= knee_weight
    equations[m + 5] -= ankle_weight
    equations[r + 0] -= knee_torque
    equations[r + 1] += knee_torque - ankle_torque
    equations[r + 2] += ankle_torque


@ti.func
def eliminate_leg(lane, leg: Static, step_s, base: Rows, const: Rows, work: Rows):
    """Factor a leg's matrix as L D L^T and take the leg out of the base's equations.

    Returns the inverse on the coupling in x, in z, and on the right-hand side.
    """
    equations = in_the_air(lane, leg, const, work)
    add_foot(lane, leg, step_s, equations, base, work)
    add_stops(lane, leg, step_s, equations, work)
    m, g, r = ti.static(Leg.inertia, Leg.coupling, Leg.rhs)
    m12, m13, m23 = equations[m + 3], equations[m + 4], equations[m + 5]
    i1 = 1.0 / equations[m]
    l21 = m12 * i1
    l31 = m13 * i1
    i2 = 1.0 / (equations[m + 1] - l21 * m12)
    rest = m23 - l21 * m13
    l32 = rest * i2
    i3 = 1.0 / (equations[m + 2] - l31 * m13 - l32 * rest)
    gx1, gx2, gx3 = equations[g], equations[g + 1], equations[g + 2]
    gz1, gz2, gz3 = equations[g + 3], equations[g + 4], equations[g + 5]
    x1, x2, x3 = substitute(gx1, gx2, gx3, l21, l31, l32, i1, i2, i3)
    z1, z2, z3 = substitute(gz1, gz2, gz3, l21, l31, l32, i1, i2, i3)
    p1, p2, p3 = substitute(
        equations[r], equations[r + 1], equations[r + 2], l21, l31, l32, i1, i2, i3
    )
    base[0] = base[0] - gx1 * x1 - gx2 * x2 - gx3 * x3
    base[1] = base[1] - gx1 * z1 - gx2 * z2 - gx3 * z3
    base[2] = base[2] - gz1 * z1 - gz2 * z2 - gz3 * z3
    base[3] = base[3] - gx1 * p1 - gx2 * p2 - gx3 * p3
    base[4] = base[4] - gz1 * p1 - gz2 * p2 - gz3 * p3
    return ti.Vector([x1, x2, x3, z1, z2, z3, p1, p2, p3])


@ti.func
def substitute(b1, b2, b3, l21, l31, l32, i1, i2, i3):
    """Solve L D L^T y = b for unit lower L and inverse pivots i."""
    y1 = b1
    y2 = b2 - l21 * y1
    y3 = b3 - l31 * y1 - l32 * y2
    x3 = y3 * i3
    x2 = y2 * i2 - l32 * x3
    x1 = y1 * i1 - l21 * x2 - l31 * x3
    return x1, x2, x3


@ti.func
def revise_contacts(lane, const: Rows, work: Rows):
    """One complementarity pass: drop contacts that pull, let slip what exceeds the cone.

    Without the drop the linearised damper would glue the foot to the ground. A slipping
    point's friction follows its normal force from pass to pass, until that no longer
    changes.
    """
    changed = 0.0
    for c in ti.static(range(CONTACTS)):
        vx, vz = point_velocity(lane, c, work)
        nx, nz = work.normal_x[c, lane], work.normal_z[c, lane]
        u_n = vx * nx + vz * nz
        u_t = vx * nz - vz * nx
        on = work.normal_on[c, lane]
        slip = work.slip[c, lane]
        normal = on * (
            work.normal_force_0[c, lane] - work.normal_damping[c, lane] * u_n
        )
        stuck = on * (work.friction_0[c, lane] - work.friction_damping[lane] * u_t)
        pulls = normal < 0.0
        normal = larger(normal, 0.0)
        cone = work.grip[lane] * normal
        breaks = (slip == 0.0) & (pulls == False) & (larger(stuck, 0.0 - stuck) > cone)  # noqa: E712
        slip = ti.select(breaks, ti.select(stuck > 0.0, 1.0, 0.0 - 1.0), slip)
        moves = (slip != 0.0) & (normal != work.normal_force[c, lane])
        changed = ti.select(pulls | breaks | moves, 1.0, changed)
        work.normal_on[c, lane] = ti.select(pulls, 0.0, on)
        work.slip[c, lane] = slip
        work.normal_force[c, lane] = normal
        friction = ti.select(slip == 0.0, stuck, slip * cone)
        work.friction[c, lane] = ti.select(pulls, 0.0, friction)
    for stop in ti.static(range(STOPS)):
        child = ti.static(4 + 3 * (stop // 2) + stop % 2)
        rate = work.new_qdot[child, lane] - work.new_qdot[child - 1, lane]
        restoring = work.stop_torque_0[stop, lane]
        torque = restoring - work.stop_damping[stop, lane] * rate
        on = work.stop_on[stop, lane]
        wrong = (on > 0.5) & (torque * restoring < 0.0)
        work.stop_on[stop, lane] = ti.select(wrong, 0.0, on)
        changed = ti.select(wrong, 1.0, changed)
    work.changed[lane] = changed


@ti.func
def step_coordinates(lane, step_s, state: Rows, work: Rows):
    """Semi-implicit Euler: q' = q + h v'."""
    for i in ti.static(range(COORDINATES)):
        state.qdot[i, lane] = work.new_qdot[i, lane]
        state.q[i, lane] += step_s * work.new_qdot[i, lane]
