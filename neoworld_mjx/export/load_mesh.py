"""Reads triangles from untrusted mesh files."""

import io
import json
import re
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import SpecError
from ..io import file_bounds
from ..io.files import MIB, read_bytes
from ..spec.mesh import MAX_VERTICES
from .checked_xml import DECLARED, inside

SUFFIXES = (".obj", ".stl", ".ply", ".off", ".glb", ".gltf", ".dae")
_MAX_INSTANCES = 16
"""Maximum number of node instances in a DAE file; each could double the size of the mesh."""
_MAX_LINE, _MAX_GROUPS = 1 << 16, 10_000
"""Maximum length of a line [bytes], and maximum number of groups and uses of materials, in an OBJ
file."""
_MAX_NODES = 10_000
_MAX_ELEMENTS = 20 * MAX_VERTICES
"""Maximum number of vertices and indices in a glTF file, counted for each instance of a mesh."""


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
    check_claims(path, kind, data)
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
    """Read a mesh file of at most `files.max_mesh_mib`; raise a SpecError if it cannot be read."""
    try:
        return read_bytes(path, file_bounds().max_mesh_mib * MIB)
    except OSError as error:
        raise SpecError(f"cannot read {path}: {error.strerror}") from None


def check_claims(path: Path, kind: str, data: bytes) -> None:
    """Refuse a file that declares more data than it contains, or repeats its data too often."""
    if kind == ".dae":
        if DECLARED.search(data) or DECLARED.search(data[:4096].replace(b"\0", b"")):
            raise SpecError(f"{path} declares a document type or entities, which are not read")
        if data.count(b"instance_node") > _MAX_INSTANCES:
            raise SpecError(f"{path} has more than {_MAX_INSTANCES} node instances")
    if kind == ".ply":
        claims = re.findall(rb"element\s+\S+\s+(\d+)", data[: data.find(b"end_header") + 1])
        if any(len(number) > 12 or int(number) > len(data) for number in claims):
            raise SpecError(f"{path} declares more elements than it has bytes")
    if kind == ".obj":
        if max(map(len, data.splitlines()), default=0) > _MAX_LINE:
            raise SpecError(f"{path} has a line of over {_MAX_LINE} bytes; split large polygons")
        if sum(map(data.count, (b"usemtl", b"\ng ", b"\no "))) > _MAX_GROUPS:
            raise SpecError(f"{path} has over {_MAX_GROUPS} groups and uses of materials")
    if kind in (".glb", ".gltf"):
        _check_accessors(path, data)


def _check_accessors(path: Path, data: bytes) -> None:
    try:
        document = gltf_document(data)
        accessors = document.get("accessors", [])
        counts = [accessor["count"] for accessor in accessors]
        fits = all(isinstance(n, int) and 0 <= n <= _MAX_ELEMENTS for n in counts)
        fits = fits and _instanced(document, counts) <= _MAX_ELEMENTS
    except (ValueError, AttributeError, LookupError, TypeError, RecursionError):
        raise SpecError(f"{path} is not glTF: its JSON cannot be read") from None
    # An accessor without a buffer view stands for any number of zeros.
    if not fits or any("bufferView" not in accessor for accessor in accessors):
        raise SpecError(f"{path} declares more vertices than it contains, or repeats too many")


def gltf_document(data: bytes) -> dict[str, Any]:
    """Return the JSON document of a text or binary glTF file, without checking its contents."""
    if data[:4] == b"glTF" and len(data) >= 20:
        (length,) = struct.unpack_from("<I", data, 12)
        data = data[20 : 20 + length]
    return json.loads(data)


def _instanced(document: dict[str, Any], counts: list[int]) -> int:
    """Return the number of vertices and indices of all instances of meshes in a glTF document."""
    sizes = []
    for mesh in document.get("meshes", []):
        used = [
            index
            for primitive in mesh["primitives"]
            for index in (*primitive["attributes"].values(), primitive.get("indices"))
            if index is not None
        ]
        sizes.append(sum(counts[index] for index in used))
    nodes = document.get("nodes", [])
    total, waiting = 0, [k for scene in document.get("scenes", []) for k in scene.get("nodes", [])]
    # A node may be a child of several others.
    for _ in range(_MAX_NODES):
        if not waiting:
            return total
        node = nodes[waiting.pop()]
        total += sizes[node["mesh"]] if "mesh" in node else 0
        waiting += node.get("children", [])
    return _MAX_ELEMENTS + 1


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
