"""Measure on MJCF models of others what each number of a world does, and whether it is right.

    pip install --no-deps --target out/models dm_control gymnasium-robotics robosuite myosuite
    python tools/try_models.py out/models            # folders, files or installed packages
    python tools/try_models.py gymnasium

A row a model. Each number is measured on the model that a world makes, in terms of
mechanics (mass matrices, forces, contacts, velocities), beside MuJoCo's own `mj_step`
on the file as it is. A factor has to change what `SCALED` says, and nothing else of
`quantities`:

    ok       what its name says
    -        the model has nothing that it could change
    refused  MujocoSimulator refuses it for this model; the reasons are below the table
    WRONG    something else; the exit code is 1
"""

import argparse
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from checkout import guarded_imports, run_command

with guarded_imports():
    import mujoco
    import numpy as np
    from numpy.typing import NDArray
    from optuna.distributions import FloatDistribution

    from storage.function_simulator import SEED
    from storage.inputs.errors import InputError, in_a_line
    from storage.mujoco_herd import Herd, SensedState
    from storage.mujoco_simulator import WORLDS, MujocoSimulator
    from storage.mujoco_worlds import FACING, gravity_of, upward

Floats = NDArray[np.float64]

STEPS = 40  # of physics, a control each
SETTLING_STEPS = 300  # before forces, contacts and mass matrices are compared
NOISY_STEPS = 400
FACTOR = 0.6  # of what has a factor
SPREAD = 0.3
SLOPE = 0.2
ROUGH_M = 0.1
PUSH_MPS = 0.7
NOISE = 0.02
DELAY_STEPS = 3
TURN_RAD = 0.3
EXACT = 1e-8  # of what should be equal, relative to the largest
CALM = 1e3  # of positions and rates: in those of a model that blows up, noise is lost
# of a deviation: of all numbers, of one of many coordinates
SIGMAS, SIGMAS_OF_ONE = (4.0, 6.0)
LEAST_FRICTION = 1e-5  # MuJoCo's mjMINMU

WORDS = OK, NOTHING, REFUSED, WRONG = "ok", "-", "refused", "WRONG"

# What each factor scales, of `quantities`.
SCALED = {
    "mass": ("translation", "rotation"),
    "inertia": ("rotation",),
    "friction": ("sliding",),
    "damping": ("damper",),
    "armature": ("armature",),
    "strength": ("forces", "torques"),
}


def never(sensed: SensedState) -> NDArray[np.bool_]:
    """A rule: no run falls."""
    return np.zeros(len(sensed.x_m), dtype=bool)


CONTROLS: list[Floats] = []  # of the model that is measured, [steps, nu]
SEEN: list[SensedState] = []


def follow(point: Any, sensed: SensedState, memory: dict[str, Any]) -> Floats:
    """Controls [n, nu] that were drawn before, whatever the state; it writes down what it sees."""
    steps = memory.get("steps", np.zeros(len(sensed.x_m), dtype=int))
    memory["steps"] = steps + 1
    SEEN.append(sensed)
    (controls,) = CONTROLS
    return np.asarray(controls[steps % len(controls)])


@dataclass
class Measured:
    """A model, in a state in which it moves.

    Attributes:
        simulator: of the model.
        plain: the file's own model, without the automatic reset.
    """

    simulator: MujocoSimulator
    plain: Any

    def __post_init__(self) -> None:
        draws = np.random.default_rng(7)
        model = self.plain
        limited = model.actuator_ctrllimited
        low = np.where(limited, model.actuator_ctrlrange[:, 0], -1.0)
        high = np.where(limited, model.actuator_ctrlrange[:, 1], 1.0)
        self.controls = low + (high - low) * draws.random((NOISY_STEPS, model.nu))
        CONTROLS[:] = [self.controls]
        largest = np.maximum(np.abs(low), np.abs(high))
        self.loud = 1e3 * largest * np.sign(draws.random(model.nu) - 0.5)
        self.data = mujoco.MjData(model)
        for control in self.controls[:SETTLING_STEPS]:
            self.data.ctrl[:] = control
            mujoco.mj_step(model, self.data)
        if not np.isfinite(self.data.qpos).all():
            mujoco.mj_resetData(model, self.data)
        self.rates = self.data.qvel + 0.1 * draws.standard_normal(model.nv)

    @cached_property
    def usual(self) -> dict[str, Floats]:
        """The file's own model in numbers of mechanics."""
        return quantities(self, self.plain)

    def models(self, **numbers: float) -> tuple[Any, Herd]:
        """The model of a world, and a robot in it; refused where a number has no meaning."""
        whole = {SEED: 5.0} | WORLDS | numbers
        drawn = {name: np.array([value]) for name, value in whole.items()}
        self.simulator._require_worlds(drawn)
        model = self.simulator._model_of(whole)
        return model, Herd(
            self.simulator.robot, {"share": np.array([1.0])}, drawn, [model]
        )

    def at(
        self, model: Any, ctrl: Floats | None = None, rates: Floats | None = None
    ) -> Any:
        """A model's data in that state."""
        data = mujoco.MjData(model)
        data.qpos[:], data.act[:] = self.data.qpos, self.data.act
        data.qvel[:] = self.data.qvel if rates is None else rates
        data.ctrl[:] = self.data.ctrl if ctrl is None else ctrl
        mujoco.mj_forward(model, data)
        return data

    def mass_matrix(self, model: Any) -> Floats:
        """In that state, [nv, nv]."""
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, self.at(model), full)
        return full

    def run(self, steps: int, **world: float) -> tuple[Floats, list[SensedState]]:
        """Positions before each step of a world's run, [steps, nq], and what was sensed then."""
        SEEN.clear()
        seconds = steps * self.simulator.control_step_s
        _, states = self.simulator.states({"share": 1.0}, {SEED: 5.0} | world, seconds)
        return np.array(states), SEEN.copy()


def differs(found: Floats, expected: Floats, scale: float = 0.0) -> str:
    """Empty, or by how much two arrays differ, of the largest number or of `scale`."""
    if found.shape != expected.shape:
        return f"of shape {found.shape}, not {expected.shape}"
    scale = max(scale, float(np.abs(expected).max(initial=0.0)), 1e-9)
    off = float(np.abs(found - expected).max(initial=0.0)) / scale
    return "" if off <= EXACT else f"off by {off:.2g} of {scale:.3g}"


def quantities(measured: Measured, model: Any) -> dict[str, Floats]:
    """What a model is, in numbers of mechanics. The first three are its mass matrix in parts."""
    bare = mujoco.MjModel.__copy__(model)
    for name in ("dof_armature", "tendon_armature", "actuator_armature"):
        getattr(bare, name)[:] = 0.0
    mujoco.mj_setConst(bare, mujoco.MjData(bare))
    full, moving = measured.mass_matrix(model), measured.mass_matrix(bare)
    data, jacobian = measured.at(model, rates=measured.rates), np.zeros((3, model.nv))
    translation = np.zeros_like(full)
    for body in range(1, model.nbody):
        mujoco.mj_jacBodyCom(model, data, jacobian, None, body)
        translation += model.body_mass[body] * jacobian.T @ jacobian
    pushed = [
        measured.at(model, ctrl) for ctrl in (None, measured.loud, -measured.loud)
    ]
    torques = np.array([each.qfrc_actuator for each in pushed])
    if model.jnt_actgravcomp.any():  # a part of them carries the weight
        torques = np.zeros_like(torques)
    return {
        "translation": translation,
        "rotation": moving - translation,
        "armature": full - moving,
        "sliding": data.contact.friction[:, :2],
        "rolling": data.contact.friction[:, 2:],
        "damper": data.qfrc_damper,
        "springs": data.qfrc_spring,
        "losses": data.efc_frictionloss,
        "fluid": data.qfrc_fluid,
        "forces": np.array([each.actuator_force for each in pushed]),
        "torques": torques,
    }


def try_factor(measured: Measured, number: str) -> str:
    """Scales what `SCALED` says, and changes nothing else."""
    ours, _ = measured.models(**{number: FACTOR})
    plain, found = measured.usual, quantities(measured, ours)
    inertia = max(
        float(np.abs(plain[name]).max()) for name in ("translation", "rotation")
    )
    for name, usual in plain.items():
        expected = usual * (FACTOR if name in SCALED[number] else 1.0)
        if name == "sliding":
            expected = np.maximum(expected, LEAST_FRICTION)
        # differences of matrices are as exact as these
        is_part = name in ("translation", "rotation", "armature")
        if said := differs(found[name], expected, inertia if is_part else 0.0):
            return f"{name} {said}"
    return "" if any(plain[name].any() for name in SCALED[number]) else NOTHING


def try_mass_spread(measured: Measured) -> str:
    """Mass and inertia of each body by a factor of its own."""
    (ours, _), plain = measured.models(mass_spread=SPREAD), measured.plain
    heavy = plain.body_mass > 0.0
    ratio = ours.body_mass[heavy] / plain.body_mass[heavy]
    off = np.abs(ratio - 1.0)
    if (
        off.max() > SPREAD
        or off.max() < 1e-3
        or (len(ratio) > 1 and np.ptp(ratio) < 1e-3)
    ):
        return f"ratios from {ratio.min():.3g} to {ratio.max():.3g}"
    expected = plain.body_inertia[heavy] * ratio[:, None]
    return differs(ours.body_inertia[heavy] / expected.clip(1e-300), np.sign(expected))


def try_delay(measured: Measured, number: str) -> str:
    """Bit by bit as `mj_step`, with controls that arrive so late; `number` "": at once."""
    late = DELAY_STEPS if number else 0
    controls = np.vstack([np.zeros((late, measured.plain.nu)), measured.controls])[
        :STEPS
    ]
    data, seen = mujoco.MjData(measured.plain), list[Floats]()
    mujoco.mj_forward(measured.plain, data)
    for control in controls:
        seen.append(data.qpos.copy())
        data.ctrl[:] = control
        mujoco.mj_step(measured.plain, data)
    expected = np.array(seen)
    world = {number: late * measured.simulator.control_step_s} if number else {}
    found, _ = measured.run(STEPS, **world)
    whole = np.isfinite(expected).all(axis=1) & (np.abs(expected).max(axis=1) < 1e6)
    count = int(np.argmin([*whole, False]))  # a model may blow up
    return "" if found[:count].tobytes() == expected[:count].tobytes() else "other bits"


def try_noise(measured: Measured, number: str) -> str:
    """What is sensed deviates by so much, in each coordinate, and nothing else does."""
    plain = measured.plain
    states, usual = measured.run(NOISY_STEPS)
    same, noisy = measured.run(NOISY_STEPS, **{number: NOISE})
    if same.tobytes() != states.tobytes():
        return "the robot moves otherwise"
    off = {"noise": list[Floats](), "noise_rate": list[Floats]()}
    for one, other in zip(usual, noisy, strict=True):
        place, rate, turned = one.qpos[0], one.qvel[0], other.qpos[0].copy()
        mujoco.mj_normalizeQuat(plain, turned)
        if np.abs(turned - other.qpos[0]).max() > 1e-9 * np.abs(turned).max():
            return "orientations of another length than 1"
        if np.abs(place).max() < CALM and np.abs(rate).max() < CALM:
            difference = np.zeros(plain.nv)
            mujoco.mj_differentiatePos(plain, difference, 1.0, place, other.qpos[0])
            off["noise"].append(difference)
            off["noise_rate"].append(other.qvel[0] - rate)
    own = np.array(off.pop(number))
    if np.abs(list(off.values())).max(initial=0.0) > 0.0:
        return "other numbers deviate"
    if own.size == 0:
        return NOTHING
    return deviates(own, SIGMAS) or next(filter(None, map(deviates, own.T)), "")


def deviates(off: Floats, sigmas: float = SIGMAS_OF_ONE) -> str:
    """Empty, or how far numbers are from having the deviation `NOISE`."""
    ratio = float(np.sqrt(np.mean(off**2))) / NOISE
    by_chance = sigmas / np.sqrt(2.0 * off.size)
    return "" if abs(ratio - 1.0) < by_chance else f"{ratio:.3f} times the deviation"


def directions(model: Any) -> tuple[Floats, Floats]:
    """Upwards and along x, as heights and runs are measured."""
    axis, sign = upward(model)
    up = np.zeros(3)
    up[axis] = sign
    return up, np.array([1.0, 0.0, 0.0])


def try_slope(measured: Measured) -> str:
    """Gravity as on ground that rises along x."""
    before, after = (
        gravity_of(measured.plain),
        measured.models(slope=SLOPE)[0].opt.gravity,
    )
    up, along = -before / np.linalg.norm(before), directions(measured.plain)[1]
    along = along - (along @ up) * up
    along /= np.linalg.norm(along)
    turned = -np.linalg.norm(before) * (up + SLOPE * along) / np.hypot(1.0, SLOPE)
    return differs(after, turned)


def try_rough(measured: Measured) -> str:
    """Heights of the ground below 300 places, by rays."""
    (ours, _), plain = measured.models(rough_m=ROUGH_M), measured.plain
    (geom,) = np.flatnonzero(ours.geom_type != plain.geom_type).tolist()
    up, along = directions(plain)
    draws, start = np.random.default_rng(3), measured.simulator._start
    places = np.repeat((start + (100.0 - start @ up) * up)[None], 300, axis=0)
    places[1:] += draws.uniform(-35.0, 35.0, (299, 1)) * along
    places[1:] += draws.uniform(-9.0, 9.0, (299, 1)) * np.cross(up, along)
    rough, level = mujoco.MjData(ours), mujoco.MjData(plain)
    mujoco.mj_kinematics(ours, rough)
    mujoco.mj_kinematics(plain, level)
    normal = level.geom_xmat[geom].reshape(3, 3)[:, 2]
    to_plane = (places - level.geom_xpos[geom]) @ normal / (up @ normal)
    to_field = [
        mujoco.mj_rayHfield(ours, rough, geom, place, -up, None) for place in places
    ]
    off = to_plane - np.array(to_field)
    if min(to_field) < 0.0:
        return "holes"
    # along its normal it is half of this away at most, and level at the start
    inside = np.abs(off).max() <= 0.5 * ROUGH_M / FACING and abs(off[0]) < 1e-6
    good = inside and np.ptp(off) > 0.7 * ROUGH_M
    return "" if good else f"from {off.min():.3g} to {off.max():.3g}"


def try_push(measured: Measured) -> str:
    """The root's velocity along x, and nothing else of it."""
    (_, herd), root = measured.models(push_mps=PUSH_MPS), measured.simulator._root
    herd._pushes(0)
    before = herd._qvel[0].copy()
    herd._pushes(int(herd._pushed_at[0]))
    data, found = measured.at(measured.plain, rates=herd._qvel[0] - before), np.zeros(6)
    body = mujoco.mjtObj.mjOBJ_XBODY
    mujoco.mj_objectVelocity(measured.plain, data, body, root, found, 0)
    found[3] = abs(found[3])
    return (
        differs(found, np.array([0.0, 0.0, 0.0, PUSH_MPS, 0.0, 0.0]))
        and f"by {found.round(3)}"
    )


def try_pose(measured: Measured) -> str:
    """Place, height, pitch and tilt of a root that turns forwards; `-` without a free joint."""
    (_, herd), plain, root = measured.models(), measured.plain, measured.simulator._root
    up, along = directions(plain)
    height_m, turn, turned = measured.simulator._start @ up, np.zeros(4), np.zeros(4)
    mujoco.mju_axisAngle2Quat(turn, np.cross(up, along), TURN_RAD)

    def off(*expected: float) -> str:
        seen = herd._seen(0.0, herd.qpos, herd._qvel)
        found = [seen.x_m, seen.height_m - height_m, seen.pitch_rad, seen.tilt_rad]
        good = np.allclose(np.ravel(found), expected, atol=1e-6)
        return "" if good else f"{np.round(np.ravel(found), 3).tolist()}"

    said, joint = off(0.0, 0.0, 0.0, 0.0), plain.body_jntadr[root]
    if said or joint < 0 or plain.jnt_type[joint] != mujoco.mjtJoint.mjJNT_FREE:
        return said or NOTHING
    first = plain.jnt_qposadr[joint]
    mujoco.mju_mulQuat(turned, turn, herd.qpos[0, first + 3 : first + 7])
    herd.qpos[0, first + 3 : first + 7] = turned
    herd.qpos[0, first : first + 3] += 0.25 * along + 0.5 * up
    herd._batch.forward()
    return off(0.25, 0.5, TURN_RAD, TURN_RAD)


def try_fall(measured: Measured) -> str:
    """The default rule: no fall at the start."""
    simulator = measured.simulator
    ruled = MujocoSimulator(simulator.model, follow, parameters=simulator.space)
    row = ruled.trial({"share": 1.0}, {}, 2.0 * ruled.control_step_s)
    return "" if row["survived_fraction"] == 1.0 else "falls at once"


TRIES: dict[str, Callable[[Measured], str]] = {
    "plain": partial(try_delay, number=""),
    "mass": partial(try_factor, number="mass"),
    "mass_spread": try_mass_spread,
    **{number: partial(try_factor, number=number) for number in list(SCALED)[1:]},
    "delay_s": partial(try_delay, number="delay_s"),
    "noise": partial(try_noise, number="noise"),
    "noise_rate": partial(try_noise, number="noise_rate"),
    "slope": try_slope,
    "rough_m": try_rough,
    "push_mps": try_push,
    "pose": try_pose,
    "fall": try_fall,
}


def measured(path: Path) -> dict[str, tuple[str, str]]:
    """What became of each of `TRIES` on a model, and why.

    Raises:
        InputError: it is no model that a controller can move.
    """
    share = {"share": FloatDistribution(0.0, 1.0)}
    simulator = MujocoSimulator(path, follow, parameters=share, fallen=never)
    plain = mujoco.MjModel.from_xml_path(str(path))
    plain.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    model, found = Measured(simulator, plain), {}
    for name, attempt in TRIES.items():
        try:
            said = attempt(model)
        except InputError as error:
            found[name] = (REFUSED, error.allowed.partition(": ")[2])
        except Exception as error:  # a model of others may break anything
            found[name] = (WRONG, in_a_line(error))
        else:
            found[name] = {"": (OK, ""), NOTHING: (NOTHING, "")}.get(
                said, (WRONG, said)
            )
    return found


def files_of(name: str) -> Iterator[Path]:
    """MJCF files below a folder or in a package, by name."""
    place = Path(name)
    if not place.exists():
        found = find_spec(name)
        if found is None or found.origin is None:
            raise InputError("model", name, "a file, a folder or an installed package")
        place = Path(found.origin).parent
    files = [place] if place.is_file() else sorted(place.rglob("*.xml"))
    yield from (each for each in files if b"<mujoco" in each.read_bytes())


def main() -> None:
    """Print a table of all models below the places on the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "places", nargs="+", help="folders, files or installed packages"
    )
    files = [file for place in parser.parse_args().places for file in files_of(place)]
    if print_table(files):
        raise SystemExit(1)


def print_table(files: list[Path]) -> int:
    """Print what became of models; how many numbers are wrong."""
    mujoco.set_mju_user_warning(lambda text: None)  # no file on who diverges
    warnings.simplefilter("ignore")  # of what a model's author should write otherwise
    words, reasons = Counter[tuple[str, str]](), Counter[str]()
    for path in files:
        try:
            found = measured(path)
        except InputError as error:
            reasons[f"not tried: it needs {error.allowed.partition(' (')[0]}"] += 1
            continue
        print(path, *(word for word, _ in found.values()), flush=True)
        words.update((number, word) for number, (word, _) in found.items())
        reasons.update(
            f"{word} {number}: {why}" for number, (word, why) in found.items() if why
        )
    print(f"\n| models | {' | '.join(WORDS)} |\n|---|---:|---:|---:|---:|")
    for number in TRIES:
        print(
            f"| `{number}` | {' | '.join(str(words[number, word]) for word in WORDS)} |"
        )
    print(
        *(f"- {times} x {reason}" for reason, times in sorted(reasons.items())),
        sep="\n",
    )
    return sum(words[number, WRONG] for number in TRIES)


if __name__ == "__main__":
    run_command(main)
