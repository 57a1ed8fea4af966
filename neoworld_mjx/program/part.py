"""Parts of a program's object, the shapes placed on them, and the joints between them."""

from collections.abc import Sequence
from typing import Any, Literal, no_type_check

from .. import spec as S
from ..errors import choices
from . import validate
from .placing import Bounds, Shape, anchor_of, bounds_at, enclosing, hinge_of, is_hinge, placed
from .sdk_types import Vec3
from .session import current, current_line


@no_type_check
class Geom:
    """A shape placed on a part."""

    name: str

    def __init__(self, spec: S.GeomSpec, bounds: Bounds, line: int | None) -> None:
        self._spec, self._bounds, self._line = spec, bounds, line
        self.name = spec.name

    def anchor(self, where: str) -> tuple[float, float, float]:
        """Return a named point of the placed shape's bounding box, such as "left.front" [m]."""
        x, y, z = anchor_of(self._bounds, where, f"anchor of {self.name}").tolist()
        return x, y, z


@no_type_check
class Part:
    """A rigid link, created by `Object.part`."""

    name: str

    def __init__(self, owner: Any, name: str, material: str | None, mass: float | None):
        self._owner, self._material, self._mass = owner, material, mass
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
            x, y, z = hinge_of(self._extent(), extent_of(others), where, argument)[0].tolist()
        else:
            x, y, z = anchor_of(self._extent(), where, argument).tolist()
        return x, y, z

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
            if wanted not in used:
                used.add(wanted)
                return wanted
            # A program that makes parts in a loop may name a shape "knob" in each of them.
            wanted = f"{self.name[:20]}_{wanted[:20]}"
        label, count = wanted, len(self._geoms)
        while label is None or label in used:
            label = f"{(wanted or self.name)[:40]}_{count}"
            count += 1
        used.add(label)
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
