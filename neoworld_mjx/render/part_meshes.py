"""Triangle meshes of the parts of an object: visible surfaces by color, and convex pieces."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..spec import ObjectSpec, PartSpec, Shape, pieces
from ..spec.convex import Piece
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
"""Colors of convex pieces, assigned in turn."""


class PartMesh(NamedTuple):
    """Triangles of one color, in the object's frame with all joints at zero."""

    vertices: NDArray
    """Vertices [m], float32 [v, 3]."""
    faces: NDArray
    """Vertex indices of the triangles, int32 [f, 3]."""
    rgb: RGB
    alpha: float


def visible_meshes(spec: ObjectSpec, part: PartSpec) -> list[PartMesh]:
    """Return the visible surfaces of a part of an object, one mesh for each color."""
    by_colour: dict[tuple[float, float, float, float], list[tuple[NDArray, NDArray]]] = {}
    for geom in part.geoms:
        rgba = spec.material(geom.material).rgba
        if geom.role == "collision":
            continue
        vertices, faces = _creased_surface(geom.shape)  # pyright: ignore[reportArgumentType] hashable
        by_colour.setdefault(rgba, []).append((geom.pose().apply(vertices), faces))
    return [
        PartMesh(*_joined(meshes), (_byte(r), _byte(g), _byte(b)), a)
        for (r, g, b, a), meshes in by_colour.items()
    ]


def piece_meshes(part: PartSpec) -> list[PartMesh]:
    """Return the convex pieces of a part, merged into one mesh for each color of PIECE_COLOURS."""
    groups: dict[RGB, list[tuple[NDArray, NDArray]]] = {}
    for k, (_, piece, local) in enumerate(pieces(part)):
        vertices, faces = _hull(piece)
        group = groups.setdefault(PIECE_COLOURS[k % len(PIECE_COLOURS)], [])
        group.append((local.apply(vertices), faces))
    return [PartMesh(*_joined(meshes), rgb, 1.0) for rgb, meshes in groups.items()]


def creased(vertices: NDArray, faces: NDArray) -> tuple[NDArray, NDArray]:
    """Split vertices at sharp edges, which stay sharp in viewers that interpolate normals."""
    normals = np.round(corner_normals(vertices, faces).reshape(-1, 3), 3)
    corners = np.column_stack([faces.ravel(), normals])
    rows, index = np.unique(corners, axis=0, return_inverse=True)
    return vertices[rows[:, 0].astype(int)], index.reshape(-1, 3).astype(np.int32)


@lru_cache(maxsize=1024)
def _creased_surface(shape: Shape) -> tuple[NDArray, NDArray]:
    """Return the creased surface of a shape in the shape's frame."""
    return creased(*shape.surface())


def _hull(piece: Piece) -> tuple[NDArray, NDArray]:
    """Return the surface of a convex piece in the frame of the piece."""
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
    from trimesh.util import append_faces

    vertices, faces = append_faces(*zip(*meshes, strict=True))
    return vertices.astype(np.float32), faces.astype(np.int32)


def _byte(value: float) -> int:
    return round(255 * min(max(value, 0.0), 1.0))
