"""A number of a world means the same on any model: measured in mechanics, on models that are odd.

The model of a world is compared with the file's own, and its runs with `mj_step`.
"""

from contextlib import nullcontext

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray
from optuna.distributions import FloatDistribution

from storage.function_simulator import SEED
from storage.mujoco_herd import Herd
from storage.mujoco_simulator import WORLDS, MujocoSimulator
from storage.mujoco_worlds import FACING, gravity_of, upward
from tests.cases import asset, refused

Floats = NDArray[np.float64]

SHARE = {"share": FloatDistribution(0.0, 1.0)}
STEPS = 40  # of physics, a control each
SETTLING_STEPS = 300  # before mass matrices, forces and contacts are compared
NOISY_STEPS = 400
FACTOR = 0.6
SLOPE = 0.2
ROUGH_M = 0.1
PUSH_MPS = 0.7
NOISE = 0.02
DELAY_STEPS = 3
TURN_RAD = 0.3
LEAST_FRICTION = 1e-5  # MuJoCo's mjMINMU

# What each factor scales, of `quantities`.
SCALED = {
    "mass": ("translation", "rotation"),
    "inertia": ("rotation",),
    "friction": ("sliding",),
    "damping": ("damper",),
    "armature": ("armature",),
    "strength": ("forces", "torques"),
}
CHANGED = {**dict.fromkeys(SCALED, FACTOR), "mass_spread": 0.3, "delay_s": 0.01}
CHANGED |= {"noise": NOISE, "noise_rate": NOISE}
CHANGED |= {"slope": SLOPE, "rough_m": ROUGH_M, "push_mps": PUSH_MPS}

CONTROLS = []  # of the model that is measured, [steps, nu]
SEEN = []


def follow(point, sensed, memory):
    """Controls [n, nu] that were drawn before, whatever the state; it writes down what it sees."""
    steps = memory.get("steps", np.zeros(len(sensed.x_m), dtype=int))
    memory["steps"] = steps + 1
    SEEN.append(sensed)
    return np.asarray(CONTROLS[0][steps % len(CONTROLS[0])])


def never(sensed):
    return np.zeros(len(sensed.x_m), dtype=bool)


class Odd:
    """A model of odd-models.toml, in a state in which it moves."""

    def __init__(self, file, xml, refused, nothing):
        file.write_text(xml)
        self.file, self.refused, self.nothing = file, refused, nothing
        self.simulator = MujocoSimulator(file, follow, parameters=SHARE, fallen=never)
        self.plain = model = mujoco.MjModel.from_xml_path(str(file))
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        draws = np.random.default_rng(7)
        ends = model.actuator_ctrlrange.T
        low, high = np.where(model.actuator_ctrllimited, ends, [[-1.0], [1.0]])
        self.controls = low + (high - low) * draws.random((NOISY_STEPS, model.nu))
        CONTROLS[:] = [self.controls]
        largest = np.maximum(np.abs(low), np.abs(high))
        self.loud = 1e3 * largest * np.sign(draws.random(model.nu) - 0.5)
        self.data = mujoco.MjData(model)
        for control in self.controls[:SETTLING_STEPS]:
            self.data.ctrl[:] = control
            mujoco.mj_step(model, self.data)
        self.rates = self.data.qvel + 0.1 * draws.standard_normal(model.nv)

    def herd(self, **numbers):
        """The model of a world, and a robot in it; refused where a number has no meaning."""
        whole = {SEED: 5.0} | WORLDS | numbers
        drawn = {name: np.array([value]) for name, value in whole.items()}
        self.simulator._require_worlds(drawn)
        model = self.simulator._model_of(whole)
        point = {"share": np.array([1.0])}
        return model, Herd(self.simulator.robot, point, drawn, [model])

    def at(self, model, ctrl=None, rates=None):
        """A model's data in that state, perhaps with other controls or rates."""
        data = mujoco.MjData(model)
        data.qpos[:], data.act[:] = self.data.qpos, self.data.act
        data.qvel[:] = self.data.qvel if rates is None else rates
        data.ctrl[:] = self.data.ctrl if ctrl is None else ctrl
        mujoco.mj_forward(model, data)
        return data

    def run(self, steps, **world):
        """Positions before each step of a run, [steps, nq], and what was sensed then."""
        SEEN.clear()
        seconds = steps * self.simulator.control_step_s
        _, states = self.simulator.states({"share": 1.0}, {SEED: 5.0} | world, seconds)
        return np.array(states), SEEN.copy()

    @property
    def axes(self):
        """Upwards and along x, as heights and runs are measured."""
        axis, sign = upward(self.plain)
        up = np.zeros(3)
        up[axis] = sign
        return up, np.array([1.0, 0.0, 0.0])


MODELS = asset("odd-models.toml")


@pytest.fixture(params=MODELS.values(), ids=MODELS)
def odd(request, tmp_path):
    return Odd(tmp_path / "odd.xml", **request.param)


def require(odd, number):
    """Leave a test of a number that has no meaning for the model."""
    if number in odd.refused:
        pytest.skip("it has no meaning there, and is refused")


def mass_matrix(odd, model):
    """In that state, [nv, nv]."""
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, odd.at(model), full)
    return full


def quantities(odd, model):
    """What a model is, in numbers of mechanics. The first three are its mass matrix in parts."""
    bare = mujoco.MjModel.__copy__(model)
    for name in ("dof_armature", "tendon_armature", "actuator_armature"):
        getattr(bare, name)[:] = 0.0
    mujoco.mj_setConst(bare, mujoco.MjData(bare))
    full, moving = mass_matrix(odd, model), mass_matrix(odd, bare)
    data, jacobian = odd.at(model, rates=odd.rates), np.zeros((3, model.nv))
    translation = np.zeros_like(full)
    for body in range(1, model.nbody):
        mujoco.mj_jacBodyCom(model, data, jacobian, None, body)
        translation += model.body_mass[body] * jacobian.T @ jacobian
    pushed = [odd.at(model, ctrl) for ctrl in (None, odd.loud, -odd.loud)]
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
        "torques": np.array([each.qfrc_actuator for each in pushed]),
    }


def test_what_has_no_meaning_is_refused_and_nothing_else(odd):
    for number, value in CHANGED.items():
        fails = number in odd.refused
        with refused(number) if fails else nullcontext():
            odd.herd(**{number: value})
    fails = "fall" in odd.refused
    with refused(r"^fallen") if fails else nullcontext():
        ruled = MujocoSimulator(odd.file, follow, parameters=SHARE)
        row = ruled.trial({"share": 1.0}, {}, 2.0 * ruled.control_step_s)
        assert row["survived_fraction"] == 1.0


def test_a_factor_scales_what_its_name_says_and_nothing_else(odd):
    plain = quantities(odd, odd.plain)
    inertia = max(np.abs(plain[name]).max() for name in ("translation", "rotation"))
    for number in SCALED.keys() - {*odd.refused}:
        model, _ = odd.herd(**{number: FACTOR})
        found = quantities(odd, model)
        for name, usual in plain.items():
            expected = usual * (FACTOR if name in SCALED[number] else 1.0)
            if name == "sliding":
                expected = np.maximum(expected, LEAST_FRICTION)
            scale = np.abs(expected).max(initial=1e-9)
            # Differences of matrices are as exact as these.
            if name in ("translation", "rotation", "armature"):
                scale = max(scale, inertia)
            close = np.allclose(found[name], expected, rtol=0.0, atol=1e-8 * scale)
            assert close, (number, name)
        has_some = any(plain[name].any() for name in SCALED[number])
        assert has_some == (number not in odd.nothing), number


def test_each_body_has_a_factor_of_its_own(odd):
    model, _ = odd.herd(mass_spread=0.3)
    heavy = odd.plain.body_mass > 0.0
    ratio = model.body_mass[heavy] / odd.plain.body_mass[heavy]
    assert 1e-3 < np.abs(ratio - 1.0).max() <= 0.3
    assert len(ratio) == 1 or np.ptp(ratio) > 1e-3
    inertia = odd.plain.body_inertia[heavy] * ratio[:, None]
    assert model.body_inertia[heavy] == pytest.approx(inertia, rel=1e-8)


@pytest.mark.parametrize("late", [0, DELAY_STEPS])
def test_a_run_has_the_bits_of_mj_step_with_controls_that_come_late(odd, late):
    controls = np.vstack([np.zeros((late, odd.plain.nu)), odd.controls])[:STEPS]
    data, expected = mujoco.MjData(odd.plain), []
    mujoco.mj_forward(odd.plain, data)
    for control in controls:
        expected.append(data.qpos.copy())
        data.ctrl[:] = control
        mujoco.mj_step(odd.plain, data)
    found, _ = odd.run(STEPS, delay_s=late * odd.simulator.control_step_s)
    assert found.tobytes() == np.array(expected).tobytes()


@pytest.mark.parametrize("number", ["noise", "noise_rate"])
def test_what_is_sensed_deviates_by_so_much_in_each_coordinate(odd, number):
    states, usual = odd.run(NOISY_STEPS)
    same, noisy = odd.run(NOISY_STEPS, **{number: NOISE})
    assert same.tobytes() == states.tobytes()
    off = {"noise": [], "noise_rate": []}
    for one, other in zip(usual, noisy, strict=True):
        turned = other.qpos[0].copy()
        mujoco.mj_normalizeQuat(odd.plain, turned)
        assert turned == pytest.approx(other.qpos[0], rel=1e-9, abs=1e-9)
        place = np.zeros(odd.plain.nv)
        mujoco.mj_differentiatePos(odd.plain, place, 1.0, one.qpos[0], other.qpos[0])
        off["noise"].append(place)
        off["noise_rate"].append(other.qvel[0] - one.qvel[0])
    own = np.array(off.pop(number))
    assert not np.any(list(off.values()))
    for column in own.T:
        deviation = np.sqrt(np.mean(column**2)) / NOISE
        assert abs(deviation - 1.0) < 6.0 / np.sqrt(2.0 * column.size)


def test_gravity_is_that_on_ground_that_rises_along_x(odd):
    require(odd, "slope")
    before, (model, _) = gravity_of(odd.plain), odd.herd(slope=SLOPE)
    down = np.linalg.norm(before)
    up, (_, along) = -before / down, odd.axes
    along = along - (along @ up) * up
    along /= np.linalg.norm(along)
    turned = -down * (up + SLOPE * along) / np.hypot(1.0, SLOPE)
    assert model.opt.gravity == pytest.approx(turned, abs=1e-8)


def test_rough_ground_has_its_heights_below_rays_and_is_level_at_the_start(odd):
    require(odd, "rough_m")
    (ours, _), plain = odd.herd(rough_m=ROUGH_M), odd.plain
    (geom,) = np.flatnonzero(ours.geom_type != plain.geom_type).tolist()
    (up, along), start = odd.axes, odd.simulator._start
    draws = np.random.default_rng(3)
    places = np.repeat((start + (100.0 - start @ up) * up)[None], 300, axis=0)
    places[1:] += draws.uniform(-35.0, 35.0, (299, 1)) * along
    places[1:] += draws.uniform(-9.0, 9.0, (299, 1)) * np.cross(up, along)
    rough, level = mujoco.MjData(ours), mujoco.MjData(plain)
    mujoco.mj_kinematics(ours, rough)
    mujoco.mj_kinematics(plain, level)
    normal = level.geom_xmat[geom].reshape(3, 3)[:, 2]
    to_plane = (places - level.geom_xpos[geom]) @ normal / (up @ normal)
    to_field = np.array(
        [mujoco.mj_rayHfield(ours, rough, geom, place, -up, None) for place in places]
    )
    assert to_field.min() >= 0.0  # no holes
    off = to_plane - to_field
    # Along its normal it is half of this away at most.
    assert np.abs(off).max() <= 0.5 * ROUGH_M / FACING
    assert abs(off[0]) < 1e-6 and np.ptp(off) > 0.7 * ROUGH_M


def test_a_push_moves_the_root_along_x_and_does_not_turn_it(odd):
    require(odd, "push_mps")
    _, herd = odd.herd(push_mps=PUSH_MPS)
    herd._pushes(0)
    before = herd._qvel[0].copy()
    herd._pushes(int(herd._pushed_at[0]))
    data = odd.at(odd.plain, rates=herd._qvel[0] - before)
    found, body = np.zeros(6), mujoco.mjtObj.mjOBJ_XBODY
    root = odd.simulator._root
    mujoco.mj_objectVelocity(odd.plain, data, body, root, found, 0)
    assert [*found[:3], abs(found[3]), *found[4:]] == pytest.approx(
        [0.0, 0.0, 0.0, PUSH_MPS, 0.0, 0.0], abs=1e-8
    )


def test_place_height_pitch_and_tilt_are_those_of_the_root(odd):
    (_, herd), root = odd.herd(), odd.simulator._root
    up, along = odd.axes
    start_m = odd.simulator._start @ up

    def seen():
        now = herd._seen(0.0, herd.qpos, herd._qvel)
        (x,), (height,) = now.x_m, now.height_m
        (pitch,), (tilt,) = now.pitch_rad, now.tilt_rad
        return [x, height - start_m, pitch, tilt]

    assert seen() == pytest.approx([0.0] * 4, abs=1e-6)
    joint = odd.plain.body_jntadr[root]
    if joint < 0 or odd.plain.jnt_type[joint] != mujoco.mjtJoint.mjJNT_FREE:
        return
    turn, turned = np.zeros(4), np.zeros(4)
    mujoco.mju_axisAngle2Quat(turn, np.cross(up, along), TURN_RAD)
    first = odd.plain.jnt_qposadr[joint]
    place, orientation = (
        herd.qpos[0, first + k : first + n] for k, n in ((0, 3), (3, 7))
    )
    mujoco.mju_mulQuat(turned, turn, orientation)
    orientation[:] = turned
    place += 0.25 * along + 0.5 * up
    herd._batch.forward()
    assert seen() == pytest.approx([0.25, 0.5, TURN_RAD, TURN_RAD], abs=1e-6)
