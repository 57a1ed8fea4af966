"""Textures of an object: tiles of its patterned materials, and where on its surfaces they lie.

A tile is laid on the face of the axis that a triangle's normal is nearest to, in metres of the
part's own frame, as in our pictures.
"""

import numpy as np
from numpy.typing import NDArray

from ..render.tiles import tile_png, tile_size
from ..spec import GeomSpec, Material, ObjectSpec
from ..spec.finish import finish
from ..spec.pose import matrix

TEXTURES = "textures"
"""Folder beside an object's files."""


def is_textured(spec: ObjectSpec, geom: GeomSpec) -> bool:
    """Return whether a geom is seen with a texture."""
    return geom.role != "collision" and finish(spec.material(geom.material)).pattern is not None


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


def texture_coordinates(
    spec: ObjectSpec, part: str, geom: GeomSpec, vertices: NDArray, faces: NDArray
) -> NDArray | None:
    """Return (u, v) of every corner of every face, [face, 3, 2], v upwards; None without a texture.

    Args:
        spec: the object.
        part: the part that the geom belongs to.
        geom: the geom.
        vertices: of its surface, in its own frame [vertex, 3] m.
        faces: of its surface [face, 3].
    """
    if not is_textured(spec, geom):
        return None
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
