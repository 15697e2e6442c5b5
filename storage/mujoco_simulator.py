"""A MuJoCo model under a controller of one's own as the simulator of a store.

docs/robots.md has an example. Any MJCF does; the worlds of `WORLDS` change it before a
run, and the columns are `COLUMNS`. All robots of a call stand in one batch of MuJoCo's,
which gives each the bits of a loop over `mj_step`. A control holds for some physics
steps, in which no Python runs.
"""

import copy
import hashlib
import tomllib
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from optuna.distributions import (
    BaseDistribution,
    CategoricalDistribution,
    IntDistribution,
)

from storage.commit import writable
from storage.function_simulator import (
    ENDED,
    SEED,
    DrawnNumbers,
    FunctionSimulator,
    NumberRanges,
    code_of,
    source_of,
)
from storage.inputs import checks
from storage.inputs.config import Table
from storage.inputs.errors import InputError, listed, one_line, shortened
from storage.inputs.reading import is_file
from storage.mujoco_herd import Herd, Robot, SensedState
from storage.mujoco_worlds import (
    Floats,
    change,
    gravity_of,
    numerics_of,
    reason_against,
    reason_against_default_fall,
    roughen,
)
from storage.simulator import SURVIVED

KNOWN = tomllib.loads(
    Path(__file__).with_name("mujoco.toml").read_text(encoding="utf-8")
)
WORLDS: dict[str, float] = KNOWN["worlds"]
COLUMNS: tuple[str, ...] = (SURVIVED, *KNOWN["columns"])
ALLOWED: dict[str, list[Any]] = KNOWN["allowed"]  # least, most, and these in words
COST = "cost_of_transport"  # which a model without gravity does not have

OF_FILES = (  # what MuJoCo makes of the files that a model names: fields of the compiled model
    "mesh_vert",
    "mesh_face",
    "mesh_pos",
    "mesh_quat",
    "hfield_size",
    "hfield_data",
    "skin_vert",
    "skin_face",
    "tex_data",
)
LONGEST_RUN_S = 10_000.0  # of one run alone, as of a walk (`taichi_nmm.simulate`)
LARGEST_BATCH = 1024  # robots: beyond, the caches of a processor are too small


Controller = Callable[[Mapping[str, Any], SensedState, dict[str, Any]], Floats]
Rule = Callable[[SensedState], NDArray[np.bool_]]


def fallen(sensed: SensedState, start_m: float) -> NDArray[np.bool_]:
    """The rule of a fall if the user gives none: below half of the start, or tilted by 1 rad.

    A model of which half of the start's height is no sign of a fall is refused without
    a rule.

    Args:
        sensed: of the n robots that are up.
        start_m: height of the root body at the start.
    """
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


def a_model(field: str, value: Any) -> Any:
    """A function that makes a model, as it is; or the path of a file that can be one."""
    if callable(value):
        return value
    with writable(Path(checks.path(field, value)), field):
        return Path(value).resolve()


of_one_run = checks.checked(
    point=checks.by_name(checks.anything),
    world=checks.by_name(checks.number()),
    seconds=checks.number(0.0, LONGEST_RUN_S),
)


class MujocoSimulator(FunctionSimulator):
    """Robots of an MJCF model in MuJoCo. It pickles, if its functions are of a module."""

    @checks.checked(
        model=a_model,
        controller=checks.function,
        worlds=checks.optional(checks.by_name(checks.number())),
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
            model: an MJCF file, or a function that returns an `mujoco.MjSpec`, for
                sensors that a file lacks.
            controller: `controller(point, sensed, memory)` returns controls [n, nu].
                `point` has the parameters by name, [n]. `memory` is a dict, empty at
                the start, whose arrays [n, ...] the controller keeps from call to call.
            parameters: Optuna's distributions by name.
            worlds: numbers of the base setting that are not those of `WORLDS`. A number
                that has no meaning for the model, such as a slope without gravity, is
                refused.
            control_step_s: how long controls hold, in whole physics steps; None is one
                of these.
            fallen: whether a robot's run is over, [n]; by default `fallen` of this
                module.
            start_qpos: MuJoCo's positions at the start; None is the model's.
            root: the body that place, height and tilt are of, and that pushes move;
                None is the first.
            measures: columns that tell candidates apart, with the ranges that a search
                covers.

        Raises:
            InputError: MuJoCo is missing, the model does not load or lacks actuators, a
                world's number or the default rule of a fall has no meaning for it.
        """
        if find_spec("mujoco") is None or find_spec("mujoco.batch") is None:
            allowed = "MuJoCo 4.0 or newer: pip install 'taichi-nmm[mujoco]'"
            raise InputError("simulator", "MujocoSimulator", allowed)
        given = dict(worlds or {})
        for name in given:
            if name not in WORLDS:
                raise InputError(
                    f"worlds.{name}", given[name], f"one of {listed(WORLDS, name)}"
                )
        self.model = Path(model) if isinstance(model, str) else model
        self._fallen, self._root_name = fallen, root
        self._start_qpos = (
            None if start_qpos is None else np.array(start_qpos, dtype=np.float64)
        )
        super().__init__(
            controller,
            parameters=parameters,
            columns=[
                name
                for name in COLUMNS
                if name != COST or gravity_of(self._plain).any()
            ],
            worlds={**WORLDS, **given},
            measures=measures,
            batch=True,
        )
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
        if not 1 <= self._root < self._plain.nbody:
            bodies = [self._plain.body(k).name for k in range(1, self._plain.nbody)]
            names = listed(bodies, root)
            raise InputError("root", root, f"a body of the model: {names}")
        self._require_worlds(
            {name: np.array([value]) for name, value in self.worlds.items()}
        )
        if fallen is None:
            reason = reason_against_default_fall(self._plain, self._root, self._start)
            if reason:
                allowed = f"a rule of your own for {self._shown}: {reason}"
                raise InputError("fallen", None, allowed)

    @property
    def code_version(self) -> str:
        """A digest of the files of controller and rule, of the model, and of the files it names."""
        numerics = numerics_of(self._plain, self._root, self._start)
        digest = hashlib.sha256(numerics + super().code_version.encode())
        digest.update(self._spec().to_xml().encode())
        if self._fallen is not None and source_of(self._fallen) != self._source:
            digest.update(code_of(self._fallen))
        if self._names_files:
            for name in OF_FILES:
                digest.update(getattr(self._plain, name).tobytes())
        return digest.hexdigest()[:16]

    @property
    def _names_files(self) -> bool:
        """Whether meshes, height fields or pictures of the model are in files of their own."""
        spec = self._spec()
        named = [each.file for each in (*spec.meshes, *spec.hfields, *spec.skins)]
        for texture in spec.textures:
            named += [texture.file, *texture.cubefiles]
        return any(named)

    @property
    def outcomes(self) -> tuple[str, ...]:
        """How far each run came, what it cost and how fast it was."""
        cost = COST if COST in (self.columns.names or ()) else "energy_j"
        return (SURVIVED, cost, "speed_mps")

    @property
    def outcome_type(self) -> type[np.float32]:
        """Half the place; no column is large."""
        return np.float32

    @property
    def packages(self) -> tuple[str, ...]:
        """NumPy and MuJoCo."""
        return ("numpy", "mujoco")

    def document(self) -> dict[str, Any]:
        """The base setting's world, how long controls hold; root and rule, where they are given."""
        start = None if self._start_qpos is None else self._start_qpos.tolist()
        root = {} if self._root_name is None else {"root": self._root_name}
        rule = {} if self._fallen is None else {"fallen": self._fallen.__qualname__}
        own = {"control_step_s": self.control_step_s, "start_qpos": start}
        return super().document() | own | root | rule

    def read_worlds(self, table: Table) -> NumberRanges:
        """The table [world], of which each number has a meaning for the model."""
        rule = super().read_worlds(table)
        self._require_worlds(
            {name: np.array(ends) for name, ends in rule.ranges.items()}
        )
        return rule

    def __getstate__(self) -> dict[str, Any]:
        """Without the compiled model and what follows from it."""
        return {
            key: value
            for key, value in vars(self).items()
            if key not in ("_plain", "_start")
        }

    def _compute(
        self, point: Any, world: Mapping[str, Any], seconds: float
    ) -> Mapping[str, Any]:
        """Columns [n, w] of n points [n, 1] in w worlds [1, w]."""
        points = {name: np.asarray(each)[:, 0] for name, each in point.items()}
        worlds = {name: np.asarray(each)[0] for name, each in world.items()}
        self._require_worlds(worlds)
        count, many = len(next(iter(points.values()))), len(worlds[SEED])
        names = [name for name in self.columns.names or () if name != ENDED]
        found = {name: np.zeros((count, many)) for name in names}
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
                for name in names:
                    found[name][rows, places] = columns[name]
        return found

    @of_one_run
    def trial(
        self, point: Mapping[str, Any], world: Mapping[str, float], seconds: float
    ) -> dict[str, float]:
        """The columns of one run of a point in a world, bit by bit those of a store.

        Args:
            point: the parameters by name.
            world: numbers of `WORLDS`, and `seed` for what the run draws; others are
                those of the base setting.
            seconds: how long it runs, if it does not fall; at most 10,000.

        Returns:
            Columns by name; NaN in a run whose controller gave no number.

        Raises:
            InputError: a parameter or a number of the world that is missing or unknown.
        """
        points, worlds = self._alone(point, world)
        shaped = {name: each[:, None] for name, each in points.items()}
        whole = {name: each[None, :] for name, each in worlds.items()}
        found = self._compute(shaped, whole, seconds)
        return {name: float(each[0, 0]) for name, each in found.items()}

    @of_one_run
    def states(
        self, point: Mapping[str, Any], world: Mapping[str, float], seconds: float
    ) -> tuple[Any, list[Floats]]:
        """The model of a world, and MuJoCo's positions in a run of a point, a control step each.

        Args:
            point: parameters by name.
            world: numbers by name; those of `WORLDS` that it has not are those of the
                base setting.
            seconds: how long the run lasts at most; no more than 10,000.

        Raises:
            InputError: a parameter or a number of the world that is missing or unknown.
        """
        points, worlds = self._alone(point, world)
        models, seen = [self._model_of(_one(worlds, 0))], list[Floats]()
        self._walk(
            points, worlds, models, seconds, lambda qpos: seen.append(qpos[0].copy())
        )
        return models[0], seen

    def _alone(
        self, point: Mapping[str, Any], world: Mapping[str, float]
    ) -> tuple[dict[str, NDArray[Any]], DrawnNumbers]:
        """A point and a world as arrays of one."""
        if set(point) != set(self.space):
            raise InputError(
                "point", list(point), f"the parameters {', '.join(self.space)}"
            )
        for name in world:
            if name not in self.worlds and name != SEED:
                known = ", ".join((*self.worlds, SEED))
                raise InputError(f"world.{name}", world[name], f"one of {known}")
        whole = {SEED: 0.0} | self.worlds | dict(world)
        if not (whole[SEED] >= 0.0 and float(whole[SEED]).is_integer()):
            raise InputError(f"world.{SEED}", whole[SEED], "a whole number, 0 or more")
        worlds = {name: np.array([float(value)]) for name, value in whole.items()}
        self._require_worlds(worlds)
        values = {name: self._as_stored(name, point[name]) for name in self.space}
        return {
            name: self._array(name, [value]) for name, value in values.items()
        }, worlds

    def _as_stored(self, name: str, value: Any) -> Any:
        """A parameter's value as a store's rows have it."""
        distribution, field = self.space[name], f"point.{name}"
        if isinstance(distribution, CategoricalDistribution):
            if value not in distribution.choices:
                raise InputError(field, value, f"one of {distribution.choices}")
            return value
        number = float(checks.number()(field, value))
        if not isinstance(distribution, IntDistribution):
            return number
        if not number.is_integer():
            raise InputError(field, value, "a whole number")
        return int(number)

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

        steps = round(seconds / self.control_step_s)
        if steps < 1:
            allowed = f"{self.control_step_s:g} s, one control step, or more"
            raise InputError("seconds", seconds, allowed)
        herd = Herd(self.robot, points, worlds, models)
        warn = mujoco.get_mju_user_warning()
        # no lines, nor a file, on who diverges
        mujoco.set_mju_user_warning(lambda text: None)
        try:
            for step in range(steps):
                watch(herd.qpos)
                if not herd.advance(step):
                    break
        finally:
            mujoco.set_mju_user_warning(warn)
        return herd.columns(steps)

    @property
    def robot(self) -> Robot:
        """What all robots of a call share."""
        return Robot(
            name=self.name,
            model=self._plain,
            root=self._root,
            start_qpos=self._start_qpos,
            controller=self.function,
            is_down=self._is_down,
            control_step_s=self.control_step_s,
            substeps=self._substeps,
        )

    def _is_down(self, sensed: SensedState, start_m: float) -> NDArray[np.bool_]:
        if self._fallen is None:
            return fallen(sensed, start_m)
        return self._fallen(sensed)

    def _require_worlds(self, worlds: DrawnNumbers) -> None:
        """Refuse numbers out of range, and numbers that have no meaning for the model."""
        for name, values in worlds.items():
            if name == SEED:
                continue
            least, most, allowed = ALLOWED.get(name, (0.0, np.inf, "0 or more"))
            for value in values[~((values >= least) & (values <= most))]:
                raise InputError(f"world.{name}", float(value), allowed)
            for value in values[values != WORLDS[name]][:1]:
                reason = reason_against(self._plain, self._root, self._start, name)
                if reason:
                    raise self._meaningless(name, float(value), reason)

    def _meaningless(self, name: str, value: float, reason: str) -> InputError:
        allowed = f"{WORLDS[name]:g} for {self._shown}: {reason}"
        return InputError(f"world.{name}", value, allowed)

    @property
    def _shown(self) -> str:
        if isinstance(self.model, Path):
            return self.model.name
        return str(getattr(self.model, "__name__", type(self.model).__name__))

    @cached_property
    def _start(self) -> Floats:
        """Place of the root at the start, [3] in m."""
        import mujoco

        data = mujoco.MjData(self._plain)
        if self._start_qpos is not None:
            data.qpos[:] = self._start_qpos
        mujoco.mj_kinematics(self._plain, data)
        return np.array(data.xpos[self._root], dtype=np.float64)

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

        kind, name = mujoco.mjtObj.mjOBJ_BODY, self._root_name
        return int(mujoco.mj_name2id(self._plain, kind, one_line(name)))

    def _spec(self) -> Any:
        """The model as it came, and what every run of it needs."""
        import mujoco

        try:
            if not isinstance(self.model, Path):
                spec = self.model()
            elif is_file(self.model):
                spec = mujoco.MjSpec.from_file(str(self.model))
            else:
                allowed = "an MJCF file, or a function that returns an MjSpec"
                raise InputError("model", self.model.name, allowed)
        except InputError:
            raise
        except ValueError as error:
            raise self._unusable(error) from None
        if not isinstance(spec, mujoco.MjSpec):
            raise InputError(
                "model", type(spec).__name__, "a function that returns an MjSpec"
            )
        # else falls are hidden
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        return spec

    def _model_of(self, world: Mapping[str, float]) -> Any:
        """The compiled model of a world."""
        draws = np.random.default_rng(
            np.random.SeedSequence(int(world[SEED]), spawn_key=(0,))
        )
        model = copy.copy(self._plain)
        if world["rough_m"] > 0.0:
            spec = self._spec()
            reason = roughen(spec, self._start, world["rough_m"], draws)
            if reason:
                raise self._meaningless("rough_m", world["rough_m"], reason)
            model = spec.compile()
        change(model, world, draws)
        return model


def _one(worlds: Mapping[str, Any], place: int) -> dict[str, float]:
    return {name: float(each[place]) for name, each in worlds.items()}
