"""Mesh and texture files of an object, and formatting of numbers for all text formats.

As in rendered images, the tiles of a pattern are projected onto a triangle along the axis of the
part's frame that is nearest to the triangle's normal. Prints of the photograph are projected from
the photograph's camera.
"""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from ..render.prints import read_print
from ..render.tiles import tile_png, tile_size
from ..spec import GeomSpec, Material, ObjectSpec
from ..spec.base_shape import BaseShape
from ..spec.convex import Piece, hull
from ..spec.finish import finish
from ..spec.pose import matrix
from ..spec.triangles import corner_normals
from .link_frames import link_origins
from .load_mesh import merged_vertices

FOLDER = "meshes"


def number(value: float) -> str:
    """Return the shortest string that parses to the same number."""
    text = repr(float(value))
    text = text.removesuffix(".0")
    return "0" if text == "-0" else text


def numbers(values: Iterable[float]) -> str:
    """Return a string of numbers, separated by spaces."""
    return " ".join(number(value) for value in values)


def urdf_primitive(shape: BaseShape) -> Piece | None:
    """Return a shape as a primitive of URDF (box, sphere or cylinder), or None if it is not one."""
    piece = shape.primitive()
    return piece if piece is not None and piece.kind in ("box", "sphere", "cylinder") else None


def visual_file(geom: GeomSpec) -> str | None:
    """Return the path of a geom's visual mesh, or None if the geom is a primitive of URDF."""
    if urdf_primitive(geom.shape) is not None:
        return None
    return f"{FOLDER}/{geom.name}.obj"


def collision_file(geom: GeomSpec, k: int) -> str:
    """Return the path of the mesh of a geom's k-th convex piece."""
    # Geom names have no hyphens, so this is never the path of a visual mesh.
    return f"{FOLDER}/{geom.name}-{k}.obj"


def piece_mesh(geom: GeomSpec, piece: Piece) -> tuple[NDArray, NDArray] | None:
    """Return the vertices [v, 3] and faces [f, 3] of a convex piece; None if it needs no mesh.

    URDF and UsdPhysics have no ellipsoids. An ellipsoid becomes its tessellated surface, whose
    facets are inside the ellipsoid by up to 1 % of the radius.
    """
    if piece.kind == "mesh":
        return hull(piece.vertices)
    if piece.kind == "ellipsoid":
        return geom.shape.surface()
    return None


def mesh_files(spec: ObjectSpec) -> dict[str, str]:
    """Return the OBJ text of each mesh file of an object, by path relative to the object's folder.

    A textured geom always has a mesh, with texture coordinates.
    """
    files: dict[str, str] = {}
    for part in spec.parts:
        for geom in part.geoms:
            has_visual = is_textured(spec, geom) or visual_file(geom) is not None
            if geom.role != "collision" and has_visual:
                vertices, faces, uv = visible_surface(spec, part.name, geom)
                files[f"{FOLDER}/{geom.name}.obj"] = obj(vertices, faces, smooth=True, uv=uv)
            if geom.role == "visual":
                continue
            for k, piece in enumerate(geom.shape.pieces()):
                mesh = piece_mesh(geom, piece)
                if mesh is not None:
                    files[collision_file(geom, k)] = obj(*mesh)
    return files


def obj(
    vertices: NDArray, faces: NDArray, *, smooth: bool = False, uv: NDArray | None = None
) -> str:
    """Return a triangle mesh as Wavefront OBJ text.

    Args:
        vertices: positions [m], shape [vertex, 3].
        faces: vertex indices, shape [face, 3].
        smooth: if True, write a normal for each corner.
        uv: texture coordinates of each corner, with v upward, shape [face, 3, 2]; requires
            `smooth`.
    """
    lines = [f"v {numbers(v)}" for v in np.round(vertices, 9).tolist()]
    corners = (faces + 1).tolist()
    if not smooth:
        lines += [f"f {a} {b} {c}" for a, b, c in corners]
        return "\n".join(lines) + "\n"
    normals = np.round(corner_normals(vertices, faces).reshape(-1, 3), 6) + 0.0
    unique, index = np.unique(normals, axis=0, return_inverse=True)
    lines += [f"vn {numbers(n)}" for n in unique.tolist()]
    textured = [("", "", "")] * len(corners)
    if uv is not None:
        points, uv_index = np.unique(uv.reshape(-1, 2) + 0.0, axis=0, return_inverse=True)
        lines += [f"vt {numbers(t)}" for t in points.tolist()]
        textured = (uv_index.reshape(-1, 3) + 1).tolist()
    lines += [
        f"f {a}/{p}/{i} {b}/{q}/{j} {c}/{r}/{k}"
        for (a, b, c), (p, q, r), (i, j, k) in zip(
            corners, textured, (index.reshape(-1, 3) + 1).tolist(), strict=True
        )
    ]
    return "\n".join(lines) + "\n"


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
