"""Static checks of an object: masses, inertias and colliders."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from ..spec import ObjectSpec, PartSpec, inertial, part_bounds, pieces
from ..spec.convex import Piece, mass_properties, planes
from ..spec.mesh import HELPER, UNKNOWN
from ..spec.pose import Pose
from .verdict import Check, Fault, Limit, make_check

MASS_RATIO = 10.0
"""Largest ratio of an authored mass to the mass from volume and density.

The smallest ratio is 1 / MASS_RATIO^2.
"""
DENSEST, LIGHTEST = 22000.0, 0.5
"""Largest and smallest mass over collider volume [kg/m^3].

The largest is close to the density of osmium, and the smallest is below the density of any foam.
"""
HEAVIEST_KG = 2000.0
INERTIA_RATIO = 30.0
"""Largest ratio of the inertia from volume and density to an authored inertia.

The smallest ratio is 3 / INERTIA_RATIO.
"""
SURFACE_SAMPLES = 240
"""Number of points that are sampled on a part's visible surface."""
MAX_UNCOVERED_FRACTION = 0.2
"""Largest fraction of a part's visible surface without a collider."""
MAX_COLLIDER_EXCESS = 0.04
"""Largest distance by which colliders exceed the visible shape, over the visible diagonal."""


def check_statics(spec: ObjectSpec) -> Iterator[Check]:
    """Yield checks of authored inertias and masses, of the total mass, and of colliders."""
    for part in spec.parts:
        yield from _inertia(spec, part)
    total = 0.0
    for part in spec.parts:
        total += part.mass if part.mass is not None else inertial(spec, part).mass
        yield from _mass(spec, part)
    limit = Limit(HEAVIEST_KG, "kg", Fault.MASS_IMPLAUSIBLE)
    yield make_check("static", "mass", total, limit)
    for part in spec.parts:
        yield from _colliders(spec, part)


def is_placeholder(part: PartSpec) -> bool:
    """Return True if a part stands for a link without geometry.

    A placeholder collides with nothing, and represents the mass and inertia of a body whose extent
    is unknown.
    """
    return all(geom.material.startswith(HELPER) for geom in part.geoms)


def _inertia(spec: ObjectSpec, part: PartSpec) -> Iterator[Check]:
    """Check that an authored inertia is physical and fits the part.

    The center of mass must lie inside the part's bounding box, within a tolerance.
    """
    if part.inertia is None or part.mass is None:
        return
    moments = np.sort(np.linalg.eigvalsh(part.inertia.tensor()))
    # The largest principal moment is at most the sum of the others.
    violation = float(max(-moments[0], moments[2] - moments[0] - moments[1], 0.0))
    size = max(abs(float(moments[2])), 1e-30)
    positive = moments[0] > 0
    value = violation / size if positive else np.inf
    limit = Limit(0.02, "", Fault.INERTIA_IMPOSSIBLE)
    yield make_check("static", f"moments:{part.name}", value, limit, part=part.name)
    if is_placeholder(part):
        return
    derived = inertial(spec, part.model_copy(update={"inertia": None}))
    ratio = max(derived.diagonal) / size if positive else np.inf
    limit = Limit(INERTIA_RATIO, "times", Fault.INERTIA_IMPOSSIBLE)
    yield make_check("static", f"spread:{part.name}", max(ratio, 3 / ratio), limit, part=part.name)
    low, high = part_bounds(spec, part)
    excess = float(np.maximum(low - part.inertia.pos, part.inertia.pos - high).max())
    limit = Limit(0.05 * float(np.linalg.norm(high - low)), "m", Fault.INERTIA_IMPOSSIBLE)
    yield make_check("static", f"centre:{part.name}", max(excess, 0.0), limit, part=part.name)


def _mass(spec: ObjectSpec, part: PartSpec) -> Iterator[Check]:
    """Check an authored mass against volume and density.

    If the density is unknown, check that the mass over the volume is possible for any material.
    """
    if part.mass is None or is_placeholder(part):
        return
    volume = derived = 0.0
    for geom, piece, _ in pieces(part):
        piece_volume = mass_properties(piece)[0]
        volume += piece_volume
        derived += piece_volume * spec.material(geom.material).density
    if any(geom.material.startswith(UNKNOWN) for geom, _, _ in pieces(part)):
        limit = Limit(DENSEST, "kg/m^3", Fault.MASS_IMPLAUSIBLE)
        density = part.mass / volume
        value = density if density > LIGHTEST else np.inf
    else:
        limit = Limit(MASS_RATIO, "times", Fault.MASS_IMPLAUSIBLE)
        ratio = part.mass / derived
        value = max(ratio, 1 / ratio / MASS_RATIO)
    yield make_check("static", f"mass:{part.name}", value, limit, part=part.name)


def _colliders(spec: ObjectSpec, part: PartSpec) -> Iterator[Check]:
    """Check that a part's colliders cover the visible shape, and do not exceed it by much."""
    roles = {geom.role for geom in part.geoms}
    if roles == {"both"} or roles == {"collision"}:
        return
    points = visible_points(part)
    low, high = points.min(axis=0), points.max(axis=0)
    size = float(np.linalg.norm(high - low))
    lowest, highest = part_bounds(spec, part)
    excess = float(np.maximum(low - lowest, highest - high).max())
    limit = Limit(max(0.003, MAX_COLLIDER_EXCESS * size), "m", Fault.COLLIDER_LARGE)
    yield make_check(
        "static", f"colliders_out:{part.name}", max(excess, 0.0), limit, part=part.name
    )
    distances = distance_outside(points, [(piece, pose) for _, piece, pose in pieces(part)])
    uncovered = float(np.mean(distances > max(0.003, 0.03 * size)))
    limit = Limit(MAX_UNCOVERED_FRACTION, "of it", Fault.COLLIDER_MISSING)
    yield make_check("static", f"colliders_missing:{part.name}", uncovered, limit, part=part.name)


def visible_points(part: PartSpec, count: int = SURFACE_SAMPLES) -> NDArray:
    """Sample points uniformly on a part's visible surface, and add the extreme vertices.

    Returns:
        Points in the object's frame [m], shape [count + 6, 3].
    """
    corners = []
    for geom in part.geoms:
        if geom.role != "collision":
            vertices, faces = geom.shape.surface()
            corners.append(geom.pose().apply(vertices)[faces])
    triangles = np.concatenate(corners)
    a, b, c = triangles.transpose(1, 0, 2)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    random = np.random.default_rng(0)
    chosen = random.choice(len(area), count, p=area / area.sum())
    u, v = np.sort(random.random((2, count)), axis=0)[..., None]
    inner = u * a[chosen] + (v - u) * b[chosen] + (1 - v) * c[chosen]
    # With the extreme vertices, the points span the full extent.
    flat = triangles.reshape(-1, 3)
    return np.concatenate([inner, flat[flat.argmin(axis=0)], flat[flat.argmax(axis=0)]])


def distance_outside(points: NDArray, solids: Sequence[tuple[Piece, Pose]]) -> NDArray:
    """Return a lower bound of the distance from each point to the nearest convex piece.

    For a piece with faces, the bound is the largest signed distance to the plane of a face.

    Args:
        points: points [m], shape [n, 3].
        solids: convex pieces with their poses.

    Returns:
        Distances [m], shape [n]; negative inside a piece.
    """
    nearest = np.full(len(points), np.inf)
    for piece, pose in solids:
        local = pose.inverse().apply(points)
        s = np.array(piece.size)
        if piece.kind in ("box", "mesh"):
            faces = planes(piece)
            distance = (local @ faces[:, :3].T - faces[:, 3]).max(axis=1)
        elif piece.kind == "sphere":
            distance = np.linalg.norm(local, axis=1) - s[0]
        elif piece.kind == "ellipsoid":
            distance = (np.linalg.norm(local / s, axis=1) - 1.0) * s.min()
        elif piece.kind == "capsule":
            local[:, 2] -= np.clip(local[:, 2], -s[1], s[1])
            distance = np.linalg.norm(local, axis=1) - s[0]
        else:
            radial, axial = np.hypot(local[:, 0], local[:, 1]), np.abs(local[:, 2])
            distance = np.maximum(radial - s[0], axial - s[1])
        nearest = np.minimum(nearest, distance)
    return nearest


def without_bad_inertia(spec: ObjectSpec, checks: Sequence[Check]) -> ObjectSpec:
    """Return the object without impossible authored inertias, so that it can be simulated."""
    names = {check.part for check in checks if check.fault is Fault.INERTIA_IMPOSSIBLE}
    parts = tuple(
        part.model_copy(update={"inertia": None}) if part.name in names else part
        for part in spec.parts
    )
    return spec.model_copy(update={"parts": parts}) if names else spec
