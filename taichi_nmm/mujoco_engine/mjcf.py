"""The walker as a MuJoCo model: links, feet, joint limits, motors, sensors and ground.

Feet are two spheres each, their soles on the line from heel to ball. Contacts are
elliptic cones with the walker's friction; a motor turns each joint; a sensor of each
foot gives contact and force. The ground of a walk is planes that are laid anew at every
step; of a file, boxes.

**Links.** The same seven, with the map between the two sets of coordinates. MuJoCo's
hinges are relative (child minus parent) about +y, which turns z towards x: clockwise
with x to the right and z up, as ours. The slides and the HAT's hinge are ours as they
stand, so
    qpos = RELATIVE q,  qvel = RELATIVE qdot,  q'' = RELATIVE^-1 qacc,
and a joint torque, which does work on child minus parent, is the hinge's generalised
force.

**Joint stops** as limits of MuJoCo's. A stop is tau = -k D (1 + w/w_max)+, D the angle
beyond the limit (`kernel.joints`): a damper that grows with the excess, and a weak
spring. A limit of MuJoCo's with impedance d, whose joint has the inverse inertia A,
gives at a slow creep under a torque T (MuJoCo's documentation, Computation, "Constraint
model")

    (1 - d) T = d (b w + K d D) / A .

Equal damping needs d/(1 - d) = D/rho with rho = w_max b/(k A). MuJoCo's impedance with
its midpoint at the limit is d_max (1 - (1 - D/width)^p): d_max is right at the width,
and p comes nearest below it. The time constant t is the shortest that MuJoCo lets a
step have: b = 2/(d_max t) is then the largest, and stable.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import mujoco
import numpy as np
from numpy.typing import NDArray

from taichi_nmm.body import (
    BALL_OFFSET_M,
    GRAVITY_MPS2,
    HEEL_OFFSET_M,
    SHANK_LENGTH_M,
    THIGH_LENGTH_M,
    Bodies,
)
from taichi_nmm.kernel import joints as stops
from taichi_nmm.kernel.contact_planes import PLANES, PLANES_PER_SOLE, SOLE_RADIUS_M
from taichi_nmm.settings import LIMITS_AS_STOPS, Settings
from taichi_nmm.terrain import GRID_X_M, Terrain
from taichi_nmm.world import MUSCLE_NAMES, Worlds

Array = NDArray[np.float64]

JOINT_PARENT = (2, 3, 4, 2, 6, 7)  # coordinate of the segment above hip, knee and ankle
RELATIVE: Array = np.eye(9)  # child minus parent at the six joints, the rest unchanged
RELATIVE[range(3, 9), JOINT_PARENT] = -1.0


def linkage(bodies: Bodies, row: int, settings: Settings, friction: float) -> Element:
    """MJCF of one of some bodies: all but the ground, and the limits of the joints."""
    mass, inertia = bodies.mass_kg[row].tolist(), bodies.inertia_kgm2[row].tolist()
    com = bodies.com_m[row].tolist()
    template = Path(__file__).with_name("walker.xml").read_text(encoding="utf-8")
    text = template.format(
        mass=mass,
        inertia=inertia,
        com=com,
        down=[-each for each in com],
        thigh_m=THIGH_LENGTH_M,
        shank_m=SHANK_LENGTH_M,
        heel_m=HEEL_OFFSET_M,
        ball_m=BALL_OFFSET_M,
        sole_m=SOLE_RADIUS_M,
        gravity_mps2=GRAVITY_MPS2,
        step_s=settings.physics_step_s,
        impratio=IMPRATIO,
        friction=float(friction),
        solref=_solref(settings),
    )
    return ElementTree.fromstring(text)


def compile_model(root: Element) -> mujoco.MjModel:
    """The model of an MJCF tree."""
    return mujoco.MjModel.from_xml_string(
        ElementTree.tostring(root, encoding="unicode")
    )


# the law is followed so far at least; walking stays within
LEAST_RANGE_RAD = math.radians(10.0)
POWERS = np.linspace(2.0, 20.0, 73)
EXCESSES = np.linspace(0.05, 0.95, 19)  # over the width, where the power is chosen
STEPS_PER_TIME_CONSTANT = 2.0  # MuJoCo's least (`refsafe`)
SMALLEST_IMPEDANCE = 1e-4  # MuJoCo's own bound
NO_LIMIT_RAD = math.pi


@dataclass(frozen=True)
class Stop:
    """A stop of a joint, as `kernel.joints` has it.

    Attributes:
        low_rad: the lower end of the range, -pi: none.
        high_rad: the upper end, pi: none.
        relaxation_radps: w_max of the law beyond the range.
    """

    low_rad: float
    high_rad: float
    relaxation_radps: float


STOPS: dict[str, Stop] = {
    "thigh": Stop(
        -NO_LIMIT_RAD, stops.HIP_EXTENSION_LIMIT_RAD, stops.HIP_RELAXATION_RADPS
    ),
    "shank": Stop(
        stops.KNEE_STRAIGHTEST_RAD, NO_LIMIT_RAD, stops.STOP_RELAXATION_RADPS
    ),
    "foot": Stop(
        stops.ANKLE_DORSIFLEXION_LIMIT_RAD,
        stops.ANKLE_PLANTARFLEXION_LIMIT_RAD,
        stops.STOP_RELAXATION_RADPS,
    ),
}  # by the segment whose hinge it is


def limit(stop: Stop, inverse_inertia: float, step_s: float) -> tuple[Array, Array]:
    """`solref` [2] and `solimp` [5] of a limit with a stop's law.

    Args:
        stop: whose law it is.
        inverse_inertia: of the joint, MuJoCo's `dof_invweight0`, 1/(kg m2).
        step_s: of the physics.
    """
    time_constant_s = STEPS_PER_TIME_CONSTANT * step_s
    stiffness = stops.STOP_STIFFNESS_NMPRAD
    slow = 2.0 * stop.relaxation_radps / (time_constant_s * stiffness * inverse_inertia)
    width = max(4.0 * slow, LEAST_RANGE_RAD)
    largest = 1.0 - slow / width  # = width/(width + rho), with rho = slow/largest
    # The power whose d/(1 - d) is nearest to D/rho, by the mean square of the
    # logarithm.
    impedance = largest * (1.0 - (1.0 - EXCESSES) ** POWERS[:, None])
    error = np.log(impedance / (1.0 - impedance)) - np.log(
        EXCESSES * (largest * width / slow)
    )
    power = float(POWERS[np.argmin(np.mean(error**2, axis=1))])
    damping = 2.0 / (largest * time_constant_s)  # b
    # K: d^2 K/(1 - d) = k A at the width, and less below; the damper does the stopping.
    spring = stiffness * inverse_inertia * (1.0 - largest) / largest**2
    return (
        np.array([time_constant_s, damping / (2.0 * math.sqrt(spring))]),
        np.array([SMALLEST_IMPEDANCE, largest, width, 0.0, power]),
    )


IMPRATIO = 10.0  # of friction to normal impedance: feet creep less
SIDES = ("l", "r")
JOINTS = tuple(f"{segment}_{side}" for side in SIDES for segment in STOPS)
HALF_WIDTH_M, BASE_M = 1.0, 1.0  # of a file's ground; the second below the lowest place
LEAST_RANGE_M = 1e-3  # of heights of a level ground
FOOT_SENSOR = 4  # numbers: contacts found, then the force x, y, z


def walk_model(bodies: Bodies, settings: Settings, friction: float) -> mujoco.MjModel:
    """The model of the first of some bodies, each sole over its `ContactPlanes` alone.

    The planes are MuJoCo's mocap bodies, in that order.
    """
    root = _walker(bodies, settings, friction)
    world, contact = _find(root, "worldbody"), SubElement(root, "contact")
    for plane in range(PLANES):
        body = SubElement(world, "body", mocap="true")
        SubElement(
            body,
            "geom",
            name=f"plane_{plane}",
            type="plane",
            size="1 1 1",
            contype="0",
            conaffinity="0",
        )
        SubElement(
            contact,
            "pair",
            geom1=f"plane_{plane}",
            geom2=f"sole_{plane // PLANES_PER_SOLE}",
            condim="3",
            friction=_numbers((friction, friction, 0.0, 0.0, 0.0)),
            solref=_solref(settings),
        )
    return compile_model(root)


def mjcf_text(
    bodies: Bodies, worlds: Worlds, ground: Terrain, settings: Settings, start: Array
) -> str:
    """The model as a file, with the ground and the start as key frame, for MuJoCo's viewer.

    A file can only have solids: the ground is a height field of the whole table. Links
    and muscles are sites and tendons, without mass, contact or force; a muscle that is
    missing in the first of the worlds is not drawn. A passive foot is a spring and a
    damper of its hinge. `start` is qpos then qvel, [18].
    """
    height_m = ground.height_m
    root = _walker(bodies, settings, float(worlds.friction[0]))
    _add_passive_feet(root, worlds)
    # MuJoCo scales heights from 0 to this
    range_m = max(float(np.ptp(height_m)), LEAST_RANGE_M)
    template = Path(__file__).with_name("visible.xml").read_text(encoding="utf-8")
    text = template.format(
        columns=len(height_m),
        heights=_numbers(np.tile(height_m, 2)),
        size=_numbers((0.5 * np.ptp(GRID_X_M), HALF_WIDTH_M, range_m, BASE_M)),
        place=_numbers((GRID_X_M.mean(), 0.0, height_m.min())),
        centre=_numbers((start[0], 0.0, start[1])),
        qpos=_numbers(start[:9]),
        qvel=_numbers(start[9:]),
    )
    for part in ElementTree.fromstring(text):
        for body in part.findall("body"):
            _find(root, "body", body.attrib["name"]).extend(body)
            part.remove(body)
        root.append(part)
    _remove_missing_muscles(root, worlds)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _add_passive_feet(root: Element, worlds: Worlds) -> None:
    """The angles of ankles are those of the hinges of feet (`JOINTS`)."""
    for side, foot in zip(SIDES, worlds.prosthesis[0].tolist(), strict=True):
        for name, number in zip(
            ("stiffness", "damping", "springref"), foot, strict=True
        ):
            if number:
                _find(root, "joint", f"foot_{side}").set(name, repr(number))


def _remove_missing_muscles(root: Element, worlds: Worlds) -> None:
    """A muscle's tendon and sites have names that begin with its own."""
    for name, strength in zip(MUSCLE_NAMES, worlds.strength[0].tolist(), strict=True):
        muscle, side = name.split("_")
        parents = list(root.iter()) if strength == 0.0 else []
        for parent in parents:
            for part in list(parent):
                if part.get("name", "").startswith(f"{muscle}_{side[0]}"):
                    parent.remove(part)


def _walker(bodies: Bodies, settings: Settings, friction: float) -> Element:
    """All but the ground."""
    root = linkage(bodies, 0, settings, friction)
    invweights = compile_model(root).dof_invweight0.tolist()
    for inverse_inertia, joint in zip(invweights[3:], JOINTS, strict=True):
        hinge, stop = _find(root, "joint", joint), STOPS[joint.split("_")[0]]
        hinge.set("limited", "true")
        hinge.set("range", _numbers((stop.low_rad, stop.high_rad)))
        if settings.mujoco.limits == LIMITS_AS_STOPS:
            solref, solimp = limit(stop, inverse_inertia, settings.physics_step_s)
            hinge.set("solreflimit", _numbers(solref))
            hinge.set("solimplimit", _numbers(solimp))
    return root


def _solref(settings: Settings) -> str:
    return _numbers((settings.mujoco.time_constant_s, settings.mujoco.damping_ratio))


def _find(root: Element, tag: str, name: str | None = None) -> Element:
    return next(e for e in root.iter(tag) if name is None or e.get("name") == name)


def _numbers(values: object) -> str:
    return " ".join(repr(float(value)) for value in np.asarray(values))
