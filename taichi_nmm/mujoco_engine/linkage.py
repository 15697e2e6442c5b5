"""The same seven links as an MJCF model, with the map between the two sets of coordinates.

MuJoCo's hinges are relative (child minus parent) about +y, which turns z towards x: clockwise with
x to the right and z up, as ours. The slides and the HAT's hinge are ours as they stand, so
    qpos = RELATIVE q,  qvel = RELATIVE qdot,  q'' = RELATIVE^-1 qacc,
and a joint torque, which does work on child minus parent, is the hinge's generalised force.
"""

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator

import mujoco
import numpy as np
from numpy.typing import NDArray

from taichi_nmm.body import (
    GRAVITY_MPS2,
    SEGMENT_NAMES,
    SHANK_LENGTH_M,
    THIGH_LENGTH_M,
    Bodies,
)

Array = NDArray[np.float64]

# Of each segment at q = 0: where its proximal joint lies in the parent, and the link's direction.
ORIGINS = ((0, 0), (0, 0), (0, -THIGH_LENGTH_M), (0, -SHANK_LENGTH_M))  # x, z
DIRECTIONS = ((0, 1), (0, -1), (0, -1), (1, 0))  # HAT up, thigh and shank down, foot forward


def relative_coordinates() -> Array:
    """RELATIVE [9, 9]: child minus parent at the six joints, the rest unchanged."""
    relative = np.eye(9)
    relative[range(3, 9), JOINT_PARENT] = -1.0
    return relative


JOINT_PARENT = (2, 3, 4, 2, 6, 7)  # coordinate of the segment above hip, knee and ankle
RELATIVE = relative_coordinates()


def linkage(bodies: Bodies, row: int = 0) -> ElementTree.Element:
    """MJCF of one body in free flight: no contact, no damping, no armature."""
    root = ElementTree.Element("mujoco")
    ElementTree.SubElement(root, "compiler", angle="radian", inertiafromgeom="false")
    ElementTree.SubElement(root, "option", gravity=f"0 0 {-GRAVITY_MPS2!r}")
    world = ElementTree.SubElement(root, "worldbody")
    links = _links(bodies, row)
    hat = _link(world, *next(links))
    for axis, direction in (("x", "1 0 0"), ("z", "0 0 1")):
        ElementTree.SubElement(hat, "joint", name=axis, type="slide", axis=direction)
    _hinge(hat)
    for _ in ("left", "right"):
        parent = hat
        for _ in ("thigh", "shank", "foot"):
            parent = _link(parent, *next(links))
            _hinge(parent)
    return root


def compile_model(root: ElementTree.Element) -> mujoco.MjModel:
    """The model of an MJCF tree."""
    return mujoco.MjModel.from_xml_string(ElementTree.tostring(root, encoding="unicode"))


def _links(bodies: Bodies, row: int) -> Iterator[tuple[str, str, str, dict[str, str]]]:
    """Name, origin in the parent, centre of mass and inertial attributes of each segment."""
    for index, name in enumerate(SEGMENT_NAMES):
        kind = 0 if index == 0 else (index - 1) % 3 + 1
        inertia = float(bodies.inertia_kgm2[row, index])
        com_m = float(bodies.com_m[row, index])
        dynamic = {
            "mass": repr(float(bodies.mass_kg[row, index])),
            "diaginertia": f"{inertia!r} {inertia!r} {inertia!r}",  # only the y axis ever turns
        }
        yield name, _point(*ORIGINS[kind]), _point(*(com_m * x for x in DIRECTIONS[kind])), dynamic


def _link(
    parent: ElementTree.Element, name: str, origin: str, com: str, dynamic: dict[str, str]
) -> ElementTree.Element:
    body = ElementTree.SubElement(parent, "body", name=name, pos=origin)
    ElementTree.SubElement(body, "inertial", {"pos": com, **dynamic})
    return body


def _hinge(body: ElementTree.Element) -> None:
    ElementTree.SubElement(body, "joint", name=body.attrib["name"], type="hinge", axis="0 1 0")


def _point(x: float, z: float) -> str:
    return f"{x!r} 0 {z!r}"
