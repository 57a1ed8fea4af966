"""Writes glTF files of the visible surfaces of objects and scenes, and of the photograph's camera.

The root nodes are the objects and the camera. The children of an object's node are its links, and
the children of a link's node are its geoms.
"""

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
from ..spec.pose import Pose
from ..spec.triangles import corner_normals
from .link_frames import transform
from .meshes import visible_surface

if TYPE_CHECKING:
    import trimesh

Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""Transform from Z-up axes to glTF's Y-up axes. Frames of objects and links are also Y-up."""
OBJECT_EXTRAS = {"neoworld": "object"}
"""Extras of the node of an object."""


def glb_bytes(scene: SceneSpec | ObjectSpec) -> bytes:
    """Return a binary glTF file (Y up, meters) with colors, metallic, roughness and textures.

    A scene's camera becomes a node with glTF's camera axes (x right, y up, z back).
    """
    import trimesh
    from trimesh.scene import Camera

    if isinstance(scene, ObjectSpec):
        scene = single_object_scene(scene)
    # Object names have no hyphens, so these names are unused.
    base = f"{scene.name}-scene"
    result = trimesh.Scene(base_frame=base)
    poses = world_poses(scene)
    for item in scene.objects:
        _add_object(result, item, poses[item.name])
    if scene.camera is not None:
        width, height, fovy = scene.camera.width, scene.camera.height_px, scene.camera.fovy
        # trimesh writes the ratio of its two angles as glTF's aspect ratio.
        fov = np.degrees([fovy * width / height, fovy])
        result.camera = Camera(name=f"{scene.name}-camera", resolution=(width, height), fov=fov)
        result.camera_transform = Y_UP @ transform(scene.camera.pose())
    content = result.export(file_type="glb")
    if not isinstance(content, bytes):
        raise ExportError("trimesh did not return binary glTF")
    return content


def _add_object(result: "trimesh.Scene", item: SceneObject, pose: Pose) -> None:
    import trimesh
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    result.graph.update(
        frame_from=result.graph.base_frame,
        frame_to=item.name,
        matrix=Y_UP @ transform(pose) @ Y_UP.T,
        metadata=OBJECT_EXTRAS,
    )
    part_poses = link_poses(item.spec, item.joint_state)
    materials = {}
    for material in item.spec.materials:
        surface = finish(material)
        tile = tile_png(material)
        # glTF multiplies a texture by the color, so the color is white.
        color = material.rgba if tile is None else (1.0, 1.0, 1.0, material.rgba[3])
        materials[material.name] = PBRMaterial(
            name=f"{item.name}-{material.name}",
            baseColorFactor=[round(255 * v) for v in color],
            baseColorTexture=None if tile is None else Image.open(BytesIO(tile), formats=["PNG"]),
            metallicFactor=surface.metallic,
            roughnessFactor=surface.roughness,
            alphaMode="BLEND" if material.rgba[3] < 1 else "OPAQUE",
        )
    for part in item.spec.parts:
        link = f"{item.name}-{part.name}"
        # As in MuJoCo, a part without visual shapes shows its colliders.
        visible = [geom for geom in part.geoms if geom.role != "collision"]
        for geom in visible or part.geoms:
            vertices, faces, uv = visible_surface(item.spec, part.name, geom)
            # Separate vertices for each corner keep edges sharp.
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
                transform=Y_UP @ transform(geom.pose()),
            )
        result.graph.update(
            frame_from=item.name,
            frame_to=link,
            matrix=Y_UP @ transform(part_poses[part.name]) @ Y_UP.T,
        )
