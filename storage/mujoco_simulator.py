"""A MuJoCo model under a controller of one's own as the simulator of a store.

docs/robots.md has an example. Any MJCF does; the worlds of `WORLDS` change it before a run, and the
columns are `COLUMNS`. All robots of a call stand in one batch of MuJoCo's, which gives each the
bits of a loop over `mj_step`. A control holds for some physics steps, in which no Python runs.
"""

import hashlib
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from optuna.distributions import BaseDistribution

from storage.function_simulator import SEED, DrawnNumbers, FunctionSimulator
from storage.simulator import SURVIVED
from taichi_nmm import checks
from taichi_nmm.errors import InputError, listed, one_line, shortened

Floats = NDArray[np.float64]

KNOWN = tomllib.loads(Path(__file__).with_name("mujoco.toml").read_text(encoding="utf-8"))
WORLDS: dict[str, float] = KNOWN["worlds"]
COLUMNS: tuple[str, ...] = (SURVIVED, *KNOWN["columns"])
ALLOWED: dict[str, list[Any]] = KNOWN["allowed"]  # least, most, and these in words
MOST_COST = 100.0
NUMERICS = b"1"  # raised with each change of this file that changes what a run gives

PUSH_EVERY_S = 2.0
START_S = 0.5  # without pushes
ROUGH_CELL_M = 0.2
ROUGH_LENGTH_M, ROUGH_WIDTH_M = 80.0, 20.0  # its middle is below the start
LEVEL_M = 1.0  # around the start, where rough ground is level
BASE_M = 1.0  # of rough ground below its lowest place
LARGEST_BATCH = 1024  # robots: beyond, the caches of a processor are too small


@dataclass(frozen=True)
class SensedState:
    """What a controller knows of the n robots that are up; noise of the world is in it."""

    time_s: float
    qpos: Floats  # [n, nq], MuJoCo's positions
    qvel: Floats  # [n, nv], its velocities
    x_m: Floats  # [n], of the root body; with height, tilt and sensors of one physics step before
    height_m: Floats  # [n], of the root body
    pitch_rad: Floats  # [n], of the root body from its start; forwards is positive
    tilt_rad: Floats  # [n], in any direction, from 0
    sensors: Mapping[str, Floats]  # of the model, by name, [n] or [n, k]


Controller = Callable[[Mapping[str, Any], SensedState, dict[str, Any]], Floats]
Rule = Callable[[SensedState], NDArray[np.bool_]]


def fallen(sensed: SensedState, start_m: float) -> NDArray[np.bool_]:
    """The rule of a fall if the user gives none: below half of the start, or tilted by 1 rad."""
    return (sensed.height_m < 0.5 * start_m) | (sensed.tilt_rad > 1.0)


def gymnasium_model(file: str) -> Path:
    """An MJCF that Gymnasium's wheel carries, such as "walker2d_v5.xml"; no code of it is run.

    Raises:
        InputError: Gymnasium is not installed, or has no such file.
    """
    found = find_spec("gymnasium")
    if found is None or found.origin is None:
        raise InputError("model", file, "Gymnasium's: pip install gymnasium")
    folder = Path(found.origin).parent / "envs" / "mujoco" / "assets"
    names = sorted(each.name for each in folder.glob("*.xml"))
    if file not in names:
        raise InputError("model", file, f"one of {listed(names, file)}")
    return folder / file


class MujocoSimulator(FunctionSimulator):
    """Robots of an MJCF model in MuJoCo. It pickles, if its functions are of a module."""

    @checks.checked(
        controller=checks.function,
        control_step_s=checks.optional(checks.number(1e-5, 1.0)),
        fallen=checks.optional(checks.function),
        start_qpos=checks.optional(checks.each(checks.number())),
        root=checks.optional(checks.text),
    )
    def __init__(
        self,
        model: str | Path | Callable[[], Any],
        controller: Controller,
        *,
        parameters: Mapping[str, BaseDistribution],
        worlds: Mapping[str, float] | None = None,
        control_step_s: float | None = None,
        fallen: Rule | None = None,
        start_qpos: Sequence[float] | None = None,
        root: str | None = None,
        measures: Mapping[str, tuple[float, float]] | None = None,
    ) -> None:
        """Loads the model once, so that it is refused here if anywhere.

        Args:
            model: an MJCF file, or a function that returns an `mujoco.MjSpec`, for sensors that a
                file lacks.
            controller: `controller(point, sensed, memory)` returns controls [n, nu]. `point` has
                the parameters by name, [n]. `memory` is a dict, empty at the start, whose arrays
                [n, ...] the controller keeps from call to call.
            parameters: Optuna's distributions by name.
            worlds: numbers of the base setting that are not those of `WORLDS`.
            control_step_s: how long controls hold, in whole physics steps; None is one of these.
            fallen: whether a robot's run is over, [n]; by default `fallen` of this module.
            start_qpos: MuJoCo's positions at the start; None is the model's.
            root: the body that height and tilt are of; None is the first.
            measures: columns that tell candidates apart, with the ranges that a search covers.

        Raises:
            InputError: MuJoCo is missing, the model does not load or lacks ground or actuators.
        """
        if find_spec("mujoco") is None or find_spec("mujoco.batch") is None:
            allowed = "MuJoCo 4.0 or newer: pip install 'taichi-nmm[mujoco]'"
            raise InputError("simulator", "MujocoSimulator", allowed)
        given = dict(worlds or {})
        for name in given:
            if name not in WORLDS:
                raise InputError(f"worlds.{name}", given[name], f"one of {listed(WORLDS, name)}")
        super().__init__(
            controller,
            parameters=parameters,
            columns=COLUMNS,
            worlds={**WORLDS, **given},
            measures=measures,
            batch=True,
        )
        self.model = Path(model).resolve() if isinstance(model, str | Path) else model
        self._fallen, self._root_name = fallen, root
        self._start_qpos = None if start_qpos is None else np.array(start_qpos, dtype=np.float64)
        model_s = self._plain.opt.timestep
        self.control_step_s = model_s if control_step_s is None else control_step_s
        self._substeps = round(self.control_step_s / model_s)
        if abs(self._substeps * model_s - self.control_step_s) > 1e-9:
            allowed = f"a whole number of the model's steps of {model_s:g} s"
            raise InputError("control_step_s", self.control_step_s, allowed)
        if self._plain.nu == 0:
            raise InputError("model", self._shown, "a model with actuators")
        if self._start_qpos is not None and len(self._start_qpos) != self._plain.nq:
            allowed = f"{self._plain.nq} numbers, as the model has positions"
            raise InputError("start_qpos", list(self._start_qpos), allowed)
        if not 0 <= self._root < self._plain.nbody:
            bodies = [self._plain.body(k).name for k in range(1, self._plain.nbody)]
            names = listed(bodies, root)
            raise InputError("root", root, f"a body of the model: {names}")

    @property
    def code_version(self) -> str:
        """A digest of the controller's file and of the model."""
        digest = hashlib.sha256(NUMERICS + super().code_version.encode())
        digest.update(self._spec().to_xml().encode())
        return digest.hexdigest()[:16]

    @property
    def outcomes(self) -> tuple[str, ...]:
        """How far each run came, what it cost and how fast it was."""
        return (SURVIVED, "cost_of_transport", "speed_mps")

    @property
    def outcome_type(self) -> type[np.float32]:
        """Half the place; no column is large."""
        return np.float32

    @property
    def packages(self) -> tuple[str, ...]:
        """NumPy and MuJoCo."""
        return ("numpy", "mujoco")

    def document(self) -> dict[str, Any]:
        """The base setting's world, and how long controls hold."""
        start = None if self._start_qpos is None else self._start_qpos.tolist()
        return super().document() | {"control_step_s": self.control_step_s, "start_qpos": start}

    def __getstate__(self) -> dict[str, Any]:
        """Without the compiled model."""
        return {key: value for key, value in vars(self).items() if key != "_plain"}

    def _compute(self, point: Any, world: Mapping[str, Any], seconds: float) -> Mapping[str, Any]:
        """Columns [n, w] of n points [n, 1] in w worlds [1, w]."""
        points = {name: np.asarray(each)[:, 0] for name, each in point.items()}
        worlds = {name: np.asarray(each)[0] for name, each in world.items()}
        self._require_worlds(worlds)
        count, many = len(next(iter(points.values()))), len(worlds[SEED])
        found = {name: np.zeros((count, many)) for name in COLUMNS}
        kinds = worlds["rough_m"] > 0.0
        for rough in np.unique(kinds):  # models of one batch have the same sizes
            places = np.flatnonzero(kinds == rough)
            own = {name: each[places] for name, each in worlds.items()}
            models = [self._model_of(_one(own, k)) for k in range(len(places))]
            size = max(LARGEST_BATCH // len(places), 1)
            for first in range(0, count, size):
                rows = slice(first, first + size)
                some = {name: each[rows] for name, each in points.items()}
                columns = self._walk(some, own, models, seconds)
                for name in COLUMNS:
                    found[name][rows, places] = columns[name]
        return found

    def states(
        self, point: Mapping[str, Any], world: Mapping[str, float], seconds: float
    ) -> tuple[Any, list[Floats]]:
        """The model of a world, and MuJoCo's positions in a run of a point, a control step each.

        Numbers of `WORLDS` that the world does not have are those of the base setting.
        """
        whole = {SEED: 0.0} | self.worlds | dict(world)
        worlds = {name: np.array([float(value)]) for name, value in whole.items()}
        self._require_worlds(worlds)
        models, seen = [self._model_of(_one(worlds, 0))], list[Floats]()
        points = {name: np.array([value]) for name, value in point.items()}
        self._walk(points, worlds, models, seconds, lambda qpos: seen.append(qpos[0].copy()))
        return models[0], seen

    def _walk(
        self,
        points: Mapping[str, Any],
        worlds: DrawnNumbers,
        models: list[Any],
        seconds: float,
        watch: Callable[[Floats], None] = lambda qpos: None,
    ) -> dict[str, Floats]:
        """Columns of n points in w worlds with these models, [n, w]."""
        import mujoco

        herd = _Herd(self, points, worlds, models)
        steps = max(round(seconds / self.control_step_s), 1)
        warn = mujoco.get_mju_user_warning()
        mujoco.set_mju_user_warning(lambda text: None)  # no lines, nor a file, on who diverges
        try:
            for step in range(steps):
                watch(herd.qpos)
                if not herd.advance(step):
                    break
        finally:
            mujoco.set_mju_user_warning(warn)
        return herd.columns(steps)

    def _require_worlds(self, worlds: DrawnNumbers) -> None:
        for name, values in worlds.items():
            least, most, allowed = ALLOWED.get(name, (0.0, np.inf, "0 or more"))
            for value in values[(values < least) | (values > most)] if name != SEED else ():
                raise InputError(f"world.{name}", float(value), allowed)

    @property
    def _shown(self) -> str:
        return self.model.name if isinstance(self.model, Path) else self.model.__name__

    @cached_property
    def _plain(self) -> Any:
        """The compiled model of the base setting."""
        spec = self._spec()
        try:
            return spec.compile()
        except ValueError as error:
            raise self._unusable(error) from None

    def _unusable(self, error: Exception) -> InputError:
        allowed = f"an MJCF that MuJoCo loads ({one_line(shortened(str(error)))})"
        return InputError("model", self._shown, allowed)

    @property
    def _root(self) -> int:
        if self._root_name is None:
            return 1
        import mujoco

        return int(mujoco.mj_name2id(self._plain, mujoco.mjtObj.mjOBJ_BODY, self._root_name))

    def _spec(self) -> Any:
        """The model as it came, and what every run of it needs."""
        import mujoco

        try:
            if not isinstance(self.model, Path):
                spec = self.model()
            elif self.model.is_file():
                spec = mujoco.MjSpec.from_file(str(self.model))
            else:
                allowed = "an MJCF file, or a function that returns an MjSpec"
                raise InputError("model", self.model.name, allowed)
        except InputError:
            raise
        except ValueError as error:
            raise self._unusable(error) from None
        if not isinstance(spec, mujoco.MjSpec):
            raise InputError("model", type(spec).__name__, "a function that returns an MjSpec")
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET  # else falls are hidden
        return spec

    def _model_of(self, world: Mapping[str, float]) -> Any:
        """The compiled model of a world."""
        import mujoco

        spec = self._spec()
        draws = np.random.default_rng(np.random.SeedSequence(int(world[SEED]), spawn_key=(0,)))
        if world["rough_m"] > 0.0:
            _roughen(spec, world["rough_m"], draws)
        model = spec.compile()
        spread = 1.0 + world["mass_spread"] * draws.uniform(-1.0, 1.0, model.nbody)
        model.body_mass[:] *= world["mass"] * spread
        model.body_inertia[:] *= (world["mass"] * world["inertia"] * spread)[:, None]
        model.geom_friction[:, 0] *= world["friction"]
        model.dof_damping[:] *= world["damping"]
        model.dof_armature[:] *= world["armature"]
        # A force is gain x control + bias: both are scaled. Of muscles, numbers 2 and 3 are forces.
        is_muscle = model.actuator_gaintype == mujoco.mjtGain.mjGAIN_MUSCLE
        for parameters in (model.actuator_gainprm, model.actuator_biasprm):
            parameters[~is_muscle, :3] *= world["strength"]
            parameters[is_muscle, 2:4] *= world["strength"]
        turn = np.arctan(world["slope"])  # the ground stays level, and gravity leans
        down = np.linalg.norm(model.opt.gravity)
        model.opt.gravity[:] = [-down * np.sin(turn), 0.0, -down * np.cos(turn)]
        mujoco.mj_setConst(model, mujoco.MjData(model))
        return model


class _Herd:
    """The robots of a call: n points x w worlds, and what became of each."""

    def __init__(
        self,
        simulator: MujocoSimulator,
        points: Mapping[str, Any],
        worlds: DrawnNumbers,
        models: list[Any],
    ) -> None:
        from mujoco.batch import Batch

        self._simulator = simulator
        self._shape = len(next(iter(points.values()))), len(models)
        many = self._shape[0] * self._shape[1]
        self._world = np.tile(np.arange(len(models)), self._shape[0])  # of each robot
        self._point = {name: np.repeat(each, len(models)) for name, each in points.items()}
        self._batch = Batch(models[0], many, nthread=1)
        self._batch.set_models([models[k] for k in self._world])
        bind, model = self._batch.bind, models[0]
        self.qpos, self._qvel, self._ctrl = bind("qpos"), bind("qvel"), bind("ctrl")
        self._place, self._turn, self._forces = bind("xpos"), bind("xmat"), bind("actuator_force")
        self._rates, self._sensors = bind("actuator_velocity"), bind("sensordata")
        self._torques = bind("qfrc_actuator")
        self._batch.reset()
        if simulator._start_qpos is not None:
            self.qpos[:] = simulator._start_qpos
            self._batch.forward()
        self._named = [
            (model.sensor(k).name, model.sensor_adr[k], model.sensor_dim[k])
            for k in range(model.nsensor)
        ]
        root = simulator._root
        self._place, self._turn = self._place[:, root], self._turn[:, root].reshape(many, 3, 3)
        self._start = self._place[0].copy()
        self._upward = self._turn[0, 2].copy()  # the vertical, in the root body's frame
        weights = [each.body_mass.sum() * np.linalg.norm(each.opt.gravity) for each in models]
        self._weight = np.array(weights, dtype=np.float64)[self._world]
        self._delay = np.rint(worlds["delay_s"] / simulator.control_step_s).astype(np.int64)
        self._queue = np.zeros((int(self._delay.max()) + 1, *self._ctrl.shape))
        self._noise = np.hstack([
            np.repeat(worlds["noise"][:, None], model.nq, axis=1),
            np.repeat(worlds["noise_rate"][:, None], model.nv, axis=1),
        ])  # fmt: skip
        self._noisy: NDArray[np.bool_] = np.any(self._noise > 0.0, axis=1)  # of each world
        self._push = worlds["push_mps"]
        self._draws = [
            np.random.default_rng(np.random.SeedSequence(int(seed), spawn_key=(1,)))
            for seed in worlds[SEED]
        ]
        self._pushed_at = np.zeros(len(models), dtype=np.int64)
        self._memory: dict[str, Any] = {}
        self._up = np.arange(many)
        self._lasted = np.zeros(many, dtype=np.int64)  # control steps
        self._energy, self._peak, self._effort = np.zeros(many), np.zeros(many), np.zeros(many)
        self._broken = np.zeros(many, dtype=bool)

    def advance(self, step: int) -> bool:
        """A control step of those that are up; whether any is up after it."""
        from mujoco.batch import SimulationError

        simulator, up = self._simulator, self._up
        sensed = self._sensed(step * simulator.control_step_s)
        asked = self._controls(sensed)
        self._queue[step % len(self._queue), up] = asked
        late = (step - self._delay[self._world[up]]) % len(self._queue)
        self._ctrl[up] = self._queue[late, up]
        self._pushes(step)
        try:
            self._batch.step(up, nstep=simulator._substeps)
        except SimulationError as error:  # those have not moved, the others have
            self.qpos[error.ids] = np.nan
        work = np.abs(self._forces[up] * self._rates[up]).sum(axis=1)
        self._energy[up] += work * simulator.control_step_s
        self._effort[up] += (asked**2).mean(axis=1)
        self._peak[up] = np.maximum(self._peak[up], np.abs(self._torques[up]).max(axis=1))
        now = self._seen((step + 1) * simulator.control_step_s, self.qpos[up], self._qvel[up])
        rule = simulator._fallen
        down = fallen(now, float(self._start[2])) if rule is None else rule(now)
        stays = np.isfinite(self.qpos[up]).all(axis=1) & ~self._broken[up] & ~np.asarray(down)
        self._lasted[up[stays]] += 1
        if not stays.all():
            self._up = up[stays]
            for name, kept in self._memory.items():
                self._memory[name] = np.asarray(kept)[stays]
        return bool(len(self._up))

    def columns(self, steps: int) -> dict[str, Floats]:
        """`COLUMNS` of all robots, [n, w]; NaN where a controller gave no number."""
        seconds = np.maximum(self._lasted, 1) * self._simulator.control_step_s
        distance = np.nan_to_num(self._place[:, 0] - self._start[0])
        moved = np.maximum(distance, 1e-6)
        found = {
            SURVIVED: self._lasted / steps,
            "distance_m": distance,
            "speed_mps": distance / seconds,
            "energy_j": self._energy,
            "cost_of_transport": np.minimum(self._energy / (self._weight * moved), MOST_COST),
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
        found = np.asarray(self._simulator.function(point, sensed, self._memory), dtype=np.float64)
        if found.shape != shape:
            raise ValueError(f"controls of shape {list(shape)} are needed, not {list(found.shape)}")
        broken: NDArray[np.bool_] = ~np.all(np.isfinite(found), axis=1)
        self._broken[self._up[broken]] = True
        return np.where(broken[:, None], 0.0, found)

    def _sensed(self, time_s: float) -> SensedState:
        """What the controller is told, with noise: a world's is the same for all its points."""
        qpos, qvel = self.qpos[self._up], self._qvel[self._up]
        if self._noisy.any():
            noise = np.zeros_like(self._noise)
            for k in np.flatnonzero(self._noisy):  # a world draws what it needs, in any company
                noise[k] = self._noise[k] * self._draws[k].standard_normal(noise.shape[1])
            world = self._world[self._up]
            rows = self._noisy[world]
            qpos[rows] += noise[world[rows], : qpos.shape[1]]
            qvel[rows] += noise[world[rows], qpos.shape[1] :]
        return self._seen(time_s, qpos, qvel)

    def _seen(self, time_s: float, qpos: Floats, qvel: Floats) -> SensedState:
        place, turn = self._place[self._up], self._turn[self._up]
        # sums in this order, since the bits of a product of matrices depend on their sizes
        up = turn[:, :, 0] * self._upward[0] + turn[:, :, 1] * self._upward[1]
        up = up + turn[:, :, 2] * self._upward[2]
        data = self._sensors[self._up]
        return SensedState(
            time_s,
            np.asfortranarray(qpos),  # a column is contiguous, whatever n: the same bits
            np.asfortranarray(qvel),
            place[:, 0] - self._start[0],
            place[:, 2].copy(),
            np.arctan2(up[:, 0], up[:, 2]),
            np.arccos(np.clip(up[:, 2], -1.0, 1.0)),
            {
                name: data[:, first].copy() if size == 1 else data[:, first : first + size]
                for name, first, size in self._named
            },
        )

    def _pushes(self, step: int) -> None:
        """Change the root's velocity where a world's next push is due."""
        if not self._push.any():
            return
        every = round(PUSH_EVERY_S / self._simulator.control_step_s)
        if step % every == 0:
            drawn = np.zeros((len(self._push), 2))
            for k in np.flatnonzero(self._push):
                drawn[k] = self._draws[k].random(2)
            first = round(START_S / self._simulator.control_step_s) if step == 0 else 0
            self._pushed_at = step + first + (drawn[:, 0] * (every - first)).astype(np.int64)
            self._push = np.abs(self._push) * np.where(drawn[:, 1] < 0.5, -1.0, 1.0)
        due = self._world[self._up]
        due = np.where(self._pushed_at[due] == step, self._push[due], 0.0)
        self._qvel[self._up, 0] += due


def _one(worlds: Mapping[str, Any], place: int) -> dict[str, float]:
    return {name: float(each[place]) for name, each in worlds.items()}


def _roughen(spec: Any, amplitude_m: float, draws: np.random.Generator) -> None:
    """Put a height field in the place of the ground, a plane of the world."""
    import mujoco

    plane, field = mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_HFIELD
    planes = [geom for geom in spec.worldbody.geoms if geom.type == plane]
    if len(planes) != 1:
        allowed = "a model with one plane as its ground, which rough ground replaces"
        raise InputError("world.rough_m", amplitude_m, allowed)
    (ground,) = planes
    along, across = (round(size / ROUGH_CELL_M) + 1 for size in (ROUGH_LENGTH_M, ROUGH_WIDTH_M))
    x, y = np.meshgrid(
        np.linspace(-0.5, 0.5, along) * ROUGH_LENGTH_M,
        np.linspace(-0.5, 0.5, across) * ROUGH_WIDTH_M,
    )
    heights = draws.random((across, along))
    heights[np.maximum(np.abs(x), np.abs(y)) <= LEVEL_M] = 0.5
    spec.add_hfield(
        name="rough_ground", nrow=across, ncol=along, userdata=heights.ravel(),
        size=[ROUGH_LENGTH_M / 2, ROUGH_WIDTH_M / 2, amplitude_m, BASE_M],
    )  # fmt: skip
    ground.type, ground.hfieldname = field, "rough_ground"
    ground.pos = [*ground.pos[:2], ground.pos[2] - 0.5 * amplitude_m]
