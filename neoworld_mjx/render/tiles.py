"""Data for other programs: tiles of patterned materials, and triangle meshes of an object's parts.

A tile is a small image that repeats seamlessly. It shows the same pattern as rendered images, on
the plane z = 0 of an object's frame. Patterns of courses repeat after a whole number of courses.
Other tiles are mirrored or blended at the edges.
"""

from functools import lru_cache
from io import BytesIO
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ..spec import Material, ObjectSpec, PartSpec, Shape, SurfacePattern, pieces
from ..spec.convex import Piece
from ..spec.finish import finish
from ..spec.triangles import corner_normals
from .appearance import displayed, linear, print_png
from .surface_patterns import patterned

PIXELS = 256
"""Edge length of a tile [px]."""
COLOURS = 48
"""Number of colors of a tile; a larger number makes no visible difference."""
SAMPLES = 2
"""Samples per pixel and axis of patterns with edges."""
GRAIN_M = 0.32
_STEPS: dict[str, tuple[int, int]] = {
    # Size along u and v in steps of the pattern: a whole number of courses if not mirrored.
    "boards": (9, 8), "tiles": (4, 4), "bricks": (12, 12), "veins": (3, 3),
    "speckles": (24, 24), "weave": (32, 32), "brushed": (40, 40),
    "checker": (4, 4),
}  # fmt: skip
_FOLDED = {
    "grain": "uv", "boards": "u", "brushed": "uv",
}  # fmt: skip
"""Axes along which a tile is mirrored."""
_BLENDED = ("veins", "speckles")
"""Patterns whose tiles are blended at the edges, because mirroring would be visible."""
OVERLAP = 0.125
"""Width of the blended edge, relative to the width of the tile."""


def tile_size(pattern: SurfacePattern) -> tuple[float, float]:
    """Return the width and height of a pattern's tile [m]."""
    if pattern.kind == "grain":
        return GRAIN_M, GRAIN_M
    u, v = (count * pattern.length for count in _STEPS[pattern.kind])
    return (u, v) if pattern.along == "x" else (v, u)


def tile_png(material: Material) -> bytes | None:
    """Return the tile of a patterned material, or the texture of a printed one, as PNG.

    The first row of pixels is at the largest v. If the material is plain, return None.
    """
    if material.photo is not None:
        return print_png(material)
    pattern = finish(material).pattern
    return None if pattern is None else _tile_png(pattern.model_dump_json(), material.rgba[:3])


@lru_cache(maxsize=256)
def _tile_png(described: str, rgb: tuple[float, float, float]) -> bytes:
    pattern, content = SurfacePattern.model_validate_json(described), BytesIO()
    image = Image.fromarray(_tile(pattern, rgb)).quantize(
        COLOURS, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE
    )
    image.save(content, format="PNG", optimize=True)
    return content.getvalue()


def _tile(pattern: SurfacePattern, rgb: tuple[float, float, float]) -> NDArray:
    """Return the tile, uint8 [PIXELS, PIXELS, 3]."""
    wide, tall = tile_size(pattern)
    folded = _FOLDED.get(pattern.kind, "")
    if pattern.along == "y":
        folded = folded.translate(str.maketrans("uv", "vu"))
    blended = pattern.kind in _BLENDED
    samples = 1 if blended else SAMPLES
    n = PIXELS * samples
    grid = (np.arange(n + round(OVERLAP * n) * blended) + 0.5) / n
    first = grid[: n // 2] if "u" in folded else grid
    second = grid[: n // 2] if "v" in folded else grid
    u, v = np.meshgrid(first * wide, second * tall)
    point = np.stack([u.ravel(), v.ravel(), np.zeros(u.size)], axis=1)
    up = np.broadcast_to([0.0, 0.0, 1.0], point.shape)
    pixel = np.full(u.size, max(wide, tall) / PIXELS)
    other = None if pattern.rgb is None else linear(np.array(pattern.rgb))
    light = patterned(pattern, linear(np.array(rgb)), other, point, up, pixel)
    rows, columns = len(second) // samples, len(first) // samples
    fine = light.reshape(rows, samples, columns, samples, 3).mean(axis=(1, 3))
    if blended:
        fine = _wrapped(np.swapaxes(_wrapped(np.swapaxes(fine, 0, 1)), 0, 1))
    if "u" in folded:
        fine = np.concatenate([fine, fine[:, ::-1]], axis=1)
    if "v" in folded:
        fine = np.concatenate([fine, fine[::-1]], axis=0)
    return np.round(255 * displayed(fine[::-1])).astype(np.uint8)


def _wrapped(rows: NDArray) -> NDArray:
    """Blend the rows beyond the edge of a tile into its first rows."""
    overlap = len(rows) - PIXELS
    weight = ((np.arange(overlap) + 0.5) / overlap)[:, None, None]
    first = weight * rows[:overlap] + (1 - weight) * rows[PIXELS:]
    return np.concatenate([first, rows[overlap:PIXELS]])


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
