"""The walker as a MuJoCo model: links, feet, joint limits, motors, ground, and what is sensed.

Feet are two spheres each, their soles on the line from heel to ball. Contacts are elliptic cones
with the walker's friction; a motor turns each joint; a sensor of each foot says whether it touches,
and the force. The ground of a walk is planes that are laid anew at every step; of a file, boxes.
"""

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import mujoco
import numpy as np

from taichi_nmm.body import BALL_OFFSET_M, HEEL_OFFSET_M, Bodies
from taichi_nmm.kernel.contact_planes import PLANES, PLANES_PER_SOLE, SOLE_RADIUS_M
from taichi_nmm.mujoco_engine.boxes import Boxes
from taichi_nmm.mujoco_engine.limits import STOPS, limit
from taichi_nmm.mujoco_engine.linkage import compile_model, linkage
from taichi_nmm.settings import LIMITS_AS_STOPS, Settings

IMPRATIO = 10.0  # of friction to normal impedance: feet creep less
SIDES = ("l", "r")
JOINTS = tuple(f"{segment}_{side}" for side in SIDES for segment in STOPS)
VIEWED_M = 2.0  # of a file opened in MuJoCo's viewer
FOOT_SENSOR = 4  # numbers: contacts found, then the force x, y, z


def walk_model(bodies: Bodies, settings: Settings, friction: float) -> mujoco.MjModel:
    """The model of the first of some bodies, each sole over the planes of `ground` alone.

    The planes are MuJoCo's mocap bodies, in that order.
    """
    root = _walker(bodies, settings, friction)
    world, contact = _find(root, "worldbody"), ElementTree.SubElement(root, "contact")
    for plane in range(PLANES):
        body = ElementTree.SubElement(world, "body", mocap="true")
        ElementTree.SubElement(
            body, "geom",
            name=f"plane_{plane}", type="plane", size="1 1 1", contype="0", conaffinity="0",
        )  # fmt: skip
        ElementTree.SubElement(
            contact, "pair",
            geom1=f"plane_{plane}", geom2=f"sole_{plane // PLANES_PER_SOLE}", condim="3",
            friction=_numbers((friction, friction, 0.0, 0.0, 0.0)), solref=_solref(settings),
        )  # fmt: skip
    return compile_model(root)


def write_mjcf(
    path: Path,
    bodies: Bodies,
    friction: float,
    ground: Boxes,
    settings: Settings,
    start: np.ndarray,
) -> None:
    """Write the model, with the whole ground and the start as key frame, for MuJoCo's viewer.

    `start` is qpos then qvel, [18].
    """
    root = _walker(bodies, settings, friction)
    world = _find(root, "worldbody")
    for box in range(len(ground)):
        ElementTree.SubElement(
            world, "geom",
            type="box", contype="0", conaffinity="1", rgba="0.6 0.6 0.55 1",
            size=_numbers(ground.half_size[box]), pos=_numbers(ground.position[box]),
            quat=_numbers(ground.quaternion[box]),
        )  # fmt: skip
    keyframe = ElementTree.SubElement(root, "keyframe")
    ElementTree.SubElement(
        keyframe, "key", name="start", qpos=_numbers(start[:9]), qvel=_numbers(start[9:])
    )
    # Where the viewer looks, and from how far: not at the whole ground.
    ElementTree.SubElement(
        root, "statistic", extent=repr(VIEWED_M), center=_numbers((start[0], 0.0, start[1]))
    )
    ElementTree.indent(root)
    path.write_text(ElementTree.tostring(root, encoding="unicode") + "\n", encoding="utf-8")


def _walker(bodies: Bodies, settings: Settings, friction: float) -> ElementTree.Element:
    """All but the ground."""
    root = linkage(bodies, 0)
    invweights = compile_model(root).dof_invweight0
    _set_options(root, settings, friction)
    _add_feet(root)
    for index, joint in enumerate(JOINTS):
        _limit_joint(root, joint, float(invweights[3 + index]), settings)
    _add_motors_and_sensors(root)
    return root


def _set_options(root: ElementTree.Element, settings: Settings, friction: float) -> None:
    option = _find(root, "option")
    option.set("timestep", repr(settings.physics_step_s))
    option.set("integrator", "implicitfast")
    option.set("cone", "elliptic")
    option.set("impratio", repr(IMPRATIO))
    # A walker that diverges is to be seen, not put back to the start.
    ElementTree.SubElement(option, "flag", autoreset="disable")
    default = ElementTree.SubElement(root, "default")
    ElementTree.SubElement(
        default, "geom",
        friction=_numbers((friction, 0.0, 0.0)), solref=_solref(settings),
    )  # fmt: skip


def _add_feet(root: ElementTree.Element) -> None:
    for leg, side in enumerate(SIDES):
        foot = _find(root, "body", f"foot_{side}")
        for end, x_m in enumerate((HEEL_OFFSET_M, BALL_OFFSET_M)):
            ElementTree.SubElement(
                foot, "geom", name=f"sole_{2 * leg + end}",
                type="sphere", size=repr(SOLE_RADIUS_M), pos=_numbers((x_m, 0.0, SOLE_RADIUS_M)),
                contype="1", conaffinity="0", group="0",
            )  # fmt: skip


def _limit_joint(
    root: ElementTree.Element, joint: str, inverse_inertia: float, settings: Settings
) -> None:
    hinge, stop = _find(root, "joint", joint), STOPS[joint.split("_")[0]]
    hinge.set("limited", "true")
    hinge.set("range", _numbers((stop.low_rad, stop.high_rad)))
    if settings.mujoco.limits == LIMITS_AS_STOPS:
        solref, solimp = limit(stop, inverse_inertia, settings.physics_step_s)
        hinge.set("solreflimit", _numbers(solref))
        hinge.set("solimplimit", _numbers(solimp))


def _add_motors_and_sensors(root: ElementTree.Element) -> None:
    actuator, sensor = (ElementTree.SubElement(root, tag) for tag in ("actuator", "sensor"))
    for joint in JOINTS:
        ElementTree.SubElement(actuator, "motor", name=joint, joint=joint)
    for side in SIDES:
        ElementTree.SubElement(
            sensor, "contact",
            body1=f"foot_{side}", data="found force", reduce="netforce", num="1",
        )  # fmt: skip


def _solref(settings: Settings) -> str:
    return _numbers((settings.mujoco.time_constant_s, settings.mujoco.damping_ratio))


def _find(root: ElementTree.Element, tag: str, name: str | None = None) -> ElementTree.Element:
    return next(e for e in root.iter(tag) if name is None or e.get("name") == name)


def _numbers(values: object) -> str:
    return " ".join(repr(float(value)) for value in np.asarray(values))
