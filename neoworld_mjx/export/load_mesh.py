"""Reads triangles from untrusted mesh files.

Readers call these functions in a limited worker (`io.limited_worker`), which bounds the memory and
the time that a file takes, whatever it declares.
"""

import io
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import SpecError
from ..io import file_bounds
from ..io.files import MIB, read_bytes
from ..spec.mesh import MAX_VERTICES
from .checked_xml import inside, refuse_entities

SUFFIXES = (".obj", ".stl", ".ply", ".off", ".glb", ".gltf", ".dae")


def load_mesh(path: Path) -> tuple[NDArray, NDArray]:
    """Return the vertices [v, 3] and triangles [f, 3] of a mesh file, in the file's units.

    Raises:
        SpecError: the file is not a mesh, contains numbers that are not finite, or is too large.
    """
    import trimesh

    kind = path.suffix.lower()
    if kind not in SUFFIXES:
        raise SpecError(f"{path}: mesh files end in {', '.join(SUFFIXES)}")
    data = mesh_bytes(path)
    if kind == ".dae":
        refuse_entities(path, data)
    try:
        loaded = trimesh.load(
            io.BytesIO(data),
            file_type=kind[1:],
            resolver=folder_buffers(path),
            force="mesh",
            process=False,
            skip_materials=True,
        )
        vertices, faces = np.array(loaded.vertices, float), np.array(loaded.faces, np.int64)  # pyright: ignore[reportAttributeAccessIssue]
    except (SpecError, MemoryError):
        raise
    except Exception as error:  # trimesh raises errors of many types
        raise SpecError(f"{path} is not a mesh: {type(error).__name__}: {error}"[:300]) from None
    if len(faces) == 0 or len(vertices) < 3 or faces.ndim != 2 or vertices.ndim != 2:
        raise SpecError(f"{path} has no triangles")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise SpecError(f"{path}: a face refers to a missing vertex")
    if not np.isfinite(vertices).all():
        raise SpecError(f"{path} has numbers that are not finite")
    vertices, faces = merged_vertices(vertices, faces)
    if len(vertices) > MAX_VERTICES or len(faces) == 0:
        raise SpecError(f"{path} has {len(vertices)} vertices; the limit is {MAX_VERTICES}")
    return vertices, faces


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


def mesh_bytes(path: Path) -> bytes:
    """Read a mesh file of at most `files.max_file_mib`; raise a SpecError if it cannot be read."""
    try:
        return read_bytes(path, file_bounds().max_file_mib * MIB)
    except OSError as error:
        raise SpecError(f"cannot read {path}: {error.strerror}") from None


def gltf_document(data: bytes) -> dict[str, Any]:
    """Return the JSON document of a text or binary glTF file, without checking its contents."""
    if data[:4] == b"glTF" and len(data) >= 20:
        (length,) = struct.unpack_from("<I", data, 12)
        data = data[20 : 20 + length]
    return json.loads(data)


def folder_buffers(path: Path) -> Any:
    """Return a resolver that gives a glTF file access only to .bin files in its folder."""
    from trimesh.resolvers import Resolver

    class Buffers(Resolver):
        def __init__(self) -> None:
            pass

        def get(self, key: str) -> bytes:
            if not str(key).endswith(".bin"):
                raise FileNotFoundError(key)
            return mesh_bytes(inside(path, str(key)))

        def keys(self) -> list[str]:
            return []

        def namespaced(self, namespace: str) -> Resolver:
            raise FileNotFoundError(namespace)

        def write(self, name: str, data: bytes) -> None:
            raise PermissionError(name)

    return Buffers()
