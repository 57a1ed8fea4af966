"""Layout measures of SAM 3D (2025), for predicted shapes and poses, and symmetries of objects.

This ADD-S compares two posed point sets in both directions and is divided by the diameter.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from neoworld_mjx.physics.support import posed_shapes
from neoworld_mjx.spec import SceneObject


class Intrinsics(NamedTuple):
    """Pinhole intrinsics as in OpenCV: (0, 0) is the center of the first pixel [px]."""

    fx: float
    fy: float
    cx: float
    cy: float

    def project(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
        """Project points in the camera's frame [m] to the image [px]."""
        ahead = np.maximum(points[:, 2:], 1e-6)
        return points[:, :2] / ahead * [self.fx, self.fy] + [self.cx, self.cy]


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
