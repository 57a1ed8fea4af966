"""Mesh files of an object, and formatting of numbers for all text formats."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from ..spec import GeomSpec, ObjectSpec
from ..spec.base_shape import BaseShape
from ..spec.convex import Piece, hull
from ..spec.triangles import corner_normals
from .textures import is_textured, visible_surface

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
