"""Reads triangles from untrusted mesh files, and checks untrusted XML before a library parses it.

Readers call these functions in a limited worker (`io.limited_worker`), which bounds the memory and
the time that a file takes, whatever it declares.
"""

import io
import json
import os
import re
import struct
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import SpecError
from ..io import file_bounds
from ..io.files import MIB, read_bytes
from ..io.text_files import MAX_DEPTH
from ..spec.shapes import MAX_VERTICES

DECLARED = re.compile(rb"<!\s*(DOCTYPE|ENTITY)", re.IGNORECASE)
_NAMES = ("name", "file", "filename", "class", "childclass", "mesh", "material", "texture", "joint")
"""Attributes whose values are names, which may look like numbers."""


def read_xml(path: Path) -> ET.Element:
    """Read an XML file that may be hostile or broken.

    Raises:
        SpecError: the file cannot be read, is truncated, declares entities, is nested too deeply,
            or contains a number that is not finite.
    """
    try:
        data = read_bytes(path, file_bounds().max_file_mib * MIB)
    except OSError as error:
        raise SpecError(f"cannot read {path}: {error.strerror}") from None
    refuse_entities(path, data)
    try:
        root = ET.fromstring(data)
    except (ET.ParseError, ValueError, LookupError) as error:
        raise SpecError(f"{path} is not valid XML: {error}") from None
    level = [root]
    for _ in range(MAX_DEPTH):
        level = [child for element in level for child in element]
    if level:
        raise SpecError(f"{path} is nested more than {MAX_DEPTH} elements deep")
    for element in root.iter():
        for key, value in element.attrib.items():
            if key not in _NAMES and not all(map(_is_finite, value.split())):
                label = element.get("name") or element.tag
                raise SpecError(
                    f"{path}: {element.tag} {label!r}: {key}={value!r} is not a finite number"
                )
    return root


def refuse_entities(path: Path, data: bytes) -> None:
    """Raise a SpecError if an XML file declares a document type or entities, which may expand."""
    for text in (data, data[:4096].replace(b"\0", b"")):  # UTF-16 has a zero byte per letter.
        if DECLARED.search(text):
            raise SpecError(f"{path} declares a document type or entities, which are not read")


def _is_finite(word: str) -> bool:
    """Return False if a word is a number that is infinite or NaN."""
    try:
        return isfinite(float(word))
    except ValueError:
        return True


def inside(path: Path, reference: str) -> Path:
    """Return the path of a file that an XML file refers to.

    Args:
        path: the XML file.
        reference: name or URI of the other file, as written in the XML file.

    Raises:
        SpecError: the other file is outside the XML file's folder, or does not exist.
    """
    folder = path.resolve().parent
    plain = re.sub(r"^(package|model|file)://", "", reference.strip())
    if plain != reference.strip() and reference.strip().startswith(("package://", "model://")):
        # The name of the package may, but need not, be the name of a folder.
        without_package = plain.split("/", 1)[-1]
        plain = plain if (folder / plain).exists() else without_package
    return inside_any(path, [plain], reference)


def inside_any(path: Path, candidates: Sequence[str], reference: str) -> Path:
    """Return the first existing file among the files that a name in an XML file may refer to.

    Args:
        path: the XML file.
        candidates: paths relative to the XML file's folder.
        reference: the name, for messages.

    Raises:
        SpecError: a candidate is outside the XML file's folder, or no candidate exists.
    """
    folder = path.resolve().parent
    # An absolute candidate replaces the folder, and is refused unless it is below the folder.
    targets = [Path(os.path.join(folder, candidate)).resolve() for candidate in candidates]
    if not all(target.is_relative_to(folder) for target in targets):
        raise SpecError(f"{path} names {reference!r}, which lies outside its folder {folder}")
    existing = [target for target in targets if target.is_file()]
    if not existing:
        raise SpecError(f"{path} names {reference!r}, which does not exist")
    return existing[0]


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
