"""Read the mechanism of a URDF file, through yourdfpy."""

import math
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import SpecError
from ..spec import Box, Cylinder, JointSpec, Site, Sphere
from ..spec.base_shape import BaseShape
from ..spec.object import Role
from .checked_xml import inside, read_xml
from .drake_contact import DRAKE
from .load_mesh import load_mesh
from .mechanism import (
    Link,
    LinkShape,
    Mechanism,
    Triangles,
    check_tree,
    triple,
    unchecked_joint,
    unchecked_mimic,
    unchecked_site,
)
from .write_urdf import CLEARANCE_M, as_drawn

XACRO = "xacro"
LOST = {
    "transmission": "transmissions",
    "gazebo": "Gazebo's extensions",
    "sensor": "sensors",
    "safety_controller": "safety controllers",
    "calibration": "calibration",
}


def read_urdf(path: Path) -> Mechanism:
    """Read a URDF file and the meshes beside it.

    Raises:
        SpecError: the file is broken or hostile, names a mesh that is not there or lies outside its
            folder, or is no tree.
    """
    import yourdfpy

    path = Path(path)
    root = read_xml(path)
    if path.suffix == ".xacro" or any(XACRO in element.tag for element in root.iter()):
        raise SpecError(
            f"{path} is written in xacro, whose expressions are programs: expand it by "
            "`xacro FILE > robot.urdf`, and give that"
        )
    if root.tag != "robot":
        raise SpecError(f"{path}: a URDF begins with <robot>, this with <{root.tag}>")
    _check(path, root)
    for mesh in root.iter("mesh"):
        inside(path, mesh.get("filename") or "")
    try:
        robot = yourdfpy.URDF.load(
            str(path), load_meshes=False, build_collision_scene_graph=False
        ).robot
    except Exception as error:  # a library's border
        raise SpecError(f"{path} is no URDF: {type(error).__name__}: {error}"[:300]) from None
    notes = [
        f"{content} are not carried"
        for tag, content in LOST.items()
        if root.find(f".//{tag}") is not None
    ]
    frames = _frames(robot, check_tree(
        path, [link.name for link in robot.links],
        [(joint.name, joint.parent, joint.child) for joint in robot.joints],
    ))  # fmt: skip
    colours = {m.name: m.color.rgba for m in robot.materials if m.color is not None and m.name}
    frictions = _frictions(root)
    drawn = {mark.get("link") for mark in root.findall("neoworld/drawn_in")}
    links = [
        _link(
            path,
            link,
            frames[link.name],
            colours,
            frictions[link.name],
            CLEARANCE_M if link.name in drawn else 0.0,
            notes,
        )
        for link in robot.links
    ]
    joints = [_joint(path, joint, frames[joint.child], notes) for joint in robot.joints]
    for mark in root.findall("neoworld/unstated"):
        none = {k: None for k in ("effort", "velocity") if k in (mark.get("limits") or "").split()}
        joints = [j.model_copy(update=none) if j.name == mark.get("joint") else j for j in joints]
    for mark in root.findall("neoworld/ball"):
        _fold_ball(mark.get("joint") or "", links, joints, notes)
    sites = _fold_frames(links, joints)
    by_name = {link.name: link for link in links}
    return Mechanism(robot.name or path.stem, by_name, joints, sites, notes)


def _fold_frames(links: list[Link], joints: list[JointSpec]) -> list[Site]:
    """Make sites of the links that have nothing but a place: no shape, mass or child."""
    parents = {joint.parent for joint in joints}
    sites = []
    for joint in [joint for joint in joints if joint.type == "fixed"]:
        link = next(link for link in links if link.name == joint.child)
        if link.shapes or link.mass or link.name in parents:
            continue
        sites.append(unchecked_site(link.name, joint.parent, link.origin))
        links.remove(link)
        joints.remove(joint)
    return sites


def _frictions(root: ET.Element) -> dict[str, list[float]]:
    """Return the friction of each collision of each link: Drake's, else PyBullet's, else 0.5."""
    result = {}
    for link in root.findall("link"):
        whole = link.find("contact/lateral_friction")
        values = []
        for collision in link.findall("collision"):
            own = collision.find(f"{{{DRAKE}}}proximity_properties/{{{DRAKE}}}mu_dynamic")
            stated = whole if own is None else own
            try:
                value = 0.5 if stated is None else float(stated.get("value") or 0.5)
            except ValueError:
                value = 0.5
            values.append(value)
        result[str(link.get("name"))] = values
    return result


def _fold_ball(name: str, links: list[Link], joints: list[JointSpec], notes: list[str]) -> None:
    """Restore the ball joint that our export wrote as three hinges with two bare links between."""
    by_name = {joint.name: joint for joint in joints}
    hinges = [by_name.get(f"{name}_{axis}") for axis in "xyz"]
    inner = [f"{name}_{axis}_link" for axis in "xy"]
    ends = [(joint.parent, joint.child) for joint in joints]
    bare = {link.name for link in links if not link.shapes}
    first, middle, last = hinges
    if first is None or middle is None or last is None or not _is_ball(first, middle, last):
        whole = False
    else:
        chain = [(first.parent, inner[0]), (inner[0], inner[1]), (inner[1], last.child)]
        joined = [end for end in ends if set(end) & set(inner)]
        whole = joined == chain and bare.issuperset(inner)
    if not whole:
        notes.append(f"ball {name} is not as it was written: its hinges are carried as they are")
        return
    assert first is not None and last is not None
    ball = first.model_copy(
        update={"name": name, "type": "ball", "child": last.child, "axis": (0.0, 0.0, 1.0)}
        | {"lower": 0.0, "effort": None, "velocity": None}
    )
    joints[:] = [ball if j is first else j for j in joints if j is first or j not in hinges]
    links[:] = [link for link in links if link.name not in inner]


def _is_ball(*hinges: JointSpec) -> bool:
    """Tell whether three hinges make a ball: one point, axes x, y, z, equal losses and limits."""
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
    most = min(first.upper, math.pi / 2)
    return same and bool(
        np.isclose(middle.upper, most) and np.isclose(hinges[2].upper, first.upper)
    )


def _check(path: Path, root: Any) -> None:
    """Refuse what makes yourdfpy fail without a message."""
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
    at: NDArray,
    colours: dict[str, Any],
    frictions: list[float],
    clearance: float,
    notes: list[str],
) -> Link:
    result = Link(link.name, origin=at[:3, 3])
    elements: list[tuple[Any, Role]] = [(link.visuals, "visual"), (link.collisions, "collision")]
    for items, role in elements:
        for k, item in enumerate(items):
            friction = frictions[k] if role == "collision" else 0.5
            inset = clearance if role == "collision" else 0.0
            place = at if item.origin is None else at @ item.origin
            rgba = _colour(getattr(item, "material", None), colours)
            for shape, local in _shapes(path, item.geometry, link.name, inset, notes):
                result.shapes.append(LinkShape(shape, place @ local, role, rgba, friction))
    own = link.inertial
    if own is not None and own.mass is not None:
        place = at if own.origin is None else at @ own.origin
        result.mass, result.com = float(own.mass), place[:3, 3]
        if own.inertia is not None:
            turn = place[:3, :3]
            result.inertia = turn @ np.asarray(own.inertia, float) @ turn.T
    return result


def _colour(material: Any, colours: dict[str, Any]) -> tuple[float, float, float, float]:
    if material is None:
        return (0.7, 0.7, 0.7, 1.0)
    rgba = material.color.rgba if material.color is not None else colours.get(material.name)
    if rgba is None:
        return (0.7, 0.7, 0.7, 1.0)
    r, g, b, a = (float(v) for v in rgba)
    return r, g, b, a


def _shapes(
    path: Path, geometry: Any, link: str, inset: float, notes: list[str]
) -> list[tuple[BaseShape | Triangles, NDArray]]:
    """Return shapes with their places in the element's frame, before our export drew them in."""
    here = np.eye(4)

    def whole(half: float) -> float:
        return as_drawn(half, inset) if inset and half > 0 else half

    try:
        if geometry.box is not None:
            return [
                (
                    Box(
                        size=triple(
                            np.array([2 * whole(v / 2) for v in map(float, geometry.box.size)])
                        )
                    ),
                    here,
                )
            ]
        if geometry.sphere is not None:
            return [(Sphere(radius=whole(float(geometry.sphere.radius))), here)]
        if geometry.cylinder is not None:
            c = geometry.cylinder
            return [
                (
                    Cylinder(radius=whole(float(c.radius)), height=2 * whole(float(c.length) / 2)),
                    here,
                )
            ]
    except ValueError:
        raise SpecError(f"{path}: link {link} has a shape whose size is not positive") from None
    if geometry.mesh is not None:
        scale = (
            np.ones(3) if geometry.mesh.scale is None else np.asarray(geometry.mesh.scale, float)
        )
        vertices, faces = load_mesh(inside(path, geometry.mesh.filename))
        if inset:
            here[:3, 3] = -(vertices.min(axis=0) + vertices.max(axis=0)) / 2 * (1 - scale)
            scale = np.ones(3)
        return [((vertices * scale, faces if np.prod(scale) > 0 else faces[:, ::-1]), here)]
    notes.append(f"link {link}: a geometry that is no box, sphere, cylinder or mesh is left out")
    return []


def _joint(path: Path, joint: Any, at: NDArray, notes: list[str]) -> JointSpec:
    kind, limit, dynamics, mimic = joint.type, joint.limit, joint.dynamics, joint.mimic
    lower = upper = 0.0
    if kind not in ("fixed", "revolute", "continuous", "prismatic"):
        notes.append(f"joint {joint.name} is {kind}: carried as fixed")
        kind = "fixed"
    if kind in ("revolute", "prismatic"):
        if limit is None or limit.lower is None or limit.upper is None:
            if kind == "prismatic":
                raise SpecError(f"{path}: joint {joint.name} is prismatic and states no limits")
            notes.append(f"joint {joint.name} states no limits: carried as continuous")
            kind = "continuous"
        else:
            lower, upper = float(limit.lower), float(limit.upper)
            if lower > upper:
                raise SpecError(
                    f"{path}: joint {joint.name}: lower {lower:g} is above upper {upper:g}"
                )
            if lower == upper:
                notes.append(f"joint {joint.name} has no range: carried as fixed")
                kind = "fixed"
    axis = at[:3, :3] @ np.asarray(joint.axis if joint.axis is not None else (1, 0, 0), float)
    if kind != "fixed" and np.linalg.norm(axis) < 1e-9:
        raise SpecError(f"{path}: joint {joint.name} has no axis")
    free = kind == "fixed"
    return unchecked_joint(
        name=joint.name,
        type=kind,
        parent=joint.parent,
        child=joint.child,
        pos=triple(at[:3, 3]),
        axis=(0, 0, 1) if free else triple(axis / np.linalg.norm(axis)),
        lower=0.0 if free or kind == "continuous" else lower,
        upper=0.0 if free or kind == "continuous" else upper,
        damping=_positive(dynamics, "damping", joint.name, notes),
        friction=_positive(dynamics, "friction", joint.name, notes),
        # Some files write 0 for "none", which would mean a joint that cannot be driven.
        effort=_stated(limit, "effort"),
        velocity=_stated(limit, "velocity"),
        mimic=None
        if mimic is None or free
        else unchecked_mimic(
            mimic.joint,
            1.0 if mimic.multiplier is None else float(mimic.multiplier),
            float(mimic.offset or 0.0),
        ),
    )


def _positive(source: Any, name: str, joint: str, notes: list[str]) -> float:
    value = float(getattr(source, name, None) or 0.0)
    if value < 0:
        notes.append(f"joint {joint}: a {name} of {value:g} is carried as none")
    return max(value, 0.0)


def _stated(source: Any, name: str) -> float | None:
    value = getattr(source, name, None)
    return float(value) if value and value > 0 and math.isfinite(value) else None
