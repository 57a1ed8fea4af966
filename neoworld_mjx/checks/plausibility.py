"""Check that sizes, masses and walls are those of real objects."""

from collections.abc import Iterator

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from ..spec import (
    Extrusion,
    Lathe,
    ObjectSpec,
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
from .signals import Signal

SMALLEST_M, LARGEST_M = 0.002, 20.0
HEAVIEST_KG = 2000.0
SOLID_KG_M3, DENSE_KG_M3 = 3000.0, 1500.0
"""Mass over the volume of the convex hull: only solid metal exceeds the first, few things that
stand on a table the second."""
WEIGHED_KG, LIFTED_KG = 1.0, 8.0
"""Below the first a dense part is a fitting; above the second few hands lift it."""
LIGHTEST_KG_M3 = 1.0
THINNEST_M = 0.0004
"""Pieces thinner than this slip through each other in a time step."""


def plausibility(spec: ObjectSpec) -> Iterator[Signal]:
    """Yield implausible sizes, masses and walls of an object."""
    low, high = bounds(spec)
    yield from _size(high - low)
    total = 0.0
    for part in spec.parts:
        own = inertial(spec, part)
        mass = own.mass
        total += mass
        if is_too_light(own):
            yield Signal(
                severity="error",
                code="too_light",
                message=f"part {part.name!r} weighs {mass:.3g} kg, too little to be simulated",
                value=mass,
                threshold=LEAST_KG,
                hint="make it larger or denser, or shapes of another part",
            )
            continue
        if part.mass is None:
            yield from _density(part.name, mass, _spanned(spec, part.name))
        yield from _thin(spec, part.name)
    if total > HEAVIEST_KG:
        yield Signal(
            severity="error",
            code="too_heavy",
            message=f"the object weighs {total:.4g} kg",
            value=total,
            threshold=HEAVIEST_KG,
            hint="lengths are in metres; make it hollow, or choose a lighter material",
        )


def _size(size: np.ndarray) -> Iterator[Signal]:
    for value, threshold, wrong in (
        (float(size.max()), LARGEST_M, size.max() > LARGEST_M),
        (float(size.min()), SMALLEST_M, size.max() < 5 * SMALLEST_M),
    ):
        if wrong:
            extents = " x ".join(f"{v:.4g}" for v in size)
            yield Signal(
                severity="error",
                code="size",
                message=f"the object measures {extents} m",
                value=value,
                threshold=threshold,
                hint="lengths are in metres",
            )


def _density(part: str, mass: float, volume: float) -> Iterator[Signal]:
    density = mass / volume
    about = f"part {part!r} weighs {mass:.3g} kg, {density:.0f} kg for each m^3 that it spans"
    if mass > WEIGHED_KG and density > SOLID_KG_M3:
        yield Signal(
            severity="error",
            code="too_heavy",
            part=part,
            message=about + ": that is solid metal",
            value=density,
            threshold=SOLID_KG_M3,
            hint="make it a shell (lathe with thickness, hollow_box); if it is solid, say so by "
            "mass=",
        )
    elif mass > LIFTED_KG and density > DENSE_KG_M3:
        yield Signal(
            severity="warning",
            code="heavy",
            part=part,
            message=about,
            value=density,
            threshold=DENSE_KG_M3,
            hint="is it hollow in the picture? then make it a shell",
        )
    elif density < LIGHTEST_KG_M3:
        yield Signal(
            severity="warning",
            code="light",
            part=part,
            message=about,
            value=density,
            threshold=LIGHTEST_KG_M3,
            hint="are the walls too thin, or is a shape missing?",
        )


def _thin(spec: ObjectSpec, name: str) -> Iterator[Signal]:
    thinnest, where = np.inf, ""
    for geom in spec.part(name).geoms:
        wall = _wall(geom.shape)
        if geom.role != "visual" and wall < thinnest:
            thinnest, where = wall, geom.name
    for geom, piece, _ in pieces(spec.part(name)):
        if piece.kind == "mesh":
            continue  # `_wall` reads the thickness that its shape states.
        wide = min(extent(piece, d) + extent(piece, -d) for d in np.eye(3))
        if wide < thinnest:
            thinnest, where = wide, geom.name
    if thinnest < THINNEST_M:
        yield Signal(
            severity="warning",
            code="thin",
            part=name,
            message=f"part {name!r}: {where} is very thin",
            value=float(thinnest),
            threshold=THINNEST_M,
            hint="things fall through such a wall; 1 mm and more is safe",
        )


def _wall(shape: Shape) -> float:
    """Return the stated thickness [m] of a shape made of meshes, infinite if it states none."""
    if isinstance(shape, Lathe):
        return shape.thickness or np.inf
    if isinstance(shape, Prism | Extrusion):
        return shape.height
    if isinstance(shape, Sweep):
        return min(*shape.width, *shape.thickness)
    return np.inf


def _spanned(spec: ObjectSpec, name: str) -> float:
    """Return the volume [m^3] of a part's convex hull."""
    corners = []
    for _, piece, at in pieces(spec.part(name)):
        if piece.kind == "box":
            own = np.array(np.meshgrid(*([-1, 1],) * 3)).reshape(3, -1).T * piece.size
        elif piece.kind == "mesh":
            own = np.array(piece.vertices)
        else:
            own = faceted(piece, 16)
        corners.append(at.apply(own))
    try:
        return float(ConvexHull(np.vstack(corners)).volume)
    except QhullError:  # The part is flat to rounding.
        return 1e-12
