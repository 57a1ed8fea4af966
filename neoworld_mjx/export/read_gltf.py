"""Reads scenes of meshes from glTF 2.0 files (meters, Y up), whose objects are groups of nodes."""

import io
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import SpecError
from .file_camera import FileCamera
from .load_mesh import folder_buffers, gltf_document, merged_vertices, mesh_bytes
from .mechanism import Triangles
from .read_mesh_scene import MAX_NODES, MeshScene, mesh_object, rows_of
from .write_glb import OBJECT_EXTRAS, Y_UP

SUFFIXES = (".glb", ".gltf")
Z_UP = Y_UP.T
"""Transform from glTF's axes (Y up) to axes with Z up."""
TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
"""Transform from OpenCV's camera axes to glTF's camera axes (x right, y up, z back). The inverse is
the same matrix."""


def read_gltf(path: Path) -> MeshScene:
    """Read the objects and the first perspective camera of a text or binary glTF file.

    Raises:
        SpecError: the file is broken or hostile.
    """
    import trimesh

    data = mesh_bytes(path)
    try:
        loaded: Any = trimesh.load(
            io.BytesIO(data),
            file_type=path.suffix.lower()[1:],
            resolver=folder_buffers(path),
            force="scene",
            process=False,
            skip_materials=True,
        )
        count = len(loaded.graph.nodes_geometry)
        if not 0 < count <= MAX_NODES:
            raise SpecError(f"{path} has {count} meshes in its nodes; expected 1 to {MAX_NODES}")
        posed = [_meshes_below(loaded, node) for node in _object_nodes(loaded.graph)]
        camera = _gltf_camera(gltf_document(data))
    except SpecError:
        raise
    except Exception as error:  # trimesh raises errors of many types
        raise SpecError(f"{path} is not glTF: {type(error).__name__}: {error}"[:300]) from None
    objects = [mesh_object(name, meshes, transform) for name, meshes, transform in posed if meshes]
    return MeshScene(objects, camera)


def _object_nodes(graph: Any) -> list[Any]:
    """Return the nodes of a glTF scene that represent objects.

    An object consists of all meshes in and below its node. The search for objects begins at the
    root of the scene. It descends by a level as long as the current level has a single node with
    meshes in or below it, this node has no mesh, and the node's extras do not mark it as an object.
    """
    meshed, tree = set(graph.nodes_geometry), graph.transforms
    level = [graph.base_frame]
    while len(level) == 1 and level[0] not in meshed:
        extras = tree.edge_data.get((tree.parents.get(level[0]), level[0]), {}).get("metadata")
        if extras and OBJECT_EXTRAS.items() <= extras.items():
            break
        level = [node for node in tree.children.get(level[0], []) if meshed & tree.successors(node)]
    return level


def _meshes_below(loaded: Any, node: Any) -> tuple[str, list[Triangles], NDArray]:
    """Return the name of a node, and the meshes in and below it with their pose.

    The meshes are in the node's frame with Z up. The pose is the affine transform from this frame
    to the world frame, shape [4, 4].
    """
    below = loaded.graph.transforms.successors(node)
    meshes = []
    for inner in (n for n in loaded.graph.nodes_geometry if n in below):
        transform, key = loaded.graph.get(inner, frame_from=node)
        mesh = loaded.geometry[key]
        if hasattr(mesh, "faces"):  # Points and lines are skipped.
            # Copy, because nodes may share a mesh, and a mirroring transform reverses its faces.
            upright = mesh.copy().apply_transform(Z_UP @ np.asarray(transform, float))
            vertices, faces = np.array(upright.vertices, float), np.array(upright.faces, np.int64)
            meshes.append(merged_vertices(vertices, faces))
    return str(node), meshes, Z_UP @ np.asarray(loaded.graph[node][0], float) @ Z_UP.T


def _gltf_camera(document: dict[str, Any]) -> FileCamera | None:
    """Return the first perspective camera of a glTF file.

    The result is None if there is no such camera, or if the transform of its node mirrors or is
    singular. trimesh itself reads only cameras that are children of the root and state their aspect
    ratio.
    """
    nodes = document.get("nodes", [])
    parents = {child: k for k, node in enumerate(nodes) for child in node.get("children", [])}
    for k, node in enumerate(nodes):
        lens = document["cameras"][node["camera"]].get("perspective") if "camera" in node else None
        if lens is None:
            continue
        pose, above = TO_OPENCV, k
        while above is not None:
            pose, above = _local(nodes[above]) @ pose, parents.pop(above, None)
        pose = Z_UP @ pose
        u, scales, v = np.linalg.svd(pose[:3, :3])
        if scales[-1] < 1e-9 or np.linalg.det(u @ v) < 0:
            return None
        # Scales of the nodes above the camera do not change the camera's image.
        pose[:3, :3] = u @ v
        return FileCamera(pose=rows_of(pose), fovy=float(lens["yfov"]))
    return None


def _local(node: dict[str, Any]) -> NDArray:
    """Return the transform from a glTF node (with a matrix, or T R S) to its parent, [4, 4]."""
    from trimesh import transformations

    if "matrix" in node:
        return np.reshape(np.asarray(node["matrix"], float), (4, 4)).T
    x, y, z, w = node.get("rotation", (0.0, 0.0, 0.0, 1.0))
    turn = transformations.quaternion_matrix([w, x, y, z])
    turn[:3, :3] *= np.asarray(node.get("scale", (1.0, 1.0, 1.0)), float)
    turn[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return turn
