"""Distances between an object's colliders and its visual geometry.

A policy that is trained on rendered images and simulated with colliders is affected by two errors.
If colliders protrude, there is contact where nothing is visible. If colliders fall short, there is
no contact where something is visible.
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
"""Depth inside another collider above which a sample is not on the surface of the union [m]."""
QUANTILE = 0.98
"""Quantile of the distances that is reported, so that single corners have no effect."""
MOST_GAP, MOST_GAP_M = 0.03, 0.003
"""An object is sound if its gaps are at most a fraction of its diagonal or a length [m], whichever
is larger."""

Points = Float[np.ndarray, "n 3"]


class ColliderGap(NamedTuple):
    """Gaps between the colliders and the visual geometry of an object."""

    protruding_m: float
    """98 % quantile of the distance from the colliders' surface to the visual surface [m]."""
    short_m: float
    """98 % quantile of the distance from the visual surface to the colliders [m]."""
    diagonal_m: float
    """Diagonal of the bounding box of the visual geometry [m]."""

    @property
    def sound(self) -> bool:
        """True if neither gap exceeds the bounds."""
        limit = max(MOST_GAP_M, MOST_GAP * self.diagonal_m)
        return max(self.protruding_m, self.short_m) <= limit


def collider_gap(spec: ObjectSpec) -> ColliderGap | None:
    """Compare the colliders of an object with its visual surface, with all joints at zero.

    Args:
        spec: the object.

    Returns:
        The gaps; None if the object has no visual geometry or no colliders.
    """
    visuals, solids = visual_meshes(spec), collision_solids(spec)
    if not visuals or not solids:
        return None
    visual = sampled(visuals, VISUAL_SAMPLES, seed=0)
    colliding = _union_surface(solids)
    protruding = KDTree(visual).query(colliding)[0]
    short = np.maximum(distance_outside(visual, solids), 0.0)
    corners = np.vstack([mesh.bounds for mesh in visuals])
    return ColliderGap(
        float(np.quantile(protruding, QUANTILE)) if len(protruding) else 0.0,
        float(np.quantile(short, QUANTILE)),
        float(np.linalg.norm(np.ptp(corners, axis=0))),
    )


def visual_meshes(spec: ObjectSpec) -> "list[trimesh.Trimesh]":
    """Return the meshes of an object's visual geometry, with all joints at zero."""
    import trimesh

    part_poses = link_poses(spec, {})
    return [
        trimesh.Trimesh(
            part_poses[part.name].then(geom.pose()).apply(vertices), faces, process=False
        )
        for part in spec.parts
        for geom in part.geoms
        if geom.role != "collision"
        for vertices, faces in [geom.shape.surface()]
    ]


def collision_solids(spec: ObjectSpec) -> list[tuple[Piece, Pose]]:
    """Return the convex colliders of an object and their poses, with all joints at zero."""
    part_poses = link_poses(spec, {})
    return [
        (piece, part_poses[part.name].then(geom.pose()).then(pose(piece.pos, piece.quat)))
        for part in spec.parts
        for geom in part.geoms
        if geom.role != "visual"
        for piece in geom.shape.pieces()
    ]


def _union_surface(solids: list[tuple[Piece, Pose]]) -> Points:
    """Sample the surface of the union of convex solids."""
    points = sampled([_mesh_of(*solid) for solid in solids], COLLIDER_SAMPLES, seed=0)
    buried: Bool[np.ndarray, " n"] = np.zeros(len(points), bool)
    for solid in solids:
        # Samples of this solid lie on its surface and therefore have no depth in it.
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
