"""MuJoCo's models as simulators: against a plain loop, closed forms, and what is refused."""

import hashlib
import os
import pickle
from pathlib import Path

import mujoco
import numpy as np
import pytest
from optuna.distributions import FloatDistribution

from storage import make_store
from storage.inputs.config import Table
from storage.mujoco_simulator import COLUMNS, WORLDS, MujocoSimulator, SensedState
from storage.points import sobol_points
from storage.simulator import find_simulator, run_points
from study.options import CONFIGS
from tests.cases import ASSETS, cases, refused
from tests.storage import rail
from tests.storage.rail import XML, Rail, made, swing

HARD = {
    "mass": [0.8, 1.3],
    "mass_spread": 0.2,
    "friction": [0.3, 1.0],
    "strength": [0.5, 1.0],
    "delay_s": [0.0, 0.03],
    "noise": 0.01,
    "noise_rate": 0.1,
    "slope": [-0.1, 0.1],
    "push_mps": 0.3,
    "inertia": 1.1,
    "damping": 1.2,
    "armature": 0.9,
}
SECONDS = 1.5


def runs(simulator, points, world, worlds=1, seconds=SECONDS):
    """Rows of points in so many worlds, [n, w]."""
    seeds = list(map(np.random.SeedSequence, range(worlds)))
    drawn = simulator.read_worlds(Table({"world": world})).draw(seeds)
    return run_points(simulator, points, drawn, worlds, seconds)[0]


def plain_loop(kp, beats, world):
    """The columns of one run, by `mj_step` alone."""
    model = mujoco.MjModel.from_xml_string(XML)
    model.body_mass[:] *= world["mass"]
    model.body_inertia[:] *= world["mass"]
    model.geom_friction[:, 0] *= world["friction"]
    model.actuator_gear[:] *= world["strength"]
    mujoco.mj_setConst(model, mujoco.MjData(model))
    data, memory = mujoco.MjData(model), {}
    mujoco.mj_forward(model, data)
    energy = effort = peak = 0.0
    steps = round(SECONDS / 0.01)
    for step in range(steps):
        up = data.xmat[1].reshape(3, 3)[:, 2]
        now = SensedState(
            time_s=step * 0.01,
            qpos=data.qpos[None].copy(),
            qvel=data.qvel[None].copy(),
            x_m=data.xpos[1:2, 0].copy(),
            height_m=data.xpos[1:2, 2].copy(),
            pitch_rad=np.array([np.arctan2(up[0], up[2])]),
            tilt_rad=np.zeros(1),
            sensors={"hip": data.sensordata[:1].copy()},
        )
        data.ctrl[:] = swing(
            {"kp": np.array([kp]), "beats": np.array([beats])}, now, memory
        )[0]
        mujoco.mj_step(model, data, 5)
        power = abs(data.actuator_force[0] * data.actuator_velocity[0])
        energy, effort = energy + 0.01 * power, effort + data.ctrl[0] ** 2
        peak = max(peak, np.abs(data.qfrc_actuator).max())
        up = data.xmat[1].reshape(3, 3)[:, 2]
        if data.xpos[1, 2] < 0.25 or np.arccos(np.clip(up[2], -1.0, 1.0)) > 1.0:
            break
    else:
        step += 1
    weight = model.body_mass.sum() * 9.81
    distance = data.xpos[1, 0]
    return {
        "survived_fraction": step / steps,
        "distance_m": distance,
        "speed_mps": distance / (max(step, 1) * 0.01),
        "energy_j": energy,
        "cost_of_transport": min(energy / (weight * max(distance, 1e-6)), 100.0),
        "peak_torque_nm": peak,
        "effort": effort / max(step, 1),
    }


def test_each_robot_is_a_loop_over_mj_step():
    points = sobol_points(1, 0, 8, Rail.parameters)
    world = {"mass": [0.8, 1.3], "friction": [0.3, 1.0]}
    seeds = list(map(np.random.SeedSequence, (0, 1)))
    drawn = Rail.read_worlds(Table({"world": world})).draw(seeds)
    rows = run_points(Rail, points, drawn, 2, SECONDS)[0]
    assert 0 < np.sum(rows["survived_fraction"] < 1.0) < 16
    for (kp, beats), found in zip(points.tolist(), rows, strict=True):
        for place in range(2):
            own = {name: float(each[place]) for name, each in drawn.items()}
            expected = plain_loop(kp, int(beats), own)
            got = {name: float(found[place][name]) for name in COLUMNS}
            assert got == pytest.approx(expected, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("more", [{}, {"rough_m": [0.02, 0.05]}])
def test_no_bit_depends_on_the_company(more):
    points, seeds = (
        sobol_points(1, 0, 8, Rail.parameters),
        map(np.random.SeedSequence, range(3)),
    )
    drawn = Rail.read_worlds(Table({"world": HARD | more})).draw(list(seeds))
    drawn["noise"][1] = drawn["noise_rate"][1] = drawn["push_mps"][2] = 0.0
    rows = run_points(Rail, points, drawn, 3, SECONDS)[0]
    for k, w in np.ndindex(8, 3):
        own = {name: each[w : w + 1] for name, each in drawn.items()}
        alone = run_points(Rail, points[k : k + 1], own, 1, SECONDS)[0]
        assert alone.tobytes() == rows[k, w].tobytes()
    again = run_points(pickle.loads(pickle.dumps(Rail)), points, drawn, 3, SECONDS)[0]
    assert (
        again.tobytes() == rows.tobytes()
        and len({row.tobytes() for row in rows.ravel()}) == 24
    )


def still(point, sensed, memory):
    return np.zeros((len(sensed.x_m), 1))


def full(point, sensed, memory):
    return np.full((len(sensed.x_m), 1), point["share"][0])


def never(sensed):
    return np.zeros(len(sensed.x_m), dtype=bool)


BLOCK, CART = ((ASSETS / name).read_text() for name in ("block.xml", "cart.xml"))
SHARE = {"share": FloatDistribution(0.0, 1.0)}


def of_share(text, controller, **more):
    """A model whose controller knows one parameter, and which falls by no rule but one given."""
    given = {"parameters": SHARE, "control_step_s": 0.01, "fallen": never} | more
    return MujocoSimulator(rail.Model(text), controller, **given)


def test_worlds_do_what_their_names_say():
    """A cart of 2 kg under 4 N; a block on a slope, whose friction is 0.2."""
    cart = of_share(CART, full)

    def moved(**world):
        row = runs(cart, np.array([[1.0]]), world, seconds=1.0)[0, 0]
        assert row["peak_torque_nm"] == pytest.approx(4.0 * world.get("strength", 1.0))
        return float(row["distance_m"])

    assert moved() == pytest.approx(1.0, rel=5e-3)  # 1/2 2 m/s2 t2
    assert moved(strength=0.5) == moved(mass=2.0) == pytest.approx(0.5, rel=5e-3)
    assert moved(delay_s=0.2) == pytest.approx(0.64, rel=5e-3)
    assert abs(moved(mass_spread=0.3, mass=1.0) - 1.0) > 1e-3
    # at a time between .5 and 1 s or not at all
    assert 0.1 < abs(moved(push_mps=5.0) - 1.0) < 2.5
    block = of_share(BLOCK, still)
    slopes = []
    for slope, friction in ((0.1, 1.0), (0.5, 1.0), (0.5, 3.0)):
        world = {"slope": slope, "friction": friction}
        row = runs(block, np.array([[0.0]]), world, seconds=1.0)[0, 0]
        slopes.append(float(row["distance_m"]))
    turn = np.arctan(0.5)
    slid = -0.5 * 9.81 * (np.sin(turn) - 0.2 * np.cos(turn))
    assert slopes == pytest.approx([0.0, slid, 0.0], abs=0.02)


def test_strength_scales_the_force_of_muscles_and_not_their_range():
    text = XML.replace(
        '<motor joint="hip" gear="20"/>', '<muscle joint="hip" lengthrange="0 1"/>'
    )
    plain, weak = (
        made(text)._model_of({**WORLDS, "seed": 1.0, "strength": s}) for s in (1, 0.5)
    )
    for parameters in ("actuator_gainprm", "actuator_biasprm"):
        ratio = getattr(weak, parameters)[0, :9] / getattr(plain, parameters)[0, :9]
        assert ratio.tolist() == [1.0, 1.0, 0.5, 0.5, *[1.0] * 5]


def test_energy_and_weight_are_what_the_robot_has():
    """A joint takes 4 N of an actuator's 100; a table, a rail and gravity along y add nothing."""
    strong = CART.replace('gear="4"', 'gear="100"')
    clipped = strong.replace('axis="1 0 0"', 'axis="1 0 0" actuatorfrcrange="-4 4"')
    table = '<body pos="9 9 9"><geom size="1" mass="70"/></body>'
    tabled = CART.replace("</worldbody>", f"{table}</worldbody>")
    sideways = CART.replace('gravity="0 0 -10"', 'gravity="0 -10 0"')
    track = '<body><geom size="1" mass="70"/><body name="cart" pos="5 5 5">'
    railed = CART.replace("<body>", track).replace(
        "</worldbody>", "</body></worldbody>"
    )
    for text in (CART, clipped, tabled, sideways, railed):
        root = "cart" if text == railed else None
        robot = of_share(text, full, root=root)
        row = robot.trial({"share": 1.0}, {}, 1.0)
        assert row["distance_m"] == pytest.approx(1.0, rel=5e-3)
        # sampled at the ends of 100 control steps: 1 % more than 4 N times 1 m
        assert row["energy_j"] == pytest.approx(4.04, rel=5e-3)
        assert row["cost_of_transport"] == pytest.approx(4.04 / 20.0, rel=5e-3)
    afloat = of_share(CART.replace("0 0 -10", "0 0 0"), full)
    assert "cost_of_transport" not in afloat.trial({"share": 1.0}, {}, 1.0)
    assert afloat.outcomes == ("survived_fraction", "energy_j", "speed_mps")


def test_a_trial_is_a_row():
    world = {"mass": 1.2, "noise": 0.01, "push_mps": 0.3}
    seeds = [np.random.SeedSequence(3)]
    drawn = Rail.read_worlds(Table({"world": world})).draw(seeds)
    rows = run_points(Rail, np.array([[1.5, 2.0]]), drawn, 1, SECONDS)[0]
    own = world | {"seed": float(drawn["seed"][0])}
    found = Rail.trial({"beats": 2, "kp": 1.5}, own, SECONDS)
    assert found == {name: float(rows[name][0, 0]) for name in COLUMNS}


def test_a_trial_has_the_types_of_a_row():
    exact = Rail.trial({"beats": 2, "kp": 1.5}, {"seed": 7}, SECONDS)
    floats = {"beats": 2.0, "kp": np.float32(1.5)}
    assert Rail.trial(floats, {"seed": 7.0}, SECONDS) == exact


@cases("refused-trials.toml", "point", "world", "seconds", "match")
@pytest.mark.parametrize("run", [Rail.trial, Rail.states])
def test_a_trial_of_no_numbers_is_refused(run, point, world, seconds, match):
    with refused(match):
        run(point, world, seconds)


CUBE = "\n".join(f"v {x} {y} {z}" for x in (0, 1) for y in (0, 1) for z in (0, 1))
FACES = "\nf 1 2 3\nf 4 5 6\nf 7 8 1\nf 2 5 8\n"
GRID = np.array([2, 2], dtype=np.int32).tobytes()
MESH = (CUBE + FACES).encode()
LARGER_MESH = MESH.replace(b"1", b"1.8", 4)
SHIN = """<mujoco model="shin">
  <compiler meshdir="geo"/><asset><mesh name="shin" file="shin.obj"/></asset>
  <worldbody><body name="shin"><geom type="mesh" mesh="shin" density="10"/></body></worldbody>
</mujoco>"""
PART = '<mujocoinclude><geom size=".3"/></mujocoinclude>'
FILES = {  # of a model, before and after a change
    "geo/foot.obj": (MESH, LARGER_MESH),
    "geo/hills.bin": (GRID + bytes(16), GRID + np.float32([0, 0, 0, 1]).tobytes()),
    "geo/net.obj": (MESH, LARGER_MESH),
    "shin/geo/shin.obj": (MESH, LARGER_MESH),
    "part.xml": (PART.encode(), PART.replace(".3", ".4").encode()),
    "shin/shin.xml": (SHIN.encode(), SHIN.replace("10", "20").encode()),
}
NAMING = (ASSETS / "naming.xml").read_text()


@pytest.mark.parametrize("changed", FILES)
def test_a_file_that_a_model_names_is_in_its_version(changed, tmp_path):
    for name, (before, _) in FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(before)
    (tmp_path / "model.xml").write_text(NAMING)

    def version():
        return MujocoSimulator(
            tmp_path / "model.xml", full, parameters=SHARE, fallen=never
        ).code_version

    first = version()
    assert version() == first
    (tmp_path / changed).write_bytes(FILES[changed][1])
    # MuJoCo keeps files, and asks for their times in s.
    os.utime(tmp_path / changed, (1e9, 1e9))
    assert version() != first


OTHERS = (
    "<include",
    "<flexcomp",
    "<edge",
    "</flexcomp",
    "<attach",
    "<model name",
    "<hfield",
    '<geom type="hfield"',
)


def test_assets_of_a_function_are_in_its_version():
    lines = [
        line for line in NAMING.splitlines() if not line.strip().startswith(OTHERS)
    ]
    text = "\n".join(lines)
    versions = [
        MujocoSimulator(
            rail.Model(text, {"foot.obj": content}),
            full,
            parameters=SHARE,
            fallen=never,
        ).code_version
        for content in (*FILES["geo/foot.obj"], FILES["geo/foot.obj"][0])
    ]
    assert versions[0] == versions[2] != versions[1]


def version_of_030(text):
    """The code's version that 0.3.0 gave to the rail with this model."""
    file = hashlib.sha256(Path(rail.__file__).read_bytes()).hexdigest()[:16]
    spec = mujoco.MjSpec.from_string(text)
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    whole = b"1" + file.encode() + spec.to_xml().encode()
    return hashlib.sha256(whole).hexdigest()[:16]


def test_a_model_without_files_has_the_version_of_before():
    """Half a store of 0.3.0 goes on, where its numbers are the same."""
    assert Rail.code_version == version_of_030(XML)
    for change in ('forcerange="-9 9"', 'damping="1"', 'armature="1"'):
        text = XML.replace('gear="20"', f'gear="20" {change}')
        assert made(text).code_version != version_of_030(text)


def test_the_root_and_the_file_of_a_rule_are_in_a_store():
    assert (
        "root" not in Rail.document() and made(root="leg").document()["root"] == "leg"
    )
    assert made(fallen=never).code_version != Rail.code_version


def soon(sensed):
    return sensed.x_m > 0.01


def test_half_a_store_of_another_rule_does_not_go_on(tmp_path):
    """Rule and controller may be of one file: which rule it is, the file does not say."""
    cart = [of_share(CART, full, fallen=rule) for rule in (never, soon)]
    with refused("fallen"):
        for each in cart:
            make_store(each, tmp_path / "cart", workers=1, samples=4)


def watched(point, sensed, memory):
    SEEN.append((sensed.qpos.copy(), sensed.qvel.copy()))
    return np.zeros((len(sensed.x_m), 1))


SEEN = []


def test_noise_has_its_deviation_and_rough_ground_its_height():
    cart = MujocoSimulator(rail.Model(CART), watched, parameters=SHARE, fallen=never)
    SEEN.clear()
    runs(cart, np.array([[0.0]]), {"noise": 0.01, "noise_rate": 0.2}, seconds=2.0)
    position, speed = (np.array([seen[k] for seen in SEEN]).ravel() for k in (0, 1))
    assert [position.std(), speed.std()] == pytest.approx([0.01, 0.2], rel=0.1)
    model, states = Rail.states(
        {"kp": 1.0, "beats": 2}, {"rough_m": 0.08, "seed": 3.0}, 0.5
    )
    heights = model.hfield_data * model.hfield_size[0, 2] + model.geom("floor").pos[2]
    assert model.geom("floor").type[0] == mujoco.mjtGeom.mjGEOM_HFIELD
    assert heights.min() == pytest.approx(-0.04) and heights.max() == pytest.approx(
        0.04
    )
    assert len(states) > 10 and states[0].tolist() == [0.0] * 4


def no_number(point, sensed, memory):
    return np.where(point["kp"] > 1.0, np.nan, 0.0)[:, None]


def two_columns(point, sensed, memory):
    return np.zeros((len(sensed.x_m), 2))


FLOATING = XML.replace("<option ", '<option gravity="0 0 0" ')


@pytest.mark.parametrize(
    ("given", "match"),
    [
        ({"worlds": {"wind": 1.0}}, r"^worlds\.wind: .* one of mass, mass_spread"),
        ({"worlds": {"mass": -1.0}}, r"^world\.mass: -1\.0 .* more than 0"),
        ({"text": "<mujoco/>"}, "^model: 'rail' .* a model with actuators"),
        (
            {"text": "<mujoco><nothing/></mujoco>"},
            "^model: 'rail' .* loads .XML Error.*nothing",
        ),
        ({"root": "knee"}, "^root: 'knee' .* a body of the model: trunk, leg"),
        ({"root": "world"}, "^root: 'world' .* a body of the model: trunk, leg"),
        ({"control_step_s": 0.003}, "^control_step_s: 0.003 .* steps of 0.002 s"),
        ({"start_qpos": [0.0]}, "^start_qpos: .* 4 numbers"),
        (
            {"text": FLOATING, "worlds": {"slope": 0.1}, "fallen": never},
            r"^world\.slope: 0\.1 .* 0 for rail: it has no gravity",
        ),
        (
            {"text": XML.replace('pos="0 0 0.5"', 'pos="0 0 -1"')},
            "^fallen: None .* a rule of your own for rail: its root, trunk, "
            "starts at a height of -1 m",
        ),
    ],
)
def test_a_model_that_is_refused(given, match):
    with refused(match):
        made(**given)


def test_a_file_that_is_not_there_is_refused():
    with refused(r"^model: 'none\.xml'"):
        MujocoSimulator("none.xml", swing, parameters=rail.PARAMETERS)


BALL = XML.replace('name="floor" type="plane" size="5 5 1"', 'size="1"')


@pytest.mark.parametrize(
    ("text", "world", "match"),
    [
        (XML, {"mass": 0.0}, r"^world\.mass: 0\.0 .* more than 0"),
        (XML, {"delay_s": 2.0}, r"^world\.delay_s: 2\.0 .* 0 to 1"),
        (BALL, {"rough_m": 0.1}, r"^world\.rough_m: .* one plane"),
        (FLOATING, {"slope": [0.0, 0.1]}, r"^world\.slope: 0\.1 .* it has no gravity"),
    ],
)
def test_worlds_that_are_refused(text, world, match):
    robot = made(text, fallen=never)
    with refused(match):
        robot.read_worlds(Table({"world": world}))


def test_controls_of_another_shape_are_refused():
    robot = MujocoSimulator(rail.Model(XML), two_columns, parameters=rail.PARAMETERS)
    allowed = r"controls of shape \[1, 1\] .* not \[1, 2\]"
    with refused(allowed):
        runs(robot, np.ones((1, 2)), {})


def test_a_controller_without_a_number_is_a_failed_run():
    robot = MujocoSimulator(rail.Model(XML), no_number, parameters=rail.PARAMETERS)
    rows = runs(robot, np.array([[0.5, 1.0], [2.0, 1.0]]), {}, seconds=0.1)[:, 0]
    assert [robot.words["run_ended"][k] for k in rows["run_ended"]] == ["ran", "failed"]
    assert rows["survived_fraction"][1] == 0.0


@pytest.mark.parametrize("name", ["walker2d", "ant"])
def test_robots_that_ship_walk_for_a_second(name):
    robot = find_simulator(f"{name}.py:robot", CONFIGS)
    robot.require_machine()
    rows = runs(robot, sobol_points(1, 0, 64, robot.parameters), {}, seconds=1.0)
    assert np.mean(rows["survived_fraction"]) > 0.1 and np.ptp(rows["distance_m"]) > 0.2
    assert robot.code_version != Rail.code_version and len(robot.parameters) == 12
