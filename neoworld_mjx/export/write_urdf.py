"""Writes the URDF of one object.

Link frames are those of `link_frames`, so joint origins are offsets without rotation. Sites and
handles are links without geometry. <contact> states the root of the mean friction of a link's
colliders for PyBullet, which multiplies the coefficients of two links. The stiffness and armature
of joints are omitted, because URDF cannot store them.

A capsule becomes a cylinder and two spheres, and an ellipsoid becomes a mesh. A ball joint becomes
three hinges <joint>_x, <joint>_y and <joint>_z through one point, with two links of tiny mass
between them; the middle hinge turns by at most a quarter turn in each direction. The element
<neoworld>, which other readers ignore, lists the mean frictions for `read_urdf`.

Parts that a joint connects may touch, because they never collide in MuJoCo. URDF cannot exclude
collisions, so in some simulators a drawer would jam in its case. Therefore the colliders of moving
parts are shrunk by 0.5 mm on each side.
"""

import math
import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..spec import GeomSpec, JointSpec, ObjectSpec, PartSpec, inertial
from ..spec.convex import Piece
from ..spec.kinematics import welded
from ..spec.pose import Pose, pose, to_rpy
from .link_frames import TENSOR_ENTRIES, Frame, frames, inertia_tensor, link_names, link_origins
from .write_glb import collision_file, number, numbers, piece_mesh, urdf_primitive, visual_file

UNLIMITED_EFFORT, UNLIMITED_VELOCITY = 1000.0, 100.0
"""Limits that are written if the object states none, because URDF requires both."""
BALL_LINK = 1e-6
"""Mass and inertia of the links within a ball joint, relative to those of the joint's child."""
CLEARANCE_M, MAX_SHRINKAGE = 0.0005, 0.1
"""Shrinkage of the colliders of moving parts on each side [m], and the maximum of this shrinkage
relative to half the size."""


def urdf_text(spec: ObjectSpec) -> str:
    """Return the URDF of an object; mesh paths are relative to the object's folder."""
    robot = ET.Element("robot", name=spec.name)
    # By default, MuJoCo discards visuals, fuses fixed links and ignores the folder of meshes.
    ET.SubElement(
        ET.SubElement(robot, "mujoco"),
        "compiler",
        discardvisual="false",
        fusestatic="false",
        strippath="false",
    )
    group = welded(spec)
    moving = {part.name for part in spec.parts if group[part.name] != group[spec.root]}
    origins, links = link_origins(spec), link_names(spec)
    mark = ET.SubElement(robot, "neoworld")
    for part in spec.parts:
        friction = number(round(_mean_friction(spec, part), 4))
        ET.SubElement(mark, "friction", link=links[part.name], value=friction)
    for material in spec.materials:
        look = ET.SubElement(robot, "material", name=material.name)
        ET.SubElement(look, "color", rgba=numbers(material.rgba))
    for part, _ in spec.ordered:
        clearance = CLEARANCE_M if part.name in moving else 0.0
        link = ET.SubElement(robot, "link", name=links[part.name])
        _fill_link(link, spec, part, origins[part.name], clearance)
    for _, joint in spec.ordered:
        if joint is not None:
            origin = origins[joint.parent]
            ends = {"parent": links[joint.parent], "child": joint.child}
            renamed = joint.model_copy(update=ends)
            if joint.type == "ball":
                _add_ball(robot, spec, renamed, origin)
            else:
                _add_joint(robot, renamed, origin)
    taken = {part.name for part in spec.parts} | {joint.name for joint in spec.joints}
    taken.add(links[spec.root])
    for frame in frames(spec):
        _add_frame(robot, links[frame.part], frame, origins[frame.part], taken)
    ET.indent(robot, " ")
    return '<?xml version="1.0"?>\n' + ET.tostring(robot, encoding="unicode") + "\n"


def _add_frame(
    robot: ET.Element, parent: str, frame: Frame, origin: NDArray, taken: set[str]
) -> None:
    """Add a site or a handle as a link without geometry and mass."""
    name = frame.name
    while name in taken or f"{name}_mount" in taken:
        name += "_"
    taken |= {name, f"{name}_mount"}
    inertia = ET.SubElement(ET.SubElement(robot, "link", name=name), "inertial")
    # PyBullet assumes 1 kg if no mass is stated.
    ET.SubElement(inertia, "mass", value="0")
    ET.SubElement(inertia, "inertia", dict.fromkeys(TENSOR_ENTRIES, "0"))
    joint = ET.SubElement(robot, "joint", name=f"{name}_mount", type="fixed")
    _origin(joint, pose(np.array(frame.pos) - origin))
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=name)


def _mean_friction(spec: ObjectSpec, part: PartSpec) -> float:
    """Return the mean friction of a part's colliders."""
    colliding = [spec.material(geom.material) for geom in part.geoms if geom.role != "visual"]
    return float(np.mean([material.friction for material in colliding]))


def _fill_link(
    link: ET.Element, spec: ObjectSpec, part: PartSpec, origin: NDArray, clearance: float
) -> None:
    friction = round(math.sqrt(_mean_friction(spec, part)), 4)
    ET.SubElement(ET.SubElement(link, "contact"), "lateral_friction", value=number(friction))
    mass = inertial(spec, part)
    element = ET.SubElement(link, "inertial")
    _origin(element, pose(np.array(mass.pos) - origin))
    ET.SubElement(element, "mass", value=number(mass.mass))
    tensor = inertia_tensor(spec, part)
    entries = {key: number(tensor[index]) for key, index in TENSOR_ENTRIES.items()}
    ET.SubElement(element, "inertia", entries)
    for geom in part.geoms:
        local = Pose(np.array(geom.pos) - origin, np.array(geom.quat))
        if geom.role != "collision":
            visual = ET.SubElement(link, "visual", name=geom.name)
            _origin(visual, local)
            geometry = ET.SubElement(visual, "geometry")
            if (primitive := urdf_primitive(geom.shape)) is not None:
                _primitive(geometry, primitive)
            else:
                ET.SubElement(geometry, "mesh", filename=str(visual_file(geom)))
            ET.SubElement(visual, "material", name=geom.material)
        if geom.role != "visual":
            for k, piece in enumerate(geom.shape.pieces()):
                piece_pose = local.then(pose(piece.pos, piece.quat))
                _add_collision(link, geom, k, piece, piece_pose, clearance)


def _primitive(geometry: ET.Element, piece: Piece) -> None:
    if piece.kind == "box":
        ET.SubElement(geometry, "box", size=numbers(2 * v for v in piece.size))
    elif piece.kind == "sphere":
        ET.SubElement(geometry, "sphere", radius=number(piece.size[0]))
    else:
        length = number(2 * piece.size[1])
        ET.SubElement(geometry, "cylinder", radius=number(piece.size[0]), length=length)


def _add_collision(
    link: ET.Element, geom: GeomSpec, k: int, piece: Piece, local: Pose, clearance: float
) -> None:
    """Add the elements of a piece that is shrunk by `clearance` on each side [m]."""

    def geometry(name: str, origin: Pose) -> ET.Element:
        collision = ET.SubElement(link, "collision", name=name)
        _origin(collision, origin)
        return ET.SubElement(collision, "geometry")

    name = f"{geom.name}-{k}"
    size = tuple(shrunk(v, clearance) for v in piece.size)
    if piece.kind in ("box", "sphere", "cylinder"):
        _primitive(geometry(name, local), replace(piece, size=size))
    elif piece.kind == "capsule":
        radius, half = size[0], piece.size[1]
        tube = replace(piece, kind="cylinder", size=(radius, half))
        _primitive(geometry(name, local), tube)
        for end, z in (("low", -half), ("high", half)):
            ball = geometry(f"{name}-{end}", local.then(pose((0, 0, z))))
            ET.SubElement(ball, "sphere", radius=number(radius))
    else:
        mesh = piece_mesh(piece)
        assert mesh is not None
        low, high = mesh[0].min(axis=0), mesh[0].max(axis=0)
        half = (high - low) / 2
        factor = np.array([shrunk(v, clearance) for v in half]) / half
        middle = (low + high) / 2
        fields = {"filename": collision_file(geom, k)}
        if clearance:
            local = local.then(pose(middle * (1 - factor)))
            fields["scale"] = numbers(np.round(factor, 9))
        ET.SubElement(geometry(name, local), "mesh", fields)


def shrunk(half: float, clearance: float) -> float:
    """Reduce half a size by a clearance [m], but by at most a fraction `MAX_SHRINKAGE`."""
    return half - min(clearance, MAX_SHRINKAGE * half)


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
            # Simulators refuse moving links without mass.
            ET.SubElement(link, "mass", value=number(BALL_LINK * mass.mass))
            tensor = {f"i{a}{b}": "0" for a, b in ("xy", "xz", "yz")}
            tensor |= {f"i{a}{a}": number(BALL_LINK * max(mass.diagonal)) for a in "xyz"}
            ET.SubElement(link, "inertia", tensor)
        limit = min(joint.upper, np.pi / 2) if axis == "y" else joint.upper
        hinge = joint.model_copy(
            update={
                "name": name,
                "type": "revolute" if joint.upper > 0 else "continuous",
                "parent": parent,
                "child": child,
                "axis": tuple(float(axis == a) for a in "xyz"),
                "lower": -limit,
                "upper": limit,
            }
        )
        _add_joint(robot, hinge, origin)
        parent, origin = child, np.array(joint.pos)


def _origin(element: ET.Element, local: Pose) -> None:
    ET.SubElement(element, "origin", xyz=numbers(local.pos), rpy=numbers(to_rpy(local.quat)))
