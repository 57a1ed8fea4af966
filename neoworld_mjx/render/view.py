"""View: any pinhole camera, and those that frame an object."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..spec import Camera
from ..spec.pose import ArrayLike

FOVY = math.radians(32.0)
"""Vertical field of view [rad] of views that frame something by themselves."""


class View(NamedTuple):
    """A pinhole camera anywhere in the world."""

    eye: NDArray
    """Centre of projection [m], shape [3]."""
    axes: NDArray
    """Columns [3, 3] in the world: right, down, forward."""
    fovy: float
    """Vertical field of view [rad]."""
    width: int
    height: int
    centre: tuple[float, float] | None = None
    """Pixel (u, v) that the view's axis passes through; None is the middle of the picture."""

    @classmethod
    def of(cls, camera: Camera, width: int | None = None, height: int | None = None) -> "View":
        """Take a scene's camera at another size.

        Args:
            camera: the camera.
            width: of the picture in pixels; None follows from `height`, or is the camera's own.
            height: of the picture in pixels; None follows from `width` by the camera's aspect.
        """
        if width is None:
            rows = camera.height_px if height is None else height
            width = max(1, round(rows * camera.width / camera.height_px))
        if height is None:
            height = max(1, round(width * camera.height_px / camera.width))
        return cls(camera.position(), camera.axes(), camera.fovy, width, height)

    @classmethod
    def look_at(
        cls, eye: ArrayLike, target: ArrayLike, *, width: int, height: int, fovy: float = FOVY
    ) -> "View":
        """Look from one point [3] m to another, upright."""
        at = np.asarray(eye, float)
        forward = np.asarray(target, float) - at
        forward = forward / np.linalg.norm(forward)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        if np.linalg.norm(right) < 1e-9:  # straight up or down: keep +x at the picture's top
            right = np.array([0.0, -1.0, 0.0])
        right = right / np.linalg.norm(right)
        return cls(
            at, np.column_stack([right, np.cross(forward, right), forward]), fovy, width, height
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
        """See all points [n, 3] m from a direction, as near as they fit.

        Args:
            points: what must be inside the picture, such as the corners of a bounding box.
            width: of the picture in pixels.
            height: of the picture in pixels.
            azimuth: of the camera about +z [rad]; 0 looks at the front (+x).
            elevation: of the camera above the horizontal [rad].
            fovy: vertical field of view [rad].
            margin: how much farther away than the nearest place that shows everything.
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
        """See a part of a camera's picture, enlarged.

        Args:
            camera: the camera.
            window: the part, in the camera's pixels (x0, y0, x1, y1); it may reach beyond.
            longer_side: of the new picture, in pixels.
        """
        x0, y0, x1, y1 = window
        scale = longer_side / max(x1 - x0, y1 - y0)
        width, height = max(1, round((x1 - x0) * scale)), max(1, round((y1 - y0) * scale))
        fovy = 2 * math.atan(height / 2 / (camera.focal * scale))
        centre = ((camera.width / 2 - x0) * scale, (camera.height_px / 2 - y0) * scale)
        return cls(camera.position(), camera.axes(), fovy, width, height, centre)

    @property
    def focal(self) -> float:
        """Focal length in pixels."""
        return self.height / 2 / math.tan(self.fovy / 2)

    def rays(self, pixels: ArrayLike) -> NDArray:
        """Return unit directions [..., 3] in the world through pixels [..., 2] (u, v)."""
        centre = self.centre or (self.width / 2, self.height / 2)
        local = (np.asarray(pixels, float) - centre) / self.focal
        d = np.concatenate([local, np.ones((*local.shape[:-1], 1))], axis=-1) @ self.axes.T
        return d / np.linalg.norm(d, axis=-1, keepdims=True)
