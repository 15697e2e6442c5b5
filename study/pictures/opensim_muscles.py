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
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from study.pictures.stick_figure import DRAWN
from taichi_nmm.kernel.muscle import ACTIVATION_TIME_S
from taichi_nmm.kernel.muscle_table import FMAX_N, LENGTHS_M, MUSCLE_DATA, TORQUES_NM
from taichi_nmm.result import MUSCLES, Trajectory
from taichi_nmm.world import MUSCLE_NAMES, Worlds

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
        fmax: largest isometric force, N; 0 where the muscle is missing.
        optimal: the fibre's optimal length, m.
        slack: the tendon's slack length, m.
        time: constant of the activation, s.
    """

    name: str
    muscle: str
    side: str
    fmax: float
    optimal: float
    slack: float
    time: float


def muscles_of(world: Worlds | None) -> list[OwnMuscle]:
    """The 14 muscles of the first of some worlds, in the order of `SIDED`; None is the nominal."""
    own, muscles = world or Worlds.nominal(), []
    for side, muscle in SIDED:
        data = MUSCLE_DATA[muscle]
        whole_side = "left" if side == "l" else "right"
        column = MUSCLE_NAMES.index(f"{muscle}_{whole_side}")
        muscles.append(
            OwnMuscle(
                name=f"{OPENSIM['muscles'][muscle]}_{side}",
                muscle=muscle,
                side=side,
                fmax=data.fmax_n * float(own.strength[0, column]),
                optimal=data.optimal_length_m * float(own.optimal_length[0, column]),
                slack=data.slack_length_m * float(own.slack_length[0, column]),
                time=ACTIVATION_TIME_S * float(own.activation_time[0, column]),
            )
        )
    return muscles


def path_lengths(trajectory: Trajectory) -> Array:
    """Lengths of fibre and tendon together, in the order of `SIDED`, m, [14, t]."""
    hip, knee, ankle = trajectory.joint_rad.reshape(
        -1, len(SIDES), len(JOINTS)
    ).transpose(2, 1, 0)
    factors = (
        np.ones_like(hip),
        hip,
        np.sin(knee),
        np.cos(knee),
        np.sin(ankle),
        np.cos(ankle),
    )
    return np.concatenate(list(np.einsum("mf,fst->smt", LENGTHS_M, np.array(factors))))


def fibre_lengths(trajectory: Trajectory, world: Worlds | None) -> dict[str, Array]:
    """By muscle, the fibre's length with which OpenSim's tendon has the walker's force, m, [t].

    Of a slack tendon, the walker's own length, or what keeps it slack. Missing muscles
    have none.
    """
    forces, strains = tendon_curve()
    paths, lengths = path_lengths(trajectory), {}
    for column, muscle in enumerate(muscles_of(world)):
        if muscle.fmax == 0.0:
            continue
        share = trajectory.muscle_force_n[:, column] / muscle.fmax
        unstretched = paths[column] - muscle.slack
        taut = unstretched - muscle.slack * np.interp(share, forces, strains)
        slack = np.maximum(trajectory.fibre_length_m[:, column], unstretched)
        lengths[muscle.name] = np.where(share > 0.0, taut, slack)
    return lengths


BEZIER_SAMPLES = 400  # of each of the curve's two parts: within 1e-6 of strain
LARGEST_FORCE = 1e6  # over Fmax; the curve is a line from the end of its toe on


def tendon_curve() -> tuple[Array, Array]:
    """OpenSim's tendon: forces over Fmax, and the strains under them.

    As `SmoothSegmentedFunctionFactory::createTendonForceLengthCurve` of OpenSim 4.6 has
    it: two quintic Bezier curves, then a line.
    """
    strain, stiffness, toe, curviness = (
        OPENSIM["tendon"][name] for name in ("strain", "stiffness", "toe", "curviness")
    )

    def on_line(force: float) -> float:
        return float(strain + (force - 1.0) / stiffness)

    foot = 0.1 * on_line(toe)
    slope = 0.5 * toe / (on_line(0.5 * toe) - foot)
    between = 0.5 * (foot + on_line(0.5 * toe))
    ends = [
        (0.0, 0.0, 0.0),
        (between, slope * (between - foot), slope),
        (on_line(toe), toe, stiffness),
    ]
    bend = 0.1 + 0.8 * curviness
    parts = [_corner(*pair, bend) for pair in pairwise(ends)]
    points = np.concatenate([*parts, [(on_line(LARGEST_FORCE), LARGEST_FORCE)]])
    return points[:, 1], points[:, 0]


def _corner(
    start: tuple[float, float, float], end: tuple[float, float, float], bend: float
) -> Array:
    """Points of a quintic Bezier curve between two lines, given as x, y and slope, [k, 2]."""
    (x0, y0, slope0), (x1, y1, slope1) = start, end
    x = (y1 - y0 - x1 * slope1 + x0 * slope0) / (slope0 - slope1)
    corner = np.array([x, y1 + slope1 * (x - x1)])
    first, last = np.array([x0, y0]), np.array([x1, y1])
    near, far = first + bend * (corner - first), last + bend * (corner - last)
    controls = np.array([first, near, near, far, far, last])
    u = np.linspace(0.0, 1.0, BEZIER_SAMPLES)[:, None]
    order = np.arange(len(controls))
    weights = np.array([1, 5, 10, 10, 5, 1]) * u**order * (1.0 - u) ** order[::-1]
    return np.asarray(weights @ controls)


def forces_text(world: Worlds | None) -> str:
    """Muscles, passive feet, and a motor of each joint, as XML."""
    parts = [_muscle_text(muscle) for muscle in muscles_of(world) if muscle.fmax > 0.0]
    feet = (world or Worlds.nominal()).prosthesis[0].tolist()
    for side, (stiffness, damping, rest) in zip(SIDES, feet, strict=True):
        if stiffness or damping:
            numbers = {"stiffness": stiffness, "damping": damping, "rest": -rest}
            ankle = _coordinate("ankle", side)
            parts.append(
                XML["prosthesis"].format(side=side, coordinate=ankle, **numbers)
            )
    for name in MOTORS:
        _, joint, side = name.split("_")
        parts.append(
            XML["actuator"].format(name=name, coordinate=_coordinate(joint, side))
        )
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
    lengths_m, arms_m = LENGTHS_M[row], TORQUES_NM[row] / FMAX_N[row]
    sums = {joint: _sum(arms_m, terms) for joint, terms in ARM_TERMS.items()}
    arms = {joint: expression for joint, expression in sums.items() if expression}
    names = {joint: _coordinate(joint, muscle.side) for joint in JOINTS}
    spanned = [names[joint] for joint in arms]

    def function(expression: str, variables: Iterable[str]) -> str:
        return XML["function"].format(
            expression=expression.format(**names), variables=" ".join(variables)
        )

    return XML["muscle"].format(
        **vars(muscle),
        vmax=float(MUSCLE_DATA[muscle.muscle].vmax_per_s),
        coordinates=" ".join(
            f"/jointset/{_path(joint, muscle.side)}" for joint in arms
        ),
        length=function(_sum(lengths_m, LENGTH_TERMS), spanned),
        arms="".join(function(expression, spanned) for expression in arms.values()),
        speed=function(
            _sum(lengths_m, SPEED_TERMS),
            [*spanned, *(f"{name}_speed" for name in spanned)],
        ),
        tendon=OPENSIM["tendon"],
    )


def _sum(factors: Array, terms: Iterable[str]) -> str:
    """Without the terms that are nothing."""
    both = zip(factors.tolist(), terms, strict=True)
    return "+".join(
        f"({factor!r})*{term}" for factor, term in both if factor and term != "0"
    )


def lines_text(world: Worlds | None) -> str:
    """Lines for the eye along muscle_paths.toml: OpenSim does not draw a FunctionBasedPath."""
    lines = []
    for muscle in muscles_of(world):
        if muscle.fmax == 0.0:
            continue
        points = []
        for number, (segment, along, ahead) in enumerate(DRAWN[muscle.muscle]["path"]):
            body, *directions = OPENSIM["segments"][segment]
            x, y = (np.array([along, ahead]) @ np.reshape(directions, (2, 2))).tolist()
            name, frame = f"{muscle.name}_{number}", body.format(side=muscle.side)
            points.append(XML["point"].format(name=name, body=frame, x=x, y=y))
        lines.append(XML["line"].format(name=muscle.name, points="\n".join(points)))
    return "".join(f"{line}\n" for line in lines)


def motor_torques(
    trajectory: Trajectory, world: Worlds | None = None
) -> dict[str, Array]:
    """What turns a coordinate beside the model's muscles and passive feet, by its motor, N m, [t].

    The controller of the swing leg, an exoskeleton, stops, and what the walker holds
    back of its muscles: while a leg goes over to swing, its hip and knee get but a
    share of their torques. The trajectory's torques are means over its intervals, and
    so are these.
    """
    angle = trajectory.joint_rad.reshape(-1, len(SIDES), len(JOINTS))
    share = trajectory.muscle_force_n.reshape(-1, len(SIDES), len(MUSCLES)) / FMAX_N
    factors = share @ TORQUES_NM
    within = np.empty_like(angle)
    within[..., 0] = factors[..., 0]
    cosines, sines = factors[..., 1::2], factors[..., 2::2]
    within[..., 1:] = cosines * np.cos(angle[..., 1:]) + sines * np.sin(angle[..., 1:])
    ankle_rate = trajectory.qdot[:, [5, 8]] - trajectory.qdot[:, [4, 7]]
    stiffness, damping, rest_rad = (world or Worlds.nominal()).prosthesis[0].T
    within[..., 2] += stiffness * (rest_rad - angle[..., 2]) - damping * ankle_rate
    means = within - 0.5 * np.diff(within, axis=0, prepend=within[:1])
    beside = means.reshape(-1, len(MOTORS)) - trajectory.joint_torque_nm
    return dict(zip(MOTORS, beside.T, strict=True))
