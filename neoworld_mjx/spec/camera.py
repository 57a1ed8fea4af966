"""The pinhole camera of a photograph, in the world frame."""

import math
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from .base import Number, Spec
from .pose import ArrayLike, Pose, from_matrix, from_yaw, matrix

Gain = Annotated[float, Field(ge=0.1, le=10)]
Offset = tuple[Number, Number]


def _zero(value: Any) -> Any:
    """Return a field that a file omits if it has its default."""
    return Field(default=value, exclude_if=lambda other: other == value)


class Camera(Spec):
    """A pinhole camera with square pixels.

    World frame: z points up; z = 0 is the floor or, if no floor is visible, the top of the main
    support. Unless a scene is expressed in the base frame of a robot, the camera is above the
    world's origin, x points ahead of it and y to its left. Pixels: u points to the right and v
    down; (0, 0) is the outer corner of the first pixel.
    """

    width: Annotated[int, Field(ge=1)]
    height_px: Annotated[int, Field(ge=1)]
    fovy: Annotated[float, Field(gt=0.01, lt=math.pi - 0.01)]
    """Vertical field of view [rad]."""
    height: Number
    """Height of the camera above z = 0 [m]."""
    pitch: Annotated[float, Field(ge=-math.pi / 2, le=math.pi / 2)]
    """Downward angle of the view from the horizontal [rad]."""
    roll: Number = 0.0
    """Clockwise rotation of the camera about the view direction, seen from behind [rad]."""
    principal: Offset = _zero((0.0, 0.0))
    """Principal point relative to the middle of the image, to the right and down [px]."""
    xy: tuple[Number, Number] = _zero((0.0, 0.0))
    """Horizontal position in the world [m]."""
    yaw: Number = _zero(0.0)
    """Direction of the view about +z; 0 looks along +x [rad]."""
    gain: tuple[Gain, Gain, Gain] = Field(
        default=(1.0, 1.0, 1.0), exclude_if=lambda value: value == (1.0, 1.0, 1.0)
    )
    """Exposure and white balance: factors by which the linear red, green and blue of rendered
    images are multiplied."""

    @property
    def focal(self) -> float:
        """Focal length in pixels."""
        return self.height_px / 2 / math.tan(self.fovy / 2)

    @property
    def center(self) -> NDArray:
        """Principal point in the image [px], shape [2]."""
        return np.array([self.width / 2, self.height_px / 2]) + self.principal

    def resized(self, width: int, height: int) -> "Camera":
        """Return the camera of the image resized to `width` x `height` [px]."""
        x, y = self.principal
        scale = height / self.height_px
        principal = (x * scale, y * scale)
        update = {"width": width, "height_px": height, "principal": principal}
        return self.model_copy(update=update)

    def axes(self) -> NDArray:
        """Return the camera's axes in the world frame as columns [3, 3]: right, down, forward."""
        cp, sp = math.cos(self.pitch), math.sin(self.pitch)
        forward = np.array([cp, 0.0, -sp])
        right, down = np.array([0.0, -1.0, 0.0]), np.array([-sp, 0.0, -cp])
        c, s = math.cos(self.roll), math.sin(self.roll)
        axes = np.column_stack([c * right + s * down, c * down - s * right, forward])
        return matrix(from_yaw(self.yaw)) @ axes if self.yaw else axes

    def position(self) -> NDArray:
        """Return the center of projection in the world frame [m], shape [3]."""
        return np.array([*self.xy, self.height])

    def pose(self) -> Pose:
        """Return the pose of the camera in MuJoCo's convention: x right, y up, looking along -z."""
        return Pose(self.position(), from_matrix(self.axes() * [1.0, -1.0, -1.0]))

    def project(self, points: ArrayLike) -> tuple[NDArray, NDArray]:
        """Project points in the world frame [m], shape [..., 3], into the image.

        Returns:
            Pixels [..., 2] and depths along the view [m], shape [...]. Points at or behind the
            camera have depths <= 0 and meaningless pixels.
        """
        local = (np.asarray(points, float) - self.position()) @ self.axes()
        depth = local[..., 2]
        safe = np.where(depth > 1e-6, depth, 1e-6)[..., None]
        return local[..., :2] / safe * self.focal + self.center, depth

    def rays(self, pixels: ArrayLike) -> NDArray:
        """Return unit vectors [..., 3] in the world frame through pixels [..., 2]."""
        local = (np.asarray(pixels, float) - self.center) / self.focal
        d = np.concatenate([local, np.ones((*local.shape[:-1], 1))], axis=-1) @ self.axes().T
        return d / np.linalg.norm(d, axis=-1, keepdims=True)
