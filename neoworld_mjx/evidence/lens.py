"""Lenses with distortion and non-square pixels, and pictures without both.

Pixels have the origin of `spec.Camera`: (0, 0) is the outer corner of the first pixel.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

LensModel = Literal["brown_conrady", "fisheye"]
"""Names of lens models.

- brown_conrady: coefficients k1 k2 p1 p2 k3 (k4 k5 k6), as in OpenCV, where k4 to k6 are those of
  the denominator. ROS calls it plumb_bob or rational_polynomial, COLMAP OPENCV or FULL_OPENCV.
- fisheye: coefficients k1 k2 k3 k4 of the equidistant model, as in cv2.fisheye. ROS calls it
  equidistant, COLMAP OPENCV_FISHEYE.
"""
COEFFICIENTS: dict[str, int] = {"brown_conrady": 8, "fisheye": 4}
"""Largest number of coefficients of each model."""
MAX_SHIFT = 0.001
"""Largest displacement that a pinhole camera with square pixels may neglect, relative to the longer
side of the image."""
LEAST_ZOOM = 0.5
"""Least focal length of an undistorted picture, relative to that of the lens at its middle."""
_ITERATIONS = 30
_EDGE_POINTS = 33


@dataclass(frozen=True)
class Lens:
    """Projection from the camera's frame (x right, y down, z ahead) into an image."""

    size: tuple[int, int]
    """Width and height of the image [px]."""
    focal: tuple[float, float]
    """Focal lengths along the rows and along the columns [px]."""
    center: tuple[float, float]
    """Principal point [px]."""
    model: LensModel = "brown_conrady"
    coefficients: tuple[float, ...] = ()

    def project(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 2"]:
        """Return the pixels of points in front of the camera [m]."""
        points = np.asarray(points, float)
        flat = points[..., :2] / np.maximum(points[..., 2:], 1e-9)
        return self._distorted(flat) * self.focal + self.center

    def slopes(self, pixels: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
        """Return x / z and y / z of the lines of sight through pixels."""
        target = (np.asarray(pixels, float) - self.center) / self.focal
        if not any(self.coefficients):
            if self.model == "fisheye":
                return _stretched(target, np.tan)
            return target
        if self.model == "fisheye":
            return _stretched(target, lambda angle: np.tan(self._undistorted_angle(angle)))
        flat = target.copy()
        for _ in range(_ITERATIONS):
            flat = flat + (target - self._distorted(flat))
        return flat

    def _distorted(self, flat: NDArray) -> NDArray:
        k = np.zeros(COEFFICIENTS[self.model])
        k[: len(self.coefficients)] = self.coefficients
        if self.model == "fisheye":
            return _stretched(flat, lambda slope: self._distorted_angle(np.arctan(slope), k))
        x, y = flat[..., 0], flat[..., 1]
        r2 = x * x + y * y
        radial = 1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
        radial = radial / (1 + r2 * (k[5] + r2 * (k[6] + r2 * k[7])))
        return np.stack(
            [
                x * radial + 2 * k[2] * x * y + k[3] * (r2 + 2 * x * x),
                y * radial + k[2] * (r2 + 2 * y * y) + 2 * k[3] * x * y,
            ],
            axis=-1,
        )

    def _distorted_angle(self, angle: NDArray, k: NDArray) -> NDArray:
        a2 = angle * angle
        return angle * (1 + a2 * (k[0] + a2 * (k[1] + a2 * (k[2] + a2 * k[3]))))

    def _undistorted_angle(self, distorted: NDArray) -> NDArray:
        k = np.zeros(COEFFICIENTS["fisheye"])
        k[: len(self.coefficients)] = self.coefficients
        angle = distorted.copy()
        for _ in range(_ITERATIONS):
            angle = np.clip(angle + distorted - self._distorted_angle(angle, k), 0, 1.5)
        return angle


@dataclass(frozen=True)
class Pinhole:
    """An image without distortion and with square pixels, of the view of a lens."""

    size: tuple[int, int]
    """Width and height [px]."""
    focal: float
    """Focal length [px]."""
    center: tuple[float, float]
    """Principal point [px]."""


def pinhole_of(lens: Lens) -> Pinhole:
    """Return the undistorted image of a lens.

    Its principal point lies at the same fraction of the image. Its focal length is the smallest
    with which every pixel shows a pixel of the lens's image, at least `LEAST_ZOOM` of the lens's.
    """
    width, height = lens.size
    fx, fy = lens.focal
    size = (width, max(round(height * fx / fy), 1))
    center = (lens.center[0], lens.center[1] * size[1] / height)
    low, high = LEAST_ZOOM * fx, 4 * fx
    for _ in range(40):
        middle = (low + high) / 2
        if _shows_lens(lens, Pinhole(size, middle, center)):
            high = middle
        else:
            low = middle
    return Pinhole(size, high, center)


def is_pinhole(lens: Lens) -> bool:
    """Return True if the lens's image is that of a pinhole camera within `MAX_SHIFT`."""
    focal = sum(lens.focal) / 2
    border = _border(lens.size)
    flat = (border - lens.center) / focal
    shown = lens.project(np.concatenate([flat, np.ones((len(flat), 1))], axis=-1))
    return float(np.abs(shown - border).max()) <= MAX_SHIFT * max(lens.size)


def undistorted_image(
    image: NDArray, lens: Lens, pinhole: Pinhole, *, smooth: bool = False
) -> NDArray:
    """Return an image of the lens as the pinhole camera sees it.

    Args:
        image: the image, shape [row, column] or [row, column, channel], at any size.
        lens: the lens.
        pinhole: the undistorted image.
        smooth: if True, interpolate linearly, and otherwise take the nearest pixel.

    Returns:
        An image of the same type, with as many pixels for each pixel of `pinhole` as the given
        image has for each pixel of the lens.
    """
    from scipy.ndimage import map_coordinates

    rows, columns = image.shape[:2]
    height = max(round(rows * pinhole.size[1] / lens.size[1]), 1)
    u, v = np.meshgrid(
        (np.arange(columns) + 0.5) * pinhole.size[0] / columns,
        (np.arange(height) + 0.5) * pinhole.size[1] / height,
    )
    flat = (np.stack([u, v], axis=-1) - pinhole.center) / pinhole.focal
    source = lens.project(np.concatenate([flat, np.ones((*flat.shape[:2], 1))], axis=-1))
    at = np.stack(
        [
            source[..., 1] * rows / lens.size[1] - 0.5,
            source[..., 0] * columns / lens.size[0] - 0.5,
        ]
    )
    remap = lambda channel: map_coordinates(channel, at, order=int(smooth), mode="nearest")
    if image.ndim == 2:
        return remap(image)
    return np.stack([remap(image[..., k]) for k in range(image.shape[2])], axis=-1)


def _stretched(flat: NDArray, function: Callable[[NDArray], NDArray]) -> NDArray:
    """Replace the distance r of points from the origin by `function(r)`."""
    r = np.linalg.norm(flat, axis=-1, keepdims=True)
    safe = np.maximum(r, 1e-12)
    return flat * np.where(r > 1e-12, function(safe) / safe, 1.0)


def _border(size: tuple[int, int]) -> NDArray:
    """Return pixels on the border of an image, shape [n, 2]."""
    width, height = size
    t = np.linspace(0, 1, _EDGE_POINTS)
    zero, one = np.zeros_like(t), np.ones_like(t)
    sides = [(t, zero), (t, one), (zero, t), (one, t)]
    return np.concatenate([np.column_stack([x * width, y * height]) for x, y in sides])


def _shows_lens(lens: Lens, pinhole: Pinhole) -> bool:
    flat = (_border(pinhole.size) - pinhole.center) / pinhole.focal
    shown = lens.project(np.concatenate([flat, np.ones((len(flat), 1))], axis=-1))
    return bool(((shown >= -0.5) & (shown <= np.array(lens.size) + 0.5)).all())
