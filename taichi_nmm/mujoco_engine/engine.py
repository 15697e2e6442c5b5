"""A batch of walkers whose bodies MuJoCo moves, one model each, and one controller batch for all.

A physics step is: our kernel senses, controls and contracts the muscles of all
(`carried.drive`) and lays the ground under their soles (`ContactPlanes`); MuJoCo steps
each body; our kernel takes in where they are (`carried.follow`).
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import Batch as Simulations
from mujoco.batch import SimulationError
from numpy.typing import NDArray

from storage.inputs.errors import InputError
from taichi_nmm.body import Bodies
from taichi_nmm.initial import PENETRATION_M, initial_rows
from taichi_nmm.kernel import backend
from taichi_nmm.kernel.carried import drive, follow
from taichi_nmm.kernel.contact_planes import PLANES, lay_planes
from taichi_nmm.kernel.layout import COORDINATES, LEGS, Drive, Motion, State
from taichi_nmm.kernel.muscle_table import muscle_table
from taichi_nmm.mujoco_engine.mjcf import FOOT_SENSOR, RELATIVE, walk_model
from taichi_nmm.packs import Packs
from taichi_nmm.settings import Settings
from taichi_nmm.terrain import GRID_X_M, Terrain
from taichi_nmm.walkers import Batch, blends
from taichi_nmm.world import NO_SLIP, NOT_OURS, OWN_CONTACT

Array = NDArray[np.float64]
Rows = NDArray[np.intp]

OF_RELATIVE: Array = np.linalg.inv(RELATIVE).astype(np.float64)  # q = OF_RELATIVE qpos
APRON_M = 30e3  # level ground before and behind the table: beyond the longest walk
CACHED = 256  # models: those of an experiment's runs come again with every trial


class ContactPlanes:
    """The planes of some walkers, [n, PLANES], and the grounds that they lie on."""

    def __init__(
        self, terrains: tuple[Terrain, ...], index: NDArray[np.integer[Any]]
    ) -> None:
        heights = np.array([ground.height_m for ground in terrains])
        self._heights = np.pad(heights, ((0, 0), (1, 1)), mode="edge")
        ends = GRID_X_M[0] - APRON_M, GRID_X_M[-1] + APRON_M
        self._nodes = np.concatenate([ends[:1], GRID_X_M, ends[1:]])
        self._index = index.astype(np.int32)
        self._qpos = np.zeros((len(index), COORDINATES))
        self._positions = np.zeros((len(index), PLANES, 3))
        self._quaternions = np.zeros((len(index), PLANES, 4))
        self._kernel = backend.BoundKernel(
            lay_planes,
            0,
            self._index,
            self._nodes,
            self._heights,
            self._qpos,
            self._positions,
            self._quaternions,
        )

    def keep(self, still: NDArray[np.bool_]) -> None:
        """Go on with these walkers alone."""
        index = self._index[: len(still)][still]
        self._index[: len(index)] = index

    def under(self, qpos: Array) -> tuple[Array, Array]:
        """Where the planes lie: points [n, PLANES, 3] and quaternions [n, PLANES, 4].

        `qpos` is MuJoCo's, [n, 9]. The arrays are overwritten by the next call.
        """
        count = len(qpos)
        self._qpos[:count] = qpos
        self._kernel.launch(count=count)
        return self._positions[:count], self._quaternions[:count]


class Herd:
    """Walkers that one call of MuJoCo's steps.

    Attributes:
        numbers: rows of the walkers in the batch.
    """

    def __init__(self, batch: Batch, settings: Settings) -> None:
        everybody = np.arange(len(batch))
        worlds = batch.worlds
        self._pushed = bool(worlds.catch_ns.any() or worlds.push.any())
        self._planes = ContactPlanes(batch.terrains, batch.terrain_index)
        bodies = np.hstack(list(vars(batch.bodies).values())).tolist()
        each = zip(map(tuple, bodies), batch.worlds.friction.tolist(), strict=True)
        self._seat(
            everybody, [_model(body, friction, settings) for body, friction in each]
        )
        starts = np.array([start_state(ground) for ground in batch.terrains])[
            batch.terrain_index
        ]
        self._qpos[:], self._qvel[:] = np.split(starts, 2, axis=1)

    def keep(self, still: NDArray[np.bool_]) -> None:
        """Go on with these walkers alone."""
        state = self._simulations.state[still]
        models = [
            model for model, stays in zip(self._models, still, strict=True) if stays
        ]
        self._planes.keep(still)
        self._seat(self.numbers[still], models)
        self._simulations.state[:] = state

    def step(self, torque: Array, push: Array) -> Array:
        """MuJoCo's step of all with these joint torques: qpos, qvel and sensors, [n, 26].

        `push` is the generalised force of catches and pushes in our coordinates, [n, 9].
        Where MuJoCo cannot go on, the velocity is no number.
        """
        self._torque[:] = torque
        if self._pushed:
            self._applied[:] = push @ OF_RELATIVE  # equal work
        position, quaternion = self._planes.under(self._qpos)
        self._plane_position[:] = position.reshape(self._plane_position.shape)
        self._plane_quaternion[:] = quaternion.reshape(self._plane_quaternion.shape)
        try:
            self._simulations.step()
        except SimulationError as error:  # those have not moved, the others have
            self._qvel[error.ids] = np.nan
        return np.concatenate((self._qpos, self._qvel, self._sensors), axis=1)

    def _seat(self, numbers: Rows, models: list[mujoco.MjModel]) -> None:
        self.numbers, self._models = numbers, models
        self._simulations = Simulations(models[0], len(models), nthread=1)
        self._simulations.set_models(models)
        bind = self._simulations.bind
        self._torque, self._sensors = bind("ctrl"), bind("sensordata")
        self._applied = bind("qfrc_applied")
        self._qpos, self._qvel = bind("qpos"), bind("qvel")
        self._plane_position, self._plane_quaternion = (
            bind("mocap_pos"),
            bind("mocap_quat"),
        )


@lru_cache(maxsize=CACHED)
def _model(
    body: tuple[float, ...], friction: float, settings: Settings
) -> mujoco.MjModel:
    """The model of a body: masses, inertias, centres of mass."""
    mass, inertia, com = np.array(body).reshape(3, 1, -1)
    return walk_model(Bodies(mass, inertia, com), settings, friction)


def start_state(terrain: Terrain) -> Array:
    """The start of every walk, the stance foot on the ground and not in it: qpos, qvel, [18]."""
    rows = initial_rows(terrain)
    q = rows[State.q : State.q + COORDINATES].copy()
    q[1] += PENETRATION_M
    qdot = rows[State.qdot : State.qdot + COORDINATES]
    return np.concatenate([RELATIVE @ q, RELATIVE @ qdot])


def launcher(
    batch: Batch, settings: Settings, packs: Packs
) -> Callable[[Packs, int, int], None]:
    """The function that advances the packs; these are put where MuJoCo's walkers start.

    Raises:
        InputError: worlds with a contact of our own engine.
    """
    for name in OWN_CONTACT:
        scale = getattr(batch.worlds, name)
        if np.any(scale != 1.0):
            raise InputError(f"worlds.{name}", float(scale[scale != 1.0][0]), NOT_OURS)
    if batch.worlds.slip.any():
        raise InputError("worlds.slip", "a slip", NO_SLIP)
    rows = packs.unfold(packs.rows).copy()
    rows[:, [State.q + 1, State.end_z]] += PENETRATION_M
    for leg in range(LEGS):
        rows[:, State.touching + 2 * leg] = rows[:, State.stance_before + leg]
    packs.rows = packs.fold(rows)
    return _Engine(batch, settings).launch


class _Engine:
    """The walkers of MuJoCo and of the kernels between launches, and their seats in the packs."""

    def __init__(self, batch: Batch, settings: Settings) -> None:
        self._settings = settings
        self._heights = np.array(
            [ground.height_m for ground in batch.terrains], dtype=backend.real_dtype()
        )
        self._herd = Herd(batch, settings)
        self._bound: NDArray[Any] | None = None

    def launch(self, packs: Packs, first_tick: int, ticks: int) -> None:
        """Advance the walkers of the packs, those that are up."""
        backend.start(self._settings.on_processor())
        if packs.rows is not self._bound:
            self._bind(packs)
        active, substeps = packs.rows[:, State.active], self._settings.substeps
        with _no_warnings():
            for tick in range(first_tick, first_tick + ticks):
                if np.count_nonzero(active) != self._active:
                    self._seat(packs)
                if not self._up:
                    return
                for substep in range(substeps):
                    self._drive.launch(tick=tick, commands=int(substep == 0))
                    seen = self._herd.step(
                        self._torques[self._seats], self._pushes[self._seats]
                    )
                    self._motions[self._seats] = motion_rows(seen)
                    self._follow.launch(tick=tick, ends=int(substep == substeps - 1))

    def _bind(self, packs: Packs) -> None:
        """Bind the kernels to the packs' arrays, which change when walkers leave."""
        self._bound, real = packs.rows, backend.real_dtype()
        count, lanes, step_s = (
            len(packs.rows),
            packs.lanes,
            self._settings.physics_step_s,
        )
        activation_blend, load_blend = blends(step_s)
        drives = np.zeros((count, Drive.count, lanes), dtype=real)
        motions = np.zeros((count, Motion.count, lanes), dtype=real)
        self._drive = backend.BoundKernel(
            drive,
            lanes,
            packs.rows,
            packs.constants,
            packs.terrains,
            self._heights,
            muscle_table(step_s).astype(real),
            drives,
            0,
            1,
            activation_blend,
        )
        self._follow = backend.BoundKernel(
            follow,
            lanes,
            packs.rows,
            packs.constants,
            drives,
            motions,
            0,
            1,
            step_s,
            load_blend,
        )
        # [pack, lane, row] of the same memory
        self._torques = drives[:, : 3 * LEGS].transpose(0, 2, 1)
        self._pushes = drives[:, Drive.push :].transpose(0, 2, 1)
        self._motions = motions.transpose(0, 2, 1)
        self._seat(packs)

    def _seat(self, packs: Packs) -> None:
        """Let the fallen walkers go, and note in which pack and lane the others are."""
        places = np.flatnonzero(packs.up())
        places = places[np.argsort(packs.walkers[places])]  # the herd's order
        self._active = np.count_nonzero(packs.rows[:, State.active])
        self._up = len(places)
        if 0 < self._up < len(self._herd.numbers):
            self._herd.keep(np.isin(self._herd.numbers, packs.walkers[places]))
        self._seats = np.divmod(places, packs.lanes)


def motion_rows(seen: Array) -> Array:
    """Rows of `layout.Motion`, [n, rows], from MuJoCo's qpos, qvel and sensors, [n, 26].

    Angles of the segments take the place of the joints', in `seen` itself.
    """
    coordinates = seen[:, : 2 * COORDINATES].reshape(-1, 2, COORDINATES)
    coordinates[:, :, 3::3] += coordinates[:, :, 2:3]
    coordinates[:, :, 4::3] += coordinates[:, :, 3::3]
    coordinates[:, :, 5::3] += coordinates[:, :, 4::3]
    feet = seen[:, 2 * COORDINATES :].reshape(-1, LEGS, FOOT_SENSOR)
    rows = np.empty((len(seen), Motion.count))
    rows[:, : 2 * COORDINATES] = coordinates.reshape(len(seen), -1)
    rows[:, Motion.touching : Motion.touching + LEGS] = feet[:, :, 0] > 0.0
    # The sensors give the force of a foot on the ground.
    rows[:, Motion.ground_force :: LEGS] = -feet[:, :, 1]
    rows[:, Motion.ground_force + 1 :: LEGS] = -feet[:, :, 3]
    return rows


@contextmanager
def _no_warnings() -> Iterator[None]:
    """Without MuJoCo's lines, on the screen and in a file, about walkers that diverge."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda text: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


def metadata(settings: Settings) -> dict[str, Any]:
    """Engine, version and numerics of a result, and the controller's engine."""
    return {
        "engine": "mujoco",
        "engine_version": mujoco.__version__,
        **settings.document(),
        "controller": backend.metadata(),
    }
