"""Ground truth of a real photograph: camera, depth, and objects with meshes and poses.

Readers of data sets return these views; files are a stranger's and are read within bounds. The
views of a folder of depth images, registered to the photographs, have no objects:

    DATA/NAME-depth.png       16 bits
    DATA/camera.json          {"fx": 1066.778, "fy": 1067.487, "cx": 312.987, "cy": 241.311,
                               "depth_scale": 0.1}, as BOP's camera.json
"""

from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from neoworld_mjx.errors import SpecError
from neoworld_mjx.io import file_bounds, open_image, read_object
from neoworld_mjx.io.files import MIB, read_bytes

from ..measures.depth_measure import Intrinsics

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
    try:
        data = read_bytes(file, file_bounds().max_picture_mib * MIB)
    except OSError as error:
        raise SpecError(f"cannot read {file}: {error.strerror}") from None
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
