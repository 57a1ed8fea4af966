"""Ground truth of a real photograph: camera, depth, and objects with meshes and poses.

Readers of data sets return these views; files are a stranger's and are read within bounds. The
views of a folder of depth images, registered to the photographs, have no objects:

    DATA/NAME-depth.png       16 bits
    DATA/camera.json          {"fx": 1066.778, "fy": 1067.487, "cx": 312.987, "cy": 241.311,
                               "depth_scale": 0.1}, as BOP's camera.json

Data sets in the BOP format: YCB-V, T-LESS, HOPE, HomebrewedDB and others.

    DATA/models_eval/obj_000001.ply, models_info.json      or models, models_cad [mm]
    DATA/SPLIT/SCENE/scene_camera.json, scene_gt.json, scene_gt_info.json, depth/IMAGE.png

Compared field by field with docs/bop_datasets_format.md of thodan/bop_toolkit (commit a3b3256):
`cam_K` and `cam_R_m2c` row by row; poses map the model's frame to the camera's (OpenCV, z ahead);
models and translations in millimeters; depth times `depth_scale` is millimeters; `visib_fract` is
the visible share of the silhouette; the diameter is the largest distance of two vertices of the
evaluation model. Not read: `models_info.json` (diameters are computed, and ADD-S needs no
symmetries), the list of targets, masks, `cam_R_w2c`, and files of several sensors
(`scene_gt_CAMTYPE.json`).
"""

import re
from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from neoworld_mjx.errors import SpecError
from neoworld_mjx.export.load_mesh import joined, load_surfaces
from neoworld_mjx.io import open_image, read_object, read_untrusted_bytes

from ..measures.pose_measure import Intrinsics

ENDING = "-depth.png"
CAMERA = "camera.json"
NOT_ROTATION = 1e-2
"""Largest deviation of R R^T from the identity; data sets round to few digits."""


@dataclass(frozen=True)
class PosedObject:
    """An object of the ground truth, in the frame of its view."""

    name: str
    vertices: Float[np.ndarray, "v 3"]
    """In the model's frame [m]."""
    faces: Int[np.ndarray, "f 3"]
    pose: Float[np.ndarray, "4 4"]
    """Pose of the model in the frame of the view [m]."""
    diameter: float
    """Largest distance of two vertices [m]."""

    @property
    def posed(self) -> Float[np.ndarray, "v 3"]:
        """Vertices in the frame of the view [m]."""
        return self.vertices @ self.pose[:3, :3].T + self.pose[:3, 3]


@dataclass(frozen=True)
class TrueView:
    """One photograph."""

    name: str
    objects: tuple[PosedObject, ...]
    """In the camera's frame (OpenCV: x right, y down, z ahead)."""
    camera: Intrinsics
    size: tuple[int, int] | None = None
    """Width and height of the image [px]; None without a depth image."""
    depth: Float[np.ndarray, "h w"] | None = None
    """Depth along the optical axis [m]; 0 where the sensor measured none."""


def read_depth(file: Path, mm: float) -> Float[np.ndarray, "h w"]:
    """Read a 16-bit depth image as meters.

    Args:
        file: an image of one channel.
        mm: millimeters of one unit, BOP's depth_scale.

    Raises:
        SpecError: it cannot be read, or is no image of one channel.
    """
    data = read_untrusted_bytes(file, SpecError)
    with open_image(data, str(file), SpecError) as image:
        values = np.asarray(image)
    if values.ndim != 2 or values.dtype == bool:
        raise SpecError(f"{file} is no depth image: expected is one channel of 16 bits")
    return values.astype(float) * (mm / 1000)


def numbers(entry: object, key: str, count: int, where: str) -> Float[np.ndarray, " n"]:
    """Return the numbers of an entry of a JSON object.

    Raises:
        SpecError: the entry is missing, or is not a list of so many finite numbers.
    """
    value = entry.get(key) if isinstance(entry, Mapping) else None
    try:
        values = np.asarray(value, float)
    except (TypeError, ValueError):
        values = np.zeros(0)
    if values.size != count or not np.isfinite(values).all():
        raise SpecError(f"{where}: {key} must be {count} numbers")
    return values.reshape(-1)


def rigid(rotation: Any, translation: Any, where: str) -> Float[np.ndarray, "4 4"]:
    """Return a rigid transform from nine numbers row by row and a translation [m].

    The rotation is replaced by the nearest one, as data sets round to few digits.

    Raises:
        SpecError: the numbers are no rotation.
    """
    matrix = np.asarray(rotation, float).reshape(3, 3)
    if np.abs(matrix @ matrix.T - np.eye(3)).max() > NOT_ROTATION or np.linalg.det(matrix) < 0:
        raise SpecError(f"{where}: the rotation is not orthonormal, or mirrors")
    u, _, v = np.linalg.svd(matrix)
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = u @ v, np.asarray(translation, float)
    return result


def diameter_of(vertices: Float[np.ndarray, "v 3"]) -> float:
    """Return the largest distance of two vertices [m]."""
    from scipy.spatial import ConvexHull, QhullError
    from scipy.spatial.distance import pdist

    with suppress(QhullError, ValueError):  # Flat or few points have no hull.
        vertices = vertices[ConvexHull(vertices).vertices]
    return float(pdist(vertices).max()) if len(vertices) > 1 else 0.0


def is_depth_folder(path: Path) -> bool:
    """Return True if a folder has depth images."""
    return any(path.glob(f"*{ENDING}"))


def depth_views(path: Path, names: Collection[str]) -> Iterator[TrueView]:
    """Read the depth images of a folder.

    Args:
        path: the folder.
        names: of the photographs to read, as far as there are any.

    Raises:
        SpecError: a file is missing or broken.
    """
    stated = read_object(path / CAMERA, SpecError)
    fx, fy, cx, cy, mm = (
        float(numbers(stated, key, 1, str(path / CAMERA))[0])
        for key in ("fx", "fy", "cx", "cy", "depth_scale")
    )
    if min(fx, fy, mm) <= 0:
        raise SpecError(f"{path / CAMERA}: focal lengths and the depth scale must be above 0")
    for file in sorted(path.glob(f"*{ENDING}")):
        name = file.name.removesuffix(ENDING)
        if name in names:
            depth = read_depth(file, mm)
            size = depth.shape[1], depth.shape[0]
            yield TrueView(name, (), Intrinsics(fx, fy, cx, cy), size, depth)


MODELS = ("models_eval", "models", "models_cad", "models_reconst", "models_fine")
"""Folders of meshes in millimeters, in the order of preference."""
CAMERA_FILE, POSES, INFO = "scene_camera.json", "scene_gt.json", "scene_gt_info.json"
LEAST_VISIBLE = 0.1
"""Least visible share of an object; BOP's targets have the same bound."""
IMAGES = (".png", ".jpg", ".tif")


def is_bop(path: Path) -> bool:
    """Return True if a folder is a data set in the BOP format, or a scene of one."""
    return (path / POSES).is_file() or bool(_scene_folders(path))


def bop_views(path: Path, names: Collection[str]) -> Iterator[TrueView]:
    """Read the views of a data set.

    A view is named SCENE_IMAGE with the numbers of the files, such as 000048_000001; where
    several splits have the scene, SPLIT_SCENE_IMAGE. Of objects that appear several times, all but
    the first are named with a number: obj_000005, obj_000005_2.

    Args:
        path: the data set, a split, or a scene.
        names: of the views to read, as far as there are any.

    Raises:
        SpecError: a file is missing or broken.
    """
    scenes = {path.name: path} if (path / POSES).is_file() else _named_scenes(path)
    if not scenes:
        raise SpecError(f"{path} has no {POSES} in itself, SCENE or SPLIT/SCENE")
    models = _models(path)
    for scene, folder in scenes.items():
        if not any(name.startswith(f"{scene}_") for name in names):
            continue
        cameras, poses = (read_object(folder / name, SpecError) for name in (CAMERA_FILE, POSES))
        info = read_object(folder / INFO, SpecError) if (folder / INFO).is_file() else {}
        for image in sorted(poses, key=_number):
            name = f"{scene}_{_number(image):06d}"
            if name in names:
                yield _view(name, folder, image, cameras, poses[image], info.get(image), models)


def _view(
    name: str,
    folder: Path,
    image: str,
    cameras: Mapping[str, Any],
    poses: Any,
    info: Any,
    models: Path,
) -> TrueView:
    where = f"{folder / CAMERA_FILE}, image {image}"
    camera = cameras.get(image)
    k = numbers(camera, "cam_K", 9, where)
    if min(k[0], k[4]) <= 0:
        raise SpecError(f"{where}: cam_K has no positive focal lengths")
    scale = numbers(camera, "depth_scale", 1, where)[0] if "depth_scale" in (camera or {}) else 1.0
    file = _image(folder / "depth", _number(image))
    depth = None if file is None else read_depth(file, float(scale))
    where = f"{folder / POSES}, image {image}"
    if not isinstance(poses, list):
        raise SpecError(f"{where}: expected is a list of objects")
    objects: list[PosedObject] = []
    for index, entry in enumerate(poses):
        here = f"{where}, object {index}"
        number = int(numbers(entry, "obj_id", 1, here)[0])
        shift = 1e-3 * numbers(entry, "cam_t_m2c", 3, here)
        pose = rigid(numbers(entry, "cam_R_m2c", 9, here), shift, here)
        if _visible(info, index) < LEAST_VISIBLE:
            continue
        vertices, faces, diameter = _model(models, number)
        stem = f"obj_{number:06d}"
        copies = sum(item.name.rpartition("_")[0] == stem or item.name == stem for item in objects)
        label = stem if not copies else f"{stem}_{copies + 1}"
        objects.append(PosedObject(label, vertices, faces, pose, diameter))
    size = None if depth is None else (depth.shape[1], depth.shape[0])
    intrinsics = Intrinsics(float(k[0]), float(k[4]), float(k[2]), float(k[5]))
    return TrueView(name, tuple(objects), intrinsics, size, depth)


def _visible(info: Any, index: int) -> float:
    try:
        return float(info[index]["visib_fract"])
    except (TypeError, KeyError, IndexError, ValueError):
        return 1.0  # Without scene_gt_info.json every object counts.


@lru_cache(maxsize=256)
def _model(folder: Path, number: int) -> tuple[np.ndarray, np.ndarray, float]:
    vertices, faces = joined(load_surfaces(folder / f"obj_{number:06d}.ply", []))
    vertices = 1e-3 * vertices
    return vertices, faces, diameter_of(vertices)


def _models(path: Path) -> Path:
    """Return the folder of meshes of a data set, of which the path may be a part."""
    for root in (path, path.parent, path.parent.parent):
        for name in MODELS:
            if any((root / name).glob("obj_*.ply")):
                return root / name
    raise SpecError(
        f"{path}: no folder with obj_000001.ply and so on; expected next to the scenes is one of "
        f"{', '.join(MODELS)}"
    )


def _scene_folders(path: Path) -> list[Path]:
    pose_files = (path.glob(f"{'*/' * depth}{POSES}") for depth in (1, 2))
    return [file.parent for files in pose_files for file in sorted(files)]


def _named_scenes(path: Path) -> dict[str, Path]:
    folders = _scene_folders(path)
    stems = [folder.name for folder in folders]
    return {
        folder.name
        if stems.count(folder.name) == 1
        else f"{folder.parent.name}_{folder.name}": folder
        for folder in folders
    }


def _image(folder: Path, number: int) -> Path | None:
    files = (folder / f"{number:06d}{suffix}" for suffix in IMAGES)
    return next((file for file in files if file.is_file()), None)


def _number(key: str) -> int:
    if not re.fullmatch(r"\d{1,9}", key):
        raise SpecError(f"image {key[:20]!r} is no number")
    return int(key)
