"""Distance of an object's colliders from its visual geometry.

A policy that trains on what a camera sees and is simulated on colliders meets both errors: contact
where nothing is seen (the colliders protrude), and none where something is (they fall short).
"""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import KDTree

from neoworld_mjx.checks.static_checks import distance_outside
from neoworld_mjx.spec import ObjectSpec, link_poses
from neoworld_mjx.spec.convex import Piece, hull
from neoworld_mjx.spec.pose import Pose, pose

from .surface_measure import sampled

if TYPE_CHECKING:
    import trimesh

COLLIDER_SAMPLES, VISUAL_SAMPLES = 4000, 20_000
BURIED_M = 1e-6
"""Depth within another collider at which a sample is no part of the surface of their union."""
QUANTILE = 0.98
"""Share of the samples within the reported distances; single corners do not count."""
MOST_GAP, MOST_GAP_M = 0.03, 0.003
"""Bounds of a sound object: the larger of a share of its diagonal and a length."""

Points = Float[np.ndarray, "n 3"]


class ColliderGap(NamedTuple):
    """Gaps between colliders and visual geometry of an object."""

    protruding_m: float
    """Distance of the colliders' surface from the visual surface, exceeded by 2 % of it."""
    short_m: float
    """Distance of the visual surface from the colliders, exceeded by 2 % of it."""
    diagonal_m: float

    @property
    def sound(self) -> bool:
        """True if neither gap exceeds the bounds."""
        limit = max(MOST_GAP_M, MOST_GAP * self.diagonal_m)
        return max(self.protruding_m, self.short_m) <= limit


def collider_gap(spec: ObjectSpec, *, seed: int = 0) -> ColliderGap | None:
    """Measure the colliders of an object at rest against its visual surface.

    Args:
        spec: the object.
        seed: of the samples.

    Returns:
        None if the object has no visual geometry or no colliders.
    """
    seen, solids = visual_meshes(spec), collision_solids(spec)
    if not seen or not solids:
        return None
    visual = sampled(seen, VISUAL_SAMPLES, seed)
    colliding = _union_surface(solids, seed)
    protruding = KDTree(visual).query(colliding)[0]
    short = np.maximum(distance_outside(visual, solids), 0.0)
    corners = np.vstack([mesh.bounds for mesh in seen])
    return ColliderGap(
        float(np.quantile(protruding, QUANTILE)) if len(protruding) else 0.0,
        float(np.quantile(short, QUANTILE)),
        float(np.linalg.norm(np.ptp(corners, axis=0))),
    )


def visual_meshes(spec: ObjectSpec) -> "list[trimesh.Trimesh]":
    """Return the visual geometry of an object at rest."""
    import trimesh

    moved = link_poses(spec, {})
    return [
        trimesh.Trimesh(moved[part.name].then(geom.pose()).apply(vertices), faces, process=False)
        for part in spec.parts
        for geom in part.geoms
        if geom.role != "collision"
        for vertices, faces in [geom.shape.surface()]
    ]


def collision_solids(spec: ObjectSpec) -> list[tuple[Piece, Pose]]:
    """Return the convex colliders of an object at rest, with their poses."""
    moved = link_poses(spec, {})
    return [
        (piece, moved[part.name].then(geom.pose()).then(pose(piece.pos, piece.quat)))
        for part in spec.parts
        for geom in part.geoms
        if geom.role != "visual"
        for piece in geom.shape.pieces()
    ]


def _union_surface(solids: list[tuple[Piece, Pose]], seed: int) -> Points:
    """Sample the surface of the union of convex solids."""
    points = sampled([_mesh_of(*solid) for solid in solids], COLLIDER_SAMPLES, seed)
    buried: Bool[np.ndarray, " n"] = np.zeros(len(points), bool)
    for solid in solids:
        # The samples of a solid lie on its own surface, which is no depth.
        buried |= distance_outside(points, [solid]) < -BURIED_M
    return points[~buried]


def _mesh_of(piece: Piece, at: Pose) -> "trimesh.Trimesh":
    import trimesh
    from trimesh import creation as create

    s = piece.size
    if piece.kind == "mesh":
        vertices, faces = hull(piece.vertices)
        mesh = trimesh.Trimesh(vertices, faces, process=False)
    elif piece.kind == "box":
        mesh = create.box(extents=[2 * side for side in s[:3]])
    elif piece.kind == "cylinder":
        mesh = create.cylinder(radius=s[0], height=2 * s[1])
    elif piece.kind == "capsule":
        mesh = create.capsule(radius=s[0], height=2 * s[1])
    else:
        mesh = create.icosphere(subdivisions=3)
        mesh.apply_scale([s[0]] * 3 if piece.kind == "sphere" else list(s[:3]))
    mesh.vertices = at.apply(mesh.vertices)
    return mesh
