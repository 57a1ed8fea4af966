"""Triangles of the parts of an object: what is seen, by colour, and the convex pieces."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..spec import GeomSpec, ObjectSpec, PartSpec
from ..spec.convex import Piece
from ..spec.pose import pose
from ..spec.triangles import corner_normals

RGB = tuple[int, int, int]

PIECE_COLOURS: tuple[RGB, ...] = (
    (66, 135, 245),
    (245, 133, 66),
    (88, 184, 96),
    (214, 84, 168),
    (240, 205, 70),
    (120, 108, 220),
    (64, 190, 196),
    (196, 98, 82),
)
"""Colours of convex pieces, in turn."""


class PartMesh(NamedTuple):
    """Triangles of one colour, in the object's frame at rest."""

    vertices: NDArray
    """float32 [v, 3] m."""
    faces: NDArray
    """int32 [f, 3]."""
    rgb: RGB
    alpha: float


def visible_meshes(spec: ObjectSpec, part: PartSpec) -> list[PartMesh]:
    """Return what is seen of a part, one mesh for each colour."""
    by_colour: dict[tuple[float, float, float, float], list[tuple[NDArray, NDArray]]] = {}
    for geom in part.geoms:
        if geom.role != "collision":
            vertices, faces = geom.shape.surface()
            placed = geom.pose().apply(creased(vertices, faces)[0])
            entry = (placed, creased(vertices, faces)[1])
            by_colour.setdefault(spec.material(geom.material).rgba, []).append(entry)
    return [
        PartMesh(*_joined(meshes), (_byte(r), _byte(g), _byte(b)), a)
        for (r, g, b, a), meshes in by_colour.items()
    ]


def piece_meshes(part: PartSpec) -> list[PartMesh]:
    """Return the convex pieces that a part collides with, in one mesh for each of a few colours."""
    groups: dict[RGB, list[tuple[NDArray, NDArray]]] = {}
    pieces = [
        (geom, piece)
        for geom in part.geoms
        if geom.role != "visual"
        for piece in geom.shape.pieces()
    ]
    for k, (geom, piece) in enumerate(pieces):
        groups.setdefault(PIECE_COLOURS[k % len(PIECE_COLOURS)], []).append(_placed(geom, piece))
    return [PartMesh(*_joined(meshes), rgb, 1.0) for rgb, meshes in groups.items()]


def creased(vertices: NDArray, faces: NDArray) -> tuple[NDArray, NDArray]:
    """Split vertices at sharp edges, so that a viewer that smooths over shared ones keeps them."""
    normals = np.round(corner_normals(vertices, faces).reshape(-1, 3), 3)
    corners = np.column_stack([faces.ravel(), normals])
    rows, index = np.unique(corners, axis=0, return_inverse=True)
    return vertices[rows[:, 0].astype(int)], index.reshape(-1, 3).astype(np.int32)


def _placed(geom: GeomSpec, piece: Piece) -> tuple[NDArray, NDArray]:
    vertices, faces = _hull(piece)
    at = geom.pose().then(pose(piece.pos, piece.quat))
    return at.apply(vertices), faces


def _hull(piece: Piece) -> tuple[NDArray, NDArray]:
    """Return the surface of a convex piece about its own origin."""
    import trimesh

    size = np.asarray(piece.size, float)
    if piece.kind == "mesh":
        mesh = trimesh.convex.convex_hull(np.array(piece.vertices, float))
    elif piece.kind == "box":
        mesh = trimesh.creation.box(2 * size)
    elif piece.kind == "sphere":
        mesh = trimesh.creation.icosphere(subdivisions=2, radius=size[0])
    elif piece.kind == "ellipsoid":
        mesh = trimesh.creation.icosphere(subdivisions=2, radius=1.0)
        mesh.apply_scale(size)
    elif piece.kind == "cylinder":
        mesh = trimesh.creation.cylinder(size[0], 2 * size[1], sections=24)
    else:
        mesh = trimesh.creation.capsule(2 * size[1], size[0], count=[24, 12])
        mesh.apply_translation([0, 0, -mesh.bounds.mean(axis=0)[2]])
    return creased(np.asarray(mesh.vertices), np.asarray(mesh.faces))


def _joined(meshes: list[tuple[NDArray, NDArray]]) -> tuple[NDArray, NDArray]:
    starts = np.cumsum([0] + [len(vertices) for vertices, _ in meshes])
    faces = [faces + start for (_, faces), start in zip(meshes, starts, strict=False)]
    return (
        np.concatenate([vertices for vertices, _ in meshes]).astype(np.float32),
        np.concatenate(faces).astype(np.int32),
    )


def _byte(value: float) -> int:
    return round(255 * min(max(value, 0.0), 1.0))
