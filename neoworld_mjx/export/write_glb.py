"""Visible surfaces of objects: mesh and texture files for all formats, and glTF files.

As in rendered images, the tiles of a pattern are projected onto a triangle along the axis of the
part's frame that is nearest to the triangle's normal. Prints of the photograph are projected from
the photograph's camera.

A glTF file contains the photograph's camera. Its root nodes are the objects and the camera. The
children of an object's node are its links, and the children of a link's node are its geoms.
"""

from collections.abc import Iterable
from functools import lru_cache
from io import BytesIO
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ..errors import ExportError
from ..physics.lowering import ellipsoid_corners
from ..render.appearance import read_print
from ..render.tiles import tile_png, tile_size
from ..spec import (
    GeomSpec,
    Material,
    ObjectSpec,
    SceneObject,
    SceneSpec,
    Shape,
    link_poses,
    single_object_scene,
    world_poses,
)
from ..spec.convex import Piece, hull
from ..spec.finish import finish
from ..spec.pose import Pose, matrix
from ..spec.primitives import BaseShape
from ..spec.triangles import corner_normals
from .link_frames import link_origins, transform
from .load_mesh import merged_vertices

if TYPE_CHECKING:
    import trimesh

FOLDER = "meshes"


def number(value: float) -> str:
    """Return the shortest string that parses to the same number."""
    text = repr(float(value))
    text = text.removesuffix(".0")
    return "0" if text == "-0" else text


def numbers(values: Iterable[float]) -> str:
    """Return a string of numbers, separated by spaces."""
    return " ".join(number(value) for value in values)


def urdf_primitive(shape: BaseShape) -> Piece | None:
    """Return a shape as a primitive of URDF (box, sphere or cylinder), or None if it is not one."""
    piece = shape.primitive()
    return piece if piece is not None and piece.kind in ("box", "sphere", "cylinder") else None


def visual_file(geom: GeomSpec) -> str | None:
    """Return the path of a geom's visual mesh, or None if the geom is a primitive of URDF."""
    if urdf_primitive(geom.shape) is not None:
        return None
    return f"{FOLDER}/{geom.name}.obj"


def collision_file(geom: GeomSpec, k: int) -> str:
    """Return the path of the mesh of a geom's k-th convex piece."""
    # Geom names have no hyphens, so this is never the path of a visual mesh.
    return f"{FOLDER}/{geom.name}-{k}.obj"


def piece_mesh(piece: Piece) -> tuple[NDArray, NDArray] | None:
    """Return the vertices [v, 3] and faces [f, 3] of a convex piece; None if it needs no mesh.

    URDF and UsdPhysics have no ellipsoids. An ellipsoid becomes the polyhedron that replaces it in
    files for MJX: it rests on a flat face, and has fewer corners than PhysX allows (64).
    """
    if piece.kind == "mesh":
        return hull(piece.vertices)
    if piece.kind == "ellipsoid":
        return hull(tuple(map(tuple, ellipsoid_corners(np.array(piece.size)).tolist())))
    return None


def mesh_files(spec: ObjectSpec) -> dict[str, str]:
    """Return the OBJ text of each mesh file of an object, by path relative to the object's folder.

    A textured geom always has a mesh, with texture coordinates.
    """
    files: dict[str, str] = {}
    for part in spec.parts:
        for geom in part.geoms:
            has_visual = is_textured(spec, geom) or visual_file(geom) is not None
            if geom.role != "collision" and has_visual:
                vertices, faces, uv = visible_surface(spec, part.name, geom)
                files[f"{FOLDER}/{geom.name}.obj"] = obj(vertices, faces, smooth=True, uv=uv)
            if geom.role == "visual":
                continue
            for k, piece in enumerate(geom.shape.pieces()):
                mesh = piece_mesh(piece)
                if mesh is not None:
                    files[collision_file(geom, k)] = obj(*mesh)
    return files


def obj(
    vertices: NDArray, faces: NDArray, *, smooth: bool = False, uv: NDArray | None = None
) -> str:
    """Return a triangle mesh as Wavefront OBJ text.

    Args:
        vertices: positions [m], shape [vertex, 3].
        faces: vertex indices, shape [face, 3].
        smooth: if True, write a normal for each corner.
        uv: texture coordinates of each corner, with v upward, shape [face, 3, 2]; requires
            `smooth`.
    """
    lines = [f"v {numbers(v)}" for v in np.round(vertices, 9).tolist()]
    corners = (faces + 1).tolist()
    if not smooth:
        lines += [f"f {a} {b} {c}" for a, b, c in corners]
        return "\n".join(lines) + "\n"
    normals = np.round(corner_normals(vertices, faces).reshape(-1, 3), 6) + 0.0
    unique, index = np.unique(normals, axis=0, return_inverse=True)
    lines += [f"vn {numbers(n)}" for n in unique.tolist()]
    textured = [("", "", "")] * len(corners)
    if uv is not None:
        points, uv_index = np.unique(uv.reshape(-1, 2) + 0.0, axis=0, return_inverse=True)
        lines += [f"vt {numbers(t)}" for t in points.tolist()]
        textured = (uv_index.reshape(-1, 3) + 1).tolist()
    lines += [
        f"f {a}/{p}/{i} {b}/{q}/{j} {c}/{r}/{k}"
        for (a, b, c), (p, q, r), (i, j, k) in zip(
            corners, textured, (index.reshape(-1, 3) + 1).tolist(), strict=True
        )
    ]
    return "\n".join(lines) + "\n"


TEXTURES = "textures"
"""Folder of the textures, relative to the object's folder."""
PRINT_CUTS = 24
"""Minimum ratio of a printed surface's bounding-box diagonal to its longest triangle edge."""


def is_textured(spec: ObjectSpec, geom: GeomSpec) -> bool:
    """Return True if a geom is visible and has a texture."""
    return geom.role != "collision" and has_texture(spec.material(geom.material))


def has_texture(material: Material) -> bool:
    """Return True if a material has a pattern or a print of the photograph."""
    return material.photo is not None or finish(material).pattern is not None


def texture_file(material: Material) -> str:
    """Return the path of a material's texture, relative to the object's folder."""
    return f"{TEXTURES}/{material.name}.png"


def texture_files(spec: ObjectSpec) -> dict[str, bytes]:
    """Return the PNG textures of an object's visible geoms, by path relative to its folder."""
    textured = [
        spec.material(geom.material)
        for part in spec.parts
        for geom in part.geoms
        if is_textured(spec, geom)
    ]
    tiles = {texture_file(material): tile_png(material) for material in textured}
    return {path: png for path, png in tiles.items() if png is not None}


def visible_surface(
    spec: ObjectSpec, part: str, geom: GeomSpec
) -> tuple[NDArray, NDArray, NDArray | None]:
    """Return the visible surface of a geom, in the geom's frame.

    Args:
        spec: the object.
        part: name of the part that the geom belongs to.
        geom: the geom.

    Returns:
        Vertices [m], shape [vertex, 3]; faces, shape [face, 3]; and texture coordinates of each
        corner, with v upward, shape [face, 3, 2], or None if the geom has no texture. Printed faces
        are subdivided, because texture coordinates follow the photograph's perspective only at
        corners.
    """
    if not is_textured(spec, geom):
        return *geom.shape.surface(), None
    material = spec.material(geom.material)
    if material.photo is None:
        vertices, faces = geom.shape.surface()
        return vertices, faces, _tiled(spec, part, geom, vertices, faces)
    vertices, faces = _subdivided(geom.shape)  # pyright: ignore[reportArgumentType] hashable
    photo = read_print(material.photo)
    corners = geom.pose().apply(vertices)[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    _, visible = photo.project(corners.mean(axis=1), normals)
    position, _ = photo.project(corners.reshape(-1, 3), np.repeat(normals, 3, axis=0))
    uv = photo.texture_coordinates(position, np.repeat(visible, 3))
    return vertices, faces, uv.reshape(-1, 3, 2)


@lru_cache(maxsize=256)
def _subdivided(shape: Shape) -> tuple[NDArray, NDArray]:
    """Subdivide a surface until no edge is longer than its diagonal divided by `PRINT_CUTS`."""
    from trimesh.remesh import subdivide_to_size

    vertices, faces = shape.surface()
    longest = float(np.linalg.norm(np.ptp(vertices, axis=0))) / PRINT_CUTS
    cut, corners, *_ = subdivide_to_size(vertices, faces, longest, max_iter=20)
    return merged_vertices(cut, corners)


def _tiled(
    spec: ObjectSpec, part: str, geom: GeomSpec, vertices: NDArray, faces: NDArray
) -> NDArray:
    pattern = finish(spec.material(geom.material)).pattern
    assert pattern is not None
    corners = (vertices @ matrix(geom.quat).T + np.array(geom.pos) - link_origins(spec)[part])[
        faces
    ]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    axis = np.argmax(np.abs(normal), axis=1)
    first, second = np.where(axis == 0, 1, 0), np.where(axis == 2, 1, 2)
    rows = np.arange(len(faces))
    wide, tall = tile_size(pattern)
    u = corners[rows, :, first] / wide
    v = corners[rows, :, second] / tall
    # Offsets by whole tiles have no effect, and renderers represent small numbers more precisely.
    u = u - np.floor(u.min(axis=1, keepdims=True))
    v = v - np.floor(v.min(axis=1, keepdims=True))
    return np.round(np.stack([u, v], axis=-1), 6)


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
