"""Doors, drawers and shelves as furniture has them, with the clearances that let them move."""

from collections.abc import Sequence
from typing import Any, no_type_check

from . import validate
from .shape_functions import box, hollow_box

_HINGES = {
    "left": ("left.back", (0, 0, 1)),
    "right": ("right.back", (0, 0, -1)),
    "bottom": ("bottom.back", (0, 1, 0)),
    "top": ("top.back", (0, -1, 0)),
}
STANDS_OFF_M = 0.0005
"""Gap between a door and the front that it covers."""
LIFTS_M = 0.0005
"""Gap under a drawer's tray."""
SWING = {"left": 1.57, "right": 1.57, "bottom": 1.5, "top": 1.5}
"""Opening angle of a door [rad]; beyond it the face would enter the frame beside its hinge."""
TRAVEL = 0.75
"""Default travel of a drawer, over its depth."""


@no_type_check
def add_door(
    owner: Any,
    name: str,
    parent: Any,
    *,
    x: float,
    y: Sequence[float],
    z: Sequence[float],
    hinge: str,
    thickness: float,
    gap: float,
    opens: float | None,
    after: Any,
    material: str | None,
) -> Any:
    """Hang a flat door before the plane x; see `Object.door`."""
    context = f"door {validate.name(name, 'door name')!r}"
    (left, width), (low, height) = _span(y, f"{context}: y"), _span(z, f"{context}: z")
    if hinge not in _HINGES:
        raise ValueError(
            f"{context}: hinge is one of {', '.join(_HINGES)}, got {validate.shown(hinge)}"
        )
    edge = validate.number(gap, f"{context}: gap", 1.0)
    size = (
        validate.length(thickness, f"{context}: thickness"),
        validate.length(width - 2 * edge, f"{context}: width inside the gap"),
        validate.length(height - 2 * edge, f"{context}: height inside the gap"),
    )
    front = validate.number(x, f"{context}: x", validate.MAX_COORDINATE_M)
    part = owner.part(name, material=material or parent._material)
    at = (front + STANDS_OFF_M, left + width / 2, low + height / 2)
    panel = part.add(box(size), at=at, by="back", name=f"{name[:40]}_panel")
    where, axis = _HINGES[hinge]
    wide = SWING[hinge] if opens is None else validate.number(opens, f"{context}: opens", 7.0)
    owner.revolute(
        f"{name[:40]}_hinge",
        parent,
        part,
        at=panel.anchor(where),
        axis=axis,
        range=(0.0, wide),
        after=after,
        opens="front",
    )
    return part


@no_type_check
def add_drawer(
    owner: Any,
    name: str,
    parent: Any,
    *,
    x: float,
    y: Sequence[float],
    z: Sequence[float],
    depth: float,
    wall: float,
    front: float,
    overlay: float,
    gap: float,
    travel: float | None,
    after: Any,
    material: str | None,
) -> Any:
    """Put a drawer into an opening whose front lies in the plane x; see `Object.drawer`."""
    context = f"drawer {validate.name(name, 'drawer name')!r}"
    (left, width), (low, height) = _span(y, f"{context}: y"), _span(z, f"{context}: z")
    side = validate.number(gap, f"{context}: gap", 1.0)
    long = validate.length(depth, f"{context}: depth")
    edge = validate.number(x, f"{context}: x", validate.MAX_COORDINATE_M)
    over = validate.number(overlay, f"{context}: overlay", 1.0)
    thick = validate.length(front, f"{context}: front")
    part = owner.part(name, material=material or parent._material)
    tray = (
        long,
        validate.length(width - 2 * side, f"{context}: width inside the gap"),
        validate.length(height - side - LIFTS_M, f"{context}: height inside the gap"),
    )
    middle = left + width / 2
    shape = hollow_box(tray, validate.length(wall, f"{context}: wall"), open="+z")
    part.add(shape, at=(edge, middle, low + LIFTS_M), by="front.bottom", name=f"{name[:40]}_tray")
    # The front covers the opening and laps over its frame; without that it closes flush with it.
    inset = side if over <= 0 else -over
    face = (
        thick,
        validate.length(width - 2 * inset, f"{context}: front"),
        validate.length(height - 2 * inset if over > 0 else tray[2], f"{context}: front"),
    )
    foot = low - over if over > 0 else low + LIFTS_M
    part.add(box(face), at=(edge, middle, foot), by="back.bottom", name=f"{name[:40]}_front")
    out = TRAVEL * long if travel is None else validate.length(travel, f"{context}: travel")
    owner.prismatic(
        f"{name[:40]}_slide",
        parent,
        part,
        axis=(1, 0, 0),
        range=(0.0, out),
        after=after,
        opens="front",
    )
    return part


@no_type_check
def add_shelf(
    parent: Any,
    *,
    x: Sequence[float],
    y: Sequence[float],
    z: float,
    thickness: float,
    material: str | None,
    name: str | None,
) -> Any:
    """Add a level board to a part; see `Object.shelf`."""
    (back, deep), (right, wide) = _span(x, "shelf: x"), _span(y, "shelf: y")
    top = validate.number(z, "shelf: z", validate.MAX_COORDINATE_M)
    board = box((deep, wide, validate.length(thickness, "shelf: thickness")))
    at = (back + deep / 2, right + wide / 2, top)
    return parent.add(board, at=at, by="top", material=material, name=name)


def _span(value: Any, argument: str) -> tuple[float, float]:
    """Validate (low, high) [m], and return low and the distance between them."""
    low, high = validate.sequence(value, argument, 2, 2)
    a = validate.number(low, argument, validate.MAX_COORDINATE_M)
    b = validate.number(high, argument, validate.MAX_COORDINATE_M)
    if b <= a:
        raise ValueError(f"{argument} must be (low, high), got {validate.shown(value)}")
    return a, b - a
