"""Reads triangles and colors from untrusted mesh files.

Readers call these functions in a limited worker (`io.limited_worker`), which bounds the memory and
the time that a file takes, whatever it declares.
"""

import io
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import SpecError
from ..io import read_untrusted_bytes
from ..spec.shapes import MAX_VERTICES
from .asset_files import inside, refuse_entities
from .gltf_file import GLTF, file_surfaces
from .mesh_colors import Color, Surface, face_weights, mean_color, small_png, texture_color

SUFFIXES = (".obj", ".stl", ".ply", ".off", ".dae", *GLTF)
PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".tga", ".tif", ".tiff", ".webp")


def joined(surfaces: list[Surface]) -> tuple[NDArray, NDArray]:
    """Return surfaces as one mesh, whose equal vertices are merged."""
    starts = np.cumsum([0, *(len(surface.vertices) for surface in surfaces)])
    vertices = np.concatenate([surface.vertices for surface in surfaces])
    faces = np.concatenate([s.faces + first for s, first in zip(surfaces, starts, strict=False)])
    return merged_vertices(vertices, faces)


def load_surfaces(path: Path, notes: list[str]) -> list[Surface]:
    """Return the surfaces of a mesh file, one for each material, in the file's units and axes.

    Collada states its unit, so its surfaces are in meters.

    Args:
        path: the file.
        notes: list to which notes on colors are added.

    Raises:
        SpecError: the file is not a mesh, contains numbers that are not finite, or is too large.
    """
    kind = path.suffix.lower()
    if kind not in SUFFIXES:
        raise SpecError(f"{path}: mesh files end in {', '.join(SUFFIXES)}")
    surfaces = file_surfaces(path, notes) if kind in GLTF else _by_trimesh(path, kind, notes)
    if sum(len(surface.vertices) for surface in surfaces) > 6 * MAX_VERTICES:
        raise SpecError(f"{path} has too many vertices; the limit is {MAX_VERTICES}")
    result = []
    for surface in surfaces:
        vertices, faces = surface.vertices, surface.faces
        if faces.ndim != 2 or vertices.ndim != 2 or len(faces) == 0:
            continue
        if faces.min() < 0 or faces.max() >= len(vertices):
            raise SpecError(f"{path}: a face refers to a missing vertex")
        if not np.isfinite(vertices).all():
            raise SpecError(f"{path} has numbers that are not finite")
        merged = merged_vertices(vertices, faces)
        if len(merged[0]) > MAX_VERTICES:
            raise SpecError(f"{path} has {len(merged[0])} vertices; the limit is {MAX_VERTICES}")
        if len(merged[1]):
            result.append(surface._replace(vertices=merged[0], faces=merged[1]))
    if not result:
        raise SpecError(f"{path} has no triangles")
    return result


def _by_trimesh(path: Path, kind: str, notes: list[str]) -> list[Surface]:
    import trimesh

    data = read_untrusted_bytes(path, SpecError)
    if kind == ".dae":
        refuse_entities(path, data)
    try:
        loaded: Any = trimesh.load(
            io.BytesIO(data),
            file_type=kind[1:],
            resolver=_folder_files(path, notes),
            force="scene",
            process=False,
        )
        meshes = loaded.dump(concatenate=False)
        return [_surface(mesh, notes) for mesh in meshes if hasattr(mesh, "faces")]
    except (SpecError, MemoryError):
        raise
    except Exception as error:  # trimesh raises errors of many types
        raise SpecError(f"{path} is not a mesh: {type(error).__name__}: {error}"[:300]) from None


def _surface(mesh: Any, notes: list[str]) -> Surface:
    """Return a mesh of trimesh with its color; one of Collada is converted to meters."""
    vertices, faces = np.array(mesh.vertices, float), np.array(mesh.faces, np.int64)
    unit = str(mesh.metadata.get("units") or "")
    if unit.endswith(" * meters"):
        vertices *= float(unit.removesuffix(" * meters"))
    if len(faces) == 0 or faces.max() >= len(vertices):
        return Surface(vertices, faces)
    visual, rgba = mesh.visual, None
    if visual.kind == "texture":
        material = visual.material
        image = getattr(material, "image", None) or getattr(material, "baseColorTexture", None)
        rgba = np.array(material.main_color, float) / 255
        stated = getattr(material, "kwargs", {})
        if "d" in stated:  # MTL states opacity or transparency.
            rgba[3] = float(np.ravel(stated["d"])[0])
        elif "tr" in stated:
            rgba[3] = 1.0 - float(np.ravel(stated["tr"])[0])
        if image is not None and visual.uv is not None:
            # Files that name a texture often leave the color black.
            factor = rgba if rgba[:3].any() else np.ones(4)
            rgba = factor * texture_color(image, np.asarray(visual.uv), vertices, faces, notes)
    elif visual.kind in ("vertex", "face"):
        colors = np.asarray(visual.face_colors, float) / 255
        rgba = mean_color(colors, face_weights(vertices, faces), f"{visual.kind} colors", notes)
    return Surface(vertices, faces, None if rgba is None else as_color(rgba))


def as_color(rgba: NDArray) -> Color:
    """Return an array [4] as a color."""
    red, green, blue, alpha = (float(v) for v in rgba)
    return red, green, blue, alpha


def merged_vertices(vertices: NDArray, faces: NDArray) -> tuple[NDArray, NDArray]:
    """Merge equal vertices [v, 3], and remove duplicate and degenerate triangles [f, 3]."""
    vertices, index = np.unique(np.round(vertices, 9), axis=0, return_inverse=True)
    faces = index.reshape(-1)[faces]
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    # Equal triangles may start at different corners.
    first = (faces.argmin(axis=1)[:, None] + np.arange(3)) % 3
    _, unique = np.unique(np.take_along_axis(faces, first, axis=1), axis=0, return_index=True)
    return vertices, faces[np.sort(unique)]


def _folder_files(path: Path, notes: list[str]) -> Any:
    """Return a resolver that gives a mesh file access to materials and pictures of its asset."""
    from trimesh.resolvers import Resolver

    class Files(Resolver):
        def __init__(self) -> None:
            pass

        def get(self, key: str) -> bytes:
            name = str(key)
            try:
                file = inside(path, name)
                if name.lower().endswith(PICTURES):
                    return small_png(read_untrusted_bytes(file, SpecError), file.name)
                if name.lower().endswith(".mtl"):
                    return read_untrusted_bytes(file, SpecError)
            except SpecError as error:
                notes.append(f"{path.name}: {error}"[:200])
            raise FileNotFoundError(name)

        def keys(self) -> list[str]:
            return []

        def namespaced(self, namespace: str) -> Resolver:
            raise FileNotFoundError(namespace)

        def write(self, name: str, data: bytes) -> None:
            raise PermissionError(name)

    return Files()
