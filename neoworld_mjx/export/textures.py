"""Textures of an object, and texture coordinates on the object's surfaces.

As in rendered images, the tiles of a pattern are projected onto a triangle along the axis of the
part's frame that is nearest to the triangle's normal. Prints of the photograph are projected from
the photograph's camera.
"""

import numpy as np
from numpy.typing import NDArray

from ..render.prints import read_print
from ..render.tiles import tile_png, tile_size
from ..spec import GeomSpec, Material, ObjectSpec
from ..spec.finish import finish
from ..spec.pose import matrix
from .link_frames import link_origins
from .load_mesh import merged_vertices

TEXTURES = "textures"
"""Folder of the textures, relative to the object's folder."""
PRINT_CUTS = 24
"""Minimum ratio of a printed surface's bounding-box diagonal to its longest triangle edge."""


def is_textured(spec: ObjectSpec, geom: GeomSpec) -> bool:
    """Return True if a geom is visible and has a texture."""
    return geom.role != "collision" and has_texture(spec.material(geom.material))


def has_texture(material: Material) -> bool:
    """Return True if a material has a pattern or a print of the photograph."""
    return material.photo is not None or finish(material).pattern is not None


def texture_file(material: Material) -> str:
    """Return the path of a material's texture, relative to the object's folder."""
    return f"{TEXTURES}/{material.name}.png"


def texture_files(spec: ObjectSpec) -> dict[str, bytes]:
    """Return the PNG textures of an object's visible geoms, by path relative to its folder."""
    textured = [
        spec.material(geom.material)
        for part in spec.parts
        for geom in part.geoms
        if is_textured(spec, geom)
    ]
    tiles = {texture_file(material): tile_png(material) for material in textured}
    return {path: png for path, png in tiles.items() if png is not None}


def visible_surface(
    spec: ObjectSpec, part: str, geom: GeomSpec
) -> tuple[NDArray, NDArray, NDArray | None]:
    """Return the visible surface of a geom, in the geom's frame.

    Args:
        spec: the object.
        part: name of the part that the geom belongs to.
        geom: the geom.

    Returns:
        Vertices [m], shape [vertex, 3]; faces, shape [face, 3]; and texture coordinates of each
        corner, with v upward, shape [face, 3, 2], or None if the geom has no texture. Printed faces
        are subdivided, because texture coordinates follow the photograph's perspective only at
        corners.
    """
    vertices, faces = geom.shape.surface()
    if not is_textured(spec, geom):
        return vertices, faces, None
    material = spec.material(geom.material)
    if material.photo is None:
        return vertices, faces, _tiled(spec, part, geom, vertices, faces)
    vertices, faces = _subdivided(vertices, faces)
    photo = read_print(material.photo)
    corners = geom.pose().apply(vertices)[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    _, visible = photo.project(corners.mean(axis=1), normals)
    position, _ = photo.project(corners.reshape(-1, 3), np.repeat(normals, 3, axis=0))
    uv = photo.texture_coordinates(position, np.repeat(visible, 3))
    return vertices, faces, uv.reshape(-1, 3, 2)


def _subdivided(vertices: NDArray, faces: NDArray) -> tuple[NDArray, NDArray]:
    """Subdivide triangles until no edge is longer than the diagonal divided by `PRINT_CUTS`."""
    from trimesh.remesh import subdivide_to_size

    longest = float(np.linalg.norm(np.ptp(vertices, axis=0))) / PRINT_CUTS
    cut, corners, *_ = subdivide_to_size(vertices, faces, longest, max_iter=20)
    return merged_vertices(cut, corners)


def _tiled(
    spec: ObjectSpec, part: str, geom: GeomSpec, vertices: NDArray, faces: NDArray
) -> NDArray:
    pattern = finish(spec.material(geom.material)).pattern
    assert pattern is not None
    corners = (vertices @ matrix(geom.quat).T + np.array(geom.pos) - link_origins(spec)[part])[
        faces
    ]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    axis = np.argmax(np.abs(normal), axis=1)
    first, second = np.where(axis == 0, 1, 0), np.where(axis == 2, 1, 2)
    rows = np.arange(len(faces))
    wide, tall = tile_size(pattern)
    u = corners[rows, :, first] / wide
    v = corners[rows, :, second] / tall
    # Offsets by whole tiles have no effect, and renderers represent small numbers more precisely.
    u = u - np.floor(u.min(axis=1, keepdims=True))
    v = v - np.floor(v.min(axis=1, keepdims=True))
    return np.round(np.stack([u, v], axis=-1), 6)
