"""Frames, names and inertias of an object's links, and its sites and handles, for all writers.

The origin of a link's frame is the anchor of the joint that moves the link. The axes of the frame
are those of the object.
"""

import re
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..io.names import unused
from ..physics.mjcf import excluded_pairs
from ..spec import JointSpec, ObjectSpec, PartSpec, inertial, pieces
from ..spec.convex import box_around
from ..spec.kinematics import welded
from ..spec.pose import Pose, matrix

TENSOR_ENTRIES = {
    "ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2),
}  # fmt: skip
"""Indices of the entries of an inertia tensor, by the name of the entry in URDF and SDF."""


def link_origins(spec: ObjectSpec) -> dict[str, NDArray]:
    """Return the origin of each part's link, by part name.

    Origins are in the object's frame with all joints at zero [m], shape [3].
    """
    return {spec.root: np.zeros(3)} | {joint.child: np.array(joint.pos) for joint in spec.joints}


def link_names(spec: ObjectSpec) -> dict[str, str]:
    """Return the name of each part's link in URDF and SDF, by part name.

    The root link has the name of the object, and the other links have the names of their parts.
    """
    names = {part.name: part.name for part in spec.parts}
    root = spec.root
    return names | {root: unused(spec.name, names.keys() - {root})}


def unjoined_pairs(spec: ObjectSpec) -> list[tuple[str, str]]:
    """Return the pairs of parts that are excluded from collisions and that no joint connects."""
    joined = {(joint.parent, joint.child) for joint in spec.joints}
    return [pair for pair in excluded_pairs(spec) if pair not in joined]


def inertia_tensor(spec: ObjectSpec, part: PartSpec) -> NDArray:
    """Return the inertia of a part about its center of mass, in the object's axes [kg m^2]."""
    mass = inertial(spec, part)
    rotation = matrix(mass.quat)
    return rotation @ np.diag(mass.diagonal) @ rotation.T


def transform(pose: Pose) -> NDArray:
    """Return a pose as a homogeneous matrix [4, 4]."""
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = matrix(pose.quat), pose.pos
    return result


HANDLE = re.compile(r"handle|knob|pull|grip|lever|finial", re.IGNORECASE)
"""Pattern of the names of parts and geoms that serve as handles."""
MARGIN_M = 0.005
"""Margin of the box around a handle; contacts inside the box are contacts with the handle [m]."""
SMALL = 0.25
"""Share of a part's face above which a geom in front of it is no handle, but the part's front."""
SAME_M = 1e-3
"""Difference of two shapes' reaches below which they reach equally far [m]."""


@dataclass(frozen=True)
class Frame:
    """Named point on a part, with the axes of the object."""

    name: str
    part: str
    pos: tuple[float, float, float]
    """Position in the object's frame with all joints at zero [m]."""
    half: tuple[float, float, float] | None = None
    """Half the edge lengths of a box around the handle [m]; None if the frame is a site."""
    joint: str | None = None
    """Joint that the handle actuates; None if the frame is a site."""


def frames(spec: ObjectSpec) -> tuple[Frame, ...]:
    """Return an object's sites, and a frame <part>_handle for each part that a joint moves.

    No frame is added for a mimic joint, or if the part has a site <part>_handle. Otherwise the
    handle is, in this order of precedence, among the geoms of the moved part and of the parts fixed
    to it:

    - the geoms whose names, or whose parts' names, match `HANDLE`;
    - for a continuous joint, the moved part;
    - the geom that reaches farthest toward where the joint opens, if it covers at most `SMALL` of
      the part as seen from there, and no hinge's axis passes through it: a bar or a knob in front
      of a door;
    - for a prismatic joint, the side toward which the part moves;
    - for a revolute or ball joint, the side that is farthest from the joint.

    The frame is at the center of the handle. A named handle whose center lies in none of its
    shapes, such as a bar on two posts, has the frame at the shape that reaches farthest.
    """
    site_frames = [Frame(site.name, site.part, site.pos) for site in spec.sites]
    taken = {site.name for site in spec.sites}
    parts = {(site.name, site.part) for site in spec.sites}
    result = []
    for joint in spec.joints:
        name = f"{joint.child}_handle"
        if joint.type == "fixed" or joint.mimic is not None or (name, joint.child) in parts:
            continue
        while name in taken:
            name += "_"
        taken.add(name)
        result.append(_handle(spec, joint, name))
    return (*site_frames, *result)


def handle_at(spec: ObjectSpec, handle: Frame, point: tuple[float, float, float]) -> Frame:
    """Return a handle, or if a point of its part is not on it, the geom there as a handle.

    Args:
        spec: the object.
        handle: a handle.
        point: the point, in the object's frame with all joints at zero [m].
    """
    assert handle.half is not None
    if np.all(np.abs(np.subtract(point, handle.pos)) <= handle.half):
        return handle
    boxes: dict[str, list[_Shape]] = {}
    for geom, piece, local in pieces(spec.part(handle.part)):
        box = _Shape(geom.name, False, *box_around(piece, local))
        boxes.setdefault(geom.name, []).append(box)
    apart = lambda s: np.linalg.norm(np.maximum(s.low - point, point - s.high).clip(0.0))
    _, half = _around(min(boxes.values(), key=lambda shapes: min(map(apart, shapes))))
    return replace(handle, pos=point, half=_triple(half + MARGIN_M))


@dataclass(frozen=True)
class _Shape:
    """Box around one convex piece of a geom, in the object's frame [m]."""

    geom: str
    named: bool
    """True if the name of the geom or of its part matches `HANDLE`."""
    low: NDArray
    high: NDArray


def _handle(spec: ObjectSpec, joint: JointSpec, name: str) -> Frame:
    group = welded(spec)
    shapes = [
        _Shape(
            f"{part.name}/{geom.name}",
            bool(HANDLE.search(geom.name) or (HANDLE.search(part.name) and part.name != spec.root)),
            *box_around(piece, local),
        )
        for part in spec.parts
        if group[part.name] == group[joint.child]
        for geom, piece, local in pieces(part)
    ]
    center, half = _around(shapes)
    way = _opening_way(joint, center)
    if named := [shape for shape in shapes if shape.named]:
        center, half = _solid(named, joint, way)
    elif way is not None and (before := _in_front(shapes, joint, way)):
        center, half = _solid(before, joint, way)
    else:
        center, half = _leading_side(joint, center, half)
    return Frame(name, joint.child, _triple(center), _triple(half + MARGIN_M), joint.name)


def _around(shapes: list[_Shape]) -> tuple[NDArray, NDArray]:
    """Return the center and the half edge lengths of the box around shapes [m]."""
    low = np.min([shape.low for shape in shapes], axis=0)
    high = np.max([shape.high for shape in shapes], axis=0)
    return (low + high) / 2, (high - low) / 2


def _opening_way(joint: JointSpec, center: NDArray) -> tuple[int, float] | None:
    """Return the axis and sign nearest to how a part's center moves when the joint opens.

    None if the joint has no such direction.
    """
    if joint.type not in ("prismatic", "revolute"):
        return None
    way = np.array(joint.axis, float)
    if joint.type == "revolute":
        way = np.cross(way, center - np.array(joint.pos))
    way *= 1.0 if abs(joint.upper) >= abs(joint.lower) else -1.0
    k = int(np.argmax(np.abs(way)))
    return k, float(np.sign(way[k]) or 1.0)


def _farthest(shapes: list[_Shape], joint: JointSpec, way: tuple[int, float]) -> _Shape:
    """Return the shape that reaches farthest; among equals, the one farthest from the joint."""
    k, sign = way
    reach = [max(sign * shape.low[k], sign * shape.high[k]) for shape in shapes]
    first = [s for s, r in zip(shapes, reach, strict=True) if r > max(reach) - SAME_M]
    anchor = np.array(joint.pos)
    # Rounded, so that mirrored shapes are equal and the first is returned.
    return max(first, key=lambda s: round(float(np.linalg.norm((s.low + s.high) / 2 - anchor)), 6))


def _in_front(shapes: list[_Shape], joint: JointSpec, way: tuple[int, float]) -> list[_Shape]:
    """Return the shapes of the geom that reaches farthest; none if it is no small one."""
    geom = _farthest(shapes, joint, way).geom
    found = [shape for shape in shapes if shape.geom == geom]
    across = [k for k in range(3) if k != way[0]]
    seen, whole = (float(np.prod(_around(group)[1][across])) for group in (found, shapes))
    return found if seen <= SMALL * whole and not _on_axis(found, joint) else []


def _on_axis(shapes: list[_Shape], joint: JointSpec) -> bool:
    """Return whether the axis of a hinge passes through the box around shapes, as in a hub.

    The point of the axis that is nearest to the center of the box decides.
    """
    if joint.type != "revolute":
        return False
    center, half = _around(shapes)
    arm, axis = center - np.array(joint.pos), np.array(joint.axis)
    return bool(np.all(np.abs(arm - (arm @ axis) * axis) <= half))


def _solid(
    shapes: list[_Shape], joint: JointSpec, way: tuple[int, float] | None
) -> tuple[NDArray, NDArray]:
    """Return the box around shapes, or around one of them if the box's center is in none."""
    center, half = _around(shapes)
    if way is None or any(np.all((s.low <= center) & (center <= s.high)) for s in shapes):
        return center, half
    farthest = _farthest(shapes, joint, way)
    geom = [shape for shape in shapes if shape.geom == farthest.geom]
    return _around([farthest]) if len(geom) == len(shapes) else _solid(geom, joint, way)


def _leading_side(joint: JointSpec, center: NDArray, half: NDArray) -> tuple[NDArray, NDArray]:
    """Return the center and the half edge lengths of the side by which a part is moved [m].

    The box around the part is given by its center and its half edge lengths.
    """
    if joint.type == "continuous":
        return center, half
    best, side = -np.inf, (0, 1.0)
    for k in range(3):
        for sign in (1.0, -1.0):
            face = center.copy()
            face[k] += sign * half[k]
            if joint.type == "prismatic":
                reach = sign * joint.axis[k]
            else:
                arm = face - np.array(joint.pos)
                along = np.array(joint.axis) if joint.type == "revolute" else np.zeros(3)
                reach = float(np.linalg.norm(arm - (arm @ along) * along))
            if reach > best + 1e-9:
                best, side = reach, (k, sign)
    k, sign = side
    middle, edges = center.copy(), half.copy()
    middle[k] += sign * half[k]
    edges[k] = 0.0
    return middle, edges


def _triple(values: NDArray) -> tuple[float, float, float]:
    x, y, z = (round(float(v), 9) + 0.0 for v in values)
    return x, y, z
