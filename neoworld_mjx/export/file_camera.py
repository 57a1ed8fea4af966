"""Camera of a photograph, as stated in the file of a scene or in a camera.json."""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from pydantic import Field, model_validator

from ..errors import PhotoError, SpecError
from ..io import read_model
from ..spec import Camera, Spec
from ..spec.base import Number
from ..spec.pose import Pose, from_yaw, pose, rotate

Row = tuple[Number, Number, Number, Number]
OFF_CENTER = 0.005
"""Largest distance of the principal point from the center of an image that is not cropped,
relative to the size of the image."""
SAME_FOCAL = 0.02
"""Largest accepted relative difference between fx and fy."""
VERTICAL = 1e-6
"""A camera looks straight down or up if the horizontal component of its unit viewing direction is
at most this value."""


class FileCamera(Spec):
    """Pinhole camera: its pose, and its intrinsics, given as fovy or as fx, fy, cx and cy."""

    pose: tuple[Row, Row, Row, Row] | None = None
    """Rigid transform from the camera's frame (OpenCV: x right, y down, z ahead) to the scene's
    world frame (Z up) [m]; None if the pose is not stated."""
    fovy: float | None = Field(default=None, gt=0.01, lt=math.pi - 0.01)
    """Vertical field of view [rad]."""
    fx: float | None = Field(default=None, gt=0, allow_inf_nan=False)
    """Focal lengths (fx, fy) and principal point (cx, cy) [px], as in BOP's camera.json."""
    fy: float | None = Field(default=None, gt=0, allow_inf_nan=False)
    cx: Number | None = None
    cy: Number | None = None

    @model_validator(mode="after")
    def _complete(self) -> "FileCamera":
        stated = [value is not None for value in (self.fx, self.fy, self.cx, self.cy)]
        if any(stated) and not all(stated):
            raise ValueError("fx, fy, cx and cy must be given together")
        if self.fx is not None and self.fy is not None and self.fovy is not None:
            raise ValueError("give fovy, or fx, fy, cx and cy, not both")
        if self.fx and self.fy and abs(self.fx / self.fy - 1) > SAME_FOCAL:
            raise ValueError(f"fx {self.fx:g} and fy {self.fy:g} differ: pixels must be square")
        if self.pose is not None:
            rotation = np.array(self.pose)[:3, :3]
            rigid = (
                np.abs(rotation @ rotation.T - np.eye(3)).max() < 1e-3
                and np.linalg.det(rotation) > 0
            )
            if not rigid or not np.allclose(self.pose[3], (0, 0, 0, 1)):
                raise ValueError("pose is not a rigid transform (a 4 x 4 matrix)")
        return self

    def completed_by(self, other: "FileCamera | None") -> "FileCamera":
        """Return a copy whose missing pose or intrinsics are taken from another camera."""
        if other is None:
            return self
        update: dict[str, object] = {}
        if self.pose is None:
            update["pose"] = other.pose
        if self.fovy is None and self.fx is None:
            update |= {key: getattr(other, key) for key in ("fovy", "fx", "fy", "cx", "cy")}
        return self.model_copy(update=update)


class Viewpoint(NamedTuple):
    """Camera of a photograph, and the transform that moves the scene in front of the camera."""

    camera: Camera
    scene_transform: Pose
    """Horizontal translation and rotation about the vertical that are applied to the scene, so that
    the camera is above the origin and heads along +x."""
    left: int
    """First column of the photograph that the camera's image shows [px]."""
    top: int
    """First row of the photograph that the camera's image shows [px]."""


def read_camera(path: Path) -> FileCamera:
    """Read a camera.json.

    Raises:
        SpecError: the file is missing, or is not a camera.
    """
    return read_model(path, FileCamera, SpecError, "a camera")


def viewpoint(camera: FileCamera, width: int, height: int) -> Viewpoint:
    """Return the camera of a photograph, and the transform of the scene to the camera.

    The camera's image is the photograph, cropped so that its center is the principal point.

    Args:
        camera: the camera, with pose and intrinsics.
        width: width of the photograph [px].
        height: height of the photograph [px].

    Raises:
        PhotoError: the camera has no pose or no intrinsics, or the intrinsics do not fit the size
            of the photograph.
    """
    if camera.pose is None or (camera.fovy is None and camera.fx is None):
        missing = "pose" if camera.pose is None else "field of view (fovy, or fx, fy, cx and cy)"
        raise PhotoError(f"the camera of the photograph has no {missing}: {CAMERA_HELP}")
    left, top, size, focal = 0, 0, [width, height], 0.0
    if camera.fovy is not None:
        focal = height / 2 / math.tan(camera.fovy / 2)
    elif camera.fx and camera.fy and camera.cx is not None and camera.cy is not None:
        focal = (camera.fx + camera.fy) / 2
        half = [min(camera.cx, width - camera.cx), min(camera.cy, height - camera.cy)]
        if min(half[0] / width, half[1] / height) < 0.25:
            raise PhotoError(
                f"the principal point ({camera.cx:g}, {camera.cy:g}) is not near the middle of a "
                f"photograph of {width} x {height} pixels: give the intrinsics for this size"
            )
        crop = [abs(h - s / 2) > OFF_CENTER * s for h, s in zip(half, (width, height), strict=True)]
        if crop[0]:
            left, size[0] = max(round(camera.cx - half[0]), 0), round(2 * half[0])
        if crop[1]:
            top, size[1] = max(round(camera.cy - half[1]), 0), round(2 * half[1])
    fovy = 2 * math.atan(size[1] / 2 / focal)
    level_camera = Camera(width=size[0], height_px=size[1], fovy=fovy, height=0, pitch=0)
    matrix = np.array(camera.pose)
    heading, pitch, roll = _angles(matrix[:3, :3])
    rotation = from_yaw(-heading)
    eye = rotate(rotation, matrix[:3, 3])
    update = {"height": float(eye[2]), "pitch": pitch, "roll": roll}
    return Viewpoint(
        Camera.model_validate(dict(level_camera) | update),
        pose((-float(eye[0]), -float(eye[1]), 0.0), rotation),
        left,
        top,
    )


CAMERA_HELP = (
    'give it by --camera FILE.json, as {"fx": 600, "fy": 600, "cx": 320, "cy": 240, '
    '"pose": [[4x4]]}, '
    "where pose transforms the camera's frame (OpenCV) to the scene's world frame (Z up); or give "
    "it in the scene's file (docs/how-to/rescue-meshes.md)"
)


def _angles(axes: Float[np.ndarray, "3 3"]) -> tuple[float, float, float]:
    """Return the heading, downward pitch and roll of a camera [rad], given its axes as columns."""
    right, down, ahead = axes.T
    level = ahead if np.hypot(*ahead[:2]) > VERTICAL else -down * np.sign(-ahead[2])
    heading = math.atan2(level[1], level[0])
    pitch = math.asin(float(np.clip(-ahead[2], -1, 1)))
    level_right = np.array([math.sin(heading), -math.cos(heading), 0.0])
    level_down = np.cross(ahead, level_right)
    return heading, pitch, math.atan2(float(right @ level_down), float(right @ level_right))


def level_transform(up: Float[np.ndarray, "3"]) -> Float[np.ndarray, "4 4"]:
    """Return the transform from a camera's frame (OpenCV) to a world frame with a level floor.

    The origin of the world frame is the camera, its z axis points up, and its x axis is the
    horizontal viewing direction.

    Args:
        up: vector of any length that points up, in the camera's frame.

    Raises:
        SpecError: `up` is zero.
    """
    size = float(np.linalg.norm(up))
    if size < 1e-6:
        raise SpecError("up must not be zero")
    z = np.asarray(up, float) / size
    ahead = np.array([0.0, 0.0, 1.0])
    x = ahead - (ahead @ z) * z
    if np.linalg.norm(x) < VERTICAL:  # x is the image's top (looking down) or bottom (looking up).
        x = np.array([0.0, -1.0, 0.0]) * -np.sign(ahead @ z)
    x /= np.linalg.norm(x)
    result = np.eye(4)
    result[:3, :3] = np.stack([x, np.cross(z, x), z])
    return result
