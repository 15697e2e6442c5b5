"""What turns the walker's joints, as OpenSim has it: muscles, a passive foot, motors.

A muscle is a Millard2012EquilibriumMuscle on a FunctionBasedPath, whose expressions OpenSim reads
from version 4.5.2 on. OpenSim's coordinate is c = -phi, phi being the joint's angle. With s, rho,
r, max and ref those of the `Attachment`, the path grows by

    s rho r (sin(ref - max) + sin(c + max)),  or  s rho r (ref + c)  of a constant arm,

and the arm is -s r cos(c + max), or -s r: without rho, which scales the walker's lengths alone. So
the arm is not the slope of the length, and the file gives length, arm and speed.

OpenSim has no tendon whose force is the square of its strain; the strain of its nearest curve
differs by up to 0.0019. So the fibre's length among the states is what OpenSim's tendon leaves of
the path under the walker's force, and OpenSim finds this force. The length also takes up that the
recorded force is of the last physics step, whose pose is one step older than the recorded one.
"""

import tomllib
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from study.pictures.stick_figure import DRAWN
from taichi_nmm.body import SIDES as WHOLE_SIDES
from taichi_nmm.kernel.muscle import ACTIVATION_TIME_S
from taichi_nmm.kernel.muscle_table import MUSCLE_DATA, MuscleData
from taichi_nmm.result import MUSCLES, Trajectory
from taichi_nmm.world import MUSCLE_NAMES as NAMES_IN_WORLDS
from taichi_nmm.world import Worlds

Array = NDArray[np.float64]

OPENSIM = tomllib.loads(Path(__file__).with_name("opensim.toml").read_text(encoding="utf-8"))
XML: dict[str, str] = {name: text.strip() for name, text in OPENSIM["xml"].items()}
LEG: list[str] = OPENSIM["leg"]
SIDES = ("l", "r")
JOINTS = ("hip", "knee", "ankle")
MOTORS = [f"motor_{joint}_{side}" for side in SIDES for joint in JOINTS]
SIDED = [(side, muscle) for side in SIDES for muscle in MUSCLES]


@dataclass(frozen=True)
class OwnMuscle:
    """A muscle of one walker's own world, by OpenSim's name.

    Attributes:
        name: with its side, as `soleus_l`.
        muscle: of `MUSCLES`.
        side: an index into `SIDES`.
        fmax_n: largest isometric force; 0 where the muscle is missing.
        optimal_m: the fibre's optimal length.
        slack_m: the tendon's.
        activation_s: time constant of the activation.
    """

    name: str
    muscle: str
    side: int
    fmax_n: float
    optimal_m: float
    slack_m: float
    activation_s: float

    @property
    def data(self) -> MuscleData:
        """The nominal muscle."""
        return MUSCLE_DATA[self.muscle]


def muscles_of(world: Worlds | None) -> list[OwnMuscle]:
    """The 14 muscles of the first of some worlds, in the order of `SIDED`; None is the nominal."""
    rows = world or Worlds.nominal()
    factors = {
        name: dict(zip(NAMES_IN_WORLDS, values[0].tolist(), strict=True))
        for name, values in vars(rows).items()
        if name in ("strength", "optimal_length", "slack_length", "activation_time")
    }
    muscles = []
    for side, muscle in SIDED:
        data, number = MUSCLE_DATA[muscle], SIDES.index(side)
        in_world = f"{muscle}_{WHOLE_SIDES[number]}"
        muscles.append(
            OwnMuscle(
                name=f"{OPENSIM['muscles'][muscle]}_{side}",
                muscle=muscle,
                side=number,
                fmax_n=data.fmax_n * factors["strength"][in_world],
                optimal_m=data.optimal_length_m * factors["optimal_length"][in_world],
                slack_m=data.slack_length_m * factors["slack_length"][in_world],
                activation_s=ACTIVATION_TIME_S * factors["activation_time"][in_world],
            )
        )
    return muscles


@dataclass(frozen=True)
class Span:
    """How a path depends on a coordinate c.

    Attributes:
        joint: an index into `JOINTS`.
        growth_m: a factor of sin(c + largest), or of c where the arm is constant.
        arm_m: at its largest, positive where the muscle drives the coordinate upwards.
        largest_rad: as it stands in the sine; None is a constant arm.
    """

    joint: int
    growth_m: float
    arm_m: float
    largest_rad: float | None


def path_of(data: MuscleData) -> tuple[float, list[Span]]:
    """Length of fibre and tendon together, m: a constant, and what each coordinate adds."""
    constant, spans = data.optimal_length_m + data.slack_length_m, []
    for joint, name in enumerate(JOINTS):
        attachment = getattr(data, name)
        if attachment is None:
            continue
        growth = attachment.sign * attachment.pennation * attachment.arm_m
        reference = float(np.deg2rad(attachment.reference_angle_deg))
        largest = None
        if attachment.angle_of_largest_arm_deg is None:
            constant += growth * reference
        else:
            largest = float(np.deg2rad(attachment.angle_of_largest_arm_deg))
            constant += growth * float(np.sin(reference - largest))
        spans.append(Span(joint, growth, -attachment.sign * attachment.arm_m, largest))
    return constant, spans


def path_lengths(muscle: OwnMuscle, trajectory: Trajectory) -> Array:
    """Length of fibre and tendon together at each sample, m, [t]."""
    length, spans = path_of(muscle.data)
    lengths = np.full(len(trajectory.time_s), length)
    for span in spans:
        coordinate = -trajectory.joint_rad[:, len(JOINTS) * muscle.side + span.joint]
        if span.largest_rad is None:
            lengths += span.growth_m * coordinate
        else:
            lengths += span.growth_m * np.sin(coordinate + span.largest_rad)
    return lengths


def fibre_lengths(trajectory: Trajectory, world: Worlds | None) -> dict[str, Array]:
    """By muscle, the fibre's length with which OpenSim's tendon has the walker's force, m, [t].

    Of a slack tendon, the walker's own length, or what keeps it slack. Missing muscles have none.
    """
    forces, strains = tendon_curve()
    lengths = {}
    for column, muscle in enumerate(muscles_of(world)):
        if muscle.fmax_n == 0.0:
            continue
        share = trajectory.muscle_force_n[:, column] / muscle.fmax_n
        unstretched = path_lengths(muscle, trajectory) - muscle.slack_m
        taut = unstretched - muscle.slack_m * np.interp(share, forces, strains)
        slack = np.maximum(trajectory.fibre_length_m[:, column], unstretched)
        lengths[muscle.name] = np.where(share > 0.0, taut, slack)
    return lengths


BEZIER_SAMPLES = 400  # of each of the curve's two parts: within 1e-6 of strain
LARGEST_FORCE = 100.0  # over Fmax; the curve is a line from the end of its toe on


def tendon_curve() -> tuple[Array, Array]:
    """OpenSim's tendon: forces over Fmax, and the strains under them.

    As `SmoothSegmentedFunctionFactory::createTendonForceLengthCurve` of OpenSim 4.6 has it: two
    quintic Bezier curves, then a line.
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
    parts = [_muscle_text(muscle) for muscle in muscles_of(world) if muscle.fmax_n > 0.0]
    feet = (world or Worlds.nominal()).prosthesis[0].tolist()
    for side, (stiffness, damping, rest) in zip(SIDES, feet, strict=True):
        if stiffness or damping:
            numbers = {"stiffness": stiffness, "damping": damping, "rest": -rest}
            ankle = _coordinate("ankle", side)
            parts.append(XML["prosthesis"].format(side=side, coordinate=ankle, **numbers))
    for name in MOTORS:
        _, joint, side = name.split("_")
        parts.append(XML["actuator"].format(name=name, coordinate=_coordinate(joint, side)))
    return "".join(f"{part}\n" for part in parts)


def _coordinate(joint: str, side: str) -> str:
    path = LEG[JOINTS.index(joint)].format(side=side)
    return path.rpartition("/")[2]


def _muscle_text(muscle: OwnMuscle) -> str:
    side = SIDES[muscle.side]
    constant, spans = path_of(muscle.data)
    coordinates = [_coordinate(JOINTS[span.joint], side) for span in spans]
    length, speed, arms = [repr(constant)], [], []
    for span, c in zip(spans, coordinates, strict=True):
        if span.largest_rad is None:
            length.append(f"({span.growth_m!r})*{c}")
            speed.append(f"({span.growth_m!r})*{c}_speed")
            arms.append(f"({span.arm_m!r})")
        else:
            angle = f"({c}+({span.largest_rad!r}))"
            length.append(f"({span.growth_m!r})*sin{angle}")
            speed.append(f"({span.growth_m!r})*cos{angle}*{c}_speed")
            arms.append(f"({span.arm_m!r})*cos{angle}")
    values = " ".join(coordinates)
    rates = " ".join(f"{c}_speed" for c in coordinates)
    paths = (LEG[span.joint].format(side=side) for span in spans)
    return XML["muscle"].format(
        name=muscle.name,
        coordinates=" ".join(f"/jointset/{path}" for path in paths),
        length=_function("+".join(length), values),
        arms="".join(_function(arm, values) for arm in arms),
        speed=_function("+".join(speed), f"{values} {rates}"),
        fmax=muscle.fmax_n,
        optimal=muscle.optimal_m,
        slack=muscle.slack_m,
        vmax=float(muscle.data.vmax_per_s),
        time=muscle.activation_s,
        tendon={name: float(value) for name, value in OPENSIM["tendon"].items()},
    )


def _function(expression: str, variables: str) -> str:
    return XML["function"].format(expression=expression, variables=variables)


def lines_text(world: Worlds | None) -> str:
    """Lines for the eye along muscle_paths.toml: OpenSim does not draw a FunctionBasedPath."""
    lines = []
    for muscle in muscles_of(world):
        if muscle.fmax_n == 0.0:
            continue
        points = []
        for number, (segment, along, ahead) in enumerate(DRAWN[muscle.muscle]["path"]):
            body, *directions = OPENSIM["segments"][segment]
            axis, front = np.reshape(directions, (2, 2)).astype(float)
            x, y = (along * axis + ahead * front).tolist()
            name, frame = f"{muscle.name}_{number}", body.format(side=SIDES[muscle.side])
            points.append(XML["point"].format(name=name, body=frame, x=x, y=y))
        lines.append(XML["line"].format(name=muscle.name, points="\n".join(points)))
    return "".join(f"{line}\n" for line in lines)


def motor_torques(trajectory: Trajectory, world: Worlds | None = None) -> dict[str, Array]:
    """What turns a coordinate beside the model's muscles and passive feet, by its motor, N m, [t].

    The controller of the swing leg, an exoskeleton, stops, and what the walker holds back of its
    muscles: while a leg goes over to swing, its hip and knee get but a share of their torques. The
    trajectory's torques are means over its intervals, and so are these.
    """
    within = passive_torques(trajectory, world)
    for column, muscle in enumerate(muscles_of(world)):
        for span in path_of(muscle.data)[1]:
            joint = len(JOINTS) * muscle.side + span.joint
            arm = np.full(len(within), span.arm_m)
            if span.largest_rad is not None:
                arm *= np.cos(span.largest_rad - trajectory.joint_rad[:, joint])
            within[:, joint] += arm * trajectory.muscle_force_n[:, column]
    means = within - 0.5 * np.diff(within, axis=0, prepend=within[:1])
    beside = -trajectory.joint_torque_nm - means
    return dict(zip(MOTORS, beside.T, strict=True))


def passive_torques(trajectory: Trajectory, world: Worlds | None) -> Array:
    """Of passive feet on the coordinates of the joints, N m, [t, 6]."""
    torques = np.zeros_like(trajectory.joint_rad)
    links, ankle = [[4, 5], [7, 8]], JOINTS.index("ankle")
    for side, foot in enumerate((world or Worlds.nominal()).prosthesis[0]):
        stiffness, damping, rest_rad = foot
        joint = len(JOINTS) * side + ankle
        rate = np.diff(trajectory.qdot[:, links[side]])[:, 0]
        torques[:, joint] = stiffness * (trajectory.joint_rad[:, joint] - rest_rad) + damping * rate
    return torques
