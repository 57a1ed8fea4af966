"""Reads the nodes, meshes and colors of untrusted glTF 2.0 files.

Accessors may be normalized, quantized or sparse. Compressed meshes (Draco, meshopt), skins and
morph targets are refused.
"""

import base64
import json
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ..errors import SpecError
from ..io import read_untrusted_bytes
from .asset_files import inside
from .mesh_colors import Color, Surface, face_weights, mean_color, small_image, texture_color

GLTF = (".glb", ".gltf")
MAX_NODES = 500
_TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
READ = ("KHR_mesh_quantization", "KHR_texture_transform", "KHR_lights_", "KHR_materials_",
        "KHR_xmp", "KHR_node_visibility", "EXT_texture_webp", "KHR_animation_pointer")  # fmt: skip
"""Beginnings of the names of extensions that are read, or that do not affect geometry."""
COMPRESSED = ("KHR_draco_mesh_compression", "EXT_meshopt_compression", "EXT_mesh_gpu_instancing")
"""Extensions without which a mesh is missing or wrong, whether or not the file requires them."""


@dataclass(frozen=True)
class GltfFile:
    """Contents of a glTF file."""

    path: Path
    document: dict[str, Any]
    """The JSON document."""
    binary: bytes
    """The binary chunk of a .glb file."""

    def rows(self, kind: str) -> list[dict[str, Any]]:
        """Return the list of a kind of element, such as nodes; empty if the file has none."""
        return self.document.get(kind, [])


def read_gltf_file(path: Path) -> GltfFile:
    """Read a text or binary glTF file.

    Raises:
        SpecError: the file cannot be read, or requires an extension that is not read.
        ValueError, KeyError, ...: the file is broken.
    """
    data, binary = read_untrusted_bytes(path, SpecError), b""
    if data[:4] == b"glTF":
        (length,) = struct.unpack_from("<I", data, 12)
        binary = data[20 + length + 8 :]
        data = data[20 : 20 + length]
    document = json.loads(data)
    if not str(document.get("asset", {}).get("version", "2")).startswith("2"):
        raise SpecError(f"{path} is glTF {document['asset']['version']}; only glTF 2.0 is read")
    used = (set(document.get("extensionsUsed", ())) & set(COMPRESSED)) | _refused(document)
    required = {e for e in document.get("extensionsRequired", ()) if not str(e).startswith(READ)}
    if used | required:
        names = ", ".join(sorted(map(str, used | required)))
        raise SpecError(
            f"{path} uses {names}, which cannot be read: export it without this extension, or "
            "expand it (for example by `gltf-transform copy IN.glb OUT.glb`)"
        )
    return GltfFile(path, document, binary)


def _refused(document: dict[str, Any]) -> set[str]:
    """Return the features of a document without which its meshes would be wrong, by name."""
    moved = [*document.get("nodes", ()), *document.get("meshes", ())]
    found = {
        "skins": any("skin" in row for row in moved),
        "morph targets": any(any(row.get("weights", ())) for row in moved),
    }
    return {name for name, used in found.items() if used}


def parents_of(file: GltfFile) -> dict[int, int]:
    """Return the parent of each node that has one."""
    nodes = file.rows("nodes")
    return {child: k for k, node in enumerate(nodes) for child in node.get("children", ())}


def node_matrix(
    file: GltfFile, parents: dict[int, int], node: int, top: int | None = None
) -> NDArray:
    """Return the transform from a node to the node `top` above it, by default to the world."""
    result, above, nodes = np.eye(4), node, file.rows("nodes")
    for _ in range(len(nodes)):
        if above == top:
            return result
        result = local_matrix(nodes[above]) @ result
        if above not in parents:
            return result
        above = parents[above]
    raise ValueError("its nodes form a cycle")


def local_matrix(node: dict[str, Any]) -> NDArray:
    """Return the transform from a glTF node (with a matrix, or T R S) to its parent, [4, 4]."""
    from trimesh import transformations

    if "matrix" in node:
        return np.reshape(np.asarray(node["matrix"], float), (4, 4)).T
    x, y, z, w = node.get("rotation", (0.0, 0.0, 0.0, 1.0))
    turn = transformations.quaternion_matrix([w, x, y, z])
    turn[:3, :3] *= np.asarray(node.get("scale", (1.0, 1.0, 1.0)), float)
    turn[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return turn


def roots_of(file: GltfFile) -> list[int]:
    """Return the root nodes of the scene that the file shows."""
    scenes = file.rows("scenes")
    if scenes:
        return list(scenes[file.document.get("scene", 0)].get("nodes", ()))
    parents = parents_of(file)
    return [k for k in range(len(file.rows("nodes"))) if k not in parents]


def nodes_below(file: GltfFile, roots: list[int]) -> list[int]:
    """Return nodes with all nodes below them, parents first."""
    nodes, result, waiting = file.rows("nodes"), list[int](), list(reversed(roots))
    while waiting:
        node = waiting.pop()
        result.append(node)
        if len(result) > len(nodes):
            raise ValueError("its nodes form a cycle")
        waiting += reversed(nodes[node].get("children", ()))
    return result


def file_surfaces(path: Path, notes: list[str]) -> list[Surface]:
    """Return all surfaces of a glTF file in the axes of its world (Y up)."""
    try:
        file = read_gltf_file(path)
        parents, shown = parents_of(file), nodes_below(file, roots_of(file))
        return [
            moved(surface, node_matrix(file, parents, node))
            for node in shown
            for surface in node_surfaces(file, node, notes)
        ]
    except (SpecError, MemoryError):
        raise
    except Exception as error:  # Broken files cause errors of many types.
        raise broken(path, error) from None


def broken(path: Path, error: Exception) -> SpecError:
    """Return the error for a file that is not valid glTF."""
    return SpecError(f"{path} is not glTF: {type(error).__name__}: {error}"[:300])


def node_surfaces(file: GltfFile, node: int, notes: list[str]) -> list[Surface]:
    """Return the surfaces of the mesh of a node, in the frame of the node (Y up)."""
    row = file.rows("nodes")[node]
    if "mesh" not in row:
        return []
    mesh = file.rows("meshes")[row["mesh"]]
    result = []
    for primitive in mesh["primitives"]:
        if "POSITION" not in primitive["attributes"]:
            continue
        faces = _faces(file, primitive)
        if faces is None:
            notes.append("points and lines are not imported")
            continue
        vertices = accessor(file, primitive["attributes"]["POSITION"]).astype(float)
        if not np.isfinite(vertices).all() or faces.max(initial=-1) >= len(vertices):
            raise ValueError("a face refers to a missing vertex, or a vertex is not finite")
        result.append(_with_material(file, primitive, Surface(vertices, faces), notes))
    return result


def moved(surface: Surface, matrix: NDArray) -> Surface:
    """Return a surface transformed by an affine matrix [4, 4], which may mirror."""
    turn = 1 if np.linalg.det(matrix[:3, :3]) > 0 else -1
    points = surface.vertices @ matrix[:3, :3].T + matrix[:3, 3]
    return surface._replace(vertices=points, faces=surface.faces[:, ::turn])


def _faces(file: GltfFile, primitive: dict[str, Any]) -> NDArray | None:
    """Return the triangles of a primitive, [f, 3]; None for points and lines."""
    mode = primitive.get("mode", 4)
    if "indices" in primitive:
        index = accessor(file, primitive["indices"]).reshape(-1).astype(np.int64)
    else:
        index = np.arange(file.rows("accessors")[primitive["attributes"]["POSITION"]]["count"])
    if mode == 4:
        return index[: len(index) // 3 * 3].reshape(-1, 3)
    if mode == 6:  # A fan.
        return np.column_stack([np.full(len(index) - 2, index[0]), index[1:-1], index[2:]])
    if mode != 5:
        return None
    strip = np.column_stack([index[:-2], index[1:-1], index[2:]])
    strip[1::2] = strip[1::2, ::-1]
    return strip


def accessor(file: GltfFile, index: int) -> NDArray:
    """Return the values of an accessor, shape [n, width]; normalized integers become floats."""
    row = file.rows("accessors")[index]
    kind, width, size = row["componentType"], _WIDTHS[row["type"]], int(row["count"])
    if "bufferView" in row:
        values = _values(file, row["bufferView"], row.get("byteOffset", 0), kind, width, size)
    elif size * width > len(file.binary) + 10**7:
        raise ValueError("an accessor without data is too large")
    else:
        values = np.zeros((size, width), _TYPES[kind])
    if "sparse" in row:
        sparse = row["sparse"]
        at, new, count = sparse["indices"], sparse["values"], int(sparse["count"])
        where = (file, at["bufferView"], at.get("byteOffset", 0), at["componentType"], 1, count)
        replaced = (file, new["bufferView"], new.get("byteOffset", 0), kind, width, count)
        values = values.copy()
        values[_values(*where).reshape(-1)] = _values(*replaced)
    if row.get("normalized") and values.dtype.kind in "iu":
        return np.maximum(values / float(np.iinfo(values.dtype).max), -1.0)
    return values


def _values(file: GltfFile, view: int, offset: int, kind: int, width: int, count: int) -> NDArray:
    """Return values of a buffer view, shape [count, width]."""
    row, dtype = file.rows("bufferViews")[view], np.dtype(_TYPES[kind])
    data = _buffer(file, row["buffer"])
    start = row.get("byteOffset", 0)
    data = data[start : start + row["byteLength"]][offset:]
    stride = row.get("byteStride") or width * dtype.itemsize
    need = stride * (count - 1) + width * dtype.itemsize if count else 0
    if count < 0 or offset < 0 or start < 0 or need > len(data):
        raise ValueError("an accessor exceeds its buffer")
    return np.ndarray((count, width), dtype, data, strides=(stride, dtype.itemsize))


def _buffer(file: GltfFile, index: int) -> bytes:
    uri = file.rows("buffers")[index].get("uri")
    return file.binary if uri is None else _linked(file, uri)


def _linked(file: GltfFile, uri: str) -> bytes:
    """Return the contents of a URI: data, or a file of the asset."""
    if uri.startswith("data:"):
        return base64.b64decode(uri.partition(",")[2])
    return read_untrusted_bytes(inside(file.path, uri), SpecError)


def _with_material(
    file: GltfFile, primitive: dict[str, Any], surface: Surface, notes: list[str]
) -> Surface:
    """Return a surface with its color: factor, texture and vertex colors multiplied."""
    attributes, rgba, stated = primitive["attributes"], np.ones(4), False
    vertices, faces = surface.vertices, surface.faces
    material = file.rows("materials")[primitive["material"]] if "material" in primitive else {}
    glossy = material.get("extensions", {}).get("KHR_materials_pbrSpecularGlossiness", {})
    older = {"diffuseFactor": "baseColorFactor", "diffuseTexture": "baseColorTexture"}
    looks = material.get("pbrMetallicRoughness", {}) | {
        older[key]: value for key, value in glossy.items() if key in older
    }
    if "baseColorFactor" in looks:
        rgba, stated = np.asarray(looks["baseColorFactor"], float), True
    if "baseColorTexture" in looks:
        for image, coordinates in _texture(file, looks["baseColorTexture"], attributes, notes):
            rgba = rgba * texture_color(image, coordinates, vertices, faces, notes)
            stated = True
    if "COLOR_0" in attributes and len(faces):
        colors = np.asarray(accessor(file, attributes["COLOR_0"]), float)
        colors = np.column_stack([colors, np.ones(len(colors))])[:, :4][faces].mean(axis=1)
        rgba = rgba * mean_color(colors, face_weights(vertices, faces), "vertex colors", notes)
        stated = True
    if material.get("alphaMode", "OPAQUE") != "BLEND":
        rgba = np.array([*rgba[:3], 1.0])
    red, green, blue, alpha = (float(v) for v in np.clip(rgba, 0, 1))
    color: Color = (red, green, blue, alpha)
    shine = {} if "metallicRoughnessTexture" in looks else looks
    return surface._replace(
        rgba=color if stated else None,
        metallic=shine.get("metallicFactor"),
        roughness=shine.get("roughnessFactor"),
    )


def _texture(
    file: GltfFile, reference: dict[str, Any], attributes: dict[str, int], notes: list[str]
) -> Iterator[tuple[Image.Image, NDArray]]:
    """Yield a texture and its coordinates (v upwards), or nothing if either is missing."""
    transform = reference.get("extensions", {}).get("KHR_texture_transform", {})
    name = f"TEXCOORD_{transform.get('texCoord', reference.get('texCoord', 0))}"
    texture = file.rows("textures")[reference["index"]]
    webp = texture.get("extensions", {}).get("EXT_texture_webp", {})
    source = texture.get("source", webp.get("source"))
    if source is None or name not in attributes:
        notes.append("a texture without a readable image or coordinates is not imported")
        return
    uv = np.asarray(accessor(file, attributes[name]), float)
    uv = uv * transform.get("scale", (1, 1)) + transform.get("offset", (0, 0))
    image = file.rows("images")[source]
    try:
        if "uri" in image:
            data = _linked(file, image["uri"])
        else:
            view = file.rows("bufferViews")[image["bufferView"]]
            start = view.get("byteOffset", 0)
            data = _buffer(file, view["buffer"])[start : start + view["byteLength"]]
        with small_image(data, f"image {source} of {file.path.name}") as opened:
            yield opened, np.column_stack([uv[:, 0], 1 - uv[:, 1]])
    except SpecError as error:
        notes.append(f"a texture is not imported: {error}"[:200])
