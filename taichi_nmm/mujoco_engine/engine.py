"""A batch of walkers whose bodies MuJoCo moves, one model each, and one controller batch for all.

A physics step is: our kernel senses, controls and contracts the muscles of all (`carried.drive`);
MuJoCo steps each body; our kernel takes in where they are (`carried.follow`).
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from copy import copy
from functools import lru_cache
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import Batch as Simulations
from mujoco.batch import SimulationError
from numpy.typing import NDArray

from taichi_nmm.body import Bodies
from taichi_nmm.constants import blends
from taichi_nmm.errors import InputError
from taichi_nmm.initial import PENETRATION_M, initial_rows
from taichi_nmm.kernel import backend
from taichi_nmm.kernel.carried import drive, follow
from taichi_nmm.kernel.layout import COORDINATES, LEGS, Drive, Motion, State
from taichi_nmm.kernel.muscle_table import muscle_table
from taichi_nmm.mujoco_engine.ground import Boxes, boxes
from taichi_nmm.mujoco_engine.linkage import RELATIVE
from taichi_nmm.mujoco_engine.mjcf import FOOT_SENSOR, compiled, walker_xml
from taichi_nmm.packs import Packs
from taichi_nmm.settings import Settings
from taichi_nmm.terrain import Terrain
from taichi_nmm.walkers import Batch
from taichi_nmm.world import NOT_OURS, OWN_CONTACT

Array = NDArray[np.float64]
Rows = NDArray[np.intp]

VIEW_TICKS = 250  # how often the boxes move along
# Around the hip: a leg and a foot, and what the fastest fall covers until the boxes move along.
VIEW_M = 2.5
CACHED = 256  # models and grounds: those of an experiment's runs come again with every trial


class Carried:
    """One walker in MuJoCo: its model with the ground around it, and where it starts."""

    def __init__(self, model: mujoco.MjModel, ground: Boxes, start: Array) -> None:
        self._ground = ground
        self._first = 0
        self.boxes = boxes_in_view(ground)
        self.model = copy(model)  # its boxes move
        self.start = start

    def look_around(self, hip_m: float) -> bool:
        """Move the boxes to where the hip is; whether any has moved."""
        near = self._ground.between(hip_m - VIEW_M, hip_m + VIEW_M)
        first = max(min(near.start, len(self._ground) - self.boxes), 0)
        if first == self._first:
            return False
        self._first = first
        here = slice(first, first + self.boxes)
        geoms = slice(0, self.boxes)  # the world's geoms come first
        size = self._ground.half_size[here]
        self.model.geom_pos[geoms] = self._ground.position[here]
        self.model.geom_quat[geoms] = self._ground.quaternion[here]
        self.model.geom_size[geoms] = size
        self.model.geom_rbound[geoms] = np.linalg.norm(size, axis=1)
        self.model.geom_aabb[geoms, 3:] = size
        return True


class Herd:
    """Walkers with as many boxes each, which one call of MuJoCo's steps.

    Attributes:
        numbers: rows of the walkers in the batch.
    """

    def __init__(self, numbers: Rows, walkers: list[Carried]) -> None:
        self._seat(numbers, walkers)
        for row, walker in enumerate(walkers):
            self._qpos[row], self._qvel[row] = np.split(walker.start, 2)

    def keep(self, still: NDArray[np.bool_]) -> None:
        """Go on with these walkers alone."""
        state = self._simulations.state[still]
        walkers = [walker for walker, stays in zip(self._walkers, still, strict=True) if stays]
        self._seat(self.numbers[still], walkers)
        self._simulations.state[:] = state

    def look_around(self) -> None:
        """Move the boxes along."""
        pairs = zip(self._walkers, self._qpos[:, 0], strict=True)
        if any([walker.look_around(float(hip_m)) for walker, hip_m in pairs]):
            self._simulations.set_models([walker.model for walker in self._walkers])

    def step(self, torque: Array) -> Array:
        """MuJoCo's step of all with these joint torques: qpos, qvel and sensors, [n, 26].

        Where MuJoCo cannot go on, the velocity is no number.
        """
        self._torque[:] = torque
        try:
            self._simulations.step()
        except SimulationError as error:  # those have not moved, the others have
            self._qvel[error.ids] = np.nan
        return np.concatenate((self._qpos, self._qvel, self._sensors), axis=1)

    def _seat(self, numbers: Rows, walkers: list[Carried]) -> None:
        self.numbers, self._walkers = numbers, walkers
        self._simulations = Simulations(walkers[0].model, len(walkers), nthread=1)
        self._simulations.set_models([walker.model for walker in walkers])
        names = ("ctrl", "qpos", "qvel", "sensordata")
        self._torque, self._qpos, self._qvel, self._sensors = map(self._simulations.bind, names)


def boxes_in_view(ground: Boxes) -> int:
    """How many boxes a model needs so that those around a walker are always there."""
    return min(ground.most_within(2 * VIEW_M), len(ground))


@lru_cache(maxsize=CACHED)
def _boxes(terrain: Terrain) -> Boxes:
    return boxes(terrain)


@lru_cache(maxsize=CACHED)
def _model(
    terrain: Terrain, body: tuple[float, ...], friction: float, settings: Settings
) -> mujoco.MjModel:
    """The model of a body (masses, inertias, centres of mass) with the first boxes of a ground."""
    mass, inertia, com = np.array(body).reshape(3, 1, -1)
    ground = _boxes(terrain)
    count = boxes_in_view(ground)
    first = Boxes(*(values[:count] for values in vars(ground).values()))
    model = compiled(walker_xml(Bodies(mass, inertia, com), first, settings, friction))
    # A box that is level here is taken as level wherever it moves, unless it is told otherwise.
    model.geom_sameframe[:count] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
    return model


def carried(batch: Batch, walker: int, settings: Settings) -> Carried:
    """A walker of a batch at the start."""
    terrain, bodies = batch.terrains[batch.terrain_index[walker]], batch.bodies
    columns = (bodies.mass_kg, bodies.inertia_kgm2, bodies.com_m)
    body = tuple(float(x) for values in columns for x in values[walker])
    friction = float(batch.worlds.friction[walker])
    return Carried(_model(terrain, body, friction, settings), _boxes(terrain), start_state(terrain))


def start_state(terrain: Terrain) -> Array:
    """The start of every walk, the stance foot on the ground and not in it: qpos, qvel, [18]."""
    rows = initial_rows(terrain)
    q = rows[State.q : State.q + COORDINATES].copy()
    q[1] += PENETRATION_M
    qdot = rows[State.qdot : State.qdot + COORDINATES]
    return np.concatenate([RELATIVE @ q, RELATIVE @ qdot])


def launcher(batch: Batch, settings: Settings, packs: Packs) -> Callable[[Packs, int, int], None]:
    """What advances the packs, which are at the start; here it is, too, that MuJoCo's starts.

    Raises:
        InputError: worlds that ask for a contact of our own engine.
    """
    for name in OWN_CONTACT:
        asked = getattr(batch.worlds, name)
        if np.any(asked != 1.0):
            raise InputError(f"worlds.{name}", float(asked[asked != 1.0][0]), NOT_OURS)
    begin(packs)
    return _Engine(batch, settings).launch


def begin(packs: Packs) -> None:
    """Put the packs' walkers where MuJoCo's start: the foot touches, and is not in the ground."""
    rows = packs.unfold(packs.rows).copy()
    rows[:, [State.q + 1, State.end_z]] += PENETRATION_M
    for leg in range(LEGS):
        rows[:, State.touching + 2 * leg] = rows[:, State.stance_before + leg]
    packs.rows = packs.fold(rows)


class _Engine:
    """What stays the same from launch to launch, and who sits where while nobody falls."""

    def __init__(self, batch: Batch, settings: Settings) -> None:
        self._settings = settings
        self._heights = np.array(
            [ground.height_m for ground in batch.terrains], dtype=backend.real_dtype()
        )
        walkers = [carried(batch, n, settings) for n in range(len(batch))]
        sizes = np.array([walker.boxes for walker in walkers])
        self._herds = [
            Herd(np.flatnonzero(sizes == size), [w for w in walkers if w.boxes == size])
            for size in np.unique(sizes)
        ]
        self._bound: NDArray[Any] | None = None

    def launch(self, packs: Packs, first_tick: int, ticks: int) -> None:
        """Advance the walkers of the packs, those that are up."""
        backend.start(self._settings.on_processor())
        if packs.rows is not self._bound or self._drive.stale:
            self._bind(packs)
        active, substeps = packs.rows[:, State.active], self._settings.substeps
        with _no_warnings():
            for tick in range(first_tick, first_tick + ticks):
                if np.count_nonzero(active) != self._active:
                    self._seat(packs)
                if not self._up:
                    return
                if tick % VIEW_TICKS == 0:
                    for herd, _seats in self._up:
                        herd.look_around()
                for substep in range(substeps):
                    self._drive.launch(tick=tick, commands=int(substep == 0))
                    self._move()
                    self._follow.launch(tick=tick, ends=int(substep == substeps - 1))

    def _bind(self, packs: Packs) -> None:
        """Bind the kernels to the packs' arrays, which change when walkers leave."""
        self._bound, real = packs.rows, backend.real_dtype()
        count, lanes, step_s = len(packs.rows), packs.lanes, self._settings.physics_step_s
        activation_blend, load_blend = blends(step_s)
        drives = np.zeros((count, Drive.count, lanes), dtype=real)
        motions = np.zeros((count, Motion.count, lanes), dtype=real)
        self._drive = backend.BoundKernel(
            drive, lanes, packs.rows, packs.constants, packs.terrains, self._heights,
            muscle_table(step_s).astype(real), drives, 0, 1, activation_blend,
        )  # fmt: skip
        self._follow = backend.BoundKernel(
            follow, lanes, packs.rows, packs.constants, drives, motions, 0, 1, step_s, load_blend
        )
        # [pack, lane, row] of the same memory
        self._torques = drives[:, : 3 * LEGS].transpose(0, 2, 1)
        self._motions = motions.transpose(0, 2, 1)
        self._seat(packs)

    def _seat(self, packs: Packs) -> None:
        """Let go who has fallen, and note in which pack and lane the others are."""
        places = np.flatnonzero(packs.up())
        self._active = np.count_nonzero(packs.rows[:, State.active])
        up = packs.walkers[places]
        self._herds = [herd for herd in self._herds if np.isin(herd.numbers, up).any()]
        self._up = []
        for herd in self._herds:
            still = np.isin(herd.numbers, up)
            if not still.all():
                herd.keep(still)
            mine = places[np.searchsorted(up, herd.numbers)]
            self._up.append((herd, np.divmod(mine, packs.lanes)))

    def _move(self) -> None:
        """MuJoCo's step of each walker that is up."""
        for herd, seats in self._up:
            self._motions[seats] = motion_rows(herd.step(self._torques[seats]))


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
    # What the foot does to the ground is sensed.
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
    """What produced a result: engine, version, numerics; the controller's engine beside it."""
    return {
        "engine": "mujoco",
        "engine_version": mujoco.__version__,
        **settings.document(),
        "controller": backend.metadata(),
    }
