"""Static checks of an object: mass, inertia and colliders."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ..config import VerifyOptions
from ..spec import ObjectSpec, PartSpec, inertial, part_bounds, pieces
from ..spec.convex import Piece, mass_properties, planes
from ..spec.mesh import HELPER, UNKNOWN
from ..spec.pose import Pose
from .verdict import Check, Fault, Limit, judged

MASS_RATIO = 10.0
"""Largest ratio of an authored mass to that by density; the inverse may be ten times as large."""
DENSEST, LIGHTEST = 22000.0, 0.5
"""Mass over the colliders' volume [kg/m^3]: osmium, and less than any foam."""
HEAVIEST_KG = 2000.0
GYRATION = 30.0
"""Largest ratio of the inertia by volume to an authored one; the inverse may be a third."""
COVER_SAMPLES = 240
MISSING_SHARE = 0.2
"""Share of a part's visible surface that may lack a collider."""
PROUD_SHARE = 0.04
"""Distance by which colliders may exceed the visible shape, over the part's diagonal."""


def helper(part: PartSpec) -> bool:
    """Tell whether a part is a placeholder for a link without geometry.

    It collides with nothing, and its mass and inertia are those of a body of unknown extent.
    """
    return all(geom.material.startswith(HELPER) for geom in part.geoms)


def inertias(spec: ObjectSpec) -> Iterator[Check]:
    """Yield checks of authored inertias.

    Principal moments must be positive and obey the triangle inequality, the centre of mass must lie
    within the part, and the moments must fit the part's extent.
    """
    for part in spec.parts:
        if part.inertia is None or part.mass is None:
            continue
        tensor = part.inertia.tensor()
        moments = np.sort(np.linalg.eigvalsh(tensor))
        lack = float(max(-moments[0], moments[2] - moments[0] - moments[1]))
        size = max(abs(float(moments[2])), 1e-30)
        limit = Limit(threshold=0.02, unit="", fault=Fault.INERTIA_IMPOSSIBLE)
        good = moments[0] > 0
        yield judged(
            "static",
            f"moments:{part.name}",
            max(lack, 0.0) / size if good else np.inf,
            limit,
            part=part.name,
        )
        if helper(part):
            continue
        own = inertial(spec, part.model_copy(update={"inertia": None}))
        ratio = max(own.diagonal) / size if good else np.inf
        limit = Limit(threshold=GYRATION, unit="times", fault=Fault.INERTIA_IMPOSSIBLE)
        yield judged("static", f"spread:{part.name}", max(ratio, 3 / ratio), limit, part=part.name)
        low, high = part_bounds(spec, part)
        out = np.maximum(low - part.inertia.pos, part.inertia.pos - high).max()
        limit = Limit(
            threshold=0.05 * float(np.linalg.norm(high - low)),
            unit="m",
            fault=Fault.INERTIA_IMPOSSIBLE,
        )
        yield judged("static", f"centre:{part.name}", max(float(out), 0.0), limit, part=part.name)


def masses(spec: ObjectSpec) -> Iterator[Check]:
    """Yield checks of authored masses against volume and density, and of the total mass."""
    total = 0.0
    for part in spec.parts:
        mass = part.mass if part.mass is not None else inertial(spec, part).mass
        total += mass
        if part.mass is None or helper(part):
            continue
        volume = derived = 0.0
        known = True
        for geom, piece, _ in pieces(part):
            v = mass_properties(piece)[0]
            volume += v
            derived += v * spec.material(geom.material).density
            known = known and not geom.material.startswith(UNKNOWN)
        if known:
            ratio = mass / derived
            limit = Limit(threshold=MASS_RATIO, unit="times", fault=Fault.MASS_IMPLAUSIBLE)
            value = max(ratio, 1 / ratio / MASS_RATIO)
        else:
            limit = Limit(threshold=DENSEST, unit="kg/m^3", fault=Fault.MASS_IMPLAUSIBLE)
            density = mass / volume
            value = density if density > LIGHTEST else np.inf
        yield judged("static", f"mass:{part.name}", value, limit, part=part.name)
    limit = Limit(threshold=HEAVIEST_KG, unit="kg", fault=Fault.MASS_IMPLAUSIBLE)
    yield judged("static", "mass", total, limit)


def colliders(spec: ObjectSpec) -> Iterator[Check]:
    """Yield checks that the colliders of each part cover its visible shape and exceed it little."""
    for part in spec.parts:
        if all(geom.role == "both" for geom in part.geoms):
            continue
        if all(geom.role == "collision" for geom in part.geoms):
            continue
        points = visible_points(part)
        low, high = points.min(axis=0), points.max(axis=0)
        size = float(np.linalg.norm(high - low))
        solid = [(piece, at) for _, piece, at in pieces(part)]
        lowest, highest = part_bounds(spec, part)
        proud = float(np.maximum(low - lowest, highest - high).max())
        slack = max(0.003, PROUD_SHARE * size)
        limit = Limit(threshold=slack, unit="m", fault=Fault.COLLIDER_LARGE)
        yield judged("static", f"colliders_out:{part.name}", max(proud, 0.0), limit, part=part.name)
        bare = float(np.mean(distance_outside(points, solid) > max(0.003, 0.03 * size)))
        limit = Limit(threshold=MISSING_SHARE, unit="of it", fault=Fault.COLLIDER_MISSING)
        yield judged("static", f"colliders_missing:{part.name}", bare, limit, part=part.name)


def visible_points(part: PartSpec, count: int = COVER_SAMPLES) -> NDArray:
    """Sample points [n, 3] m evenly on a part's visible surface, in the object's frame."""
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
    # With the extreme vertices the samples have the full extent.
    flat = triangles.reshape(-1, 3)
    return np.concatenate([inner, flat[flat.argmin(axis=0)], flat[flat.argmax(axis=0)]])


def distance_outside(points: NDArray, solids: list[tuple[Piece, Pose]]) -> NDArray:
    """Return a lower bound [n] m of the distance of points [n, 3] to the nearest convex piece.

    For pieces with faces the bound is the distance to the furthest face's plane.
    """
    nearest = np.full(len(points), np.inf)
    for piece, at in solids:
        local = at.inverse().apply(points)
        s = np.array(piece.size)
        if piece.kind in ("box", "mesh"):
            faces = planes(piece)
            out = (local @ faces[:, :3].T - faces[:, 3]).max(axis=1)
        elif piece.kind == "sphere":
            out = np.linalg.norm(local, axis=1) - s[0]
        elif piece.kind == "ellipsoid":
            out = (np.linalg.norm(local / s, axis=1) - 1.0) * s.min()
        elif piece.kind == "capsule":
            axial = local.copy()
            axial[:, 2] -= np.clip(local[:, 2], -s[1], s[1])
            out = np.linalg.norm(axial, axis=1) - s[0]
        else:
            out = np.maximum(np.hypot(local[:, 0], local[:, 1]) - s[0], np.abs(local[:, 2]) - s[1])
        nearest = np.minimum(nearest, out)
    return nearest


def without_bad_inertia(spec: ObjectSpec, checks: list[Check]) -> ObjectSpec:
    """Return the object with impossible inertias recomputed, so that it can be simulated."""
    bad = {c.part for c in checks if c.outcome == "FAIL" and c.fault is Fault.INERTIA_IMPOSSIBLE}
    if not bad:
        return spec
    parts = tuple(
        p.model_copy(update={"inertia": None}) if p.name in bad else p for p in spec.parts
    )
    return spec.model_copy(update={"parts": parts})


def statics(spec: ObjectSpec, options: VerifyOptions) -> list[Check]:
    """Return all checks of this module."""
    return [*inertias(spec), *masses(spec), *colliders(spec)]
