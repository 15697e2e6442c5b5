"""The robots of a call in one batch of MuJoCo's: what each senses, does and costs."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from storage.function_simulator import SEED, DrawnNumbers
from storage.inputs.errors import InputError
from storage.mujoco_worlds import Floats, push_rates, quaternions, upward, weight_of
from storage.simulator import SURVIVED

MOST_COST = 100.0
PUSH_EVERY_S = 2.0
START_S = 0.5  # without pushes


@dataclass(frozen=True)
class SensedState:
    """What a controller knows of the n robots that are up.

    Noise of the world is in `qpos` and `qvel` alone. Heights are along z, or along y in
    a model whose gravity is along y, from the model's origin.

    Attributes:
        time_s: since the beginning of the run.
        qpos: MuJoCo's positions, [n, nq].
        qvel: its velocities, [n, nv].
        x_m: of the root body, [n]; with height, tilt and sensors of one physics step
            before.
        height_m: of the root body, [n].
        pitch_rad: of the root body from its start, forwards positive, [n].
        tilt_rad: of the root body in any direction, from 0, [n].
        sensors: of the model, by name, [n] or [n, k].
    """

    time_s: float
    qpos: Floats
    qvel: Floats
    x_m: Floats
    height_m: Floats
    pitch_rad: Floats
    tilt_rad: Floats
    sensors: Mapping[str, Floats]


@dataclass(frozen=True, eq=False)
class Robot:
    """What all robots of a herd share.

    Attributes:
        name: of the simulator, for errors.
        model: MuJoCo's, of the base setting.
        root: number of the body that height and tilt are of.
        start_qpos: MuJoCo's positions at the start, [nq]; None: the model's.
        controller: controls [n, nu] of a point, what is sensed, and its memory.
        is_down: whether runs are over, [n], of what is sensed and the root's height at
            the start in m.
        control_step_s: how long controls hold.
        substeps: physics steps in it.
    """

    name: str
    model: Any
    root: int
    start_qpos: Floats | None
    controller: Callable[..., Any]
    is_down: Callable[[SensedState, float], NDArray[np.bool_]]
    control_step_s: float
    substeps: int


class Herd:
    """The robots of a call: n points x w worlds, and what became of each."""

    def __init__(
        self,
        robot: Robot,
        points: Mapping[str, Any],
        worlds: DrawnNumbers,
        models: list[Any],
    ) -> None:
        from mujoco.batch import Batch

        self._robot = robot
        self._shape = len(next(iter(points.values()))), len(models)
        many = self._shape[0] * self._shape[1]
        self._world = np.tile(np.arange(len(models)), self._shape[0])  # of each robot
        self._point = {
            name: np.repeat(each, len(models)) for name, each in points.items()
        }
        self._batch = Batch(models[0], many, nthread=1)
        self._batch.set_models([models[k] for k in self._world])
        model, root = robot.model, robot.root
        bind = self._batch.bind
        self.qpos = bind("qpos")
        self._qvel = bind("qvel")
        self._ctrl = bind("ctrl")
        self._forces = bind("actuator_force")
        self._speeds = bind("actuator_velocity")
        self._torques = bind("qfrc_actuator")
        self._sensors = bind("sensordata")
        self._place = bind("xpos")[:, root]
        self._turn = bind("xmat")[:, root].reshape(many, 3, 3)
        self._batch.reset()
        if robot.start_qpos is not None:
            self.qpos[:] = robot.start_qpos
            self._batch.forward()
        self._named = [
            (model.sensor(k).name, model.sensor_adr[k], model.sensor_dim[k])
            for k in range(model.nsensor)
        ]
        self._start = self._place[0].copy()
        self._axis, self._sign = upward(model)
        self._start_m = float(self._sign * self._start[self._axis])
        # the vertical, in the root body's frame
        self._upward = self._sign * self._turn[0, self._axis]
        weights = [weight_of(each, root) for each in models]
        self._weight = np.array(weights, dtype=np.float64)[self._world]
        self._delay = np.rint(worlds["delay_s"] / robot.control_step_s).astype(np.int64)
        self._queue = np.zeros((int(self._delay.max()) + 1, *self._ctrl.shape))
        self._noise = np.hstack(
            [
                np.repeat(worlds["noise"][:, None], model.nq, axis=1),
                np.repeat(worlds["noise_rate"][:, None], model.nv, axis=1),
            ]
        )
        # of each world
        self._noisy: NDArray[np.bool_] = np.any(self._noise > 0.0, axis=1)
        self._quaternions = quaternions(model)
        self._push = worlds["push_mps"]
        self._rates = push_rates(model, root)
        # where joints take a part of the actuators' forces only, their work is what
        # joints get
        self._is_clipped = bool(np.any(model.jnt_actfrclimited))
        self._draws = [
            np.random.default_rng(np.random.SeedSequence(int(seed), spawn_key=(1,)))
            for seed in worlds[SEED]
        ]
        self._pushed_at = np.zeros(len(models), dtype=np.int64)
        self._memory: dict[str, Any] = {}
        self._up = np.arange(many)
        self._lasted = np.zeros(many, dtype=np.int64)  # control steps
        self._energy = np.zeros(many)
        self._peak = np.zeros(many)
        self._effort = np.zeros(many)
        self._broken = np.zeros(many, dtype=bool)

    def advance(self, step: int) -> bool:
        """A control step of those that are up; whether any is up after it."""
        from mujoco.batch import SimulationError

        robot, up = self._robot, self._up
        sensed = self._sensed(step * robot.control_step_s)
        asked = self._controls(sensed)
        self._queue[step % len(self._queue), up] = asked
        late = (step - self._delay[self._world[up]]) % len(self._queue)
        self._ctrl[up] = self._queue[late, up]
        self._pushes(step)
        try:
            self._batch.step(up, nstep=robot.substeps)
        except SimulationError as error:  # those have not moved, the others have
            self.qpos[error.ids] = np.nan
        if self._is_clipped:
            power = self._torques[up] * self._qvel[up]
        else:
            power = self._forces[up] * self._speeds[up]
        self._energy[up] += np.abs(power).sum(axis=1) * robot.control_step_s
        self._effort[up] += (asked**2).mean(axis=1)
        self._peak[up] = np.maximum(
            self._peak[up], np.abs(self._torques[up]).max(axis=1)
        )
        now = self._seen(
            (step + 1) * robot.control_step_s, self.qpos[up], self._qvel[up]
        )
        down = robot.is_down(now, self._start_m)
        stays = (
            np.isfinite(self.qpos[up]).all(axis=1)
            & ~self._broken[up]
            & ~np.asarray(down)
        )
        self._lasted[up[stays]] += 1
        if not stays.all():
            self._up = up[stays]
            for name, kept in self._memory.items():
                self._memory[name] = np.asarray(kept)[stays]
        return bool(len(self._up))

    def columns(self, steps: int) -> dict[str, Floats]:
        """Columns of all robots, [n, w]; NaN where a controller gave no number."""
        seconds = np.maximum(self._lasted, 1) * self._robot.control_step_s
        distance = np.nan_to_num(self._place[:, 0] - self._start[0])
        moved = np.maximum(distance, 1e-6)
        weight = self._weight * moved
        # of a robot without weight, whose column is left out
        cost = np.full(len(weight), np.nan)
        np.divide(self._energy, weight, out=cost, where=weight > 0.0)
        cost = np.minimum(cost, MOST_COST)
        found = {
            SURVIVED: self._lasted / steps,
            "distance_m": distance,
            "speed_mps": distance / seconds,
            "energy_j": self._energy,
            "cost_of_transport": cost,
            "peak_torque_nm": self._peak,
            "effort": self._effort / np.maximum(self._lasted, 1),
        }
        for values in found.values():
            values[self._broken] = np.nan
        return {name: values.reshape(self._shape) for name, values in found.items()}

    def _controls(self, sensed: SensedState) -> Floats:
        """The controller's controls of those that are up, [n, nu]."""
        point = {name: each[self._up] for name, each in self._point.items()}
        shape = (len(self._up), self._ctrl.shape[1])
        found = np.asarray(
            self._robot.controller(point, sensed, self._memory), dtype=np.float64
        )
        if found.shape != shape:
            allowed = f"controls of shape {list(shape)} (robots, controls), not {list(found.shape)}"
            raise InputError("controller", self._robot.name, allowed)
        broken: NDArray[np.bool_] = ~np.all(np.isfinite(found), axis=1)
        self._broken[self._up[broken]] = True
        return np.where(broken[:, None], 0.0, found)

    def _sensed(self, time_s: float) -> SensedState:
        """What the controller is told, with noise: a world's is the same for all its points."""
        qpos, qvel = self.qpos[self._up], self._qvel[self._up]
        if self._noisy.any():
            noise = np.zeros_like(self._noise)
            # a world draws what it needs, in any company
            for k in np.flatnonzero(self._noisy):
                noise[k] = self._noise[k] * self._draws[k].standard_normal(
                    noise.shape[1]
                )
            world = self._world[self._up]
            rows = self._noisy[world]
            turns = {
                first: _turns(noise[:, first : first + 3])
                for first in self._quaternions
            }
            # of a quaternion, three of the four numbers are an angle each
            for first in turns:
                noise[:, first : first + 4] = 0.0
            qpos[rows] += noise[world[rows], : qpos.shape[1]]
            qvel[rows] += noise[world[rows], qpos.shape[1] :]
            for first, turn in turns.items():
                place = slice(first, first + 4)
                qpos[rows, place] = _product(qpos[rows, place], turn[world[rows]])
        return self._seen(time_s, qpos, qvel)

    def _seen(self, time_s: float, qpos: Floats, qvel: Floats) -> SensedState:
        place, turn = self._place[self._up], self._turn[self._up]
        # sums in this order, since the bits of a product of matrices depend on their
        # sizes
        up = turn[:, :, 0] * self._upward[0] + turn[:, :, 1] * self._upward[1]
        up = up + turn[:, :, 2] * self._upward[2]
        upright = self._sign * up[:, self._axis]
        data = self._sensors[self._up]
        sensors = {}
        for name, first, size in self._named:
            found = data[:, first : first + size]
            sensors[name] = found[:, 0].copy() if size == 1 else found
        return SensedState(
            time_s=time_s,
            # A column is contiguous, whatever n, so that its sums have the same bits.
            qpos=np.asfortranarray(qpos),
            qvel=np.asfortranarray(qvel),
            x_m=place[:, 0] - self._start[0],
            height_m=self._sign * place[:, self._axis],
            pitch_rad=np.arctan2(up[:, 0], upright),
            tilt_rad=np.arccos(np.clip(upright, -1.0, 1.0)),
            sensors=sensors,
        )

    def _pushes(self, step: int) -> None:
        """Change the root's velocity where a world's next push is due."""
        if self._rates is None or not self._push.any():
            return
        every = round(PUSH_EVERY_S / self._robot.control_step_s)
        if step % every == 0:
            drawn = np.zeros((len(self._push), 2))
            for k in np.flatnonzero(self._push):
                drawn[k] = self._draws[k].random(2)
            first = round(START_S / self._robot.control_step_s) if step == 0 else 0
            self._pushed_at = (
                step + first + (drawn[:, 0] * (every - first)).astype(np.int64)
            )
            self._push = np.abs(self._push) * np.where(drawn[:, 1] < 0.5, -1.0, 1.0)
        due = self._world[self._up]
        due = np.where(self._pushed_at[due] == step, self._push[due], 0.0)
        for dof in np.flatnonzero(self._rates):
            self._qvel[self._up, dof] += due * self._rates[dof]


def _turns(angles: Floats) -> Floats:
    """Unit quaternions [w, 4] of turns by these angles about x, y and z, [w, 3] in rad."""
    import mujoco

    found = np.zeros((len(angles), 4))
    found[:, 0] = 1.0
    for turn, angle in zip(found, angles, strict=True):
        mujoco.mju_quatIntegrate(turn, angle, 1.0)
    return found


def _product(first: Floats, second: Floats) -> Floats:
    """Quaternions [n, 4] one after the other; elementwise, so that no bit depends on n."""
    a, b, c, d = first.T
    w, x, y, z = second.T
    return np.column_stack(
        [
            a * w - b * x - c * y - d * z,
            a * x + b * w + c * z - d * y,
            a * y - b * z + c * w + d * x,
            a * z + b * y - c * x + d * w,
        ]
    )
