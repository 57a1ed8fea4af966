"""Export of an object part as one glTF mesh with vertex colors, which needs only one draw call.

A browser without a GPU spends most of the time per frame on lighting and triangles. In a large
scene, vertex colors therefore include the lighting, and surfaces are simplified, with deviations
that the photograph's camera does not resolve.
"""

import json
import struct
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...render.appearance import linear
from ...render.part_meshes import PartMesh, visible_meshes, visible_triangles
from ...spec import ObjectSpec, PartSpec, SceneSpec
from ...spec.pose import rotate

LIT_TRIANGLES = 20_000
"""Largest number of triangles of a scene that the browser lights and that is not simplified."""
TOLERANCE = 5e-4
"""Largest deviation of simplified surfaces, relative to the distance from the camera: a third of a
pixel in a picture of 640 rows."""
SKY, SUN, GROUND = 1.2, 3.0, 0.4
"""Intensities of the page's lights: ambient light, light from above, and light from below."""
TO_SUN = np.array([-0.19, -0.19, 0.96])
"""Direction of the light from above."""
SHEEN = 0.015
"""Uncolored reflectance of a dielectric."""
_GLTF, _JSON, _BIN = 0x46546C67, 0x4E4F534A, 0x004E4942
_FLOAT, _UINT = 5126, 5125


class Detail(NamedTuple):
    """Level of detail of a scene's surfaces."""

    tolerance: float = 0.0
    """Largest deviation of simplified surfaces [m]; if 0, every triangle is kept."""
    lit: bool = True
    """If True, the browser lights surfaces; if False, vertex colors include the lighting."""


def detail_of(scene: SceneSpec, distance: float) -> Detail:
    """Return the level of detail for a scene.

    Args:
        scene: the scene.
        distance: distance of the objects from the camera [m].
    """
    count = sum(visible_triangles(part) for obj in scene.objects for part in obj.spec.parts)
    return Detail() if count <= LIT_TRIANGLES else Detail(TOLERANCE * distance, lit=False)


def part_glb(spec: ObjectSpec, part: PartSpec, quat: NDArray, detail: Detail) -> bytes | None:
    """Return the opaque surfaces of a part as binary glTF.

    Args:
        spec: the object.
        part: a part of the object.
        quat: rotation from the object's frame, with all joints at zero, to the part in the world.
        detail: level of detail.

    Returns:
        The glTF, in the object's frame with all joints at zero; None if the part has no opaque
        surface.
    """
    meshes = visible_meshes(spec, part, opaque=True, tolerance=detail.tolerance)
    if not meshes:
        return None
    normals = np.vstack([vertex_normals(mesh) for mesh in meshes])
    colors = np.repeat(
        linear(np.array([mesh.rgb for mesh in meshes]) / 255),
        [len(mesh.vertices) for mesh in meshes],
        axis=0,
    )
    if not detail.lit:
        colors = _light(rotate(quat, normals))[:, None] * ((1 - SHEEN) * colors + SHEEN)
    starts = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes])
    faces = np.vstack([mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)])
    return _glb(np.vstack([mesh.vertices for mesh in meshes]), normals, colors, faces, detail.lit)


def vertex_normals(mesh: PartMesh) -> NDArray:
    """Return the unit normals at vertices [v, 3], area-weighted means over the adjacent faces."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]].astype(float) for k in range(3))
    areas = np.repeat(np.cross(b - a, c - a), 3, axis=0)
    index, count = mesh.faces.ravel(), len(mesh.vertices)
    total = np.stack([np.bincount(index, areas[:, k], count) for k in range(3)], axis=1)
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-30)


def _light(normals: NDArray) -> NDArray:
    """Return the brightness [n] of white surfaces, given normals [n, 3] in the world frame."""
    sun = np.clip(normals @ (TO_SUN / np.linalg.norm(TO_SUN)), 0.0, None)
    return (SKY + SUN * sun + GROUND * np.clip(-normals[:, 2], 0.0, None)) / np.pi


def _glb(vertices: NDArray, normals: NDArray, colors: NDArray, faces: NDArray, lit: bool) -> bytes:
    arrays = [np.asarray(array, "<f4") for array in (vertices, normals, colors)]
    buffers = [array.tobytes() for array in (*arrays, faces.astype("<u4"))]
    starts = np.cumsum([0] + [len(buffer) for buffer in buffers]).tolist()
    accessors: list[dict[str, object]] = [
        {"bufferView": k, "componentType": _FLOAT, "count": len(vertices), "type": "VEC3"}
        for k in range(3)
    ]
    accessors[0] |= {"min": arrays[0].min(axis=0).tolist(), "max": arrays[0].max(axis=0).tolist()}
    accessors.append(
        {"bufferView": 3, "componentType": _UINT, "count": faces.size, "type": "SCALAR"}
    )
    attributes = {"POSITION": 0, "NORMAL": 1, "COLOR_0": 2}
    unlit = {} if lit else {"extensions": {"KHR_materials_unlit": {}}}
    surface = {"metallicFactor": 0, "roughnessFactor": 1}
    document = {
        "asset": {"version": "2.0"},
        "extensionsUsed": [] if lit else ["KHR_materials_unlit"],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "materials": [{"pbrMetallicRoughness": surface, **unlit}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": 3, "material": 0}]}],
        "accessors": accessors,
        "bufferViews": [
            {"buffer": 0, "byteOffset": start, "byteLength": len(buffer)}
            for start, buffer in zip(starts, buffers, strict=False)
        ],
        "buffers": [{"byteLength": starts[-1]}],
    }
    if lit:
        del document["extensionsUsed"]  # glTF forbids an empty list.
    return _packed(json.dumps(document).encode(), buffers)


def _packed(text: bytes, buffers: Sequence[bytes]) -> bytes:
    text += b" " * (-len(text) % 4)
    content = b"".join(buffers)
    chunks = struct.pack("<II", len(text), _JSON) + text
    chunks += struct.pack("<II", len(content), _BIN) + content
    return struct.pack("<III", _GLTF, 2, 12 + len(chunks)) + chunks
