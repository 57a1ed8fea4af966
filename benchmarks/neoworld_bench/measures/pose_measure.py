"""Depth error of a rendered scene relative to a sensor's depth image, after a similarity transform.

A single photograph does not determine the scale, and the camera of a reconstruction differs from
the true camera. One similarity transform of the whole scene removes both errors. The remaining
error is that of layout and shapes.

Layout measures of SAM 3D (2025), for predicted shapes and poses: ADD-S, ICP rotation, 3D IoU.

This ADD-S compares two posed point sets in both directions and is divided by the diameter.

Rotational symmetry of an object about the vertical.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from neoworld_mjx.physics.support import posed_shapes
from neoworld_mjx.spec import SceneObject

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

DepthPoints = Float[np.ndarray, "n 3"]


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

    def project(self, points: DepthPoints) -> Float[np.ndarray, "n 2"]:
        """Project points in the camera's frame [m] to the image [px]."""
        ahead = np.maximum(points[:, 2:], 1e-6)
        return points[:, :2] / ahead * [self.fx, self.fy] + [self.cx, self.cy]


class Similarity(NamedTuple):
    """Similarity transform x -> scale * R x + t."""

    scale: float
    rotation: Float[np.ndarray, "3 3"]
    translation: Float[np.ndarray, " 3"]
    """In the unit of the transformed points."""

    def apply(self, points: DepthPoints) -> DepthPoints:
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
    absolute_mm: float
    """The same without the similarity transform, in the camera's frame [mm]."""
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
    distance, raw = (np.linalg.norm(gap, axis=1) for gap in (off, source - target))
    objects = {}
    for index, name in enumerate(names):
        visible = int((rendered_mask & (segmentation == index)).sum())
        if visible:
            of = owner == index
            objects[name] = _error(off[of], distance[of], raw[of], visible)
    return DepthMeasure(fitted, float((distance <= tolerance).mean()), objects)


def robust_similarity(source: DepthPoints, target: DepthPoints, tolerance: float) -> Similarity:
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
    source: DepthPoints, target: DepthPoints, weights: Float[np.ndarray, " n"]
) -> Similarity:
    """Return the similarity with the smallest weighted sum of squared distances (Umeyama 1991)."""
    w = weights / weights.sum()
    a, b = w @ source, w @ target
    p, q = source - a, target - b
    rotation = Rotation.align_vectors(q, p, weights=w)[0].as_matrix()
    scale = float(w @ np.sum((p @ rotation.T) * q, axis=1) / (w @ np.sum(p * p, axis=1)))
    return Similarity(scale, rotation, b - scale * rotation @ a)


def _error(
    off: DepthPoints, distance: Float[np.ndarray, " n"], raw: Float[np.ndarray, " n"], visible: int
) -> DepthError:
    if not len(off):
        return DepthError(np.nan, np.nan, np.nan, np.nan, visible, 0)
    return DepthError(
        1e3 * float(np.median(distance)),
        1e3 * float(np.median(raw)),
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


RECALL = 0.1
"""A pose is correct if ADD-S is below this fraction of the diameter."""
ICP_STEPS, ICP_CHANGE = 100, 1e-10

Points = Float[np.ndarray, "n 3"]
TruePoints = Float[np.ndarray, "m 3"]


class LayoutMeasure(NamedTuple):
    """Layout measures of SAM 3D for one object; `axis_box_iou` computes the 3D IoU."""

    add_s: float
    """ADD-S divided by the true diameter."""
    correct: bool
    """True if `add_s` is below RECALL (ADD-S @ 0.1)."""
    icp_rot_deg: float
    """Angle of the rotation by which ICP aligns the predicted with the true points [deg]."""


def layout_measure(predicted: Points, truth: TruePoints, diameter: float) -> LayoutMeasure:
    """Compare samples of a predicted object with samples of the true object.

    Args:
        predicted: samples of the predicted object at its predicted pose [m].
        truth: samples of the true object at its true pose, in the same frame [m].
        diameter: diameter of the true object [m].
    """
    score = add_s(predicted, truth) / diameter
    return LayoutMeasure(score, score < RECALL, icp_rotation_deg(predicted, truth))


def add_s(predicted: Points, truth: TruePoints) -> float:
    """Return the mean distance to the nearest point of the other set, over both directions [m]."""
    forth = KDTree(truth).query(predicted)[0].mean()
    back = KDTree(predicted).query(truth)[0].mean()
    return float(forth + back) / 2


def recall(errors: list[float | None]) -> float | None:
    """Return the fraction of errors below RECALL; None if there are no objects.

    A missed object has the error None, which counts as an error above it.
    """
    correct = [error is not None and error < RECALL for error in errors]
    return float(np.mean(correct)) if correct else None


def icp_rotation_deg(predicted: Points, truth: TruePoints) -> float:
    """Return the angle of the rotation by which ICP aligns two posed point sets [deg].

    Rigid ICP starts at the given poses and pairs predicted points with the nearest true points. A
    rotation that maps a shape onto itself is therefore no error.
    """
    tree, points, total = KDTree(truth), predicted, np.eye(3)
    for _ in range(ICP_STEPS):
        nearest = truth[tree.query(points)[1]]
        turn = Rotation.align_vectors(nearest - nearest.mean(axis=0), points - points.mean(axis=0))[
            0
        ].as_matrix()
        points = (points - points.mean(axis=0)) @ turn.T + nearest.mean(axis=0)
        total = turn @ total
        if np.abs(turn - np.eye(3)).max() < ICP_CHANGE:
            break
    return float(np.degrees(Rotation.from_matrix(total).magnitude()))


def axis_box_iou(a: Points, b: TruePoints) -> float:
    """Return the intersection over union of the axis-aligned bounding boxes of two point sets."""
    low = np.maximum(a.min(axis=0), b.min(axis=0))
    high = np.minimum(a.max(axis=0), b.max(axis=0))
    common = float(np.prod(np.maximum(high - low, 0.0)))
    union = float(np.prod(np.ptp(a, axis=0)) + np.prod(np.ptp(b, axis=0))) - common
    return common / union if union > 0 else 0.0


MOST_DIFFERENCE = 0.02
"""Maximum difference between symmetric extents, as a fraction of the largest extent."""


def symmetry(item: SceneObject) -> float:
    """Return the smallest rotation about the vertical that maps an object onto itself [rad].

    The result is 0 for round objects, such as a ball or a standing can, whose heading is undefined.
    Without symmetry, it is 2 pi.
    """
    points = np.vstack(
        [pose.apply(shape.surface()[0]) for shape, pose in posed_shapes(item, tilted=True)]
    )
    points[:, 2] -= points[:, 2].mean()
    angles = np.linspace(0, 2 * np.pi, 360, endpoint=False)
    around = np.stack([np.cos(angles), np.sin(angles)])
    # Use extents to the sides and obliquely up and down: half a turn does not map a leaning object
    # onto itself, although its extents to the sides stay the same.
    extents = np.stack(
        [(points @ np.vstack([around, np.full(360, up)])).max(axis=0) for up in (0.0, 1.0, -1.0)]
    )
    # Measure extents from the Steiner point, which rotates with the outline.
    extents -= around.T @ (around @ extents[0]) * 2 / len(angles)
    for step in (10, 45, 60, 90, 120, 180):
        difference = np.abs(extents - np.roll(extents, step, axis=1)).max()
        if difference < MOST_DIFFERENCE * extents.max():
            return 0.0 if step == 10 else math.radians(step)
    return 2 * math.pi
