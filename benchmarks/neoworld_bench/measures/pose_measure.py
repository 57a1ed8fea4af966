"""Measures of poses and layouts as the field defines them.

ADD and ADD-S of poses of one model are those of Hinterstoisser et al. 2012 and of BOP (`add`,
`adi`). Where shape and pose are both predicted, ADD-S, ICP rotation and 3D IoU are the layout
measures of SAM 3D (2025): ADD-S of two posed point sets in both directions, over the diameter.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree
from scipy.spatial.distance import pdist
from scipy.spatial.transform import Rotation

RECALL = 0.1
"""Largest ADD or ADD-S of a correct pose, over the diameter."""
ICP_STEPS, ICP_CHANGE = 100, 1e-10

Points = Float[np.ndarray, "n 3"]
TruePoints = Float[np.ndarray, "m 3"]
Matrix4 = Float[np.ndarray, "4 4"]


class LayoutMeasure(NamedTuple):
    """SAM 3D's layout measures of one object, except for `axis_box_iou`."""

    add_s: float
    """ADD-S over the true diameter."""
    correct: bool
    """True if ADD-S is below RECALL: ADD-S @ 0.1."""
    icp_rot_deg: float
    """Angle of the rotation by which ICP aligns the predicted with the true points."""


def layout_measure(predicted: Points, truth: TruePoints, diameter: float) -> LayoutMeasure:
    """Compare samples of a predicted object with those of the true one.

    Args:
        predicted: samples of the posed prediction [m].
        truth: samples of the posed true object in the same frame [m].
        diameter: of the true object [m].
    """
    score = add_s(predicted, truth) / diameter
    return LayoutMeasure(score, score < RECALL, icp_rotation_deg(predicted, truth))


def add(model: Points, predicted: Matrix4, truth: Matrix4) -> float:
    """Return the average distance of a model's points at two poses [m]."""
    return float(np.linalg.norm(_posed(model, predicted) - _posed(model, truth), axis=1).mean())


def adi(model: Points, predicted: Matrix4, truth: Matrix4) -> float:
    """Return the average distance from a model's points at the true pose to the nearest ones at the
    predicted pose [m]: ADD-S of objects with indistinguishable views.
    """
    return float(KDTree(_posed(model, predicted)).query(_posed(model, truth))[0].mean())


def add_s(predicted: Points, truth: TruePoints) -> float:
    """Return the mean of both average distances to the nearest point of the other set [m]."""
    forth = KDTree(truth).query(predicted)[0].mean()
    back = KDTree(predicted).query(truth)[0].mean()
    return float(forth + back) / 2


def recall(errors: list[float | None], threshold: float = RECALL) -> float | None:
    """Return the share of errors below a threshold; missed objects (None) count as errors.

    Returns:
        None without objects.
    """
    correct = [error is not None and error < threshold for error in errors]
    return float(np.mean(correct)) if correct else None


def point_diameter(points: Points) -> float:
    """Return the largest distance of two points [m]."""
    return float(pdist(points).max()) if len(points) > 1 else 0.0


def icp_rotation_deg(predicted: Points, truth: TruePoints) -> float:
    """Return the angle of the rotation by which ICP aligns two posed point sets.

    Rigid ICP from the given poses, from predicted to nearest true points. Rotations that map a
    shape onto itself are no error, as the nearest points hide them.
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
    """Return the intersection over union of the axis-aligned boxes of two point sets."""
    low = np.maximum(a.min(axis=0), b.min(axis=0))
    high = np.minimum(a.max(axis=0), b.max(axis=0))
    common = float(np.prod(np.maximum(high - low, 0.0)))
    union = float(np.prod(np.ptp(a, axis=0)) + np.prod(np.ptp(b, axis=0))) - common
    return common / union if union > 0 else 0.0


def _posed(points: Points, pose: Matrix4) -> Points:
    return points @ pose[:3, :3].T + pose[:3, 3]
