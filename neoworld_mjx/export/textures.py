"""Textures of an object: tiles of its patterned materials, and where on its surfaces they lie.

A tile is laid on the face of the axis that a triangle's normal is nearest to, in metres of the
part's own frame, as in our pictures; a print of the photograph where the camera saw the surface.
"""

import numpy as np
from numpy.typing import NDArray

from ..render.prints import read_print
from ..render.tiles import tile_png, tile_size
from ..spec import GeomSpec, Material, ObjectSpec
from ..spec.finish import finish
from ..spec.pose import matrix

TEXTURES = "textures"
"""Folder beside an object's files."""
PRINT_CUTS = 24
"""Edges of triangles with a print are at most the whole's diagonal over this."""


def is_textured(spec: ObjectSpec, geom: GeomSpec) -> bool:
    """Return whether a geom is seen with a texture."""
    return geom.role != "collision" and has_texture(spec.material(geom.material))


def has_texture(material: Material) -> bool:
    """Return whether a material has a texture: a pattern, or a print of the photograph."""
    return material.photo is not None or finish(material).pattern is not None


def texture_file(material: Material) -> str:
    """Return the path of a material's texture, relative to the object."""
    return f"{TEXTURES}/{material.name}.png"


def texture_files(spec: ObjectSpec) -> dict[str, bytes]:
    """Return the textures of what is seen of an object: path relative to it, and PNG."""
    result: dict[str, bytes] = {}
    for part in spec.parts:
        for geom in part.geoms:
            if is_textured(spec, geom):
                material = spec.material(geom.material)
                content = tile_png(material)
                if content is not None:
                    result[texture_file(material)] = content
    return result


def visible_surface(
    spec: ObjectSpec, part: str, geom: GeomSpec
) -> tuple[NDArray, NDArray, NDArray | None]:
    """Return what is drawn of a geom, in its own frame.

    Args:
        spec: the object.
        part: the part that the geom belongs to.
        geom: the geom.

    Returns:
        Vertices [vertex, 3] m, faces [face, 3], and (u, v) of every corner of every face,
        [face, 3, 2], v upwards; None without a texture. Of what bears a print the faces are cut up,
        as a photograph's perspective bends over large ones.
    """
    vertices, faces = geom.shape.surface()
    if not is_textured(spec, geom):
        return vertices, faces, None
    material = spec.material(geom.material)
    if material.photo is None:
        return vertices, faces, _tiled(spec, part, geom, vertices, faces)
    vertices, faces = _cut_up(vertices, faces)
    shown = read_print(material.photo)
    corners = geom.pose().apply(vertices)[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    _, seen = shown.seen(corners.mean(axis=1), normals)
    at, _ = shown.seen(corners.reshape(-1, 3), np.repeat(normals, 3, axis=0))
    places = shown.texture_places(at, np.repeat(seen, 3))
    return vertices, faces, places.reshape(-1, 3, 2)


def _cut_up(vertices: NDArray, faces: NDArray) -> tuple[NDArray, NDArray]:
    """Cut triangles until none is longer than a share of the whole."""
    from trimesh.remesh import subdivide_to_size

    longest = float(np.linalg.norm(np.ptp(vertices, axis=0))) / PRINT_CUTS
    cut, corners, *_ = subdivide_to_size(vertices, faces, longest, max_iter=20)
    merged, index = np.unique(np.round(cut, 9), axis=0, return_inverse=True)
    corners = index.ravel()[corners]
    whole = (corners[:, 0] != corners[:, 1]) & (corners[:, 1] != corners[:, 2])
    return merged, corners[whole & (corners[:, 2] != corners[:, 0])]


def _tiled(
    spec: ObjectSpec, part: str, geom: GeomSpec, vertices: NDArray, faces: NDArray
) -> NDArray:
    pattern = finish(spec.material(geom.material)).pattern
    assert pattern is not None
    origin = next((np.array(j.pos) for j in spec.joints if j.child == part), np.zeros(3))
    placed = vertices @ matrix(geom.quat).T + np.array(geom.pos) - origin
    corners = placed[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    axis = np.argmax(np.abs(normal), axis=1)
    first, second = np.where(axis == 0, 1, 0), np.where(axis == 2, 1, 2)
    rows = np.arange(len(faces))
    wide, tall = tile_size(pattern)
    u = corners[rows, :, first] / wide
    v = corners[rows, :, second] / tall
    # Renderers keep more digits of small numbers, and whole tiles look the same.
    u = u - np.floor(u.min(axis=1, keepdims=True))
    v = v - np.floor(v.min(axis=1, keepdims=True))
    return np.round(np.stack([u, v], axis=-1), 6)
