"""Reads the mechanism of a URDF file with yourdfpy."""

import io
import math
import os
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import SpecError
from ..io import read_untrusted_bytes
from ..spec import Box, Capsule, Cylinder, JointSpec, Mimic, Site, Sphere
from ..spec.pose import triple
from ..spec.primitives import BaseShape
from .asset_files import inside, inside_any, read_xml
from .load_mesh import joined, load_surfaces
from .mechanism import (
    GRAY,
    SLIDE_M,
    Link,
    LinkShape,
    Mechanism,
    check_tree,
    visual_shapes,
)
from .mesh_colors import Color, Surface, small_image

XACRO = "xacro"
WORLD_LINK = re.compile(r"world([_-]?(link|base|frame))?", re.IGNORECASE)
"""Pattern of the names of root links that stand for the world."""
GEOMETRIES = ("box", "cylinder", "sphere", "mesh", "capsule")
LAYOUT = ("meshdir", "assetdir", "strippath", "discardvisual", "fusestatic")
"""Settings of MuJoCo in URDF that concern files, or that no import depends on."""
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
    notes: list[str] = []
    _find_meshes(path, root, notes)
    capsules = _replace_unknown_shapes(root, notes)
    try:
        robot = yourdfpy.URDF.load(
            io.BytesIO(ET.tostring(root)),  # pyright: ignore[reportArgumentType] lxml reads streams
            load_meshes=False,
            build_collision_scene_graph=False,
        ).robot
    except Exception as error:  # yourdfpy raises errors of many types
        raise SpecError(f"{path} is not URDF: {type(error).__name__}: {error}"[:300]) from None
    notes += [
        f"{content} are not imported"
        for tag, content in NOT_IMPORTED.items()
        if root.find(f".//{tag}") is not None
    ]
    base = check_tree(
        path, [link.name for link in robot.links],
        [(joint.name, joint.parent, joint.child) for joint in robot.joints],
    )  # fmt: skip
    frames = _frames(robot, base)
    # A material may be defined in a visual, and used in others by its name.
    defined = [*robot.materials, *(v.material for link in robot.links for v in link.visuals)]
    colors = {m.name: color for m in defined if m and (color := _stated_color(path, m, notes))}
    links = [
        _link(path, link, frames[link.name], colors, capsules, _friction(root, link.name), notes)
        for link in robot.links
    ]
    # A file without any collider shows objects whose colliders are derived.
    for link in links if any(link.collisions for link in robot.links) else ():
        link.visual_only = all(shape.role == "visual" for shape in link.shapes)
    below = [joint.type for joint in robot.joints if joint.parent == base]
    world = next(link for link in links if link.name == base)
    fixed = WORLD_LINK.fullmatch(base) is not None
    free = fixed and not world.shapes and not world.mass and below == ["floating"]
    joints = []
    for joint in robot.joints:
        ignored = notes if not (free and joint.parent == base) else []
        joints.append(_joint(path, joint, frames[joint.child], ignored))
        if joint.type == "planar":
            links += _split_planar(joint, frames[joint.child], joints, notes)
    world.static = fixed and not free and not world.mass
    sites = _fold_frames(links, joints)
    by_name = {link.name: link for link in links}
    name = robot.name or path.stem
    return Mechanism(name, by_name, joints, sites, notes, fixed=fixed and not free)


def _find_meshes(path: Path, root: ET.Element, notes: list[str]) -> None:
    """Check that all meshes exist, and note the settings of MuJoCo that are not applied.

    A mesh that is not where the file names it is looked for without its folders, as MuJoCo does:
    in the `meshdir` of the element <mujoco>, or next to the file.
    """
    stated = {key: v for e in root.findall("mujoco/*") for key, v in e.attrib.items()}
    folder = stated.get("meshdir", stated.get("assetdir", ""))
    for mesh in root.iter("mesh"):
        name = mesh.get("filename") or ""
        try:
            inside(path, name)
        except SpecError:
            other = os.path.join(folder, re.split(r"[/\\]", name)[-1])
            try:
                inside_any(path, [other], name)
            except SpecError:
                other = ""
            if not name or not other:
                raise
            mesh.set("filename", other)
            notes.append(f"{name} does not exist: {other} is read, as in MuJoCo")
    ignored = [f"{key}={value}" for key, value in stated.items() if key not in LAYOUT]
    if ignored:
        notes.append(f"settings of MuJoCo are not applied: {', '.join(ignored)}"[:200])


def _split_planar(
    joint: Any, frame: NDArray, joints: list[JointSpec], notes: list[str]
) -> list[Link]:
    """Replace the last joint, which is planar, by two slides and a hinge, as MuJoCo does.

    Returns:
        The links between them.
    """
    last = joints.pop()
    normal = frame[:3, :3] @ np.asarray(joint.axis if joint.axis is not None else (1, 0, 0), float)
    if np.linalg.norm(normal) < 1e-9:
        raise SpecError(f"joint {joint.name} has no axis")
    normal /= np.linalg.norm(normal)
    first = np.cross(np.eye(3)[int(np.argmin(np.abs(normal)))], normal)
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)
    inner = [Link(f"{joint.name}_{axis}_link") for axis in "xy"]
    ends = [last.parent, inner[0].name, inner[1].name, last.child]
    reach = {"type": "prismatic", "lower": -SLIDE_M, "upper": SLIDE_M}
    kinds = {"x": (first, reach), "y": (second, reach), "z": (normal, {"type": "continuous"})}
    for k, (name, (axis, update)) in enumerate(kinds.items()):
        update = {"parent": ends[k], "child": ends[k + 1], "axis": triple(axis), **update}
        joints.append(last.model_copy(update={"name": f"{joint.name}_{name}", **update}))
    notes.append(
        f"joint {joint.name} is planar: imported as two slides of {SLIDE_M:g} m and a hinge"
    )
    return inner


def _replace_unknown_shapes(root: ET.Element, notes: list[str]) -> set[tuple[str, str, int]]:
    """Replace capsules, which yourdfpy does not know, by cylinders, and remove unknown shapes.

    Returns:
        The name of the link, "visual" or "collision", and the index of each capsule.
    """
    capsules = set()
    for link in root.findall("link"):
        name = link.get("name") or ""
        for tag in ("visual", "collision"):
            for element in link.findall(tag):
                shapes = element.findall("geometry/*")
                if len(shapes) == 1 and shapes[0].tag in GEOMETRIES:
                    continue
                kinds = ", ".join(shape.tag for shape in shapes) or "no shape"
                notes.append(f"link {name}: a {tag} with {kinds} is not imported")
                link.remove(element)
            for k, element in enumerate(link.findall(tag)):
                shape = element.find("geometry/capsule")
                if shape is not None:
                    shape.tag = "cylinder"
                    capsules.add((name, tag, k))
    return capsules


def _stated_color(path: Path, material: Any, notes: list[str]) -> Color | None:
    """Return the color of a material, or the mean color of its texture; None if it has neither."""
    if material.color is not None:
        red, green, blue, alpha = (float(v) for v in material.color.rgba)
        return red, green, blue, alpha
    if material.texture is None or not material.texture.filename:
        return None
    name = material.texture.filename
    try:
        with small_image(read_untrusted_bytes(inside(path, name), SpecError), name) as image:
            pixel = np.asarray(image.convert("RGB"), float).reshape(-1, 3).mean(axis=0) / 255
    except SpecError as error:
        notes.append(f"a texture is not imported: {error}"[:200])
        return None
    notes.append(f"texture {name} is replaced by its mean color")
    red, green, blue = (float(v) for v in pixel)
    return red, green, blue, 1.0


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
    """Return the friction of a link: its own, that stated for PyBullet, or 0.5 if there is none."""
    marks = [mark for mark in root.findall("neoworld/friction") if mark.get("link") == link]
    for element in root.findall("link"):
        if element.get("name") == link:
            marks += element.findall("contact/lateral_friction")
    try:
        return float(marks[0].get("value") or 0.5) if marks else 0.5
    except ValueError:
        return 0.5


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
    colors: dict[str, Color],
    capsules: set[tuple[str, str, int]],
    friction: float,
    notes: list[str],
) -> Link:
    result = Link(link.name)
    for k, item in enumerate(link.visuals):
        name = None if item.material is None else item.material.name
        stated = None if item.material is None else _stated_color(path, item.material, [])
        rgba = stated or colors.get(str(name))
        capsule = (link.name, "visual", k) in capsules
        if item.geometry.mesh is not None:
            looks: list[str] = []
            surfaces, pose = _surfaces(path, item, frame, looks)
            result.shapes += visual_shapes(surfaces, pose, [k] * len(surfaces), rgba)
            notes += [] if rgba else [f"link {link.name}: {note}" for note in dict.fromkeys(looks)]
        else:
            shape, pose = _primitive(path, item, link.name, frame, capsule=capsule)
            result.shapes.append(LinkShape(shape, pose, "visual", rgba or GRAY))
    for k, item in enumerate(link.collisions):
        if item.geometry.mesh is not None:
            surfaces, pose = _surfaces(path, item, frame, [])
            shape = joined(surfaces)
        else:
            capsule = (link.name, "collision", k) in capsules
            shape, pose = _primitive(path, item, link.name, frame, capsule=capsule)
        result.shapes.append(LinkShape(shape, pose, "collision", friction=friction))
    inertial = link.inertial
    if inertial is not None and inertial.mass is not None:
        pose = frame if inertial.origin is None else frame @ inertial.origin
        result.mass, result.com = float(inertial.mass), pose[:3, 3]
        if inertial.inertia is not None:
            rotation = pose[:3, :3]
            result.inertia = rotation @ np.asarray(inertial.inertia, float) @ rotation.T
    return result


def _primitive(
    path: Path, item: Any, link: str, frame: NDArray, *, capsule: bool
) -> tuple[BaseShape, NDArray]:
    """Return the shape of a visual or a collision, and its pose in the root frame."""
    pose = frame if item.origin is None else frame @ item.origin
    geometry = item.geometry
    try:
        if geometry.box is not None:
            x, y, z = (float(v) for v in geometry.box.size)
            return Box(size=(x, y, z)), pose
        if geometry.sphere is not None:
            return Sphere(radius=float(geometry.sphere.radius)), pose
        radius, length = float(geometry.cylinder.radius), float(geometry.cylinder.length)
        if capsule:
            return Capsule(radius=radius, length=length), pose
        return Cylinder(radius=radius, height=length), pose
    except (ValueError, TypeError):
        raise SpecError(f"{path}: link {link} has a shape whose size is not positive") from None


def _surfaces(
    path: Path, item: Any, frame: NDArray, notes: list[str]
) -> tuple[list[Surface], NDArray]:
    """Return the surfaces of a mesh, scaled, and their pose in the root frame."""
    mesh, pose = item.geometry.mesh, frame if item.origin is None else frame @ item.origin
    scale = np.ones(3) if mesh.scale is None else np.ones(3) * np.asarray(mesh.scale, float)
    turn = 1 if np.prod(scale) > 0 else -1
    return [
        surface._replace(vertices=surface.vertices * scale, faces=surface.faces[:, ::turn])
        for surface in load_surfaces(inside(path, mesh.filename), notes)
    ], pose


def _joint(path: Path, joint: Any, frame: NDArray, notes: list[str]) -> JointSpec:
    kind, limit, dynamics, mimic = joint.type, joint.limit, joint.dynamics, joint.mimic
    lower = upper = 0.0
    if kind not in ("fixed", "revolute", "continuous", "prismatic"):
        if kind != "planar":
            notes.append(f"joint {joint.name} is {kind}: imported as fixed")
        kind = "fixed"
    if kind in ("revolute", "prismatic"):
        low, high = getattr(limit, "lower", None), getattr(limit, "upper", None)
        if low is not None or high is not None:
            lower, upper = float(low or 0.0), float(high or 0.0)
            if low is None or high is None:
                missing = "lower" if low is None else "upper"
                notes.append(f"joint {joint.name} states no {missing} limit: it is 0, as in URDF")
        elif kind == "prismatic":
            lower, upper = -SLIDE_M, SLIDE_M
            notes.append(
                f"joint {joint.name} slides without limits: here from {lower:g} to {upper:g} m"
            )
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
