"""The linkage's dynamics written another way: dense, from the Jacobians of the seven masses.

The simulator solves the closed form of the equations as an arrow matrix; nothing here
knows of it. Every centre of mass is `hip + sum_k arm[i, k] u_k(th_k)`, u_k the unit
vector along segment k, so with e_k = du_k/dth_k the Jacobian of segment i is J_i = [1,
arm[i, k] e_k] and the centripetal part of its acceleration is `-sum_k arm[i, k] u_k
w_k^2`.

Arrays: states q, qdot [n, 9] as in `taichi_nmm`, joint torques [n, 6], bodies of length
1 or n.
"""

import numpy as np
from numpy.typing import NDArray

from taichi_nmm.body import SHANK_LENGTH_M, THIGH_LENGTH_M

Array = NDArray[np.float64]


def contract(subscripts, *operands):
    """`np.einsum`, with the type of its result."""
    result = np.einsum(subscripts, *operands)
    return result


def unit_vectors(q):
    """u_k [n, 7, 2]: HAT up, thighs and shanks down, feet forward, all turned clockwise by th_k."""
    sine, cosine = np.sin(q[:, 2:]), np.cos(q[:, 2:])
    u = np.stack([-sine, -cosine], axis=-1)
    u[:, 0] *= -1.0
    for foot in (3, 6):
        u[:, foot] = np.stack([cosine[:, foot], -sine[:, foot]], axis=-1)
    return u


def clockwise_quarter_turn(u):
    """du/dth of a vector that turns clockwise with th, [..., 2]."""
    return np.stack([u[..., 1], -u[..., 0]], axis=-1)


def arms_m(bodies):
    """arm[i, k] in m: how far the centre of mass of segment i lies along u_k, [n, 7, 7]."""
    arm = np.zeros((len(bodies), 7, 7))
    arm[:, range(7), range(7)] = bodies.com_m
    for thigh in (1, 4):
        shank, foot = thigh + 1, thigh + 2
        arm[:, [shank, foot], thigh] = THIGH_LENGTH_M
        arm[:, foot, shank] = SHANK_LENGTH_M
    return arm


def jacobians(q, bodies):
    """d(centre of mass of segment i)/dq, [n, 7, 2, 9]."""
    e = clockwise_quarter_turn(unit_vectors(q))
    base = np.broadcast_to(np.eye(2), (len(q), 7, 2, 2))
    return np.concatenate([base, contract("nik,nkc->nick", arms_m(bodies), e)], axis=-1)


def com_positions(q, bodies):
    """Centre of mass of each segment, [n, 7, 2]."""
    return q[:, None, :2] + contract("nik,nkc->nic", arms_m(bodies), unit_vectors(q))


def com_accelerations(q, qdot, qddot, bodies):
    """Acceleration of each segment's centre of mass, [n, 7, 2]."""
    turning = contract(
        "nik,nkc,nk->nic", arms_m(bodies), unit_vectors(q), qdot[:, 2:] ** 2
    )
    return contract("nica,na->nic", jacobians(q, bodies), qddot) - turning


def momentum(q, qdot, bodies):
    """Linear momentum in N s, [n, 2]."""
    velocity = contract("nica,na->nic", jacobians(q, bodies), qdot)
    return contract("ni,nic->nc", bodies.mass_kg, velocity)


def angular_momentum(q, qdot, bodies):
    """About the whole body's centre of mass, clockwise positive, in N m s, [n]."""
    velocity = contract("nica,na->nic", jacobians(q, bodies), qdot)
    orbit = moment_about_com(q, velocity, bodies)
    return orbit + contract("ni,ni->n", bodies.inertia_kgm2, qdot[:, 2:])


def moment_about_com(q, rate, bodies):
    """Clockwise moment of m_i rate_i (velocities or accelerations, [n, 7, 2]), [n]."""
    position = com_positions(q, bodies)
    mass = bodies.mass_kg[..., None]
    centre = np.sum(mass * position, axis=1, keepdims=True) / np.sum(
        mass, axis=1, keepdims=True
    )
    x, z = np.moveaxis(mass * (position - centre), -1, 0)
    return contract("ni,ni->n", z, rate[..., 0]) - contract("ni,ni->n", x, rate[..., 1])
