"""The objects behind the SDK: an object under construction, its parts, placed shapes and joints."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from .. import spec as S
from ..errors import choices
from ..spec.pose import from_rpy, pose
from . import arguments as take
from .materials import MATERIALS
from .placing import Bounds, Shape, anchor_of, bounds_of
from .session import current, here

MAX_ANGLE_RAD = 200.0


class Geom:
    """A shape in its place on a part."""

    def __init__(self, spec: S.Geom, bounds: Bounds, line: int | None) -> None:
        self._spec, self._bounds, self._line = spec, bounds, line
        self.name = spec.name

    def anchor(self, where: str) -> tuple[float, float, float]:
        """Return a named point of the shape's bounding box, as placed: "top", "left.front"."""
        x, y, z = anchor_of(self._bounds, where, f"anchor of {self.name}").tolist()
        return x, y, z


class Part:
    """A rigid link; made by `Object.part`."""

    def __init__(self, owner: "Object", name: str, material: str | None, mass: float | None):
        self._owner, self._material, self._mass = owner, material, mass
        self._geoms: list[Geom] = []
        self._line = here()
        self.name = name

    def add(
        self,
        shape: Shape,
        at: Sequence[float] = (0.0, 0.0, 0.0),
        rpy: Sequence[float] = (0.0, 0.0, 0.0),
        *,
        by: str = "",
        material: str | None = None,
        rgb: Sequence[float] | None = None,
        role: str = "both",
        name: str | None = None,
    ) -> Geom:
        """Place a shape on the part.

        Args:
            shape: what `box`, `cylinder`, `lathe` and the like returned.
            at: where the shape's origin goes, in the object's frame [m].
            rpy: fixed-axis roll, pitch, yaw [rad], applied about the shape's origin first.
            by: an anchor of the turned shape's bounding box that goes to `at` instead of its
                origin, such as "bottom" or "back.top".
            material: name of a material; the part's own by default.
            rgb: colour in 0 to 1 that overrides the material's.
            role: "both", or "visual" (seen only, no mass), or "collision".
            name: unique in the object; numbered by default.
        """
        what = f"part {self.name!r}, add"
        if not isinstance(shape, Shape):
            raise TypeError(f"{what}: needs a shape such as box(...), got {take.shown(shape)}")
        label = self._geom_name(name, what)
        where = np.array(take.vector(at, f"{what}: at"))
        turned = from_rpy(*take.vector(rpy, f"{what}: rpy", MAX_ANGLE_RAD))
        bounds = bounds_of(shape, pose((0, 0, 0), turned))
        if by:
            where = where - anchor_of(bounds, by, f"{what}: by")
        if role not in ("both", "visual", "collision"):
            given = choices(take.shown(role), ("both", "visual", "collision"))
            raise ValueError(f"{what}: role: {given}")
        spec = take.described(
            S.Geom,
            f"{what} {label!r}",
            name=label,
            shape=shape._spec,
            pos=tuple(where.tolist()),
            quat=tuple(turned.tolist()),
            material=self._owner._shade(material or self._material, rgb, what),
            role=role,
        )
        account = current()
        account.use("geoms", 1, account.max_geoms)
        account.use("convex pieces", len(shape._spec.pieces()), account.max_pieces)
        geom = Geom(spec, (bounds[0] + where, bounds[1] + where), here())
        self._geoms.append(geom)
        return geom

    def anchor(self, where: str) -> tuple[float, float, float]:
        """Return a named point of the bounding box of what the part has so far."""
        if not self._geoms:
            raise ValueError(f"part {self.name!r} has no shapes yet, so it has no anchors")
        low = np.min([geom._bounds[0] for geom in self._geoms], axis=0)
        high = np.max([geom._bounds[1] for geom in self._geoms], axis=0)
        x, y, z = anchor_of((low, high), where, f"anchor of part {self.name!r}").tolist()
        return x, y, z

    def _geom_name(self, given: str | None, what: str) -> str:
        taken = self._owner._geom_names
        if given is None:
            count = len(self._geoms)
            while (given := f"{self.name[:40]}_{count}") in taken:
                count += 1
        elif take.name(given, f"{what}: name") in taken:
            raise ValueError(f"{what}: the name {given!r} is taken by another shape")
        taken.add(given)
        return given


class Joint:
    """A joint between two parts; made by `Object.revolute` and its like."""

    def __init__(self, fields: dict[str, Any], line: int | None) -> None:
        self._fields, self._line = fields, line
        self.name: str = fields["name"]


class Object:
    """The object that a program makes; exactly one a program.

    Args:
        name: an identifier, such as "cup".
        label: what it is, in words.
    """

    def __init__(self, name: str, label: str = "") -> None:
        self.name = take.name(name, "Object name")
        self.label = take.text(label, "Object label")
        self._parts: list[Part] = []
        self._joints: list[Joint] = []
        self._sites: list[S.Site] = []
        self._materials: dict[str, S.Material] = {}
        self._geom_names: set[str] = set()
        current().objects.append(self)

    def material(
        self,
        name: str,
        like: str | None = None,
        *,
        density: float | None = None,
        friction: float | None = None,
        rgb: Sequence[float] | None = None,
        alpha: float | None = None,
    ) -> str:
        """Define a material and return its name; what is not given is taken from `like`."""
        what = f"material {take.name(name, 'material name')!r}"
        if name in self._materials:
            raise ValueError(f"{what} is defined twice")
        base = MATERIALS.get(name) if like is None else self._known_material(like, what)
        if base is None and density is None:
            raise ValueError(f"{what} needs density= or like= (a named material)")
        fields: dict[str, Any] = {"density": 1000.0, "friction": 0.45}
        fields |= {} if base is None else base.model_dump()
        fields["name"] = name
        if density is not None:
            fields["density"] = take.number(density, f"{what}: density")
        if friction is not None:
            fields["friction"] = take.number(friction, f"{what}: friction")
        r, g, b, a = fields.get("rgba", (0.7, 0.7, 0.7, 1.0))
        if rgb is not None:
            r, g, b = take.colour(rgb, f"{what}: rgb")
        a = a if alpha is None else take.number(alpha, f"{what}: alpha")
        fields["rgba"] = (r, g, b, a)
        self._materials[name] = take.described(S.Material, what, **fields)
        return name

    def part(self, name: str, material: str | None = None, mass: float | None = None) -> Part:
        """Add a rigid part.

        Args:
            name: unique in the object.
            material: of its shapes, where they name none themselves.
            mass: [kg], when it is known; else it follows from volume and density.
        """
        label = take.name(name, "part name")
        self._free(label, "part", [part.name for part in self._parts])
        if material is not None:
            self._known_material(material, f"part {label!r}")
        if mass is not None and take.number(mass, f"part {label!r}: mass") <= 0:
            raise ValueError(f"part {label!r}: mass must be positive, got {mass!r}")
        account = current()
        account.use("parts", 1, account.max_parts)
        part = Part(self, label, material, None if mass is None else float(mass))
        self._parts.append(part)
        return part

    def fixed(self, name: str, parent: Part, child: Part) -> Joint:
        """Fasten a part to another."""
        return self._join("fixed", name, parent, child, {})

    def revolute(
        self,
        name: str,
        parent: Part,
        child: Part,
        *,
        at: Sequence[float],
        axis: Sequence[float],
        range: Sequence[float],
        damping: float | None = None,
        friction: float | None = None,
        stiffness: float = 0.0,
        effort: float | None = None,
        velocity: float | None = None,
        mimic: Joint | None = None,
        multiplier: float = 1.0,
        offset: float = 0.0,
    ) -> Joint:
        """Hinge `child` to `parent` at a point, about an axis, between two angles [rad].

        Positive opens, by the right-hand rule about `axis`. The shapes are drawn at angle 0.
        Damping [N m s/rad] and friction [N m] that are not given follow from the child's inertia
        and weight. With `mimic` it follows another joint: multiplier * q + offset.
        """
        given = {k: v for k, v in locals().items() if k not in ("self", "name", "parent", "child")}
        return self._join("revolute", name, parent, child, given)

    def continuous(
        self,
        name: str,
        parent: Part,
        child: Part,
        *,
        at: Sequence[float],
        axis: Sequence[float],
        damping: float | None = None,
        friction: float | None = None,
        effort: float | None = None,
        velocity: float | None = None,
        mimic: Joint | None = None,
        multiplier: float = 1.0,
        offset: float = 0.0,
    ) -> Joint:
        """Let `child` turn without end about an axis through a point: a wheel, a knob."""
        given = {k: v for k, v in locals().items() if k not in ("self", "name", "parent", "child")}
        return self._join("continuous", name, parent, child, given)

    def prismatic(
        self,
        name: str,
        parent: Part,
        child: Part,
        *,
        axis: Sequence[float],
        range: Sequence[float],
        at: Sequence[float] | None = None,
        damping: float | None = None,
        friction: float | None = None,
        stiffness: float = 0.0,
        effort: float | None = None,
        velocity: float | None = None,
        mimic: Joint | None = None,
        multiplier: float = 1.0,
        offset: float = 0.0,
    ) -> Joint:
        """Let `child` slide along an axis between two distances [m]; positive pulls it out."""
        given = {k: v for k, v in locals().items() if k not in ("self", "name", "parent", "child")}
        return self._join("prismatic", name, parent, child, given)

    def site(self, name: str, part: Part, at: Sequence[float]) -> None:
        """Mark a point on a part, such as a grasp point or a spout."""
        label = take.name(name, "site name")
        self._free(label, "site", [site.name for site in self._sites])
        self._own(part, f"site {label!r}: part")
        account = current()
        account.use("sites", 1, account.max_geoms)
        where = take.vector(at, f"site {label!r}: at")
        self._sites.append(S.Site(name=label, part=part.name, pos=where))

    def _join(
        self, kind: str, name: str, parent: Part, child: Part, given: dict[str, Any]
    ) -> Joint:
        what = f"joint {take.name(name, 'joint name')!r}"
        self._free(name, "joint", [joint.name for joint in self._joints])
        self._own(parent, f"{what}: parent")
        self._own(child, f"{what}: child")
        if parent is child:
            raise ValueError(f"{what}: parent and child are both {parent.name!r}")
        other = next((j for j in self._joints if j._fields["child"] == child.name), None)
        if other is not None:
            raise ValueError(
                f"{what}: part {child.name!r} hangs on joint {other.name!r} already; "
                f"a part has one parent"
            )
        fields: dict[str, Any] = {"name": name, "type": kind}
        fields |= {"parent": parent.name, "child": child.name}
        if given.get("at") is not None:
            fields["pos"] = take.vector(given["at"], f"{what}: at")
        if "axis" in given:
            fields["axis"] = take.vector(given["axis"], f"{what}: axis")
        if "range" in given:
            lower, upper = take.sequence(given["range"], f"{what}: range", 2, 2)
            fields["lower"] = take.number(lower, f"{what}: range", MAX_ANGLE_RAD)
            fields["upper"] = take.number(upper, f"{what}: range", MAX_ANGLE_RAD)
        for key in ("damping", "friction", "stiffness", "effort", "velocity"):
            if given.get(key) is not None:
                fields[key] = take.number(given[key], f"{what}: {key}")
        leader = given.get("mimic")
        if leader is not None:
            if not isinstance(leader, Joint) or leader not in self._joints:
                raise TypeError(f"{what}: mimic must be a joint of this object, made before")
            fields["mimic"] = S.Mimic(
                joint=leader.name,
                multiplier=take.number(given["multiplier"], f"{what}: multiplier"),
                offset=take.number(given["offset"], f"{what}: offset"),
            )
        take.described(S.Joint, what, **fields)
        joint = Joint(fields, here())
        self._joints.append(joint)
        return joint

    def _known_material(self, name: Any, what: str) -> S.Material:
        label = take.name(name, f"{what}: material")
        found = self._materials.get(label) or MATERIALS.get(label)
        if found is None:
            known = sorted({*self._materials, *MATERIALS})
            raise ValueError(f"{what}: material: {choices(label, known)}")
        return found

    def _shade(self, name: str | None, rgb: Sequence[float] | None, what: str) -> str:
        if name is None:
            raise ValueError(f"{what}: needs material=, as the part has none of its own")
        base = self._known_material(name, what)
        if rgb is not None:
            r, g, b = take.colour(rgb, f"{what}: rgb")
            tint = "".join(f"{round(255 * v):02x}" for v in (r, g, b))
            shaded = f"{base.name[:40]}_{tint}"
            base = base.model_copy(update={"name": shaded, "rgba": (r, g, b, base.rgba[3])})
        self._materials.setdefault(base.name, base)
        return base.name

    def _own(self, part: Any, what: str) -> None:
        if not isinstance(part, Part):
            raise TypeError(
                f"{what} must be a part made by {self.name}.part(...), got {take.shown(part)}"
            )
        if part._owner is not self:
            raise ValueError(f"{what} {part.name!r} belongs to another object")

    def _free(self, name: str, kind: str, taken: list[str]) -> None:
        if name in taken:
            raise ValueError(f"{kind} {name!r} exists already")


__all__ = ["Geom", "Joint", "Object", "Part"]
