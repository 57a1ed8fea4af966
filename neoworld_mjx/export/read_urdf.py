"""Reads the mechanism of a URDF file with yourdfpy."""

import math
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import SpecError
from ..spec import Box, Cylinder, JointSpec, Mimic, Site, Sphere
from ..spec.pose import triple
from ..spec.primitives import BaseShape
from .load_mesh import inside, load_mesh, read_xml
from .mechanism import (
    GRAY,
    Link,
    LinkShape,
    Mechanism,
    Triangles,
    check_tree,
)
from .write_urdf import CLEARANCE_M, original_half

XACRO = "xacro"
NOT_IMPORTED = {
    "transmission": "transmissions",
    "gazebo": "Gazebo's extensions",
    "sensor": "sensors",
    "safety_controller": "safety controllers",
    "calibration": "calibration",
}


def read_urdf(path: Path) -> Mechanism:
    """Read a URDF file and its meshes.

    Raises:
        SpecError: the file is broken or hostile, refers to a mesh that is missing or outside the
            file's folder, or its links do not form a tree.
    """
    import yourdfpy

    path = Path(path)
    root = read_xml(path)
    if path.suffix == ".xacro" or any(XACRO in element.tag for element in root.iter()):
        raise SpecError(
            f"{path} is written in xacro, whose expressions are programs: expand it with "
            "`xacro FILE > robot.urdf` and use the result"
        )
    if root.tag != "robot":
        raise SpecError(f"{path}: the root element of URDF is <robot>, not <{root.tag}>")
    _check_names(path, root)
    for mesh in root.iter("mesh"):
        inside(path, mesh.get("filename") or "")
    try:
        robot = yourdfpy.URDF.load(
            str(path), load_meshes=False, build_collision_scene_graph=False
        ).robot
    except Exception as error:  # yourdfpy raises errors of many types
        raise SpecError(f"{path} is not URDF: {type(error).__name__}: {error}"[:300]) from None
    notes = [
        f"{content} are not imported"
        for tag, content in NOT_IMPORTED.items()
        if root.find(f".//{tag}") is not None
    ]
    frames = _frames(robot, check_tree(
        path, [link.name for link in robot.links],
        [(joint.name, joint.parent, joint.child) for joint in robot.joints],
    ))  # fmt: skip
    colors = {m.name: m.color.rgba for m in robot.materials if m.color is not None and m.name}
    shrunk = {mark.get("link") for mark in root.findall("neoworld/drawn_in")}
    links = [
        _link(
            path,
            link,
            frames[link.name],
            colors,
            _friction(root, link.name),
            CLEARANCE_M if link.name in shrunk else 0.0,
            notes,
        )
        for link in robot.links
    ]
    joints = [_joint(path, joint, frames[joint.child], notes) for joint in robot.joints]
    for mark in root.findall("neoworld/unstated"):
        unstated = {k: None for k in ("effort", "velocity") if k in mark.get("limits", "").split()}
        joints = [
            j.model_copy(update=unstated) if j.name == mark.get("joint") else j for j in joints
        ]
    for mark in root.findall("neoworld/ball"):
        _fold_ball(mark.get("joint") or "", links, joints, notes)
    sites = _fold_frames(links, joints)
    return Mechanism(
        robot.name or path.stem, {link.name: link for link in links}, joints, sites, notes
    )


def _fold_frames(links: list[Link], joints: list[JointSpec]) -> list[Site]:
    """Convert each fixed link that has no shape, mass or child to a site."""
    parents = {joint.parent for joint in joints}
    sites = []
    for joint in [joint for joint in joints if joint.type == "fixed"]:
        link = next(link for link in links if link.name == joint.child)
        if link.shapes or link.mass or link.name in parents:
            continue
        sites.append(Site.model_construct(name=link.name, part=joint.parent, pos=joint.pos))
        links.remove(link)
        joints.remove(joint)
    return sites


def _friction(root: ET.Element, link: str) -> float:
    """Return the friction coefficient that a link states for PyBullet; 0.5 if it states none."""
    for element in root.findall("link"):
        stated = element.find("contact/lateral_friction")
        if element.get("name") == link and stated is not None:
            try:
                return float(stated.get("value") or 0.5)
            except ValueError:
                return 0.5
    return 0.5


def _fold_ball(name: str, links: list[Link], joints: list[JointSpec], notes: list[str]) -> None:
    """Restore a ball joint that `write_urdf` wrote as three hinges with two links between them."""
    by_name = {joint.name: joint for joint in joints}
    hinges = [by_name.get(f"{name}_{axis}") for axis in "xyz"]
    inner = [f"{name}_{axis}_link" for axis in "xy"]
    ends = [(joint.parent, joint.child) for joint in joints]
    empty_links = {link.name for link in links if not link.shapes}
    first, middle, last = hinges
    complete = False
    if first and middle and last and _is_ball(first, middle, last):
        chain = [(first.parent, inner[0]), (inner[0], inner[1]), (inner[1], last.child)]
        joined = [end for end in ends if set(end) & set(inner)]
        complete = joined == chain and empty_links.issuperset(inner)
    if not complete:
        notes.append(f"ball joint {name} was edited: imported as separate hinges")
        return
    assert first is not None and last is not None
    ball = first.model_copy(
        update={"name": name, "type": "ball", "child": last.child, "axis": (0.0, 0.0, 1.0)}
        | {"lower": 0.0, "effort": None, "velocity": None}
    )
    joints[:] = [ball if j is first else j for j in joints if j is first or j not in hinges]
    links[:] = [link for link in links if link.name not in inner]


def _is_ball(*hinges: JointSpec) -> bool:
    """Return True if three hinges are those that `write_urdf` writes for a ball joint.

    The hinges have the same anchor, damping and friction, the axes x, y and z, and symmetric limits
    that follow from the limit of the first hinge.
    """
    first, middle, _ = hinges
    same = all(
        h.type == first.type
        and h.mimic is None
        and h.type in ("revolute", "continuous")
        and np.allclose(h.pos, first.pos, atol=1e-6)
        and np.allclose(h.axis, axis, atol=1e-6)
        and np.allclose((h.damping, h.friction), (first.damping, first.friction))
        and np.isclose(h.lower, -h.upper)
        for h, axis in zip(hinges, np.eye(3), strict=True)
    )
    middle_upper = min(first.upper, math.pi / 2)
    return same and bool(
        np.isclose(middle.upper, middle_upper) and np.isclose(hinges[2].upper, first.upper)
    )


def _check_names(path: Path, root: ET.Element) -> None:
    """Refuse a file with missing names, for which yourdfpy raises no useful error."""
    for joint in root.findall("joint"):
        for end in ("parent", "child"):
            element = joint.find(end)
            if element is None or not element.get("link"):
                raise SpecError(f"{path}: joint {joint.get('name')!r} has no {end} link")
    for element in (*root.findall("link"), *root.findall("joint")):
        if not element.get("name"):
            raise SpecError(f"{path}: a {element.tag} has no name")
    if root.find("link") is None:
        raise SpecError(f"{path} has no links")


def _frames(robot: Any, root: str) -> dict[str, NDArray]:
    frames = {root: np.eye(4)}
    waiting = list(robot.joints)
    while waiting:
        joint = next(joint for joint in waiting if joint.parent in frames)
        waiting.remove(joint)
        local = np.eye(4) if joint.origin is None else joint.origin
        frames[joint.child] = frames[joint.parent] @ local
    return frames


def _link(
    path: Path,
    link: Any,
    frame: NDArray,
    colors: dict[str, Any],
    friction: float,
    clearance: float,
    notes: list[str],
) -> Link:
    result = Link(link.name)
    for item in link.visuals:
        rgba = _color(item.material, colors)
        for shape, pose in _shapes(path, item, link.name, frame, 0.0, notes):
            result.shapes.append(LinkShape(shape, pose, "visual", rgba))
    for item in link.collisions:
        for shape, pose in _shapes(path, item, link.name, frame, clearance, notes):
            result.shapes.append(LinkShape(shape, pose, "collision", friction=friction))
    inertial = link.inertial
    if inertial is not None and inertial.mass is not None:
        pose = frame if inertial.origin is None else frame @ inertial.origin
        result.mass, result.com = float(inertial.mass), pose[:3, 3]
        if inertial.inertia is not None:
            rotation = pose[:3, :3]
            result.inertia = rotation @ np.asarray(inertial.inertia, float) @ rotation.T
    return result


def _color(material: Any, colors: dict[str, Any]) -> tuple[float, float, float, float]:
    rgba = None
    if material is not None:
        rgba = material.color.rgba if material.color is not None else colors.get(material.name)
    if rgba is None:
        return GRAY
    red, green, blue, alpha = (float(v) for v in rgba)
    return red, green, blue, alpha


def _shapes(
    path: Path, item: Any, link: str, frame: NDArray, clearance: float, notes: list[str]
) -> list[tuple[BaseShape | Triangles, NDArray]]:
    """Return the shapes of a visual or a collision, and their poses in the root frame.

    If `clearance` is not 0, the shapes are enlarged to the size before `write_urdf` shrank them.
    """
    pose = frame if item.origin is None else frame @ item.origin
    geometry = item.geometry

    def original(size: Any) -> float:
        half = float(size) / 2
        return 2 * (original_half(half, clearance) if clearance and half > 0 else half)

    try:
        if geometry.box is not None:
            x, y, z = (original(v) for v in geometry.box.size)
            return [(Box(size=(x, y, z)), pose)]
        if geometry.sphere is not None:
            return [(Sphere(radius=original(2 * float(geometry.sphere.radius)) / 2), pose)]
        if geometry.cylinder is not None:
            radius = original(2 * float(geometry.cylinder.radius)) / 2
            height = original(geometry.cylinder.length)
            return [(Cylinder(radius=radius, height=height), pose)]
    except ValueError:
        raise SpecError(f"{path}: link {link} has a shape whose size is not positive") from None
    if geometry.mesh is None:
        notes.append(f"link {link}: a geometry other than box, sphere, cylinder or mesh is skipped")
        return []
    stated = geometry.mesh.scale
    scale = np.ones(3) if stated is None else np.asarray(stated, float)
    vertices, faces = load_mesh(inside(path, geometry.mesh.filename))
    if clearance:
        shift = np.eye(4)
        shift[:3, 3] = -(vertices.min(axis=0) + vertices.max(axis=0)) / 2 * (1 - scale)
        return [((vertices, faces), pose @ shift)]
    return [((vertices * scale, faces if np.prod(scale) > 0 else faces[:, ::-1]), pose)]


def _joint(path: Path, joint: Any, frame: NDArray, notes: list[str]) -> JointSpec:
    kind, limit, dynamics, mimic = joint.type, joint.limit, joint.dynamics, joint.mimic
    lower = upper = 0.0
    if kind not in ("fixed", "revolute", "continuous", "prismatic"):
        notes.append(f"joint {joint.name} is {kind}: imported as fixed")
        kind = "fixed"
    if kind in ("revolute", "prismatic"):
        if limit is not None and limit.lower is not None and limit.upper is not None:
            lower, upper = float(limit.lower), float(limit.upper)
        elif kind == "prismatic":
            raise SpecError(f"{path}: joint {joint.name} is prismatic and has no limits")
        else:
            notes.append(f"joint {joint.name} has no limits: imported as continuous")
            kind = "continuous"
        if lower > upper:
            raise SpecError(f"{path}: joint {joint.name}: lower {lower:g} is above upper {upper:g}")
        if kind != "continuous" and lower == upper:
            notes.append(f"joint {joint.name} has no range: imported as fixed")
            kind = "fixed"
    axis = frame[:3, :3] @ np.asarray(joint.axis if joint.axis is not None else (1, 0, 0), float)
    if kind != "fixed" and np.linalg.norm(axis) < 1e-9:
        raise SpecError(f"{path}: joint {joint.name} has no axis")
    limited = kind in ("revolute", "prismatic")
    leader = None
    if mimic is not None and kind != "fixed":
        multiplier = 1.0 if mimic.multiplier is None else float(mimic.multiplier)
        leader = Mimic.model_construct(
            joint=mimic.joint, multiplier=multiplier, offset=float(mimic.offset or 0.0)
        )
    return JointSpec.model_construct(
        name=joint.name,
        type=kind,
        parent=joint.parent,
        child=joint.child,
        pos=triple(frame[:3, 3]),
        axis=(0, 0, 1) if kind == "fixed" else triple(axis / np.linalg.norm(axis)),
        lower=lower if limited else 0.0,
        upper=upper if limited else 0.0,
        damping=_not_negative(dynamics, "damping", joint.name, notes),
        friction=_not_negative(dynamics, "friction", joint.name, notes),
        effort=_positive(limit, "effort"),
        velocity=_positive(limit, "velocity"),
        mimic=leader,
    )


def _not_negative(source: Any, name: str, joint: str, notes: list[str]) -> float:
    value = float(getattr(source, name, None) or 0.0)
    if value < 0:
        notes.append(f"joint {joint}: a {name} of {value:g} is imported as 0")
    return max(value, 0.0)


def _positive(source: Any, name: str) -> float | None:
    """Return a limit, or None if it is missing or 0, as some files write for no limit."""
    value = getattr(source, name, None)
    return float(value) if value and value > 0 and math.isfinite(value) else None
