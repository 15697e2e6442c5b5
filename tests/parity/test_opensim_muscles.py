"""OpenSim's model of a walker's muscles: forces, arms and numbers, computed from the files alone.

By a calculation of our own from the file's functions, with OpenSim's tendon as its
documentation has it (`TendonForceLengthCurve`), and by OpenSim itself where it is
installed: pip install opensim.
"""

from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import BPoly

from storage.inputs.config import Table
from study.pictures.opensim_muscles import tendon_curve
from study.pictures.stick_figure import muscle_paths
from study.pictures.trajectory_files import CONTROLS, MODEL, STATES, write_opensim
from taichi_nmm import PUBLISHED_GAINS, Trajectory, simulate
from taichi_nmm.body import Bodies
from taichi_nmm.kernel.joints import KNEE_STRAIGHTEST_RAD
from taichi_nmm.kernel.muscle import ECCENTRIC, SHAPE, WIDTH
from taichi_nmm.parameters import LOW_LEVEL_GAINS, LOW_LEVEL_NAMES
from taichi_nmm.result import MUSCLES
from taichi_nmm.world import read_world
from tests.study.pictures.test_trajectory_files import read_storage

pytestmark = pytest.mark.slow

Array = NDArray[np.float64]

OURS = {
    "soleus": "SOL",
    "tib_ant": "TA",
    "gastroc": "GAS",
    "vasti": "VAS",
    "hamstrings": "HAM",
    "glut_max": "GLU",
    "iliopsoas": "HFL",
}
NAMES = [f"{name}_{side}" for side in "lr" for name in OURS]
# Of Geyer and Herr 2010: Fmax, optimal length, slack length, largest speed.
PUBLISHED = {
    "soleus": (4000.0, 0.04, 0.26, 6.0),
    "tib_ant": (800.0, 0.06, 0.24, 12.0),
    "gastroc": (1500.0, 0.05, 0.40, 12.0),
    "vasti": (6000.0, 0.08, 0.23, 12.0),
    "hamstrings": (3000.0, 0.10, 0.31, 12.0),
    "glut_max": (1500.0, 0.11, 0.13, 12.0),
    "iliopsoas": (2000.0, 0.11, 0.10, 12.0),
}
OWN_WORLD = {
    "muscles": {
        "SOL_left": 0.5,
        "HAM_right": 0.7,
        "GLU_left": 0.0,
        "optimal_length": {"GAS": 1.1},
        "slack_length": {"VAS_left": 1.02},
        "activation_time": {"TA": 2.0},
    },
    "prosthesis": {
        "side": "right",
        "stiffness_nmprad": 400.0,
        "damping_nmsprad": 1.0,
        "rest_rad": 0.1,
    },
    "exoskeleton": {"motion": "hip_extension", "side": "left"},
}
JOINTS = [
    f"/jointset/{joint}_{side}/{coordinate}_{side}"
    for side in "lr"
    for joint, coordinate in (
        ("hip", "hip_flexion"),
        ("knee", "knee_angle"),
        ("ankle", "ankle_angle"),
    )
]
COORDINATES = [path.rpartition("/")[2] for path in JOINTS]
MISSING = {"glut_max_l", "soleus_r", "tib_ant_r", "gastroc_r"}


class Case(NamedTuple):
    """A walk, and the folder that OpenSim gets."""

    trajectory: Trajectory
    folder: Path

    @property
    def model(self):
        return ElementTree.parse(self.folder / MODEL)

    def table(self, name):
        return read_storage((self.folder / name).read_text())[1]

    @property
    def muscles(self):
        return {each.get("name", ""): each for each in self.model.iter(MUSCLE)}

    def force(self, name):
        """The walker's own, by OpenSim's name."""
        return self.trajectory.muscle_force_n[:, NAMES.index(name)]


MUSCLE = "Millard2012EquilibriumMuscle"


def walked(world, folder):
    worlds = read_world(Table(world)).draw([1])
    low_level = np.array([parameter.default for parameter in LOW_LEVEL_GAINS])
    low_level[LOW_LEVEL_NAMES.index("exo_torque")] = 10.0 if world else 0.0
    result = simulate(
        PUBLISHED_GAINS,
        low_level_gains=low_level,
        duration_s=4.0,
        worlds=worlds,
        record=[0],
        record_rate_hz=1000.0,
    )
    write_opensim(folder, result.trajectories[0], Bodies.nominal(), world=worlds)
    return Case(result.trajectories[0], folder)


@pytest.fixture(scope="module", params=[{}, OWN_WORLD], ids=["nominal", "own world"])
def case(request, tmp_path_factory):
    return walked(request.param, tmp_path_factory.mktemp("opensim") / "walk")


def number(muscle, tag):
    return float(muscle.findtext(f".//{tag}", "nan"))


def computed(function, arguments):
    """The value of an ExpressionBasedFunction; arguments are by place, as OpenSim takes them."""
    names = function.findtext(".//variables", "").split()
    given = dict(zip(names, arguments, strict=True))
    value = eval(
        function.findtext(".//expression", ""), {"sin": np.sin, "cos": np.cos}, given
    )
    return np.asarray(value + np.zeros_like(arguments[0]))


def tendon_force(muscle, strain):
    """OpenSim's curve: two quintic Bezier curves between lines, then a line."""
    curve = muscle.find("TendonForceLengthCurve")
    one, stiffness, toe, curviness = (
        number(curve, tag)
        for tag in (
            "strain_at_one_norm_force",
            "stiffness_at_one_norm_force",
            "norm_force_at_toe_end",
            "curviness",
        )
    )
    x_toe = one + (toe - 1.0) / stiffness
    x_middle = one + (0.5 * toe - 1.0) / stiffness
    foot = x_toe / 10.0
    slope = 0.5 * toe / (x_middle - foot)
    x_joint = foot + 0.5 * (x_middle - foot)
    y_joint = slope * (x_joint - foot)
    corners = [np.array([foot, 0.0])]
    x = (stiffness * x_toe - toe + y_joint - slope * x_joint) / (stiffness - slope)
    corners.append(np.array([x, y_joint + slope * (x - x_joint)]))
    ends = [np.zeros(2), np.array([x_joint, y_joint]), np.array([x_toe, toe])]
    c = 0.1 + 0.8 * curviness
    u = np.linspace(0.0, 1.0, 3000)
    points = []
    for start, corner, end in zip(ends, corners, ends[1:], strict=False):
        near, far = (1 - c) * start + c * corner, (1 - c) * end + c * corner
        points.append(
            BPoly(np.array([[start], [near], [near], [far], [far], [end]]), [0, 1])(u)
        )
    x, y = np.concatenate(points).T
    beyond = toe + stiffness * (strain - x_toe)
    return np.where(strain > x_toe, beyond, np.interp(strain, x, y))


def coordinates(case, muscle, kind):
    table = case.table(STATES)
    return [
        table[f"{path}/{kind}"]
        for path in muscle.findtext(".//coordinate_paths", "").split()
    ]


def moment_arms(case, muscle):
    """By the numbers of `JOINTS`, in the states of the file."""
    paths = muscle.findtext(".//coordinate_paths", "").split()
    functions = muscle.findall(".//moment_arm_functions/*")
    values = coordinates(case, muscle, "value")
    return {
        JOINTS.index(path): computed(function, values)
        for path, function in zip(paths, functions, strict=True)
    }


def test_opensims_tendon_has_the_walkers_force_at_the_states_of_the_file(case):
    states = case.table(STATES)
    muscles = case.muscles
    assert set(NAMES) - set(muscles) in (set(), MISSING)
    for name, muscle in muscles.items():
        length = computed(
            muscle.find(".//length_function/*"), coordinates(case, muscle, "value")
        )
        fibre = states[f"/forceset/{name}/fiber_length"]
        strain = (length - fibre) / number(muscle, "tendon_slack_length") - 1.0
        force = number(muscle, "max_isometric_force") * tendon_force(muscle, strain)
        error = np.abs(force - case.force(name)).max() / case.force(name).max()
        assert error < 0.001, (name, error)  # wanted: 0.05


def test_the_fibres_of_the_file_are_the_walkers_but_for_tendon_and_step(case):
    """What is between them: two curves of a tendon, and how far the path goes in a physics step."""
    states = case.table(STATES)
    for name, element in case.muscles.items():
        own = case.trajectory.fibre_length_m[:, NAMES.index(name)]
        away_m = np.abs(states[f"/forceset/{name}/fiber_length"] - own)
        pose = [
            *coordinates(case, element, "value"),
            *coordinates(case, element, "speed"),
        ]
        speed_mps = np.abs(
            computed(element.find(".//lengthening_speed_function/*"), pose)
        )
        between_m = 0.0019 * number(element, "tendon_slack_length") + 1e-3 * speed_mps
        assert (away_m < between_m + 1e-4).all(), (name, away_m.max())
        assert away_m.max() < 2e-3, (name, away_m.max())


def test_opensim_itself_computes_the_walkers_forces(case, monkeypatch):
    monkeypatch.chdir(case.folder)  # OpenSim begins a log where it is imported
    opensim = pytest.importorskip("opensim", reason="no OpenSim: pip install opensim")
    opensim.Logger.setLevelString("warn")
    model = opensim.Model(str(case.folder / MODEL))
    model.initSystem()
    table = opensim.TimeSeriesTable(str(case.folder / STATES))
    states = opensim.StatesTrajectory.createFromStatesTable(model, table)
    muscles = [model.getMuscles().get(n) for n in range(model.getMuscles().getSize())]
    assert {muscle.getName() for muscle in muscles} == set(case.muscles)
    forces = {each.getName(): [] for each in muscles}
    errors = []
    arms = {each.getName(): [[] for _ in JOINTS] for each in muscles}
    for sample in range(0, states.getSize(), 20):
        state = states.get(sample)
        model.realizeDynamics(state)
        for muscle in muscles:
            forces[muscle.getName()].append(muscle.getActuation(state))
            for coordinate, values in zip(
                COORDINATES, arms[muscle.getName()], strict=True
            ):
                joint = model.getCoordinateSet().get(coordinate)
                values.append(muscle.computeMomentArm(state, joint))
    for name, force in forces.items():
        error = (
            np.abs(np.array(force) - case.force(name)[::20]).max()
            / case.force(name).max()
        )
        errors.append(error)
        element = case.muscles[name]
        for joint, ours in moment_arms(case, element).items():
            np.testing.assert_allclose(arms[name][joint], ours[::20], atol=1e-9)
    assert max(errors) < 0.001  # wanted: 0.05
    assert model.getTotalMass(state) == pytest.approx(80.0)


def test_muscles_passive_feet_and_motors_turn_the_joints_as_the_walker_did(case):
    """At the middles of the intervals, of which motors and the walker's torques are the means."""
    walk = case.trajectory
    torques = np.zeros_like(case.trajectory.joint_torque_nm)
    for name, muscle in case.muscles.items():
        for joint, arm in moment_arms(case, muscle).items():
            torques[:, joint] += arm * case.force(name)
    controls, states = case.table(CONTROLS), case.table(STATES)
    for spring in case.model.iter("SpringGeneralizedForce"):
        joint = COORDINATES.index(spring.findtext("coordinate", ""))
        angle, rate = (states[f"{JOINTS[joint]}/{kind}"] for kind in ("value", "speed"))
        stretch = angle - number(spring, "rest_length")
        torques[:, joint] -= number(spring, "stiffness") * stretch
        torques[:, joint] -= number(spring, "viscosity") * rate
    actuators = {
        f"/forceset/{each.get('name')}": each.findtext("coordinate", "")
        for each in case.model.iter("CoordinateActuator")
    }
    assert set(actuators) == set(controls) - {"time"} and set(
        actuators.values()
    ) == set(COORDINATES)
    torques[1:] = 0.5 * (torques[1:] + torques[:-1])
    for name, coordinate in actuators.items():
        torques[:, COORDINATES.index(coordinate)] += controls[name]
    peak = np.abs(walk.joint_torque_nm).max()
    np.testing.assert_allclose(torques, -walk.joint_torque_nm, atol=1e-6 * peak)
    # A motor has what its name says, and no torque of a muscle: in stance nothing, but
    # for stops.
    stance, extended = (
        walk.stance[:, 0],
        walk.joint_rad[:, 1] < KNEE_STRAIGHTEST_RAD + 0.01,
    )
    motor = np.abs(controls["/forceset/motor_knee_l"])[stance & ~extended]
    assert np.median(motor) < 0.01 * np.abs(walk.joint_torque_nm[:, 1]).max()


def test_the_rate_of_a_path_is_that_of_its_length(case):
    for muscle in case.muscles.values():
        values, rates = (coordinates(case, muscle, kind) for kind in ("value", "speed"))
        function = muscle.find(".//length_function/*")
        step = 1e-6
        later, earlier = (
            computed(
                function,
                [
                    value + sign * step * rate
                    for value, rate in zip(values, rates, strict=True)
                ],
            )
            for sign in (1.0, -1.0)
        )
        speed = computed(
            muscle.find(".//lengthening_speed_function/*"), [*values, *rates]
        )
        np.testing.assert_allclose(speed, (later - earlier) / (2 * step), atol=1e-6)


def numbers_of(model):
    tags = (
        "max_isometric_force",
        "optimal_fiber_length",
        "tendon_slack_length",
        "max_contraction_velocity",
        "activation_time_constant",
        "pennation_angle_at_optimal",
    )
    return {
        each.get("name", ""): tuple(number(each, tag) for tag in tags)
        for each in model.iter(MUSCLE)
    }


def test_every_muscle_has_the_numbers_of_the_walkers_own_world(case):
    found = numbers_of(case.model)
    own = len(found) < len(NAMES)
    factors = {}
    if own:
        factors = {
            ("soleus_l", 0): 0.5,
            ("hamstrings_r", 0): 0.7,
            ("gastroc_l", 1): 1.1,
            ("vasti_l", 2): 1.02,
            ("tib_ant_l", 4): 2.0,
        }
        assert set(found) == set(NAMES) - MISSING
    for name, values in found.items():
        published = (*PUBLISHED[name.rpartition("_")[0]], 0.01, 0.0)
        wanted = [
            each * factors.get((name, n), 1.0) for n, each in enumerate(published)
        ]
        assert values == pytest.approx(wanted, rel=1e-12), name
    states = case.table(STATES)
    assert {
        path.split("/")[2] for path in states if path.startswith("/forceset")
    } == set(found)
    springs = list(case.model.iter("SpringGeneralizedForce"))
    assert len(springs) == own
    for spring in springs:
        assert spring.findtext("coordinate") == "ankle_angle_r"
        values = [
            number(spring, tag) for tag in ("stiffness", "viscosity", "rest_length")
        ]
        assert values == [400.0, 1.0, -0.1]


def test_lines_run_where_the_muscles_are_drawn(case):
    origins = {
        "pelvis": (0.0, 0.0),
        "femur": (0.0, 0.0),
        "tibia": (0.0, -0.5),
        "calcn": (0.0, -1.0),
    }
    lines = {each.get("name", ""): each for each in case.model.iter("GeometryPath")}
    assert set(lines) == {f"{name}_line" for name in case.muscles}
    for name, line in lines.items():
        muscle, side = name.removesuffix("_line").rpartition("_")[::2]
        drawn = muscle_paths(np.zeros(9), "lr".index(side))[MUSCLES.index(OURS[muscle])]
        points = []
        for point in line.iter("PathPoint"):
            body = point.findtext("socket_parent_frame", "").rpartition("/")[2]
            place = np.array(point.findtext("location", "").split(), dtype=float)
            assert body == "pelvis" or body.endswith(f"_{side}")
            points.append(place[:2] + origins[body.split("_")[0]])
        np.testing.assert_allclose([points[0], points[-1]], drawn[[0, -1]], atol=1e-12)


def test_the_tendons_strain_is_near_the_walkers():
    """As the text of the module says: within 0.0019 up to 1.4 Fmax."""
    forces, strains = tendon_curve()
    share = np.linspace(0.0, 1.4, 1401)
    away = np.abs(np.interp(share, forces, strains) - 0.04 * np.sqrt(share))
    assert 0.0015 < away.max() < 0.0019


def test_the_fibres_curves_are_as_near_as_the_documents_say(case, monkeypatch):
    """Of one muscle: all have the same."""
    monkeypatch.chdir(case.folder)
    opensim = pytest.importorskip("opensim", reason="no OpenSim: pip install opensim")
    model = opensim.Model(str(case.folder / MODEL))
    model.initSystem()
    muscle = opensim.Millard2012EquilibriumMuscle.safeDownCast(
        model.getMuscles().get(0)
    )
    length, speed = np.linspace(0.3, 1.0 + WIDTH, 281), np.linspace(-1.0, 1.0, 401)
    lengthening = ECCENTRIC + (ECCENTRIC - 1.0) * (speed - 1.0) / (
        1.0 + 7.56 * SHAPE * speed
    )
    curves = [
        (
            muscle.getActiveForceLengthCurve(),
            length,
            0.05 ** np.abs((length - 1.0) / WIDTH) ** 3,
        ),
        (
            muscle.getFiberForceLengthCurve(),
            length,
            np.maximum((length - 1.0) / WIDTH, 0.0) ** 2,
        ),
        (
            muscle.getForceVelocityCurve(),
            speed,
            np.where(speed < 0.0, (1.0 + speed) / (1.0 - SHAPE * speed), lengthening),
        ),
    ]
    for (curve, places, ours), most in zip(curves, (0.11, 0.01, 0.06), strict=True):
        theirs = [curve.calcValue(place) for place in places.tolist()]
        assert np.abs(np.array(theirs) - ours).max() < most
