"""Scenes that are faster to simulate: without some objects, and with fewer colliders."""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..checks.static_checks import distance_outside
from ..errors import SpecError, choices
from ..export.link_frames import inertia_tensor
from ..io.names import unused
from ..physics.decompose import hull_points
from ..spec import GeomSpec, Mesh, ObjectSpec, PartSpec, SceneSpec, inertial, pieces
from ..spec.convex import Piece, hull
from ..spec.object import AuthoredInertia
from ..spec.pose import Pose
from ..spec.shapes import faceted

Colliders = Literal["exact", "coarse"]
COARSE_PIECES, COARSE_M = 8, 0.02
"""Number of convex pieces to which those of a rigid part are joined, and largest distance by which
a hull may exceed its pieces [m], so that cavities stay open."""
SECTORS = 12
"""Number of facets around round pieces in hulls."""
NEIGHBORS = 6
"""Number of nearest groups of pieces with which a group may be joined."""


def scene_without(scene: SceneSpec, names: Sequence[str]) -> SceneSpec:
    """Return a scene without some objects.

    Raises:
        SpecError: there is no such object, another one stands on it, or nothing is left.
    """
    known = [item.name for item in scene.objects]
    for name in names:
        if name not in known:
            raise SpecError(f"scene {scene.name}: without: {choices(name, known)}")
    left = tuple(item for item in scene.objects if item.name not in names)
    for item in left:
        if item.parent in names:
            raise SpecError(
                f"scene {scene.name}: without {item.parent}: {item.name} stands on it, so leave "
                f"{item.name} out, too"
            )
    if not left:
        raise SpecError(f"scene {scene.name}: without {', '.join(names)} it has no objects")
    return scene.model_copy(update={"objects": left})


def with_coarse_colliders(scene: SceneSpec) -> tuple[SceneSpec, dict[str, float]]:
    """Join colliders into convex hulls, until each rigid part has `COARSE_PIECES`.

    A part keeps more pieces if a hull would exceed them by more than `COARSE_M`, or if they are of
    different materials. Masses and inertias stay.

    Returns:
        The scene, and by object about how far its new colliders exceed the exact ones [m]; objects
        that do not change are omitted.
    """
    objects, errors = [], dict[str, float]()
    for item in scene.objects:
        joined = [_coarse_part(item.spec, part) for part in item.spec.parts]
        changed = [error for _, error in joined if error is not None]
        if changed:
            parts = tuple(part for part, _ in joined)
            errors[item.name] = max(changed)
            item = item.model_copy(update={"spec": item.spec.model_copy(update={"parts": parts})})
        objects.append(item)
    return scene.model_copy(update={"objects": tuple(objects)}), errors


class _Group(NamedTuple):
    """Pieces that share a hull."""

    points: NDArray
    """Corners of the hull [m], shape [n, 3]."""
    solids: tuple[tuple[Piece, Pose], ...]
    material: str
    error: float
    """Largest distance of the hull from the pieces [m]."""


def _coarse_part(spec: ObjectSpec, part: PartSpec) -> tuple[PartSpec, float | None]:
    """Return a part with few colliders and the error [m]; None if the part does not change."""
    groups = [
        _Group(at.apply(faceted(piece, SECTORS)), ((piece, at),), geom.material, 0.0)
        for geom, piece, at in pieces(part)
    ]
    count = len(groups)
    costs: dict[tuple[int, int], _Group] = {}
    while len(groups) > COARSE_PIECES:
        best = None
        for i, j in _candidates(groups):
            key = id(groups[i].solids), id(groups[j].solids)
            if key not in costs:
                costs[key] = _union(groups[i], groups[j])
            if best is None or costs[key].error < best[0].error:
                best = costs[key], i, j
        if best is None or best[0].error > COARSE_M:
            break
        group, i, j = best
        groups = [g for k, g in enumerate(groups) if k not in (i, j)] + [group]
    if len(groups) == count:
        return part, None
    geoms = [
        geom.model_copy(update={"role": "visual"})
        for geom in part.geoms
        if geom.role != "collision"
    ]
    taken = {geom.name for other in spec.parts for geom in other.geoms}
    for group in groups:
        name = unused(f"{part.name}_collider", taken)
        taken.add(name)
        vertices, faces = hull(tuple(map(tuple, hull_points(group.points).tolist())))
        shape = Mesh(
            vertices=tuple(map(tuple, vertices.tolist())), faces=tuple(map(tuple, faces.tolist()))
        )
        geoms.append(GeomSpec(name=name, shape=shape, material=group.material, role="collision"))
    whole, tensor = inertial(spec, part), inertia_tensor(spec, part)
    moments, products = np.diag(tensor), tensor[(0, 0, 1), (1, 2, 2)]
    inertia = AuthoredInertia(
        pos=whole.pos, moments=tuple(moments.tolist()), products=tuple(products.tolist())
    )
    update = {"geoms": tuple(geoms), "mass": whole.mass, "inertia": inertia}
    return part.model_copy(update=update), max(group.error for group in groups)


def _candidates(groups: Sequence[_Group]) -> list[tuple[int, int]]:
    """Return pairs of neighboring groups of one material."""
    centers = np.array([group.points.mean(axis=0) for group in groups])
    apart = np.linalg.norm(centers[:, None] - centers, axis=-1)
    for i, group in enumerate(groups):
        for j, other in enumerate(groups):
            if i == j or group.material != other.material:
                apart[i, j] = np.inf
    nearest = np.argsort(apart, axis=1, kind="stable")[:, :NEIGHBORS]
    pairs = {(min(i, j), max(i, j)) for i, row in enumerate(nearest.tolist()) for j in row}
    return sorted(pair for pair in pairs if np.isfinite(apart[pair]))


def _union(a: _Group, b: _Group) -> _Group:
    """Return the hull of two groups."""
    points = hull_points(np.concatenate([a.points, b.points]))
    vertices, faces = hull(tuple(map(tuple, points.tolist())))
    corners, solids = vertices[faces], a.solids + b.solids
    middles = (corners + np.roll(corners, 1, axis=1)) / 2
    surface = np.concatenate([corners.mean(axis=1), middles.reshape(-1, 3)])
    error = max(float(distance_outside(surface, solids).max()), 0.0)
    return _Group(vertices, solids, a.material, error)
