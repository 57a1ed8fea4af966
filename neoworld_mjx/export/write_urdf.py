"""URDF of one object.

A link's frame has its origin at its joint's anchor and the object's orientation, so origins are
plain offsets. What URDF has no place for is left out: joint stiffness and armature, friction of
surfaces, sites. Capsules become a cylinder and two balls, ellipsoids meshes. URDF knows no ball
joint: it becomes three hinges <joint>_x, _y, _z through one point, with two links of tiny mass
between them; each turns as far as the ball, the middle one at most a quarter turn. An element
<neoworld>, which other readers ignore, names the balls, so that our reader restores them.
"""

import xml.etree.ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from ..spec import GeomSpec, JointSpec, ObjectSpec, PartSpec, inertial
from ..spec.convex import Piece
from ..spec.pose import Pose, matrix, pose, to_rpy
from .meshes import (
    collision_file,
    number,
    numbers,
    piece_mesh,
    urdf_primitive,
    visual_file,
)

UNLIMITED_EFFORT, UNLIMITED_VELOCITY = 1000.0, 100.0
"""URDF demands both of a limited joint; these stand for "not stated"."""
BALL_LINK = 1e-6
"""Mass and inertia of the links within a ball joint, over its child's."""


def urdf_text(spec: ObjectSpec) -> str:
    """Return an object as URDF; mesh paths are relative to its folder."""
    robot = ET.Element("robot", name=spec.name)
    # Without this MuJoCo's loader drops visuals, fuses fixed links and loses the meshes' folder.
    ET.SubElement(
        ET.SubElement(robot, "mujoco"),
        "compiler",
        discardvisual="false",
        fusestatic="false",
        strippath="false",
    )
    balls = [joint for joint in spec.joints if joint.type == "ball"]
    if balls:
        mark = ET.SubElement(robot, "neoworld")
        for joint in balls:
            ET.SubElement(mark, "ball", joint=joint.name)
    for material in spec.materials:
        look = ET.SubElement(robot, "material", name=material.name)
        ET.SubElement(look, "color", rgba=numbers(material.rgba))
    origins = {joint.child: np.array(joint.pos) for joint in spec.joints}
    origins[spec.root] = np.zeros(3)
    for part, _ in spec.ordered:
        _add_link(robot, spec, part, origins[part.name])
    for _, joint in spec.ordered:
        if joint is not None and joint.type == "ball":
            _add_ball(robot, spec, joint, origins[joint.parent])
        elif joint is not None:
            _add_joint(robot, joint, origins[joint.parent])
    ET.indent(robot, " ")
    return '<?xml version="1.0"?>\n' + ET.tostring(robot, encoding="unicode") + "\n"


def _add_link(robot: ET.Element, spec: ObjectSpec, part: PartSpec, origin: NDArray) -> None:
    link = ET.SubElement(robot, "link", name=part.name)
    mass = inertial(spec, part)
    element = ET.SubElement(link, "inertial")
    _origin(element, pose(np.array(mass.pos) - origin))
    ET.SubElement(element, "mass", value=number(mass.mass))
    rotation = matrix(mass.quat)
    tensor = rotation @ np.diag(mass.diagonal) @ rotation.T
    entries = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2)}
    entries |= {"iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    ET.SubElement(element, "inertia", {key: number(tensor[at]) for key, at in entries.items()})
    for geom in part.geoms:
        local = Pose(np.array(geom.pos) - origin, np.array(geom.quat))
        if geom.role != "collision":
            visual = ET.SubElement(link, "visual", name=geom.name)
            _origin(visual, local)
            _visual_shape(ET.SubElement(visual, "geometry"), geom)
            ET.SubElement(visual, "material", name=geom.material)
        if geom.role != "visual":
            for k, piece in enumerate(geom.shape.pieces()):
                at = local.then(pose(piece.pos, piece.quat))
                _add_collision(link, geom, k, piece, at)


def _visual_shape(geometry: ET.Element, geom: GeomSpec) -> None:
    piece = urdf_primitive(geom.shape)
    if piece is None:
        ET.SubElement(geometry, "mesh", filename=str(visual_file(geom)))
    else:
        _primitive(geometry, piece)


def _primitive(geometry: ET.Element, piece: Piece) -> None:
    if piece.kind == "box":
        ET.SubElement(geometry, "box", size=numbers(2 * v for v in piece.size))
    elif piece.kind == "sphere":
        ET.SubElement(geometry, "sphere", radius=number(piece.size[0]))
    else:
        _cylinder(geometry, piece.size[0], 2 * piece.size[1])


def _add_collision(link: ET.Element, geom: GeomSpec, k: int, piece: Piece, at: Pose) -> None:
    def geometry(name: str, where: Pose) -> ET.Element:
        element = ET.SubElement(link, "collision", name=name)
        _origin(element, where)
        return ET.SubElement(element, "geometry")

    name = f"{geom.name}-{k}"
    if piece.kind in ("box", "sphere", "cylinder"):
        _primitive(geometry(name, at), piece)
    elif piece.kind == "capsule":
        radius, half = piece.size[:2]
        _cylinder(geometry(name, at), radius, 2 * half)
        for end, z in (("low", -half), ("high", half)):
            ball = geometry(f"{name}-{end}", at.then(pose((0, 0, z))))
            ET.SubElement(ball, "sphere", radius=number(radius))
    else:
        assert piece_mesh(geom, piece) is not None
        ET.SubElement(geometry(name, at), "mesh", filename=collision_file(geom, k))


def _cylinder(geometry: ET.Element, radius: float, length: float) -> None:
    ET.SubElement(geometry, "cylinder", radius=number(radius), length=number(length))


def _add_joint(robot: ET.Element, joint: JointSpec, parent_origin: NDArray) -> None:
    element = ET.SubElement(robot, "joint", name=joint.name, type=joint.type)
    _origin(element, pose(np.array(joint.pos) - parent_origin))
    ET.SubElement(element, "parent", link=joint.parent)
    ET.SubElement(element, "child", link=joint.child)
    if joint.type == "fixed":
        return
    ET.SubElement(element, "axis", xyz=numbers(joint.axis))
    limit: dict[str, str] = {}
    if joint.type != "continuous":
        limit = {"lower": number(joint.lower), "upper": number(joint.upper)}
    if limit or joint.effort is not None or joint.velocity is not None:
        limit["effort"] = number(UNLIMITED_EFFORT if joint.effort is None else joint.effort)
        limit["velocity"] = number(UNLIMITED_VELOCITY if joint.velocity is None else joint.velocity)
        ET.SubElement(element, "limit", limit)
    ET.SubElement(
        element, "dynamics", damping=number(joint.damping), friction=number(joint.friction)
    )
    if joint.mimic is not None:
        ET.SubElement(
            element,
            "mimic",
            joint=joint.mimic.joint,
            multiplier=number(joint.mimic.multiplier),
            offset=number(joint.mimic.offset),
        )


def _add_ball(
    robot: ET.Element, spec: ObjectSpec, joint: JointSpec, parent_origin: NDArray
) -> None:
    mass = inertial(spec, spec.part(joint.child))
    parent, origin = joint.parent, parent_origin
    for axis in "xyz":
        name = f"{joint.name}_{axis}"
        child = joint.child if axis == "z" else f"{name}_link"
        if axis != "z":
            link = ET.SubElement(ET.SubElement(robot, "link", name=child), "inertial")
            _origin(link, pose())
            # Nothing at all would be refused by simulators.
            ET.SubElement(link, "mass", value=number(BALL_LINK * mass.mass))
            tensor = {f"i{a}{b}": "0" for a, b in ("xy", "xz", "yz")}
            tensor |= {f"i{a}{a}": number(BALL_LINK * max(mass.diagonal)) for a in "xyz"}
            ET.SubElement(link, "inertia", tensor)
        most = min(joint.upper, np.pi / 2) if axis == "y" else joint.upper
        hinge = joint.model_copy(
            update={
                "name": name,
                "type": "revolute" if joint.upper > 0 else "continuous",
                "parent": parent,
                "child": child,
                "axis": tuple(float(axis == a) for a in "xyz"),
                "lower": -most,
                "upper": most,
            }
        )
        _add_joint(robot, hinge, origin)
        parent, origin = child, np.array(joint.pos)


def _origin(element: ET.Element, at: Pose) -> None:
    ET.SubElement(element, "origin", xyz=numbers(at.pos), rpy=numbers(to_rpy(at.quat)))


__all__ = ["UNLIMITED_EFFORT", "UNLIMITED_VELOCITY", "urdf_text"]
