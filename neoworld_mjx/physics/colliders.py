"""Canonical colliders of a scene as arrays: convex pieces by kind.

D_pen is measured on these colliders, regardless of the engine that simulates the scene.
"""

import jax
import numpy as np
from neoworld_kernels import Colliders, PieceGroup
from numpy.typing import NDArray

from ..spec import Lathe, SceneObject, Shape
from ..spec.convex import Piece, box_around, planes
from ..spec.pose import Pose, matrix, pose
from .support import posed_shapes

_KIND = {
    "box": "box",
    "sphere": "capsule",
    "capsule": "capsule",
    "cylinder": "cylinder",
    "ellipsoid": "ellipsoid",
    "mesh": "polytope",
}


def collect_colliders(objects: tuple[SceneObject, ...]) -> Colliders:
    """Collect the convex pieces of all objects, in the objects' frames at their joint states.

    A wedge that a lathe repeats around an axis is stored once.
    """
    rows: dict[str, list[tuple[int, Piece, Pose, int]]] = {kind: [] for kind in Colliders._fields}
    for owner, item in enumerate(objects):
        for shape, shape_pose in posed_shapes(item):
            for piece, repeats in _distinct(shape):
                kind = _KIND[piece.kind] if repeats == 1 else "sector"
                rows[kind].append(
                    (owner, piece, shape_pose.then(pose(piece.pos, piece.quat)), repeats)
                )
    return Colliders(**{kind: _group(rows[kind]) for kind in Colliders._fields})


def _distinct(shape: Shape) -> list[tuple[Piece, int]]:
    # An oval lathe has no rotational symmetry.
    if isinstance(shape, Lathe) and shape.oval == 1.0:
        return shape.distinct_pieces()
    return [(piece, 1) for piece in shape.pieces()]


def _group(rows: list[tuple[int, Piece, Pose, int]]) -> PieceGroup:
    faces = [planes(p) if p.kind == "mesh" else np.zeros((0, 4)) for _, p, _, _ in rows]
    width = max((len(f) for f in faces), default=0)
    table = np.zeros((len(rows), width, 4))
    table[..., 3] = 1e6
    size, extent = np.zeros((len(rows), 3)), np.zeros((len(rows), 2, 3))
    for k, (_, piece, _, repeats) in enumerate(rows):
        table[k, : len(faces[k])] = faces[k]
        size[k, : len(piece.size)] = piece.size
        extent[k] = _extent(piece, repeats)
        if repeats > 1:
            size[k, 0] = repeats
    f32 = lambda value, shape: jax.device_put(np.array(value, np.float32).reshape(shape))
    return PieceGroup(
        owner=jax.device_put(np.array([owner for owner, _, _, _ in rows], np.int32)),
        pos=f32([piece_pose.pos for _, _, piece_pose, _ in rows], (-1, 3)),
        rot=f32([matrix(piece_pose.quat) for _, _, piece_pose, _ in rows], (-1, 3, 3)),
        size=f32(size, (-1, 3)),
        planes=f32(table, (len(rows), width, 4)),
        extent=f32(extent, (-1, 2, 3)),
    )


def _extent(piece: Piece, repeats: int) -> NDArray:
    """Return the bounding box of a piece and its repeats about the z axis, in the piece's frame."""
    if repeats == 1:
        return np.array(box_around(piece, pose()))
    x, y, z = np.array(piece.vertices).T
    radius = np.hypot(x, y).max()
    return np.array([[-radius, -radius, z.min()], [radius, radius, z.max()]])
