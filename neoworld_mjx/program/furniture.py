"""Doors, drawers and shelves, with the clearances that let them move."""

from typing import Any, Literal, no_type_check

from . import validate
from .object_joints import After, ObjectJoints
from .part import Geom, Part
from .sdk_types import Point2
from .shape_functions import box, hollow_box

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
