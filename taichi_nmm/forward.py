"""`forward_dynamics`: accelerations of the linkage in the air, by the simulator's own functions."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taichi_nmm import checks
from taichi_nmm.body import Bodies
from taichi_nmm.errors import InputError
from taichi_nmm.kernel import backend
from taichi_nmm.kernel.entry_points import accelerate
from taichi_nmm.kernel.layout import COORDINATES
from taichi_nmm.packs import Packs
from taichi_nmm.parameters import PUBLISHED_GAINS
from taichi_nmm.settings import Settings
from taichi_nmm.walkers import check_batch, constant_rows

JOINTS = 6


def forward_dynamics(
    q: ArrayLike, qdot: ArrayLike, joint_torque: ArrayLike, bodies: Bodies | None = None
) -> NDArray[np.float64]:
    """Accelerations of a batch of states without contact, float64 [n, 9].

    Args:
        q: hip x, z and the angles of HAT, thigh, shank, foot left, then right, [n, 9].
        qdot: their rates, [n, 9].
        joint_torque: left hip, knee, ankle, right hip, knee, ankle, N m, [n, 6]; positive turns
            the child clockwise.
        bodies: one for all or n of them; None is the nominal body.

    Raises:
        InputError: a shape that does not fit, or a number that is not finite.
    """
    angles = _matrix("q", q, COORDINATES)
    count = len(angles)
    rates = _matrix("qdot", qdot, COORDINATES, count)
    torques = _matrix("joint_torque", joint_torque, JOINTS, count)
    batch = check_batch(np.tile(PUBLISHED_GAINS, (count, 1)), bodies)
    settings = Settings(precision="float64", arch="cpu")
    backend.start(settings)
    packs = Packs(np.hstack([angles, rates]), constant_rows(batch, settings))
    accelerations = np.zeros((len(packs.rows), COORDINATES, packs.lanes))
    backend.launch(
        accelerate, packs.lanes, packs.rows, packs.fold(torques), packs.constants, accelerations
    )
    return packs.unfold(accelerations)


def _matrix(
    name: str, values: ArrayLike, columns: int, rows: int | None = None
) -> NDArray[np.float64]:
    matrix = checks.numbers(name, values)
    count = "n" if rows is None else str(rows)
    fits = matrix.ndim == 2 and len(matrix) > 0 and matrix.shape[1] == columns
    if not fits or (rows is not None and len(matrix) != rows):
        raise InputError(f"{name}.shape", matrix.shape, f"[{count}, {columns}]")
    return checks.finite(name, matrix)
