"""Triangles out of mesh files from elsewhere."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import SpecError
from ..spec.mesh import MAX_VERTICES

SUFFIXES = (".obj", ".stl", ".ply", ".off", ".glb", ".gltf", ".dae")
MAX_BYTES = 256 << 20


def load_mesh(path: Path) -> tuple[NDArray, NDArray]:
    """Read vertices [v, 3] and triangles [f, 3] of a mesh file, as they are in the file.

    Raises:
        SpecError: it is no mesh, holds numbers that are none, or is too large.
    """
    import trimesh

    if path.suffix.lower() not in SUFFIXES:
        raise SpecError(f"{path}: meshes are read from {', '.join(SUFFIXES)}")
    if path.stat().st_size > MAX_BYTES:
        raise SpecError(f"{path} has over {MAX_BYTES >> 20} MB")
    try:
        loaded = trimesh.load(path, force="mesh", process=False, skip_materials=True)
        vertices, faces = np.array(loaded.vertices, float), np.array(loaded.faces, np.int64)  # pyright: ignore[reportAttributeAccessIssue]
    except Exception as error:  # a library's border
        raise SpecError(f"{path} is no mesh: {type(error).__name__}: {error}"[:300]) from None
    if len(faces) == 0 or len(vertices) < 3:
        raise SpecError(f"{path} holds no triangles")
    if not np.isfinite(vertices).all():
        raise SpecError(f"{path} holds numbers that are none")
    vertices, index = np.unique(np.round(vertices, 9), axis=0, return_inverse=True)
    faces = index.reshape(-1)[faces]
    faces = faces[
        (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    ]
    if len(vertices) > MAX_VERTICES or len(faces) == 0:
        raise SpecError(f"{path} has {len(vertices)} corners; at most {MAX_VERTICES} are read")
    return vertices, faces


__all__ = ["load_mesh"]
