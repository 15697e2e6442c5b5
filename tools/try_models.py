"""Measure on MJCF models of others what each number of a world does, and whether it is right.

    pip install --no-deps --target out/models dm_control gymnasium-robotics robosuite myosuite
    python tools/try_models.py out/models            # folders, files or installed packages
    python tools/try_models.py gymnasium

A row a model. Each number is measured on the model that a world makes, in terms of mechanics (mass
matrices, forces, contacts, velocities), beside MuJoCo's own `mj_step` on the file as it is:

    ok       what its name says
    -        the model has nothing that it could change
    refused  MujocoSimulator refuses it for this model; the reasons are below the table
    WRONG    something else; the exit code is 1
"""

import argparse
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
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
    from storage.mujoco_herd import Herd, SensedState
    from storage.mujoco_simulator import WORLDS, MujocoSimulator
    from storage.mujoco_worlds import FACING, gravity_of, quaternions, upward
    from taichi_nmm.errors import InputError, in_a_line

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

OK, NOTHING, REFUSED, WRONG = "ok", "-", "refused", "WRONG"


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
    """A model, in a state in which it moves."""

    simulator: MujocoSimulator
    plain: Any  # the file's own model, without the automatic reset

    def __post_init__(self) -> None:
        draws = np.random.default_rng(7)
        model = self.plain
        limited = model.actuator_ctrllimited
        low = np.where(limited, model.actuator_ctrlrange[:, 0], -1.0)
        high = np.where(limited, model.actuator_ctrlrange[:, 1], 1.0)
        self.controls = low + (high - low) * draws.random((NOISY_STEPS, model.nu))
        CONTROLS[:] = [self.controls]
        self.loud = (
            1e3 * np.maximum(np.abs(low), np.abs(high)) * np.sign(draws.random(model.nu) - 0.5)
        )
        data = mujoco.MjData(model)
        for control in self.controls[:SETTLING_STEPS]:
            data.ctrl[:] = control
            mujoco.mj_step(model, data)
        self.qpos, self.qvel = data.qpos.copy(), data.qvel.copy()
        self.act, self.ctrl = data.act.copy(), data.ctrl.copy()
        if not np.isfinite(self.qpos).all():
            self.qpos, self.qvel = model.qpos0.copy(), np.zeros(model.nv)
        self.rates = self.qvel + 0.1 * draws.standard_normal(model.nv)

    def world(self, **numbers: float) -> Any:
        """The model of a world; refused where a number has no meaning."""
        whole = {SEED: 5.0} | WORLDS | numbers
        self.simulator._require_worlds({name: np.array([v]) for name, v in whole.items()})
        return self.simulator._model_of(whole)

    def at(self, model: Any, ctrl: Floats | None = None, rates: Floats | None = None) -> Any:
        """A model's data in that state."""
        data = mujoco.MjData(model)
        data.qpos[:] = self.qpos
        data.qvel[:] = self.qvel if rates is None else rates
        data.act[:] = self.act
        data.ctrl[:] = self.ctrl if ctrl is None else ctrl
        mujoco.mj_forward(model, data)
        return data


def differs(found: Floats, expected: Floats, tolerance: float = EXACT) -> str:
    """Empty, or by how much two arrays differ."""
    scale = max(float(np.abs(expected).max(initial=0.0)), 1e-9)
    off = float(np.abs(found - expected).max(initial=0.0)) / scale
    return "" if off <= tolerance else f"off by {off:.2g} of {scale:.3g}"


def matrix_of(model: Any, data: Any) -> Floats:
    """The mass matrix [nv, nv]."""
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    return full


def without_armature(model: Any) -> Any:
    bare = mujoco.MjModel.__copy__(model)
    for name in ("dof_armature", "tendon_armature", "actuator_armature"):
        getattr(bare, name)[:] = 0.0
    mujoco.mj_setConst(bare, mujoco.MjData(bare))
    return bare


def plain_run(measured: Measured, controls: Floats) -> Floats:
    """Positions before each step of `mj_step` alone, [steps, nq]."""
    data, seen = mujoco.MjData(measured.plain), []
    mujoco.mj_forward(measured.plain, data)
    for control in controls:
        seen.append(data.qpos.copy())
        data.ctrl[:] = control
        mujoco.mj_step(measured.plain, data)
    return np.array(seen)


def our_run(measured: Measured, steps: int, **world: float) -> Floats:
    """Positions before each step of a world's run, [steps, nq]."""
    SEEN.clear()
    seconds = steps * measured.simulator.control_step_s
    _, states = measured.simulator.states({"share": 1.0}, {SEED: 5.0} | world, seconds)
    return np.array(states)


def try_plain(measured: Measured) -> str:
    """Without a world's number: bit by bit as `mj_step`."""
    expected = plain_run(measured, measured.controls[:STEPS])
    found = our_run(measured, STEPS)
    whole = np.isfinite(expected).all(axis=1) & (np.abs(expected).max(axis=1) < 1e6)
    count = min(len(found), int(whole.sum()))
    return "" if found[:count].tobytes() == expected[:count].tobytes() else "other bits"


def try_mass(measured: Measured) -> str:
    ours = measured.world(mass=FACTOR)
    bare = [without_armature(model) for model in (ours, measured.plain)]
    heavy, usual = (matrix_of(model, measured.at(model)) for model in bare)
    if said := differs(heavy, FACTOR * usual):
        return f"mass matrix {said}"
    one, other = measured.at(ours), measured.at(measured.plain)
    if differs(one.actuator_force, other.actuator_force):
        return "actuators' forces change"
    return differs(one.qfrc_fluid, other.qfrc_fluid) and "the fluid's forces change"


def try_mass_spread(measured: Measured) -> str:
    ours, plain = measured.world(mass_spread=SPREAD), measured.plain
    has_mass = plain.body_mass > 0.0
    ratio = ours.body_mass[has_mass] / plain.body_mass[has_mass]
    spins = ours.body_inertia[has_mass] / np.maximum(plain.body_inertia[has_mass], 1e-300)
    round_ones = np.all(plain.body_inertia[has_mass] > 0.0, axis=1)
    if np.abs(ratio - 1.0).max() > SPREAD or (len(ratio) > 1 and np.ptp(ratio) < 1e-3):
        return f"ratios from {ratio.min():.3g} to {ratio.max():.3g}"
    return differs(spins[round_ones], np.repeat(ratio[round_ones, None], 3, axis=1))


def try_inertia(measured: Measured) -> str:
    ours, plain = measured.world(inertia=FACTOR), measured.plain
    data = measured.at(plain)
    spin, rotation = np.zeros((plain.nv, plain.nv)), np.zeros((3, plain.nv))
    for body in range(1, plain.nbody):
        mujoco.mj_jacBody(plain, data, None, rotation, body)
        turn = data.ximat[body].reshape(3, 3)
        spin += rotation.T @ turn @ np.diag(plain.body_inertia[body]) @ turn.T @ rotation
    change = matrix_of(ours, measured.at(ours)) - matrix_of(plain, data)
    scale = max(float(np.abs(matrix_of(plain, data)).max()), 1e-9)
    off = np.abs(change - (FACTOR - 1.0) * spin).max()
    if off > 1e-9 * scale:
        return f"mass matrix off by {off:.2g}"
    found = measured.at(ours, rates=measured.rates).qfrc_fluid
    expected = measured.at(plain, rates=measured.rates).qfrc_fluid
    return differs(found, expected) and "the fluid's forces change"


def try_friction(measured: Measured) -> str:
    ours = measured.world(friction=FACTOR)
    for ctrl in (measured.ctrl, measured.loud):
        one, other = measured.at(ours, ctrl).contact, measured.at(measured.plain, ctrl).contact
        if len(other.friction) == 0:
            return NOTHING
        if len(one.friction) != len(other.friction):
            return "other contacts"
        expected = other.friction.copy()
        expected[:, :2] = np.maximum(FACTOR * expected[:, :2], 1e-5)  # MuJoCo's mjMINMU
        if said := differs(one.friction, expected):
            return said
    return ""


def try_damping(measured: Measured) -> str:
    ours = measured.at(measured.world(damping=FACTOR), rates=measured.rates)
    plain = measured.at(measured.plain, rates=measured.rates)
    if not plain.qfrc_damper.any():
        return NOTHING
    return differs(ours.qfrc_damper, FACTOR * plain.qfrc_damper)


def try_armature(measured: Measured) -> str:
    ours, plain = measured.world(armature=FACTOR), measured.plain
    bare = without_armature(plain)
    with_it, without = (matrix_of(model, measured.at(model)) for model in (plain, bare))
    if not (with_it - without).any():
        return NOTHING
    found = matrix_of(ours, measured.at(ours)) - without
    off = np.abs(found - FACTOR * (with_it - without)).max()
    return "" if off < 1e-9 * np.abs(with_it).max() else f"mass matrix off by {off:.2g}"


def try_strength(measured: Measured) -> str:
    ours, plain = measured.world(strength=FACTOR), measured.plain
    some = False
    for ctrl in (measured.ctrl, measured.loud, -measured.loud):
        weak, usual = measured.at(ours, ctrl), measured.at(plain, ctrl)
        some = some or bool(usual.actuator_force.any())
        if said := differs(weak.actuator_force, FACTOR * usual.actuator_force):
            return f"forces {said}"
        compensated = plain.jnt_actgravcomp.any()
        found, expected = weak.qfrc_actuator, FACTOR * usual.qfrc_actuator
        if not compensated and (said := differs(found, expected)):
            return f"torques {said}"
    return "" if some else NOTHING


def try_delay_s(measured: Measured) -> str:
    late = np.zeros((STEPS, measured.plain.nu))
    late[DELAY_STEPS:] = measured.controls[: STEPS - DELAY_STEPS]
    expected = plain_run(measured, late)
    found = our_run(measured, STEPS, delay_s=DELAY_STEPS * measured.simulator.control_step_s)
    count = min(len(found), int(np.isfinite(expected).all(axis=1).sum()))
    return "" if found[:count].tobytes() == expected[:count].tobytes() else "another delay"


def turned_by(places: Floats, others: Floats) -> Floats:
    """Rotations [n, 3] in rad between orientations [n, 4]."""
    found = np.zeros((len(places), 3))
    for k, (one, other) in enumerate(zip(places, others, strict=True)):
        mujoco.mju_subQuat(found[k], one, other)
    return found


def try_noise(measured: Measured) -> str:
    states = our_run(measured, NOISY_STEPS, noise=NOISE)
    sensed = np.array([each.qpos[0] for each in SEEN])
    count = min(len(states), len(sensed))
    calm = np.all(np.abs(states[:count]) < CALM, axis=1)
    states, sensed = states[:count][calm], sensed[:count][calm]
    scalar, off = np.ones(measured.plain.nq, dtype=bool), list[Floats]()
    for first in quaternions(measured.plain):
        place = slice(first, first + 4)
        scalar[place] = False
        lengths = np.linalg.norm(sensed[:, place], axis=1)
        if np.abs(lengths - 1.0).max() > 1e-9:
            return f"orientations of length {lengths.min():.4g} to {lengths.max():.4g}"
        off.append(turned_by(sensed[:, place], states[:, place]).ravel())
    off.append((sensed - states)[:, scalar].ravel())
    return next((said for each in off if (said := deviates(each))), "")


def try_noise_rate(measured: Measured) -> str:
    our_run(measured, NOISY_STEPS)
    usual = np.array([each.qvel[0] for each in SEEN])
    our_run(measured, NOISY_STEPS, noise_rate=NOISE)
    sensed = np.array([each.qvel[0] for each in SEEN])
    calm = np.abs(usual) < CALM
    return deviates((sensed - usual)[calm])


def deviates(off: Floats) -> str:
    """Empty, or how far numbers are from having the deviation `NOISE`."""
    if off.size == 0:
        return ""
    ratio = float(off.std()) / NOISE
    by_chance = 4.0 / np.sqrt(2.0 * off.size)
    return "" if abs(ratio - 1.0) < by_chance else f"{ratio:.3f} times the deviation"


def try_slope(measured: Measured) -> str:
    before, after = gravity_of(measured.plain), measured.world(slope=SLOPE).opt.gravity
    up = -before / np.linalg.norm(before)
    along = np.array([1.0, 0.0, 0.0])
    along -= (along @ up) * up
    along /= np.linalg.norm(along)
    rise = (-after @ along) / (-after @ up)  # of the ground, where the new vertical is up
    aside = np.cross(along, up) @ after
    same = np.isclose(np.linalg.norm(after), np.linalg.norm(before))
    good = abs(rise - SLOPE) < EXACT and abs(aside) < EXACT and same
    return "" if good else f"gravity is {np.round(after, 3).tolist()}"


def ray_heights(model: Any, geom: int, places: Floats, axis: int, sign: float) -> Floats:
    """Heights of a geom below places [n, 3]; NaN where it is not below."""
    bare = mujoco.MjModel.__copy__(model)
    bare.geom_matid[:] = -1
    bare.geom_rgba[:, 3] = 0.0
    bare.geom_rgba[geom, 3] = 1.0
    if bare.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE:
        bare.geom_size[geom] = 0.0  # its size is for the eye: it has no end
    data, down = mujoco.MjData(bare), np.zeros(3)
    mujoco.mj_kinematics(bare, data)
    down[axis] = -sign
    found = []
    for place in places:
        far = mujoco.mj_ray(bare, data, place, down, None, 1, -1, np.array([-1], dtype=np.int32))
        found.append(sign * place[axis] - far if far >= 0.0 else np.nan)
    return np.array(found)


def try_rough_m(measured: Measured) -> str:
    ours, plain = measured.world(rough_m=ROUGH_M), measured.plain
    (geom,) = np.flatnonzero(ours.geom_type != plain.geom_type).tolist()
    axis, sign = upward(plain)
    draws = np.random.default_rng(3)
    start = measured.simulator._start
    places = np.repeat(start[None], 300, axis=0)
    places[1:, 0] += draws.uniform(-35.0, 35.0, 299)
    places[1:, 3 - axis] += draws.uniform(-9.0, 9.0, 299)
    places[:, axis] = sign * (sign * start[axis] + 100.0)
    rough = ray_heights(ours, geom, places, axis, sign)
    level = ray_heights(plain, geom, places, axis, sign)
    off = rough - level
    if not np.isfinite(off).all():
        return "holes"
    # along its normal it is half of this away at most, and level at the start
    inside = np.abs(off).max() <= 0.5 * ROUGH_M / FACING and abs(off[0]) < 1e-6
    return (
        "" if inside and np.ptp(off) > 0.7 * ROUGH_M else f"from {off.min():.3g} to {off.max():.3g}"
    )


def herd_of(measured: Measured, **world: float) -> Herd:
    whole = {SEED: 5.0} | WORLDS | world
    drawn = {name: np.array([value]) for name, value in whole.items()}
    measured.simulator._require_worlds(drawn)
    models = [measured.simulator._model_of(whole)]
    return Herd(measured.simulator, {"share": np.array([1.0])}, drawn, models)


def try_push(measured: Measured) -> str:
    herd, plain = herd_of(measured, push_mps=PUSH_MPS), measured.plain
    herd._pushes(0)
    herd.qpos[0] = measured.qpos
    before = herd._qvel[0].copy()
    herd._pushes(int(herd._pushed_at[0]))
    change = herd._qvel[0] - before
    data = measured.at(plain)
    moves, turns = np.zeros((3, plain.nv)), np.zeros((3, plain.nv))
    mujoco.mj_jacBody(plain, data, moves, turns, measured.simulator._root)
    place = data.xpos[measured.simulator._root]
    mujoco.mj_jac(plain, data, moves, turns, place, measured.simulator._root)
    velocity, rate = moves @ change, turns @ change
    good = abs(abs(velocity[0]) - PUSH_MPS) < EXACT and np.abs([*velocity[1:], *rate]).max() < EXACT
    return "" if good else f"velocity changes by {np.round(velocity, 3).tolist()}"


def try_pose(measured: Measured) -> str:
    """Height, pitch and tilt of a root that turns forwards; `-` if it turns on no free joint."""
    herd, plain, root = herd_of(measured), measured.plain, measured.simulator._root
    axis, sign = upward(plain)
    seen = herd._sensed(0.0)
    place = measured.simulator._start
    if not np.allclose([seen.height_m[0], seen.pitch_rad[0], seen.tilt_rad[0], seen.x_m[0]],
                       [sign * place[axis], 0.0, 0.0, 0.0], atol=1e-7):  # fmt: skip
        return "another height or tilt at the start"
    joint = plain.body_jntadr[root]
    if joint < 0 or plain.jnt_type[joint] != mujoco.mjtJoint.mjJNT_FREE:
        return NOTHING
    first = plain.jnt_qposadr[joint]
    up, along = np.zeros(3), np.array([1.0, 0.0, 0.0])
    up[axis] = sign
    turn, turned = np.zeros(4), np.zeros(4)
    mujoco.mju_axisAngle2Quat(turn, np.cross(up, along), TURN_RAD)
    mujoco.mju_mulQuat(turned, turn, herd.qpos[0, first + 3 : first + 7])
    herd.qpos[0, first + 3 : first + 7] = turned
    herd.qpos[0, first : first + 3] += 0.25 * along + 0.5 * up
    herd._batch.forward()
    seen = herd._seen(0.0, herd.qpos, herd._qvel)
    found = [seen.x_m[0], seen.height_m[0], seen.pitch_rad[0], seen.tilt_rad[0]]
    expected = [0.25, sign * place[axis] + 0.5, TURN_RAD, TURN_RAD]
    return "" if np.allclose(found, expected, atol=1e-6) else f"{np.round(found, 3).tolist()}"


def try_fall(measured: Measured) -> str:
    """The default rule: no fall at the start."""
    ruled = MujocoSimulator(
        measured.simulator.model,
        follow,
        parameters=measured.simulator.space,
        control_step_s=measured.simulator.control_step_s,
    )
    row = ruled.trial({"share": 1.0}, {}, 2.0 * ruled.control_step_s)
    return "" if row["survived_fraction"] == 1.0 else "falls at once"


TRIES: dict[str, Callable[[Measured], str]] = {
    "plain": try_plain,
    "mass": try_mass,
    "mass_spread": try_mass_spread,
    "inertia": try_inertia,
    "friction": try_friction,
    "damping": try_damping,
    "armature": try_armature,
    "strength": try_strength,
    "delay_s": try_delay_s,
    "noise": try_noise,
    "noise_rate": try_noise_rate,
    "slope": try_slope,
    "rough_m": try_rough_m,
    "push_mps": try_push,
    "pose": try_pose,
    "fall": try_fall,
}


def measured(path: Path) -> dict[str, tuple[str, str]]:
    """What became of each of `TRIES` on a model, and why.

    Raises:
        InputError: it is no model that a controller can move.
    """
    simulator = MujocoSimulator(
        path, follow, parameters={"share": FloatDistribution(0.0, 1.0)}, fallen=never
    )
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
            word = NOTHING if said == NOTHING else WRONG if said else OK
            found[name] = (word, said)
    return found


def files_of(name: str) -> list[Path]:
    """MJCF files below a folder or in a package, by name."""
    place = Path(name)
    if not place.exists():
        found = find_spec(name)
        if found is None or found.origin is None:
            raise InputError("model", name, "a file, a folder or an installed package")
        place = Path(found.origin).parent
    files = [place] if place.is_file() else sorted(place.rglob("*.xml"))
    return [each for each in files if b"<mujoco" in each.read_bytes()]


def main() -> None:
    """Print a table of all models below the places on the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("places", nargs="+", help="folders, files or installed packages")
    if print_table(parser.parse_args().places):
        raise SystemExit(1)


def print_table(places: list[str]) -> int:
    """Print what became of all models below these places; how many numbers are wrong."""
    mujoco.set_mju_user_warning(lambda text: None)  # no file on who diverges
    warnings.simplefilter("ignore")  # of what a model's author should write otherwise
    print(f"| model | {' | '.join(TRIES)} |")
    print(f"|---|{'---|' * len(TRIES)}")
    words = {name: Counter[str]() for name in TRIES}
    reasons, unmoved = Counter[str](), Counter[str]()
    count = wrong = 0
    for place in places:
        for path in files_of(place):
            try:
                found = measured(path)
            except InputError as error:
                unmoved[error.allowed.partition(" (")[0]] += 1
                continue
            count += 1
            cells = [word for word, _ in found.values()]
            print(f"| {'/'.join(path.parts[-3:])} | {' | '.join(cells)} |", flush=True)
            for number, (word, why) in found.items():
                words[number][word] += 1
                if word == REFUSED:
                    reasons[f"{number}: {why}"] += 1
                elif word == WRONG:
                    wrong += 1
                    print(f"\nWRONG {number}: {why}\n", flush=True)
    kinds = (OK, NOTHING, REFUSED, WRONG)
    print(f"\n| of {count} models | {' | '.join(kinds)} |\n|---|---:|---:|---:|---:|")
    for number, counted in words.items():
        print(f"| `{number}` | {' | '.join(str(counted[kind]) for kind in kinds)} |")
    print("\nRefused:")
    for reason, times in sorted(reasons.items()):
        print(f"- {times} x {reason}")
    print("\nNot tried:")
    for reason, times in unmoved.items():
        print(f"- {times} x needs {reason}")
    return wrong


if __name__ == "__main__":
    run_command(main)
