"""Pinhole cameras at any pose, and views that frame an object."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..spec import Camera
from ..spec.pose import ArrayLike

FOVY = math.radians(32.0)
"""Vertical field of view of views that frame an object [rad]."""


class View(NamedTuple):
    """A pinhole camera at any pose."""

    eye: NDArray
    """Center of projection [m], shape [3]."""
    axes: NDArray
    """Axes of the camera in the world frame, as columns [3, 3]: right, down, forward."""
    fovy: float
    """Vertical field of view [rad]."""
    width: int
    height: int
    centre: tuple[float, float] | None = None
    """Principal point (u, v) [px]; if None, the center of the image."""
    gain: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Factors by which the linear red, green and blue of rendered images are multiplied."""

    @classmethod
    def of(cls, camera: Camera, width: int | None = None, height: int | None = None) -> "View":
        """Return the view of a scene's camera at another size.

        Args:
            camera: the camera.
            width: width [px]; if None, it follows from `height` or is the width of the camera.
            height: height [px]; if None, it follows from `width` and the camera's aspect ratio.
        """
        if width is None:
            rows = camera.height_px if height is None else height
            width = max(1, round(rows * camera.width / camera.height_px))
        if height is None:
            height = max(1, round(width * camera.height_px / camera.width))
        centre = None
        if any(camera.principal):
            u, v = camera.resized(width, height).center
            centre = (float(u), float(v))
        position, axes = camera.position(), camera.axes()
        return cls(position, axes, camera.fovy, width, height, centre, camera.gain)

    @classmethod
    def look_at(
        cls, eye: ArrayLike, target: ArrayLike, *, width: int, height: int, fovy: float = FOVY
    ) -> "View":
        """Return an upright view from `eye` towards `target`, both in the world frame [m]."""
        origin = np.asarray(eye, float)
        forward = np.asarray(target, float) - origin
        forward = forward / np.linalg.norm(forward)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        if np.linalg.norm(right) < 1e-9:  # straight up or down: +x is at the top of the image
            right = np.array([0.0, -1.0, 0.0])
        right = right / np.linalg.norm(right)
        return cls(
            origin, np.column_stack([right, np.cross(forward, right), forward]), fovy, width, height
        )

    @classmethod
    def framing(
        cls,
        points: ArrayLike,
        *,
        width: int,
        height: int,
        azimuth: float = math.radians(-35.0),
        elevation: float = math.radians(28.0),
        fovy: float = FOVY,
        margin: float = 1.22,
    ) -> "View":
        """Return a view from a given direction that shows all points.

        Args:
            points: points in the world frame [m], shape [n, 3].
            width: width [px].
            height: height [px].
            azimuth: azimuth of the camera about +z [rad]; 0 looks at the front (+x).
            elevation: elevation of the camera above the horizontal [rad].
            fovy: vertical field of view [rad].
            margin: ratio of the camera's distance to the smallest one at which all points are seen.
        """
        p = np.asarray(points, float)
        centre = (p.min(axis=0) + p.max(axis=0)) / 2
        away = np.array(
            [
                math.cos(elevation) * math.cos(azimuth),
                math.cos(elevation) * math.sin(azimuth),
                math.sin(elevation),
            ]
        )
        view = cls.look_at(centre + away, centre, width=width, height=height, fovy=fovy)
        local = (p - centre) @ view.axes
        tall = math.tan(fovy / 2)
        wide = tall * width / height
        need = np.maximum(np.abs(local[:, 0]) / wide, np.abs(local[:, 1]) / tall) - local[:, 2]
        distance = max(float(need.max()), 1e-3) * margin
        return view._replace(eye=centre + away * distance)

    @classmethod
    def through(
        cls, camera: Camera, window: tuple[float, float, float, float], longer_side: int
    ) -> "View":
        """Return an enlarged view of a window in a camera's image.

        Args:
            camera: the camera.
            window: the window (x0, y0, x1, y1) in the camera's pixels; it may extend beyond the
                image.
            longer_side: longer side of the new image [px].
        """
        x0, y0, x1, y1 = window
        scale = longer_side / max(x1 - x0, y1 - y0)
        width, height = max(1, round((x1 - x0) * scale)), max(1, round((y1 - y0) * scale))
        fovy = 2 * math.atan(height / 2 / (camera.focal * scale))
        u, v = camera.center.tolist()
        centre = ((u - x0) * scale, (v - y0) * scale)
        return cls(camera.position(), camera.axes(), fovy, width, height, centre)

    def resized(self, width: int, height: int) -> "View":
        """Return the view with another size [px], the same field of view and the same gain.

        The principal point moves with the center of the image. Its offset from this center scales
        with the focal length.
        """
        centre = self.centre
        if centre is not None:
            scale = height / self.height
            centre = (
                width / 2 + (centre[0] - self.width / 2) * scale,
                height / 2 + (centre[1] - self.height / 2) * scale,
            )
        return self._replace(width=width, height=height, centre=centre)

    @property
    def focal(self) -> float:
        """Focal length in pixels."""
        return self.height / 2 / math.tan(self.fovy / 2)

    def rays(self, pixels: ArrayLike) -> NDArray:
        """Return unit vectors [..., 3] in the world frame through pixels (u, v) [..., 2]."""
        centre = self.centre or (self.width / 2, self.height / 2)
        local = (np.asarray(pixels, float) - centre) / self.focal
        d = np.concatenate([local, np.ones((*local.shape[:-1], 1))], axis=-1) @ self.axes.T
        return d / np.linalg.norm(d, axis=-1, keepdims=True)
