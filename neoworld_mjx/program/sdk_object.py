"""The object that a program makes: its materials, parts, joints and sites."""

from collections.abc import Sequence
from typing import Any, Literal, no_type_check

from .. import spec as S
from ..checks.allowance import Allowance
from ..errors import choices
from . import validate
from .finishing import inherited_finish, stated_finish
from .furniture import add_door, add_drawer, add_shelf
from .joining import joint_fields
from .materials import MATERIALS
from .part import Geom, Joint, Part
from .sdk_types import Point2, Vec3
from .session import current, here

MAX_ALLOWED_M, MIN_REASON = 0.005, 10
After = Part | Joint | Sequence[Part | Joint] | None
"""Parts or joints that must be open before a joint moves."""


@no_type_check
class Object:
    """The object that a program makes; a program makes exactly one.

    Args:
        name: an identifier, such as "cup".
        label: what it is, in words.
    """

    name: str
    label: str

    def __init__(self, name: str, label: str = "") -> None:
        self.name = validate.name(name, "Object name")
        self.label = validate.text(label, "Object label")
        self._parts: list[Part] = []
        self._joints: list[Joint] = []
        self._sites: list[S.Site] = []
        self._allowances: list[Allowance] = []
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
        rgb: Vec3 | None = None,
        alpha: float | None = None,
        pattern: str | None = None,
        rgb2: Vec3 | None = None,
        step: float | None = None,
        along: Literal["x", "y"] = "x",
        metallic: float | None = None,
        roughness: float | None = None,
    ) -> str:
        """Define a material and return its name; what is not given is taken from `like`.

        Args:
            name: of the material.
            like: a named material, or one defined before.
            density: [kg/m^3].
            friction: sliding friction coefficient.
            rgb: colour, each from 0 to 1.
            alpha: how much it hides of what is behind, from 0 to 1.
            pattern: "plain", "grain", "boards", "tiles", "bricks", "veins", "speckles", "weave" or
                "brushed".
            rgb2: colour of the pattern's joints, veins, speckles or gaps.
            step: width of a board, edge of a tile, height of a brick, distance of veins, ... [m].
            along: whether boards run along the first or the second axis of a face.
            metallic: from 0 to 1; by default what the name says ("steel").
            roughness: from 0 (a mirror) to 1; by default what the name says.
        """
        context = f"material {validate.name(name, 'material name')!r}"
        if name in self._materials:
            raise ValueError(f"{context} is defined twice")
        base = MATERIALS.get(name) if like is None else self._known_material(like, context)
        if base is None and density is None:
            raise ValueError(f"{context} needs density= or like= (a named material)")
        fields: dict[str, Any] = {"density": 1000.0, "friction": 0.45}
        fields |= {} if base is None else base.model_dump()
        fields |= {} if base is None else inherited_finish(base, name)
        fields["name"] = name
        if density is not None:
            fields["density"] = validate.number(density, f"{context}: density")
        if friction is not None:
            fields["friction"] = validate.number(friction, f"{context}: friction")
        r, g, b, a = fields.get("rgba", (0.7, 0.7, 0.7, 1.0))
        if rgb is not None:
            r, g, b = validate.colour(rgb, f"{context}: rgb")
            a = 1.0 if base is None or base == MATERIALS.get(base.name) else a
        a = a if alpha is None else validate.number(alpha, f"{context}: alpha")
        fields["rgba"] = (r, g, b, a)
        fields |= stated_finish(pattern, rgb2, step, along, metallic, roughness, context)
        self._materials[name] = validate.described(S.Material, context, **fields)
        return name

    def part(self, name: str, material: str | None = None, mass: float | None = None) -> Part:
        """Add a rigid part.

        Args:
            name: unique in the object.
            material: of its shapes, where they name none themselves.
            mass: [kg], when it is known; else it follows from volume and density.
        """
        label = validate.name(name, "part name")
        self._free(label, "part", [part.name for part in self._parts])
        if material is not None:
            self._known_material(material, f"part {label!r}")
        if mass is not None and validate.number(mass, f"part {label!r}: mass") <= 0:
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
        at: Vec3 | str,
        axis: Vec3 | str | None = None,
        range: Point2,
        damping: float | None = None,
        friction: float | None = None,
        stiffness: float = 0.0,
        effort: float | None = None,
        velocity: float | None = None,
        mimic: Joint | None = None,
        multiplier: float = 1.0,
        offset: float = 0.0,
        after: After = None,
        opens: Vec3 | str | None = None,
    ) -> Joint:
        """Hinge `child` to `parent` at a point, about an axis, between two angles [rad].

        Positive opens, by the right-hand rule about `axis`. The shapes are drawn at angle 0.
        `at` may be an anchor of the child; "left.hinge", the left edge of a flat child, says the
        axis as well: the one about which positive moves it away from its parent.
        Damping [N m s/rad] and friction [N m] that are not given follow from the child's inertia
        and weight. With `mimic` it follows another joint: multiplier * q + offset.
        `after` names what must be open first, doors or their joints: a rack's is its door. `opens`
        says which way the child's middle sets out, such as "front"; the compile checks compare it
        with the axis.
        """
        return self._join("revolute", name, parent, child, _arguments(locals()))

    def continuous(
        self,
        name: str,
        parent: Part,
        child: Part,
        *,
        at: Vec3 | str,
        axis: Vec3 | str,
        damping: float | None = None,
        friction: float | None = None,
        effort: float | None = None,
        velocity: float | None = None,
        mimic: Joint | None = None,
        multiplier: float = 1.0,
        offset: float = 0.0,
        after: After = None,
    ) -> Joint:
        """Let `child` turn without end about an axis through a point: a wheel, a knob."""
        return self._join("continuous", name, parent, child, _arguments(locals()))

    def ball(
        self,
        name: str,
        parent: Part,
        child: Part,
        *,
        at: Vec3 | str,
        swing: float | None = None,
        damping: float | None = None,
        friction: float | None = None,
        stiffness: float = 0.0,
        after: After = None,
    ) -> Joint:
        """Let `child` turn about a point in all directions, by up to `swing` [rad] from rest."""
        return self._join("ball", name, parent, child, _arguments(locals()))

    def prismatic(
        self,
        name: str,
        parent: Part,
        child: Part,
        *,
        axis: Vec3 | str,
        range: Point2,
        at: Vec3 | str | None = None,
        damping: float | None = None,
        friction: float | None = None,
        stiffness: float = 0.0,
        effort: float | None = None,
        velocity: float | None = None,
        mimic: Joint | None = None,
        multiplier: float = 1.0,
        offset: float = 0.0,
        after: After = None,
        opens: Vec3 | str | None = None,
    ) -> Joint:
        """Let `child` slide along an axis between two distances [m]; positive pulls it out."""
        return self._join("prismatic", name, parent, child, _arguments(locals()))

    def door(
        self,
        name: str,
        parent: Part,
        *,
        x: float,
        y: Point2,
        z: Point2,
        hinge: Literal["left", "right", "top", "bottom"],
        thickness: float = 0.018,
        gap: float = 0.001,
        opens: float | None = None,
        after: After = None,
        material: str | None = None,
    ) -> Part:
        """Hang a flat door, or a flap, before a front that lies in the plane x.

        Args:
            name: of the part; its joint is called <name>_hinge.
            parent: what it hangs on.
            x: the plane whose +x side it stands on.
            y: (low, high) of the area that it covers.
            z: (low, high) of the area that it covers.
            hinge: the edge it turns about: "left" (+y), "right" (-y), "top" or "bottom".
            thickness: along x.
            gap: left free at all four edges.
            opens: angle when fully open [rad]; by default 1.57 at the sides, 1.5 above and below.
            after: what must be open first, as for `revolute`.
            material: the parent's by default.
        """
        self._own(parent, "door: parent")
        return add_door(self, name, parent, **_arguments(locals()))

    def drawer(
        self,
        name: str,
        parent: Part,
        *,
        x: float,
        y: Point2,
        z: Point2,
        depth: float,
        wall: float = 0.01,
        front: float = 0.018,
        overlay: float = 0.0,
        gap: float = 0.002,
        travel: float | None = None,
        after: After = None,
        material: str | None = None,
    ) -> Part:
        """Put a drawer into an opening: a tray behind the plane x and a front before it.

        Args:
            name: of the part; its joint is called <name>_slide.
            parent: what it slides in.
            x: the plane of the opening.
            y: (low, high) of the opening inside its frame.
            z: (low, high) of the opening; the tray runs on its floor.
            depth: of the tray, back from x.
            wall: thickness of the tray's walls.
            front: thickness of the front, before x.
            overlay: how far the front laps over the frame on all sides; 0 leaves a gap instead.
            gap: left free beside and above the tray.
            travel: how far it comes out; three quarters of its depth by default.
            after: what must be open first, as for `revolute`.
            material: the parent's by default.
        """
        self._own(parent, "drawer: parent")
        return add_drawer(self, name, parent, **_arguments(locals()))

    def shelf(
        self,
        parent: Part,
        *,
        x: Point2,
        y: Point2,
        z: float,
        thickness: float = 0.018,
        material: str | None = None,
        name: str | None = None,
    ) -> Geom:
        """Add a level board to a part, from x[0] to x[1] and y[0] to y[1], its top at z."""
        self._own(parent, "shelf: parent")
        return add_shelf(parent, name=name, **_arguments(locals()))

    def site(self, name: str, part: Part, at: Vec3) -> None:
        """Mark a point on a part, such as a grasp point or a spout."""
        label = validate.name(name, "site name")
        self._free(label, "site", [site.name for site in self._sites])
        self._own(part, f"site {label!r}: part")
        account = current()
        account.use("sites", 1, account.max_geoms)
        where = validate.vector(at, f"site {label!r}: at")
        self._sites.append(S.Site(name=label, part=part.name, pos=where))

    def allow_overlap(self, first: Part, second: Part, depth: float, reason: str) -> None:
        """Declare that two parts enter each other by up to `depth` [m], at most 5 mm, and why."""
        self._own(first, "allow_overlap: first")
        self._own(second, "allow_overlap: second")
        deep = validate.length(depth, "allow_overlap: depth")
        why = validate.text(reason, "allow_overlap: reason")
        if deep > MAX_ALLOWED_M or len(why) < MIN_REASON:
            raise ValueError(
                f"allow_overlap takes a depth up to {MAX_ALLOWED_M} m and a reason of "
                f"{MIN_REASON} letters and more"
            )
        account = current()
        account.use("allowances", 1, account.max_parts)
        self._allowances.append(Allowance(first.name, second.name, deep, why))

    def _join(
        self, kind: str, name: str, parent: Part, child: Part, arguments: dict[str, Any]
    ) -> Joint:
        context = f"joint {validate.name(name, 'joint name')!r}"
        self._free(name, "joint", [joint.name for joint in self._joints])
        self._own(parent, f"{context}: parent")
        self._own(child, f"{context}: child")
        if parent is child:
            raise ValueError(f"{context}: parent and child are both {parent.name!r}")
        other = next((j for j in self._joints if j._fields["child"] == child.name), None)
        if other is not None:
            raise ValueError(
                f"{context}: part {child.name!r} hangs on joint {other.name!r} already; "
                f"a part has one parent"
            )
        leader = arguments.get("mimic")
        if leader is not None and (not isinstance(leader, Joint) or leader not in self._joints):
            raise TypeError(f"{context}: mimic must be a joint of this object, made before")
        if leader is not None and leader._fields["type"] == "ball":
            raise ValueError(f"{context}: cannot follow {leader.name!r}, a ball")
        fields = joint_fields(context, name, kind, parent, child, arguments)
        if arguments.get("after") is not None:
            fields["after"] = self._openers(arguments["after"], f"{context}: after")
        validate.described(S.JointSpec, context, **fields)
        joint = Joint(fields, here())
        self._joints.append(joint)
        return joint

    def _openers(self, value: Any, argument: str) -> tuple[str, ...]:
        """Return the names of joints, given as joints or as the parts that they move."""
        names = []
        openers = value if isinstance(value, list | tuple) else [value]
        for opener in validate.sequence(openers, argument, 1, 8):
            if isinstance(opener, Part):
                self._own(opener, argument)
                joint = next((j for j in self._joints if j._fields["child"] == opener.name), None)
            else:
                joint = opener if opener in self._joints else None
            if joint is None:
                raise ValueError(
                    f"{argument} must be a part or a joint of this object, or a list of them, "
                    f"whose joint is made before; got {validate.shown(value)}"
                )
            if joint._fields["type"] not in ("revolute", "prismatic") or "mimic" in joint._fields:
                raise ValueError(
                    f"{argument}: {joint.name!r} must be revolute or prismatic and follow no other"
                )
            names.append(joint.name)
        return tuple(dict.fromkeys(names))

    def _known_material(self, name: Any, context: str) -> S.Material:
        label = validate.name(name, f"{context}: material")
        material = self._materials.get(label) or MATERIALS.get(label)
        if material is None:
            known = sorted({*self._materials, *MATERIALS})
            raise ValueError(f"{context}: material: {choices(label, known)}")
        return material

    def _shade(self, name: str | None, rgb: Sequence[float] | None, context: str) -> str:
        if name is None:
            raise ValueError(f"{context}: needs material=, as the part has none of its own")
        base = self._known_material(name, context)
        if rgb is not None:
            r, g, b = validate.colour(rgb, f"{context}: rgb")
            tint = "".join(f"{round(255 * v):02x}" for v in (r, g, b))
            shaded = f"{base.name[:40]}_{tint}"
            base = base.model_copy(update={"name": shaded, "rgba": (r, g, b, 1.0)})
        self._materials.setdefault(base.name, base)
        return base.name

    def _own(self, part: Any, argument: str) -> None:
        if not isinstance(part, Part):
            raise TypeError(
                f"{argument} must be a part made by {self.name}.part(...), "
                f"got {validate.shown(part)}"
            )
        if part._owner is not self:
            raise ValueError(f"{argument} {part.name!r} belongs to another object")

    def _free(self, name: str, kind: str, used: list[str]) -> None:
        if name in used:
            raise ValueError(f"{kind} {name!r} exists already")


def _arguments(local: dict[str, Any]) -> dict[str, Any]:
    """Return the arguments of a call besides its object, name and parts."""
    return {k: v for k, v in local.items() if k not in ("self", "name", "parent", "child")}
