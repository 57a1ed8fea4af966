"""Parts of a program's object, the shapes placed on them, and the joints between them.

Type aliases of the SDK's arguments.

Shapes of programs, poses and bounding boxes of shapes, and named points of bounding boxes.
"""

from collections.abc import Sequence
from typing import Any, Literal, no_type_check

import numpy as np
from numpy.typing import NDArray

from .. import spec as S
from ..errors import choices
from ..spec.convex import box_around
from ..spec.pose import IDENTITY, Pose, from_rpy, pose, triple
from . import session as validate
from .session import current, current_line

Vec3 = tuple[float, float, float] | list[float]
Point2 = tuple[float, float] | list[float]
Face = Literal["+x", "-x", "+y", "-y", "+z", "-z"]

Bounds = tuple[NDArray, NDArray]
"""Lowest and highest corner of a bounding box [m], each of shape [3]."""

_SIDES = {
    "front": (0, 1),
    "back": (0, -1),
    "left": (1, 1),
    "right": (1, -1),
    "top": (2, 1),
    "bottom": (2, -1),
    **{f"{sign}{axis}": (k, int(sign + "1")) for k, axis in enumerate("xyz") for sign in "+-"},
}

_DIRECTIONS = {**_SIDES, "up": _SIDES["top"], "down": _SIDES["bottom"]}


@no_type_check
class Shape:
    """A solid that can be added to a part."""

    __slots__ = ("_pose", "_spec")

    def __init__(self, spec: Any, origin: Pose | None = None) -> None:
        self._spec: S.Shape = spec
        self._pose = pose() if origin is None else origin

    def __repr__(self) -> str:
        return repr(self._spec)

    @property
    def size(self) -> tuple[float, float, float]:
        """Edge lengths [m] of the axis-aligned bounding box, after rotations by `moved`."""
        low, high = bounds_of(self, pose())
        return triple(high - low)

    @property
    def volume(self) -> float:
        """Volume of the solid [m^3]."""
        return self._spec.volume()

    def distance(self, point: Vec3) -> float:
        """Return the signed distance from the shape's surface to a point [m], negative inside."""
        local = self._pose.inverse().apply(validate.vector(point, "distance: point"))
        return float(self._spec.signed_distance(local)[0])

    def moved(
        self, at: Vec3 = (0.0, 0.0, 0.0), rpy: Vec3 = (0.0, 0.0, 0.0), *, by: str = ""
    ) -> "Shape":
        """Return a copy of the shape, rotated by `rpy` and placed at `at` as by `Part.add`."""
        return Shape(self._spec, placed(self, at, rpy, by, "moved"))


@no_type_check
def placed(shape: Shape, at: Sequence[float], rpy: Sequence[float], by: str, context: str) -> Pose:
    """Return the pose that puts a shape's origin or anchor at a point.

    Args:
        shape: the shape.
        at: the point in the object's frame [m], shape [3].
        rpy: fixed-axis roll, pitch and yaw [rad], shape [3].
        by: anchor of the rotated shape's bounding box; if empty, the shape's origin lies at the
            point.
        context: name of the call, for messages.
    """
    position = np.array(validate.vector(at, f"{context}: at"))
    rotation = from_rpy(*validate.rotation(rpy, f"{context}: rpy"))
    if by:
        bounds = bounds_of(shape, pose((0, 0, 0), rotation))
        position = position - anchor_of(bounds, by, f"{context}: by")
    origin, local = pose(position, rotation), shape._pose
    if tuple(local.quat.tolist()) == IDENTITY and not local.pos.any():
        return origin
    return origin.then(local)


def bounds_of(shape: Shape, at: Pose) -> Bounds:
    """Return the bounding box of a shape at a pose."""
    return bounds_at(shape._spec, at.then(shape._pose))


def bounds_at(spec: S.Shape, at: Pose) -> Bounds:
    """Return the bounding box of a shape's spec at a pose."""
    return enclosing(
        [box_around(piece, at.then(pose(piece.pos, piece.quat))) for piece in spec.pieces()]
    )


def enclosing(boxes: Sequence[Bounds]) -> Bounds:
    """Return the smallest bounding box that contains all given bounding boxes."""
    return np.min([low for low, _ in boxes], axis=0), np.max([high for _, high in boxes], axis=0)


def anchor_of(bounds: Bounds, where: Any, argument: str) -> NDArray:
    """Return a named point of a bounding box [m], shape [3].

    Examples of names are "top", "left.front", "-x.bottom" and "centre". Along each axis that the
    name does not mention, the point lies in the middle.
    """
    if not isinstance(where, str):
        raise TypeError(
            f"{argument} must be a string such as 'top', got {validate.formatted(where)}"
        )
    low, high = bounds
    point = (low + high) / 2
    for axis, sign in _named(validate.text(where, argument).split("."), argument).items():
        point[axis] = high[axis] if sign > 0 else low[axis]
    return point


def _named(words: list[str], argument: str) -> dict[int, int]:
    """Return the sign of each axis that the words of an anchor mention, by axis index."""
    signs: dict[int, int] = {}
    for word in words:
        if word == "centre":
            continue
        if word not in _SIDES:
            raise ValueError(
                f"{argument} takes {', '.join(_SIDES)} or centre, joined by dots as in "
                f"'left.bottom', or 'left.hinge'; got {validate.formatted('.'.join(words))}"
            )
        axis, sign = _SIDES[word]
        if axis in signs:
            raise ValueError(
                f"{argument} {validate.formatted('.'.join(words))} names one direction twice"
            )
        signs[axis] = sign
    return signs


def is_hinge(where: Any) -> bool:
    """Return True if an anchor names a hinge line, such as "left.hinge"."""
    return isinstance(where, str) and "hinge" in where.split(".")


def hinge_of(
    bounds: Bounds, others: Bounds | None, where: str, argument: str
) -> tuple[NDArray, NDArray]:
    """Return the hinge line at an edge of a flat part, such as a door or a lid.

    The line runs along the named edge, on the face towards the other parts.

    Args:
        bounds: bounding box of the flat part, whose shortest edge is the thickness.
        others: bounding box of the parts that the flat part is attached to and opens away from. If
            None, the flat part opens to the front, to the left or upwards.
        where: anchor such as "left.hinge".
        argument: name of the argument that contains the anchor, for messages.

    Returns:
        The center of the edge [m], shape [3], and the axis about which positive angles open the
        part, shape [3].
    """
    words = [word for word in validate.text(where, argument).split(".") if word != "hinge"]
    edges = _named(words, argument)
    low, high = bounds
    thin = int(np.argmin(high - low))
    if len(edges) != 1 or thin in edges:
        raise ValueError(
            f"{argument} names one edge of a flat part, such as 'left.hinge'; this part is "
            f"thinnest from {('back to front', 'right to left', 'bottom to top')[thin]}, "
            f"got {validate.formatted(where)}"
        )
    middle = (low + high) / 2
    outward = 1
    if others is not None and middle[thin] < (others[0][thin] + others[1][thin]) / 2:
        outward = -1
    ((edge, side),) = edges.items()
    point = middle.copy()
    point[edge] = high[edge] if side > 0 else low[edge]
    point[thin] = low[thin] if outward > 0 else high[thin]
    # Positive angles move the edge opposite to the named edge outwards.
    axis = np.cross(-side * np.eye(3)[edge], outward * np.eye(3)[thin])
    return point, axis + 0.0


def direction(value: Any, argument: str) -> tuple[float, float, float]:
    """Return a direction, given as three numbers or as a word such as "front", "up" or "-y"."""
    if not isinstance(value, str):
        return validate.vector(value, argument)
    if value not in _DIRECTIONS:
        raise ValueError(
            f"{argument} must be (x, y, z) or one of {', '.join(_DIRECTIONS)}, "
            f"got {validate.formatted(value)}"
        )
    axis, sign = _DIRECTIONS[value]
    return triple(sign * np.eye(3)[axis] + 0.0)


@no_type_check
class Geom:
    """A shape placed on a part."""

    name: str

    def __init__(self, spec: S.GeomSpec, bounds: Bounds, line: int | None) -> None:
        self._spec, self._bounds, self._line = spec, bounds, line
        self.name = spec.name

    def anchor(self, where: str) -> tuple[float, float, float]:
        """Return a named point of the placed shape's bounding box, such as "left.front" [m]."""
        return triple(anchor_of(self._bounds, where, f"anchor of {self.name}"))


@no_type_check
class Part:
    """A rigid link, created by `Object.part`."""

    name: str

    def __init__(self, owner: Any, name: str, material: str | None):
        self._owner, self._material = owner, material
        self._mass: float | None = None
        self._geoms: list[Geom] = []
        self._named: set[str] = set()
        self._line = current_line()
        self.name = name

    def add(
        self,
        shape: Shape,
        at: Vec3 = (0.0, 0.0, 0.0),
        rpy: Vec3 = (0.0, 0.0, 0.0),
        *,
        by: str = "",
        material: str | None = None,
        rgb: Vec3 | None = None,
        role: Literal["both", "visual", "collision"] = "both",
        name: str | None = None,
    ) -> Geom:
        """Place a shape on the part.

        Args:
            shape: a result of `box`, `cylinder`, `lathe` and the like.
            at: position of the shape's origin in the object's frame [m].
            rpy: fixed-axis roll, pitch, yaw [rad], applied about the shape's origin first.
            by: anchor of the rotated shape's bounding box, such as "bottom" or "back.top". The
                anchor is placed at `at` instead of the shape's origin.
            material: name of a material; by default the part's material.
            rgb: red, green and blue from 0 to 1, which replace the material's color.
            role: "both", "visual" (without mass and collisions) or "collision" (invisible).
            name: name that is unique in the part; by default a numbered name. If another part has a
                shape with this name, the part's name is prepended.
        """
        context = f"part {self.name!r}, add"
        if not isinstance(shape, Shape):
            raise TypeError(
                f"{context}: needs a shape such as box(...), got {validate.formatted(shape)}"
            )
        label = self._geom_name(name, context)
        pose = placed(shape, at, rpy, by, context)
        if role not in ("both", "visual", "collision"):
            valid = choices(validate.formatted(role), ("both", "visual", "collision"))
            raise ValueError(f"{context}: role: {valid}")
        spec = validate.build_spec(
            S.GeomSpec,
            f"{context} {label!r}",
            name=label,
            shape=shape._spec,
            pos=tuple(pose.pos.tolist()),
            quat=tuple(pose.quat.tolist()),
            material=self._owner._shade(material or self._material, rgb, context),
            role=role,
        )
        session = current()
        session.use("geoms", 1, session.max_geoms)
        session.use("convex pieces", len(shape._spec.pieces()), session.max_pieces)
        geom = Geom(spec, bounds_at(shape._spec, pose), current_line())
        self._geoms.append(geom)
        return geom

    def anchor(self, where: str) -> tuple[float, float, float]:
        """Return a named point of the bounding box of the shapes that the part has so far [m].

        "left.hinge" is the point about which a flat part turns if it is hinged at the left edge.
        The point lies on this edge, on the face towards the object's other parts.
        """
        argument = f"anchor of part {self.name!r}"
        if is_hinge(where):
            others = [part for part in self._owner._parts if part is not self and part._geoms]
            return triple(hinge_of(self._extent(), extent_of(others), where, argument)[0])
        return triple(anchor_of(self._extent(), where, argument))

    def set_mass(self, mass: float) -> None:
        """Set the part's mass [kg], which replaces the mass from volume and density."""
        if validate.number(mass, f"part {self.name!r}: mass") <= 0:
            raise ValueError(f"part {self.name!r}: mass must be positive, got {mass!r}")
        self._mass = float(mass)

    def _extent(self) -> Bounds:
        extent = extent_of([self])
        if extent is None:
            raise ValueError(f"part {self.name!r} has no shapes yet, so it has no anchors")
        return extent

    def _geom_name(self, wanted: str | None, context: str) -> str:
        """Return the wanted name, or a similar name if another shape of the object has it."""
        used = self._owner._geom_names
        if wanted is not None:
            if validate.name(wanted, f"{context}: name") in self._named:
                raise ValueError(
                    f"{context}: the name {wanted!r} is taken by another shape of the part"
                )
            self._named.add(wanted)
            if wanted.lower() not in used:
                used.add(wanted.lower())
                return wanted
            # A program that makes parts in a loop may name a shape "knob" in each of them.
            wanted = f"{self.name[:20]}_{wanted[:20]}"
        label, count = wanted, len(self._geoms)
        while label is None or label.lower() in used:
            label = f"{(wanted or self.name)[:40]}_{count}"
            count += 1
        used.add(label.lower())
        return label


def extent_of(parts: Sequence[Part]) -> Bounds | None:
    """Return the bounding box of all shapes that the parts have so far, or None without shapes."""
    boxes = [geom._bounds for part in parts for geom in part._geoms]
    return enclosing(boxes) if boxes else None


@no_type_check
class Joint:
    """A joint between two parts, created by `Object.revolute` and similar methods."""

    name: str

    def __init__(self, fields: dict[str, Any], line: int | None) -> None:
        self._fields, self._line = fields, line
        self.name = fields["name"]

    def set_dynamics(
        self,
        *,
        damping: float | None = None,
        friction: float | None = None,
        stiffness: float | None = None,
        effort: float | None = None,
        velocity: float | None = None,
    ) -> None:
        """Set losses, stiffness and drive limits of the joint; omitted values remain unchanged.

        Args:
            damping: damping [N m s/rad, or N s/m for a prismatic joint].
            friction: dry friction [N m or N].
            stiffness: stiffness of a spring that pulls the joint to 0 [N m/rad or N/m].
            effort: largest torque or force of a drive [N m or N].
            velocity: largest speed [rad/s or m/s].
        """
        values = {k: v for k, v in locals().items() if k != "self" and v is not None}
        context = f"joint {self.name!r}"
        numbers = {k: validate.number(v, f"{context}: {k}") for k, v in values.items()}
        validate.build_spec(S.JointSpec, context, **{**self._fields, **numbers})
        self._fields |= numbers
