"""Plausibility checks: are sizes, masses and wall thicknesses those of a real object?"""

from collections.abc import Iterator

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from ..spec import (
    Extrusion,
    Lathe,
    ObjectSpec,
    PartSpec,
    Prism,
    Shape,
    Sweep,
    bounds,
    inertial,
    is_too_light,
    pieces,
)
from ..spec.convex import extent
from ..spec.csg import faceted
from ..spec.mass import LEAST_KG
from .signals import Severity, Signal, error_signal

SMALLEST_M, LARGEST_M = 0.01, 20.0
"""Limits on the longest edge of an object [m]."""
HEAVIEST_KG = 2000.0
SOLID_KG_M3, DENSE_KG_M3 = 3000.0, 1500.0
"""Limits on a part's mass over the volume of the part's convex hull.

Only solid metal exceeds the first limit, and few tabletop objects exceed the second limit.
"""
WEIGHED_KG, LIFTED_KG = 1.0, 8.0
"""Masses above which the two limits on density apply.

A dense part that is lighter than the first mass is a fitting. A part that is heavier than the
second mass is hard to lift.
"""
LIGHTEST_KG_M3 = 1.0
THINNEST_M = 0.0004
"""Thickness below which pieces can pass through each other within a time step."""


def plausibility(spec: ObjectSpec) -> Iterator[Signal]:
    """Yield signals for implausible sizes, masses and wall thicknesses of an object."""
    low, high = bounds(spec)
    yield from _size(high - low)
    total = 0.0
    for part in spec.parts:
        inertia = inertial(spec, part)
        total += inertia.mass
        if is_too_light(inertia):
            yield error_signal(
                "too_light",
                f"part {part.name!r} weighs {inertia.mass:.3g} kg, too little to be simulated",
                value=inertia.mass,
                threshold=LEAST_KG,
                hint="make it larger or denser, or shapes of another part",
            )
            continue
        if part.mass is None:
            yield from _density(part.name, inertia.mass, inertia.mass / _hull_volume(part))
        yield from _thickness(part)
    if total > HEAVIEST_KG:
        hint = "lengths are in metres; make it hollow, or choose a lighter material"
        message = f"the object weighs {total:.4g} kg"
        yield error_signal("too_heavy", message, value=total, threshold=HEAVIEST_KG, hint=hint)


def _size(size: np.ndarray) -> Iterator[Signal]:
    longest = float(size.max())
    message = f"the object measures {' x '.join(f'{v:.4g}' for v in size)} m"
    hint = "lengths are in metres"
    if longest > LARGEST_M:
        yield error_signal("size", message, value=longest, threshold=LARGEST_M, hint=hint)
    if longest < SMALLEST_M:
        yield error_signal("size", message, value=longest, threshold=SMALLEST_M, hint=hint)


def _density(part: str, mass: float, density: float) -> Iterator[Signal]:
    """Check a part's density [kg/m^3], which is the mass over the volume of the convex hull."""
    message = f"part {part!r} weighs {mass:.3g} kg, {density:.0f} kg for each m^3 that it spans"
    severity: Severity = "warning"
    if mass > WEIGHED_KG and density > SOLID_KG_M3:
        severity, code, limit = "error", "too_heavy", SOLID_KG_M3
        message += ": that is solid metal"
        hint = "make it a shell (lathe with thickness, hollow_box); if it is solid, say so by mass="
    elif mass > LIFTED_KG and density > DENSE_KG_M3:
        code, limit = "heavy", DENSE_KG_M3
        hint = "is it hollow in the picture? then make it a shell"
    elif density < LIGHTEST_KG_M3:
        code, limit = "light", LIGHTEST_KG_M3
        hint = "are the walls too thin, or is a shape missing?"
    else:
        return
    yield Signal(
        severity=severity, code=code, part=part, message=message, hint=hint, value=density,
        threshold=limit,
    )  # fmt: skip


def _thickness(part: PartSpec) -> Iterator[Signal]:
    """Check the smallest thickness [m] of a part's shapes and convex pieces."""
    walls = [(_wall(geom.shape), geom.name) for geom in part.geoms if geom.role != "visual"]
    for geom, piece, _ in pieces(part):
        if piece.kind != "mesh":  # For meshes, `_wall` returns the thickness that the shape states.
            width = min(extent(piece, axis) + extent(piece, -axis) for axis in np.eye(3))
            walls.append((width, geom.name))
    thickness, shape = min(walls, key=lambda wall: wall[0], default=(np.inf, ""))
    if thickness < THINNEST_M:
        yield Signal(
            severity="warning",
            code="thin",
            part=part.name,
            message=f"part {part.name!r}: {shape} is very thin",
            value=float(thickness),
            threshold=THINNEST_M,
            hint="things fall through such a wall; 1 mm and more is safe",
        )


def _wall(shape: Shape) -> float:
    """Return the thickness [m] that a shape states, or infinity if it states none."""
    if isinstance(shape, Lathe):
        return shape.thickness or np.inf
    if isinstance(shape, Prism | Extrusion):
        return shape.height
    if isinstance(shape, Sweep):
        return min(*shape.width, *shape.thickness)
    return np.inf


def _hull_volume(part: PartSpec) -> float:
    """Return the volume of a part's convex hull [m^3]."""
    corners = []
    for _, piece, pose in pieces(part):
        if piece.kind == "box":
            vertices = np.array(np.meshgrid(*([-1, 1],) * 3)).reshape(3, -1).T * piece.size
        elif piece.kind == "mesh":
            vertices = np.array(piece.vertices)
        else:
            vertices = faceted(piece, 16)
        corners.append(pose.apply(vertices))
    try:
        return float(ConvexHull(np.vstack(corners)).volume)
    except QhullError:  # The part is flat up to rounding.
        return 1e-12
