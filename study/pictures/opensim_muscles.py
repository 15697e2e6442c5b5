"""What turns the walker's joints, as OpenSim has it: muscles, a passive foot, motors.

A muscle is a Millard2012EquilibriumMuscle on a FunctionBasedPath, whose expressions
OpenSim reads from version 4.5.2 on. They are sums of the simulator's own factors
(`LENGTHS_M`, `TORQUES_NM`). The walker's pennation scales its lengths and not its arms,
so the arm is not the slope of the length, and the file gives length, arm and speed.
OpenSim's coordinates are the joints' angles, negative.

OpenSim has no tendon whose force is the square of its strain; the strain of its nearest
curve differs by up to 0.0019. So the fibre's length among the states is what OpenSim's
tendon leaves of the path under the walker's force, and OpenSim finds this force. The
length also takes up that the recorded force is of the last physics step, whose pose is
one step older than the recorded one.
"""

import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from study.pictures.stick_figure import DRAWN, FIRST_LEG_COLUMN
from taichi_nmm.kernel.muscle import ACTIVATION_TIME_S
from taichi_nmm.kernel.muscle_table import FMAX_N, LENGTHS_M, MUSCLE_DATA, TORQUES_NM
from taichi_nmm.result import MUSCLES, Trajectory
from taichi_nmm.world import Worlds

Array = NDArray[np.float64]

OPENSIM = tomllib.loads(
    Path(__file__).with_name("opensim.toml").read_text(encoding="utf-8")
)
XML: dict[str, str] = {name: text.strip() for name, text in OPENSIM["xml"].items()}
LEG: list[str] = OPENSIM["leg"]
SIDES = ("l", "r")
JOINTS = ("hip", "knee", "ankle")
MOTORS = [f"motor_{joint}_{side}" for side in SIDES for joint in JOINTS]
SIDED = [(side, muscle) for side in SIDES for muscle in MUSCLES]


@dataclass(frozen=True)
class OwnMuscle:
    """A muscle of a walker's own world.

    Attributes:
        name: OpenSim's, with the side, as `soleus_l`.
        muscle: of `MUSCLES`.
        side: of `SIDES`.
        column: of the trajectory's muscles and of the world's.
        fmax: largest isometric force, N.
        optimal: the fibre's optimal length, m.
        slack: the tendon's slack length, m.
        time: constant of the activation, s.
    """

    name: str
    muscle: str
    side: str
    column: int
    fmax: float
    optimal: float
    slack: float
    time: float


def muscles_of(world: Worlds) -> list[OwnMuscle]:
    """The muscles of the first of some worlds, in the order of `SIDED`, but those missing."""
    muscles = []
    for column, (side, muscle) in enumerate(SIDED):
        data = MUSCLE_DATA[muscle]
        fmax = data.fmax_n * float(world.strength[0, column])
        if fmax > 0.0:
            found = OwnMuscle(
                name=f"{OPENSIM['muscles'][muscle]}_{side}",
                muscle=muscle,
                side=side,
                column=column,
                fmax=fmax,
                optimal=data.optimal_length_m * float(world.optimal_length[0, column]),
                slack=data.slack_length_m * float(world.slack_length[0, column]),
                time=ACTIVATION_TIME_S * float(world.activation_time[0, column]),
            )
            muscles.append(found)
    return muscles


def by_leg(values: Array) -> Array:
    """Columns of the left leg, then of the right [t, 2 k], as [t, 2, k]."""
    return values.reshape(len(values), len(SIDES), -1)


def gained(values: Array) -> Array:
    """How much values grow in the interval that ends at a sample, 0 at the first."""
    return np.diff(values, axis=0, prepend=values[:1])


def middle(values: Array) -> Array:
    """Values in the middle of the interval that ends at a sample."""
    return values - 0.5 * gained(values)


def path_lengths(trajectory: Trajectory) -> Array:
    """Lengths of fibre and tendon together, in the order of `SIDED`, m, [14, t]."""
    hip, knee, ankle = by_leg(trajectory.joint_rad).T
    sines_cosines = [np.sin(knee), np.cos(knee), np.sin(ankle), np.cos(ankle)]
    factors = np.array([np.ones_like(hip), hip, *sines_cosines])
    return np.concatenate(list(np.einsum("mf,fst->smt", LENGTHS_M, factors)))


def fibre_lengths(trajectory: Trajectory, world: Worlds) -> dict[str, Array]:
    """By muscle, the fibre's length with which OpenSim's tendon has the walker's force, m, [t].

    Of a slack tendon, the walker's own length, or what keeps it slack. Missing muscles
    have none.
    """
    forces, strains = tendon_curve()
    paths = path_lengths(trajectory)
    lengths = {}
    for muscle in muscles_of(world):
        share = trajectory.muscle_force_n[:, muscle.column] / muscle.fmax
        unstretched = paths[muscle.column] - muscle.slack
        taut = unstretched - muscle.slack * np.interp(share, forces, strains)
        slack = np.maximum(trajectory.fibre_length_m[:, muscle.column], unstretched)
        lengths[muscle.name] = np.where(share > 0.0, taut, slack)
    return lengths


BEZIER_SAMPLES = 400  # of each of the curve's two parts: within 1e-6 of strain
LARGEST_FORCE = 1e6  # over Fmax; the curve is a line from the end of its toe on


def tendon_curve() -> tuple[Array, Array]:
    """OpenSim's tendon: forces over Fmax, and the strains under them.

    As `SmoothSegmentedFunctionFactory::createTendonForceLengthCurve` of OpenSim 4.6 has
    it: two quintic Bezier curves, then a line.
    """
    strain, stiffness, toe, curviness = OPENSIM["tendon"].values()

    def on_line(force: float) -> float:
        return float(strain + (force - 1.0) / stiffness)

    foot = 0.1 * on_line(toe)
    middle = on_line(0.5 * toe)
    slope = 0.5 * toe / (middle - foot)
    between = 0.5 * (foot + middle)
    start = Point(x=0.0, y=0.0, slope=0.0)
    knee = Point(x=between, y=slope * (between - foot), slope=slope)
    end = Point(x=on_line(toe), y=toe, slope=stiffness)
    bend = 0.1 + 0.8 * curviness
    last = np.array([[on_line(LARGEST_FORCE), LARGEST_FORCE]])
    parts = [_corner(start, knee, bend), _corner(knee, end, bend), last]
    strains, forces = np.concatenate(parts).T
    return forces, strains


class Point(NamedTuple):
    """A point of a curve, and the curve's slope there."""

    x: float
    y: float
    slope: float


def _corner(start: Point, end: Point, bend: float) -> Array:
    """Points of a quintic Bezier curve between two points, along their slopes, [k, 2]."""
    rise = end.y - start.y - end.x * end.slope + start.x * start.slope
    x = rise / (start.slope - end.slope)  # where the lines along the slopes meet
    corner = np.array([x, end.y + end.slope * (x - end.x)])
    first, last = np.array(start[:2]), np.array(end[:2])
    near, far = first + bend * (corner - first), last + bend * (corner - last)
    controls = np.array([first, near, near, far, far, last])
    u = np.linspace(0.0, 1.0, BEZIER_SAMPLES)[:, None]
    order = np.arange(len(controls))
    weights = np.array([1, 5, 10, 10, 5, 1]) * u**order * (1.0 - u) ** order[::-1]
    return np.asarray(weights @ controls)


def forces_text(world: Worlds) -> str:
    """Muscles, passive feet, and a motor of each joint, as XML."""
    parts = [_muscle_text(muscle) for muscle in muscles_of(world)]
    feet = world.prosthesis[0].tolist()
    for side, (stiffness, damping, rest_rad) in zip(SIDES, feet, strict=True):
        if stiffness or damping:
            spring = XML["prosthesis"].format(
                side=side,
                coordinate=_coordinate("ankle", side),
                stiffness=stiffness,
                damping=damping,
                rest=-rest_rad,
            )
            parts.append(spring)
    for name in MOTORS:
        _, joint, side = name.split("_")
        coordinate = _coordinate(joint, side)
        parts.append(XML["actuator"].format(name=name, coordinate=coordinate))
    return "".join(f"{part}\n" for part in parts)


def _coordinate(joint: str, side: str) -> str:
    return _path(joint, side).rpartition("/")[2]


def _path(joint: str, side: str) -> str:
    return LEG[JOINTS.index(joint)].format(side=side)


# Terms of the expressions, as the factors of `LENGTHS_M` and `TORQUES_NM` have them.
LENGTH_TERMS = (
    "1",
    "(-{hip})",
    "sin(-{knee})",
    "cos({knee})",
    "sin(-{ankle})",
    "cos({ankle})",
)
SPEED_TERMS = (
    "0",
    "(-{hip}_speed)",
    "(-cos({knee})*{knee}_speed)",
    "(-sin({knee})*{knee}_speed)",
    "(-cos({ankle})*{ankle}_speed)",
    "(-sin({ankle})*{ankle}_speed)",
)
ARM_TERMS = {
    "hip": ("(-1)", "0", "0", "0", "0"),
    "knee": ("0", "(-cos({knee}))", "sin({knee})", "0", "0"),
    "ankle": ("0", "0", "0", "(-cos({ankle}))", "sin({ankle})"),
}


def _muscle_text(muscle: OwnMuscle) -> str:
    row = MUSCLES.index(muscle.muscle)
    arms_m = TORQUES_NM[row] / FMAX_N[row]
    sums = {joint: _sum(arms_m, terms) for joint, terms in ARM_TERMS.items()}
    arms = {joint: text for joint, text in sums.items() if text}  # that it spans
    names = {joint: _coordinate(joint, muscle.side) for joint in JOINTS}
    spanned = " ".join(names[joint] for joint in arms)
    speeds = " ".join(f"{names[joint]}_speed" for joint in arms)

    def function(expression: str, variables: str) -> str:
        text = expression.format(**names)
        return XML["function"].format(expression=text, variables=variables)

    paths = [f"/jointset/{_path(joint, muscle.side)}" for joint in arms]
    speed = _sum(LENGTHS_M[row], SPEED_TERMS)
    return XML["muscle"].format(
        **vars(muscle),
        vmax=float(MUSCLE_DATA[muscle.muscle].vmax_per_s),
        coordinates=" ".join(paths),
        length=function(_sum(LENGTHS_M[row], LENGTH_TERMS), spanned),
        arms="".join(function(expression, spanned) for expression in arms.values()),
        speed=function(speed, f"{spanned} {speeds}"),
        tendon=OPENSIM["tendon"],
    )


def _sum(factors: Array, terms: Iterable[str]) -> str:
    """Without the terms that are nothing."""
    both = zip(factors.tolist(), terms, strict=True)
    return "+".join(
        f"({factor!r})*{term}" for factor, term in both if factor and term != "0"
    )


def lines_text(world: Worlds) -> str:
    """Lines for the eye along muscle_paths.toml: OpenSim does not draw a FunctionBasedPath."""
    lines = []
    for muscle in muscles_of(world):
        points = []
        for number, (segment, along, ahead) in enumerate(DRAWN[muscle.muscle]["path"]):
            frame = OPENSIM["segments"][segment]
            x, y = np.array([along, ahead]) @ frame["directions"]
            point = XML["point"].format(
                name=f"{muscle.name}_{number}",
                body=frame["body"].format(side=muscle.side),
                x=float(x),
                y=float(y),
            )
            points.append(point)
        lines.append(XML["line"].format(name=muscle.name, points="\n".join(points)))
    return "".join(f"{line}\n" for line in lines)


def motor_torques(trajectory: Trajectory, world: Worlds) -> dict[str, Array]:
    """What turns a coordinate beside the model's muscles and passive feet, by its motor, N m, [t].

    The controller of the swing leg, an exoskeleton, stops, and what the walker holds
    back of its muscles: while a leg goes over to swing, its hip and knee get but a
    share of their torques. The trajectory's torques are means over its intervals, and
    so are these.
    """
    activity = by_leg(trajectory.muscle_force_n) / FMAX_N
    hip, knee_cos, knee_sin, ankle_cos, ankle_sin = (activity @ TORQUES_NM).T
    _, knee_rad, ankle_rad = by_leg(trajectory.joint_rad).T
    knee = knee_cos * np.cos(knee_rad) + knee_sin * np.sin(knee_rad)
    ankle = ankle_cos * np.cos(ankle_rad) + ankle_sin * np.sin(ankle_rad)
    _, shank_rate, foot_rate = by_leg(trajectory.qdot[:, FIRST_LEG_COLUMN:]).T
    stiffness, damping, rest_rad = world.prosthesis[0].T[..., None]
    ankle += stiffness * (rest_rad - ankle_rad) - damping * (foot_rate - shank_rate)
    within = np.array([hip, knee, ankle]).T.reshape(-1, len(MOTORS))
    beside = middle(within) - trajectory.joint_torque_nm
    return dict(zip(MOTORS, beside.T, strict=True))
