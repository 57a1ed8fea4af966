"""URDF of one object.

A link's frame has its origin at its joint's anchor and the object's orientation, so origins are
plain offsets. The root link has the object's name, as in MJCF. Sites and handles are links without
geometry. Friction of surfaces is written for PyBullet (<contact>), and for Drake with more that it
alone reads (drake_contact.py). What URDF has no place for is left out: joint stiffness and
armature. Capsules become a cylinder and two balls, ellipsoids meshes. URDF knows no ball joint: it
becomes three hinges <joint>_x, _y, _z through one point, with two links of tiny mass between them;
each turns as far as the ball, the middle one at most a quarter turn. An element <neoworld>, which
other readers ignore, names the balls, the links that are drawn in and the limits that are not
stated, so that our reader restores them.

Parts that a joint joins may touch in our scenes, where they never collide. URDF has no word for
that, and some readers let a drawer jam in its case; so colliders of what moves are drawn in by half
a millimetre on all sides, and an SRDF beside the file lists the pairs for planners.
"""

import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..physics.mjcf import excluded_pairs
from ..spec import GeomSpec, JointSpec, ObjectSpec, PartSpec, inertial
from ..spec.convex import Piece
from ..spec.kinematics import welded
from ..spec.pose import Pose, matrix, pose, to_rpy
from .drake_contact import DRAKE, add_contact, add_filters, declare_convex
from .handles import Frame, frames
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
CLEARANCE_M, MOST_OF_HALF = 0.0005, 0.1
"""How far colliders of moving parts are drawn in on each side [m], and at most over half a size."""


def urdf_text(spec: ObjectSpec) -> str:
    """Return an object as URDF; mesh paths are relative to its folder."""
    robot = ET.Element("robot", {"name": spec.name, "xmlns:drake": DRAKE})
    # Without this MuJoCo's loader drops visuals, fuses fixed links and loses the meshes' folder.
    ET.SubElement(
        ET.SubElement(robot, "mujoco"),
        "compiler",
        discardvisual="false",
        fusestatic="false",
        strippath="false",
    )
    group = welded(spec)
    moving = {part.name for part in spec.parts if group[part.name] != group[spec.root]}
    unstated = {joint.name: words for joint in spec.joints if (words := _unstated(joint))}
    if moving or unstated:
        mark = ET.SubElement(robot, "neoworld")
        for name, words in unstated.items():
            ET.SubElement(mark, "unstated", joint=name, limits=words)
        for joint in spec.joints:
            if joint.type == "ball":
                ET.SubElement(mark, "ball", joint=joint.name)
        for part in spec.parts:
            if part.name in moving:
                ET.SubElement(mark, "drawn_in", link=part.name)
    for material in spec.materials:
        look = ET.SubElement(robot, "material", name=material.name)
        ET.SubElement(look, "color", rgba=numbers(material.rgba))
    origins = {joint.child: np.array(joint.pos) for joint in spec.joints}
    origins[spec.root] = np.zeros(3)
    for part, _ in spec.ordered:
        clearance = CLEARANCE_M if part.name in moving else 0.0
        _add_link(robot, spec, part, origins[part.name], clearance)
    for _, joint in spec.ordered:
        if joint is not None:
            origin = origins[joint.parent]
            ends = {"parent": link_name(spec, joint.parent), "child": joint.child}
            named = joint.model_copy(update=ends)
            if joint.type == "ball":
                _add_ball(robot, spec, named, origin)
            else:
                _add_joint(robot, named, origin)
    taken = {part.name for part in spec.parts} | {joint.name for joint in spec.joints}
    taken.add(link_name(spec, spec.root))
    for frame in frames(spec):
        _add_frame(robot, spec, frame, origins[frame.part], taken)
    links = {part.name: link_name(spec, part.name) for part in spec.parts}
    add_filters(robot, "urdf", spec, links)
    ET.indent(robot, " ")
    return '<?xml version="1.0"?>\n' + ET.tostring(robot, encoding="unicode") + "\n"


def srdf_text(spec: ObjectSpec) -> str:
    """Return which links of the URDF never collide, for MoveIt and Pinocchio."""
    robot = ET.Element("robot", name=spec.name)
    for one, other in excluded_pairs(spec):
        links = {"link1": link_name(spec, one), "link2": link_name(spec, other)}
        ET.SubElement(robot, "disable_collisions", {**links, "reason": "Adjacent"})
    ET.indent(robot, " ")
    return '<?xml version="1.0"?>\n' + ET.tostring(robot, encoding="unicode") + "\n"


def link_name(spec: ObjectSpec, part: str) -> str:
    """Return the name of a part's link: the root's is the object's, as that of its body in MJCF."""
    name = spec.name if part == spec.root else part
    taken = {other.name for other in spec.parts if other.name != spec.root}
    while part == spec.root and name in taken:
        name += "_"
    return name


def _add_frame(
    robot: ET.Element, spec: ObjectSpec, frame: Frame, origin: NDArray, taken: set[str]
) -> None:
    """Add a site or handle: a link that has nothing but its place."""
    name = frame.name
    while name in taken or f"{name}_mount" in taken:
        name += "_"
    taken |= {name, f"{name}_mount"}
    inertia = ET.SubElement(ET.SubElement(robot, "link", name=name), "inertial")
    # PyBullet takes 1 kg where nothing is stated.
    ET.SubElement(inertia, "mass", value="0")
    ET.SubElement(inertia, "inertia", {f"i{k}": "0" for k in ("xx", "xy", "xz", "yy", "yz", "zz")})
    joint = ET.SubElement(robot, "joint", name=f"{name}_mount", type="fixed")
    _origin(joint, pose(np.array(frame.pos) - origin))
    ET.SubElement(joint, "parent", link=link_name(spec, frame.part))
    ET.SubElement(joint, "child", link=name)


def _add_link(
    robot: ET.Element, spec: ObjectSpec, part: PartSpec, origin: NDArray, clearance: float
) -> None:
    link = ET.SubElement(robot, "link", name=link_name(spec, part.name))
    solid = [spec.material(geom.material) for geom in part.geoms if geom.role != "visual"]
    friction = round(float(np.mean([material.friction for material in solid])), 4)
    ET.SubElement(ET.SubElement(link, "contact"), "lateral_friction", value=number(friction))
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
                for element in _add_collision(link, geom, k, piece, at, clearance):
                    add_contact(element, "urdf", piece, spec.material(geom.material).friction)


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


def _add_collision(
    link: ET.Element, geom: GeomSpec, k: int, piece: Piece, at: Pose, clearance: float
) -> list[ET.Element]:
    """Add the elements of a piece, drawn in on each side by `clearance` [m], and return them."""
    collisions: list[ET.Element] = []

    def geometry(name: str, where: Pose) -> ET.Element:
        collisions.append(ET.SubElement(link, "collision", name=name))
        _origin(collisions[-1], where)
        return ET.SubElement(collisions[-1], "geometry")

    name = f"{geom.name}-{k}"
    size = tuple(drawn_in(v, clearance) for v in piece.size)
    if piece.kind in ("box", "sphere", "cylinder"):
        _primitive(geometry(name, at), replace(piece, size=size))
    elif piece.kind == "capsule":
        radius, half = size[0], piece.size[1]
        _cylinder(geometry(name, at), radius, 2 * half)
        for end, z in (("low", -half), ("high", half)):
            ball = geometry(f"{name}-{end}", at.then(pose((0, 0, z))))
            ET.SubElement(ball, "sphere", radius=number(radius))
    else:
        mesh = piece_mesh(geom, piece)
        assert mesh is not None
        low, high = mesh[0].min(axis=0), mesh[0].max(axis=0)
        half = (high - low) / 2
        factor = np.array([drawn_in(v, clearance) for v in half]) / half
        middle = (low + high) / 2
        fields = {"filename": collision_file(geom, k)}
        if clearance:
            at = at.then(pose(middle * (1 - factor)))
            fields["scale"] = numbers(np.round(factor, 9))
        declare_convex(ET.SubElement(geometry(name, at), "mesh", fields))
    return collisions


def drawn_in(half: float, clearance: float) -> float:
    """Return half a size [m] after drawing in its sides; thin things lose a tenth at most."""
    return half - min(clearance, MOST_OF_HALF * half)


def as_drawn(half: float, clearance: float) -> float:
    """Return half a size [m] before its sides were drawn in."""
    thick = half + clearance
    return thick if MOST_OF_HALF * thick >= clearance else half / (1 - MOST_OF_HALF)


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


def _unstated(joint: JointSpec) -> str:
    """Name the limits that URDF demands of a joint and the object does not state."""
    if joint.type not in ("revolute", "prismatic", "continuous"):
        return ""
    names = [name for name in ("effort", "velocity") if getattr(joint, name) is None]
    return "" if joint.type == "continuous" and len(names) == 2 else " ".join(names)


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
