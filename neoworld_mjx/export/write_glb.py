"""glTF of objects and scenes, for viewers: what is visible, posed, one node for every link."""

from io import BytesIO
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image

from ..errors import ExportError
from ..render.tiles import tile_png
from ..spec import (
    ObjectSpec,
    SceneObject,
    SceneSpec,
    link_poses,
    single_object_scene,
    world_poses,
)
from ..spec.finish import finish
from ..spec.pose import Pose, matrix
from ..spec.triangles import corner_normals
from .textures import visible_surface

if TYPE_CHECKING:
    import trimesh


def glb_bytes(scene: SceneSpec | ObjectSpec) -> bytes:
    """Return a binary glTF file, Y up and in metres, with colours, shine and textures."""
    import trimesh

    if isinstance(scene, ObjectSpec):
        scene = single_object_scene(scene)
    # Names of objects have no hyphens, so these are free.
    base = f"{scene.name}-scene"
    result = trimesh.Scene(base_frame=base)
    # Ours has Z up: a quarter turn about x.
    up = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    result.graph.update(frame_from=base, frame_to="z-up", matrix=up)
    poses = world_poses(scene)
    for item in scene.objects:
        _add_object(result, item, poses[item.name])
    content = result.export(file_type="glb")
    if not isinstance(content, bytes):
        raise ExportError("trimesh writes no binary glTF")
    return content


def _add_object(result: "trimesh.Scene", item: SceneObject, at: Pose) -> None:
    import trimesh
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    result.graph.update(frame_from="z-up", frame_to=item.name, matrix=_transform(at))
    moved = link_poses(item.spec, item.joint_state)
    materials = {}
    for material in item.spec.materials:
        made = finish(material)
        tile = tile_png(material)
        # A texture is multiplied by the colour, so that is white.
        colour = material.rgba if tile is None else (1.0, 1.0, 1.0, material.rgba[3])
        materials[material.name] = PBRMaterial(
            name=f"{item.name}-{material.name}",
            baseColorFactor=[round(255 * v) for v in colour],
            baseColorTexture=None if tile is None else Image.open(BytesIO(tile), formats=["PNG"]),
            metallicFactor=made.metallic,
            roughnessFactor=made.roughness,
            alphaMode="BLEND" if material.rgba[3] < 1 else "OPAQUE",
        )
    for part in item.spec.parts:
        link = f"{item.name}-{part.name}"
        result.graph.update(
            frame_from=item.name, frame_to=link, matrix=_transform(moved[part.name])
        )
        for geom in part.geoms:
            if geom.role == "collision":
                continue
            vertices, faces, uv = visible_surface(item.spec, part.name, geom)
            # Corners of their own keep edges sharp.
            mesh = trimesh.Trimesh(
                vertices[faces].reshape(-1, 3),
                np.arange(faces.size).reshape(-1, 3),
                vertex_normals=corner_normals(vertices, faces).reshape(-1, 3),
                process=False,
            )
            mesh.visual = TextureVisuals(
                uv=None if uv is None else uv.reshape(-1, 2), material=materials[geom.material]
            )
            name = f"{item.name}-{part.name}-{geom.name}"
            result.add_geometry(
                mesh,
                geom_name=name,
                node_name=name,
                parent_node_name=link,
                transform=_transform(geom.pose()),
            )


def _transform(at: Pose) -> np.ndarray:
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = matrix(at.quat), at.pos
    return result
