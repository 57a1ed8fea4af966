"""Samples of data sets of real poses, written from scenes by this project's own renderer."""

import json
from pathlib import Path

import numpy as np
from neoworld_bench.measures.pose_measure import Intrinsics
from neoworld_bench.real_poses.scene_depth import intrinsics_of, scene_points
from PIL import Image

from neoworld_mjx.render import visible_surface
from neoworld_mjx.spec import Box, Camera, Cylinder, SceneObject, SceneSpec, world_poses
from neoworld_mjx.spec.pose import matrix
from tests.support.scenes import CERAMIC, single

SIZE = (160, 120)
TENTH_MM = 0.1
"""Depth scale of the samples, in millimeters."""


def desk(camera: Camera | None = None) -> SceneSpec:
    """Return a block, a turned carton and a can on a table, seen by a camera."""
    camera = camera or Camera(width=160, height_px=120, fovy=0.7, height=0.5, pitch=0.6)
    table = single("table", (Box(size=(0.6, 0.8, 0.04)), (0, 0, 0.02)))
    block = single("block", (Box(size=(0.06, 0.05, 0.1)), (0, 0, 0.05)))
    carton = single("carton", (Box(size=(0.12, 0.07, 0.05)), (0, 0, 0.025)))
    can = single("can", (Cylinder(radius=0.035, height=0.11), (0, 0, 0.055)), material=CERAMIC)
    on = {"parent": "table", "z": 0.04}
    return SceneSpec(
        name="desk",
        objects=(
            SceneObject(name="table", spec=table, environment=True, xy=(0.8, 0.0)),
            SceneObject(name="block", spec=block, xy=(0.02, 0.12), yaw=0.3, **on),
            SceneObject(name="carton", spec=carton, xy=(-0.1, -0.05), yaw=0.8, **on),
            SceneObject(name="can", spec=can, xy=(0.05, -0.15), **on),
        ),
        camera=camera,
    )


def write_bop(folder: Path, scenes, *, cameras=None, models="models", unit_mm=1.0, split="test"):
    """Write a data set in the BOP format with one image of each scene.

    Args:
        folder: of the data set.
        scenes: scenes with the same movable objects, each with a camera.
        cameras: intrinsics by image; those of the scenes' cameras by default.
        models: folder of the meshes.
        unit_mm: millimeters of a unit of the meshes.
        split: folder of the scene.
    """
    place = folder / split / "000007"
    (place / "depth").mkdir(parents=True)
    (folder / models).mkdir()
    movable = [item for item in scenes[0].objects if not item.environment]
    info = {}
    for number, item in enumerate(movable, start=1):
        vertices, faces = visible_surface(item.spec)
        write_ply(folder / models / f"obj_{number:06d}.ply", 1e3 / unit_mm * vertices, faces)
        low, size = vertices.min(axis=0), np.ptp(vertices, axis=0)
        info[number] = dict(
            zip(("min_x", "min_y", "min_z"), (1e3 * low).tolist(), strict=True),
            size_x=1e3 * float(size[0]),
        )
    (folder / models / "models_info.json").write_text(json.dumps(info))
    entries, poses, shares = {}, {}, {}
    for image, scene in enumerate(scenes, start=3):
        camera = (cameras or {}).get(image) or intrinsics_of(scene.camera, *SIZE)
        k = [camera.fx, 0, camera.cx, 0, camera.fy, camera.cy, 0, 0, 1]
        entries[image] = {"cam_K": k, "depth_scale": TENTH_MM}
        drawn = scene_points(scene, scene.camera, camera, SIZE)
        write_depth(place / "depth" / f"{image:06d}.png", drawn.points[..., 2])
        poses[image] = [
            _pose_entry(number, scene, item.name) for number, item in enumerate(movable, start=1)
        ]
        shares[image] = [{"visib_fract": 1.0} for _ in movable]
    for name, value in (
        ("scene_camera.json", entries),
        ("scene_gt.json", poses),
        ("scene_gt_info.json", shares),
    ):
        (place / name).write_text(json.dumps(value))
    return folder


def camera_of(scene: SceneSpec) -> Camera:
    """Return the camera of a scene that has one."""
    assert scene.camera is not None
    return scene.camera


def camera_pose(scene: SceneSpec, name: str) -> np.ndarray:
    """Return the pose [4, 4] m of an object in the frame of the scene's camera (OpenCV)."""
    camera = camera_of(scene)
    pose, axes = world_poses(scene)[name], camera.axes()
    result = np.eye(4)
    result[:3, :3] = axes.T @ matrix(pose.quat)
    result[:3, 3] = axes.T @ (pose.pos - camera.position())
    return result


def write_depth(file: Path, depth: np.ndarray) -> None:
    """Write a depth image [m] in tenths of millimeters; 0 where nothing is hit."""
    known = np.where(np.isfinite(depth), depth, 0.0)
    values = np.round(known * 1e3 / TENTH_MM).astype(np.uint16)
    Image.fromarray(values).save(file)


def write_ply(file: Path, vertices: np.ndarray, faces: np.ndarray) -> None:
    """Write an ASCII PLY file, as BOP's models."""
    head = [
        "ply",
        "format ascii 1.0",
        f"element vertex {len(vertices)}",
        *(f"property float {axis}" for axis in "xyz"),
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "end_header",
    ]
    rows = [" ".join(f"{value:.9g}" for value in row) for row in vertices]
    triangles = [f"3 {a} {b} {c}" for a, b, c in faces.tolist()]
    file.write_text("\n".join([*head, *rows, *triangles]) + "\n")


def write_depth_folder(folder: Path, scene: SceneSpec, name: str = "desk") -> Intrinsics:
    """Write the depth image of a scene and the camera's intrinsics; return these."""
    camera = intrinsics_of(camera_of(scene), *SIZE)
    drawn = scene_points(scene, camera_of(scene), camera, SIZE)
    folder.mkdir(parents=True, exist_ok=True)
    write_depth(folder / f"{name}-depth.png", drawn.points[..., 2])
    stated = {**camera._asdict(), "depth_scale": TENTH_MM}
    (folder / "camera.json").write_text(json.dumps(stated))
    return camera


def _pose_entry(number: int, scene: SceneSpec, name: str) -> dict:
    pose = camera_pose(scene, name)
    return {
        "obj_id": number,
        "cam_R_m2c": pose[:3, :3].reshape(-1).tolist(),
        "cam_t_m2c": (1e3 * pose[:3, 3]).tolist(),
    }
