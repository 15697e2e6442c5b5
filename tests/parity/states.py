"""Random states of the linkage, shared by the parity tests."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from taichi_nmm.body import Bodies

LARGEST_RATE_PS = 10.0  # m/s and rad/s; walking stays below
LARGEST_TORQUE_NM = 300.0


@dataclass(frozen=True)
class States:
    """q, qdot [n, 9], joint torques [n, 6] and n bodies."""

    q: NDArray[np.float64]
    qdot: NDArray[np.float64]
    joint_torque: NDArray[np.float64]
    bodies: Bodies


def random_states(count: int, seed: int = 20161) -> States:
    """Any angles, fast rates, strong torques; every second body is disturbed."""
    rng = np.random.default_rng(seed)
    return States(
        q=rng.uniform(-np.pi, np.pi, (count, 9)),
        qdot=rng.uniform(-LARGEST_RATE_PS, LARGEST_RATE_PS, (count, 9)),
        joint_torque=rng.uniform(-LARGEST_TORQUE_NM, LARGEST_TORQUE_NM, (count, 6)),
        bodies=half_disturbed(count),
    )


def half_disturbed(count: int) -> Bodies:
    """`count` bodies, every second one disturbed by its own seed."""
    nominal, disturbed = Bodies.nominal(count), Bodies.disturbed(range(count))
    odd = (np.arange(count) % 2 == 1)[:, None]
    return Bodies(
        np.where(odd, disturbed.mass_kg, nominal.mass_kg),
        np.where(odd, disturbed.inertia_kgm2, nominal.inertia_kgm2),
        np.where(odd, disturbed.com_m, nominal.com_m),
    )
