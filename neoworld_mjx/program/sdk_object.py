"""The object that a program creates, with materials, parts, sites and allowed overlaps.

Doors, drawers and shelves, with the clearances that let them move.
"""

from collections.abc import Sequence
from typing import Any, Literal, no_type_check

from .. import spec as S
from ..checks.signals import Allowance
from ..errors import choices
from ..spec.finish import finish
from . import session as validate
from .object_joints import After, ObjectJoints
from .part import Geom, Joint, Part, Point2, Vec3
from .session import current
from .shape_functions import box, hollow_box
from .supports import MATERIALS, inherited_finish, stated_finish

_HINGES = {
    "left": ("left.back", (0, 0, 1), 1.57),
    "right": ("right.back", (0, 0, -1), 1.57),
    "bottom": ("bottom.back", (0, 1, 0), 1.5),
    "top": ("top.back", (0, -1, 0), 1.5),
}
"""Anchor, axis and default opening angle [rad] of a door's hinge, by the hinged edge.

At a larger angle, the door would penetrate the frame next to the hinge.
"""
DOOR_GAP_M = 0.0005
"""Gap between a door and the front that the door covers [m]."""
TRAY_GAP_M = 0.0005
"""Gap under a drawer's tray [m]."""
TRAVEL = 0.75
"""Default travel of a drawer, as a fraction of the tray's depth."""


@no_type_check
class Furniture(ObjectJoints):
    """Methods of `Object` that add doors, drawers and shelves."""

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
        """Hang a flat door or flap in front of the plane at x, and return its part.

        Args:
            name: name of the part. The joint is named <name>_hinge.
            parent: part that the door hangs on.
            x: position of the front's plane [m]; the door hangs on the +x side of the plane.
            y: (low, high) of the covered area [m].
            z: (low, high) of the covered area [m].
            hinge: hinged edge: "left" (+y), "right" (-y), "top" or "bottom".
            thickness: thickness along x [m].
            gap: clearance at all four edges [m].
            opens: angle of the fully open door [rad]; by default 1.57 for the left and right edge,
                and 1.5 for the top and bottom edge.
            after: parts or joints that must be open first, as for `revolute`.
            material: name of a material; by default the parent's material.
        """
        self._check_part(parent, "door: parent")
        context = f"door {validate.name(name, 'door name')!r}"
        (left, width), (low, height) = _span(y, f"{context}: y"), _span(z, f"{context}: z")
        if hinge not in _HINGES:
            raise ValueError(
                f"{context}: hinge is one of {', '.join(_HINGES)}, got {validate.formatted(hinge)}"
            )
        edge = validate.number(gap, f"{context}: gap", 1.0)
        size = (
            validate.length(thickness, f"{context}: thickness"),
            validate.length(width - 2 * edge, f"{context}: width inside the gap"),
            validate.length(height - 2 * edge, f"{context}: height inside the gap"),
        )
        front = validate.number(x, f"{context}: x", validate.MAX_COORDINATE_M)
        part = self.part(name, material=material or parent._material)
        at = (front + DOOR_GAP_M, left + width / 2, low + height / 2)
        panel = part.add(box(size), at=at, by="back", name=f"{name[:40]}_panel")
        anchor, axis, angle = _HINGES[hinge]
        if opens is not None:
            angle = validate.number(opens, f"{context}: opens", 7.0)
        self.revolute(
            f"{name[:40]}_hinge",
            parent,
            part,
            at=panel.anchor(anchor),
            axis=axis,
            range=(0.0, angle),
            after=after,
            opens="front",
        )
        return part

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
        """Put a drawer into an opening, and return its part.

        The tray lies behind the plane at x, and the front panel lies in front of the plane.

        Args:
            name: name of the part. The joint is named <name>_slide.
            parent: part that the drawer slides in.
            x: position of the plane of the opening [m].
            y: (low, high) of the opening inside its frame [m].
            z: (low, high) of the opening [m]; the tray slides just above the lower bound.
            depth: depth of the tray, backwards from x [m].
            wall: thickness of the tray's walls [m].
            front: thickness of the front panel [m].
            overlay: width of the strip of the frame that the front panel covers on all sides [m].
                If 0, the front panel has the width and height of the tray.
            gap: clearance at the sides and above the tray [m].
            travel: distance that the drawer opens [m]; by default three quarters of `depth`.
            after: parts or joints that must be open first, as for `revolute`.
            material: name of a material; by default the parent's material.
        """
        self._check_part(parent, "drawer: parent")
        context = f"drawer {validate.name(name, 'drawer name')!r}"
        (left, width), (low, height) = _span(y, f"{context}: y"), _span(z, f"{context}: z")
        side = validate.number(gap, f"{context}: gap", 1.0)
        length = validate.length(depth, f"{context}: depth")
        edge = validate.number(x, f"{context}: x", validate.MAX_COORDINATE_M)
        lap = validate.number(overlay, f"{context}: overlay", 1.0)
        thickness = validate.length(front, f"{context}: front")
        part = self.part(name, material=material or parent._material)
        tray = (
            length,
            validate.length(width - 2 * side, f"{context}: width inside the gap"),
            validate.length(height - side - TRAY_GAP_M, f"{context}: height inside the gap"),
        )
        middle, floor = left + width / 2, low + TRAY_GAP_M
        shape = hollow_box(tray, validate.length(wall, f"{context}: wall"), open="+z")
        part.add(shape, at=(edge, middle, floor), by="front.bottom", name=f"{name[:40]}_tray")
        # Without an overlay, the front panel has the width and height of the tray.
        inset = side if lap <= 0 else -lap
        face = (
            thickness,
            validate.length(width - 2 * inset, f"{context}: front"),
            validate.length(height - 2 * inset if lap > 0 else tray[2], f"{context}: front"),
        )
        at = (edge, middle, low - lap if lap > 0 else floor)
        part.add(box(face), at=at, by="back.bottom", name=f"{name[:40]}_front")
        distance = TRAVEL * length
        if travel is not None:
            distance = validate.length(travel, f"{context}: travel")
        self.prismatic(
            f"{name[:40]}_slide",
            parent,
            part,
            axis=(1, 0, 0),
            range=(0.0, distance),
            after=after,
            opens="front",
        )
        return part

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
        """Add a level board to a part; the board spans `x` and `y`, and `z` is its top [m]."""
        self._check_part(parent, "shelf: parent")
        (back, depth), (right, width) = _span(x, "shelf: x"), _span(y, "shelf: y")
        top = validate.number(z, "shelf: z", validate.MAX_COORDINATE_M)
        board = box((depth, width, validate.length(thickness, "shelf: thickness")))
        at = (back + depth / 2, right + width / 2, top)
        return parent.add(board, at=at, by="top", material=material, name=name)


def _span(value: Any, argument: str) -> tuple[float, float]:
    """Validate (low, high) [m], and return low and high - low."""
    low, high = validate.pair(value, argument)
    if high <= low:
        raise ValueError(f"{argument} must be (low, high), got {validate.formatted(value)}")
    return low, high - low


MAX_ALLOWED_M, MIN_REASON = 0.005, 10


@no_type_check
class Object(Furniture):
    """The object of a program, which must create exactly one.

    Args:
        name: an identifier, such as "cup".
        label: the kind of object, in words.
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
        """Define a material, and return its name.

        Omitted properties are copied from the material `like`. If `like` is None, they are copied
        from the named material `name`, if it exists.

        Args:
            name: name of the material.
            like: name of a named material or of a material that the program defined before.
            density: density [kg/m^3].
            friction: coefficient of sliding friction.
            rgb: red, green and blue, each from 0 to 1.
            alpha: opacity from 0 to 1.
            pattern: "plain", "grain", "boards", "tiles", "bricks", "veins", "speckles", "weave",
                "brushed" or "checker"; by default that of the substance in the name, if it has one.
            rgb2: color of the pattern's joints, veins, speckles, gaps or other fields.
            step: scale of the pattern [m]: the width of a board, the edge of a tile, the height of
                a brick, the spacing of veins, and so on.
            along: axis of a face along which boards run: the first ("x") or the second ("y").
            metallic: from 0 to 1; by default the value of the substance in the name, such as
                "steel".
            roughness: from 0 (a mirror) to 1; by default the value of the substance in the name.
        """
        context = f"material {validate.name(name, 'material name')!r}"
        if name.lower() in map(str.lower, self._materials):
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
        if pattern is None and (rgb2 is not None or step is not None):
            usual = finish(validate.build_spec(S.Material, context, **fields)).pattern
            pattern = None if usual is None else usual.kind
        fields |= stated_finish(pattern, rgb2, step, along, metallic, roughness, context)
        self._materials[name] = validate.build_spec(S.Material, context, **fields)
        return name

    def part(self, name: str, material: str | None = None, mass: float | None = None) -> Part:
        """Add a rigid part, and return it.

        Args:
            name: name that is unique among the object's parts.
            material: default material of the part's shapes.
            mass: mass [kg]; by default the mass follows from volume and density.
        """
        label = validate.name(name, "part name")
        validate.unused(label, "part", [part.name for part in self._parts])
        if material is not None:
            self._known_material(material, f"part {label!r}")
        part = Part(self, label, material)
        if mass is not None:
            part.set_mass(mass)
        session = current()
        session.use("parts", 1, session.max_parts)
        self._parts.append(part)
        return part

    def site(self, name: str, part: Part, at: Vec3) -> None:
        """Mark a point on a part, such as a grasp point or a spout."""
        label = validate.name(name, "site name")
        validate.unused(label, "site", [site.name for site in self._sites])
        self._check_part(part, f"site {label!r}: part")
        session = current()
        session.use("sites", 1, session.max_geoms)
        position = validate.vector(at, f"site {label!r}: at")
        self._sites.append(S.Site(name=label, part=part.name, pos=position))

    def allow_overlap(self, first: Part, second: Part, depth: float, reason: str) -> None:
        """Allow two parts to overlap by up to `depth` [m], for a stated reason.

        `depth` may be at most 0.005 m.
        """
        self._check_part(first, "allow_overlap: first")
        self._check_part(second, "allow_overlap: second")
        depth = validate.length(depth, "allow_overlap: depth")
        reason = validate.text(reason, "allow_overlap: reason")
        if depth > MAX_ALLOWED_M or len(reason) < MIN_REASON:
            raise ValueError(
                f"allow_overlap takes a depth up to {MAX_ALLOWED_M} m and a reason of "
                f"{MIN_REASON} letters and more"
            )
        session = current()
        session.use("allowances", 1, session.max_parts)
        self._allowances.append(Allowance(first.name, second.name, depth, reason))

    def _known_material(self, name: Any, context: str) -> S.Material:
        label = validate.name(name, f"{context}: material")
        material = self._materials.get(label) or MATERIALS.get(label)
        if material is None:
            known = sorted({*self._materials, *MATERIALS})
            raise ValueError(f"{context}: material: {choices(label, known)}")
        return material

    def _shade(self, name: str | None, rgb: Sequence[float] | None, context: str) -> str:
        """Define a material on first use, recolored if `rgb` is not None, and return its name."""
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
