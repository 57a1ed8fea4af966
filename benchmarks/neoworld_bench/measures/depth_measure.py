"""Depth error of a rendered scene relative to a sensor's depth image, after a similarity transform.

A single photograph does not determine the scale, and the camera of a reconstruction differs from
the true camera. One similarity transform of the whole scene removes both errors. The remaining
error is that of layout and shapes.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

TOLERANCE = 0.015
"""Distance at which a pixel's weight is a quarter, as a fraction of the sensor's median depth."""
FIRST_TOLERANCE_M = 0.3
"""Tolerance of the first step of the fit [m]."""
COOLING = 1.2
"""Factor by which the tolerance decreases in each step."""
MAX_STEPS, SETTLED = 200, 1e-7
"""Maximum number of steps of the fit, and change of the similarity below which it ends."""
FIT_PIXELS = 20_000
"""Approximate maximum number of pixels for the fit, spread evenly over the image."""
LEAST_PIXELS = 100
"""Minimum number of pixels that have both a rendered and a measured depth."""

Points = Float[np.ndarray, "n 3"]


class Intrinsics(NamedTuple):
    """Pinhole intrinsics as in OpenCV: (0, 0) is the center of the first pixel [px]."""

    fx: float
    fy: float
    cx: float
    cy: float

    def directions(self, width: int, height: int) -> Float[np.ndarray, "h w 3"]:
        """Return directions through the pixels' centers: x right, y down, z forward and equal 1."""
        v, u = np.mgrid[:height, :width].astype(float)
        return np.stack([(u - self.cx) / self.fx, (v - self.cy) / self.fy, np.ones_like(u)], -1)

    def project(self, points: Points) -> Float[np.ndarray, "n 2"]:
        """Project points in the camera's frame [m] to the image [px]."""
        ahead = np.maximum(points[:, 2:], 1e-6)
        return points[:, :2] / ahead * [self.fx, self.fy] + [self.cx, self.cy]


class Similarity(NamedTuple):
    """Similarity transform x -> scale * R x + t."""

    scale: float
    rotation: Float[np.ndarray, "3 3"]
    translation: Float[np.ndarray, " 3"]
    """In the unit of the transformed points."""

    def apply(self, points: Points) -> Points:
        """Transform points."""
        return self.scale * points @ self.rotation.T + self.translation

    @property
    def angle_deg(self) -> float:
        """Angle of the rotation [deg]."""
        return float(np.degrees(Rotation.from_matrix(self.rotation).magnitude()))


IDENTITY = Similarity(1.0, np.eye(3), np.zeros(3))


class DepthError(NamedTuple):
    """Depth errors over the pixels of one object."""

    error_mm: float
    """Median distance between the rendered and the measured point of a pixel [mm]."""
    depth_error_mm: float
    """Median absolute difference of the depths [mm]."""
    bias_mm: float
    """Median difference of the depths [mm]; positive if the object is too far away."""
    visible_px: int
    """Number of pixels that show the object in the rendered image."""
    measured_px: int
    """Number of pixels that show the object and at which the sensor has a depth."""


class DepthMeasure(NamedTuple):
    """Depth errors of a scene."""

    similarity: Similarity
    """Transform from the frame of the scene's camera to the frame of the sensor's camera [m]."""
    inliers: float
    """Fraction of the compared pixels whose distance is within TOLERANCE."""
    objects: dict[str, DepthError]
    """Errors by object. Objects without a visible pixel are omitted. Errors are NaN if the sensor
    has no depth at any pixel of the object."""


def depth_measure(
    rendered: Float[np.ndarray, "h w 3"],
    segmentation: Int[np.ndarray, "h w"],
    names: tuple[str, ...],
    sensor: Float[np.ndarray, "h w 3"],
) -> DepthMeasure:
    """Compare the points of a rendered scene with the points of a sensor, pixel by pixel.

    Args:
        rendered: points of the scene in the frame of the scene's camera, with OpenCV axes [m]. The
            depth of a pixel without a surface is inf.
        segmentation: index of the object at each pixel; -1 for the background.
        names: names of the objects by index.
        sensor: measured points in the frame of the sensor's camera [m]. The depth of a pixel
            without a measurement is 0.

    Raises:
        ValueError: fewer than LEAST_PIXELS pixels have both depths.
    """
    rendered_mask = (segmentation >= 0) & np.isfinite(rendered[..., 2])
    overlap = rendered_mask & (sensor[..., 2] > 0)
    count = int(overlap.sum())
    if count < LEAST_PIXELS:
        raise ValueError(
            f"{count} pixels have both a rendered and a measured depth; a comparison needs "
            f"{LEAST_PIXELS}"
        )
    source, target, owner = rendered[overlap], sensor[overlap], segmentation[overlap]
    tolerance = TOLERANCE * float(np.median(target[:, 2]))
    fitted = robust_similarity(source, target, tolerance)
    off = fitted.apply(source) - target
    distance = np.linalg.norm(off, axis=1)
    objects = {}
    for index, name in enumerate(names):
        visible = int((rendered_mask & (segmentation == index)).sum())
        if visible:
            objects[name] = _error(off[owner == index], distance[owner == index], visible)
    return DepthMeasure(fitted, float((distance <= tolerance).mean()), objects)


def robust_similarity(source: Points, target: Points, tolerance: float) -> Similarity:
    """Fit the similarity transform that maps as many points as possible close to their partners.

    The fit minimizes the Geman-McClure loss by iteratively reweighted least squares. It starts with
    the median ratio of depths as the scale. The tolerance decreases from FIRST_TOLERANCE_M to the
    given tolerance, so that the fit converges from distant starts (graduated non-convexity, Yang et
    al. 2020).

    Args:
        source: points [m].
        target: partner of each point [m].
        tolerance: distance at which a pair's weight is a quarter [m].
    """
    step = max(1, len(source) // FIT_PIXELS)
    p, q = source[::step], target[::step]
    fitted = Similarity(float(np.median(q[:, 2] / p[:, 2])), np.eye(3), np.zeros(3))
    width = max(FIRST_TOLERANCE_M, tolerance)
    for _ in range(MAX_STEPS):
        distance = np.linalg.norm(fitted.apply(p) - q, axis=1)
        new = least_squares_similarity(p, q, (1 + (distance / width) ** 2) ** -2.0)
        change = abs(new.scale - fitted.scale) + np.abs(new.translation - fitted.translation).max()
        fitted = new
        if width == tolerance and change < SETTLED:
            break
        width = max(width / COOLING, tolerance)
    return fitted


def least_squares_similarity(
    source: Points, target: Points, weights: Float[np.ndarray, " n"]
) -> Similarity:
    """Return the similarity with the smallest weighted sum of squared distances (Umeyama 1991)."""
    w = weights / weights.sum()
    a, b = w @ source, w @ target
    p, q = source - a, target - b
    rotation = Rotation.align_vectors(q, p, weights=w)[0].as_matrix()
    scale = float(w @ np.sum((p @ rotation.T) * q, axis=1) / (w @ np.sum(p * p, axis=1)))
    return Similarity(scale, rotation, b - scale * rotation @ a)


def _error(off: Points, distance: Float[np.ndarray, " n"], visible: int) -> DepthError:
    if not len(off):
        return DepthError(np.nan, np.nan, np.nan, visible, 0)
    return DepthError(
        1e3 * float(np.median(distance)),
        1e3 * float(np.median(np.abs(off[:, 2]))),
        1e3 * float(np.median(off[:, 2])),
        visible,
        len(off),
    )


def measured_points(
    depth: Float[np.ndarray, "h w"], camera: Intrinsics
) -> Float[np.ndarray, "h w 3"]:
    """Return the points of a depth image in the camera's frame [m]; 0 for pixels without depth."""
    height, width = depth.shape
    measured = np.isfinite(depth) & (depth > 0)
    return camera.directions(width, height) * np.where(measured, depth, 0.0)[..., None]
