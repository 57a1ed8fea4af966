"""Chamfer distance and F-score between samples of an object's surface and the ground truth.

Both surfaces are sampled uniformly by area. Lengths are divided by the diagonal of the ground
truth, so thresholds are relative to the object's size. Samples cover all faces, including the
insides of drawers and cupboards.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from neoworld_mjx.spec import ObjectSpec, Spec

from .joint_measure import quarter_turn

if TYPE_CHECKING:
    import trimesh

THRESHOLDS = (0.01, 0.05)
SAMPLES = 10_000
ICP_STEPS = 30
MIN_IMPROVEMENT = 1e-5
"""The fit stops if the Chamfer distance decreases by less than this fraction."""


class Closeness(Spec):
    """Distances between two sets of samples, relative to the diagonal."""

    chamfer_x10: float
    """Ten times the Chamfer distance: the mean over both directions of the mean distance (not
    squared) from a sample to the nearest sample of the other set.
    """
    f_01: float
    """F-score at 0.01 [%]: harmonic mean, over both directions, of the fractions of samples within
    0.01 of the other set."""
    f_05: float
    """F-score at 0.05 [%]."""


class GeometryMeasure(Spec):
    """Comparison of an object's surface with the ground truth."""

    unaligned: Closeness
    """Distances with both objects in the canonical frame, so errors of size and front count."""
    aligned: Closeness
    """Distances after the best fit of the predicted samples to the ground truth."""
    turn_deg: float
    """Rotation of the fit about the vertical [deg]."""
    scale: float
    """Scale factor of the fit."""


def geometry_measure(
    predicted: ObjectSpec | NDArray, truth: NDArray, *, samples: int = SAMPLES, seed: int = 0
) -> GeometryMeasure:
    """Compare an object's surface with samples of the ground truth (paper Section 4, geometry).

    The fit starts from each of the four quarter turns about the vertical, with equal box centers
    and diagonals. Up to 30 steps of least squares to the nearest samples fit a rotation about the
    vertical, a translation and a scale. The start with the smallest final Chamfer distance is used.
    Objects are not mirrored or tilted.

    Args:
        predicted: the reconstructed object, or its samples in its canonical frame [m], shape
            [n, 3].
        truth: samples of the ground truth in its canonical frame [m], shape [m, 3]; see
            `canonical_points`.
        samples: number of samples of the reconstructed object.
        seed: seed of the samples.
    """
    points = (
        surface_points(predicted, samples, seed) if isinstance(predicted, ObjectSpec) else predicted
    )
    true = np.asarray(truth, float)
    size = float(np.linalg.norm(np.ptp(true, axis=0)))
    tree = KDTree(true / size)
    plain = closeness(points / size, true / size, tree)
    best: tuple[Closeness, float, float] | None = None
    for turns in range(4):
        fitted, turn, scale = _fitted(points @ quarter_turn(turns).T, true, tree, size)
        fit = closeness(fitted, true / size, tree)
        if best is None or fit.chamfer_x10 < best[0].chamfer_x10:
            best = fit, (90.0 * turns + np.degrees(turn) + 180.0) % 360.0 - 180.0, scale
    assert best is not None
    return GeometryMeasure(
        unaligned=plain,
        aligned=best[0],
        turn_deg=best[1],
        scale=best[2],
    )


def closeness(a: NDArray, b: NDArray, tree: KDTree) -> Closeness:
    """Return the Chamfer distance and F-scores between point sets `a` [n, 3] and `b` [m, 3].

    Args:
        a: points, divided by the diagonal of the ground truth.
        b: points in the same unit.
        tree: KD-tree of `b`.
    """
    forth = tree.query(a)[0]
    back = KDTree(a).query(b)[0]

    def f(threshold: float) -> float:
        precision, recall = float((forth <= threshold).mean()), float((back <= threshold).mean())
        both = precision + recall
        return 200 * precision * recall / both if both else 0.0

    return Closeness(
        chamfer_x10=float(5 * (forth.mean() + back.mean())),
        f_01=f(THRESHOLDS[0]),
        f_05=f(THRESHOLDS[1]),
    )


def surface_points(spec: ObjectSpec, count: int = SAMPLES, seed: int = 0) -> NDArray:
    """Sample the visible shapes of an object uniformly by area, with all joints at zero.

    If shapes penetrate each other, their inner faces are sampled, too.

    Returns:
        Points in the object's frame [m], shape [count, 3]. The points depend only on the seed.
    """
    import trimesh

    meshes = [
        trimesh.Trimesh(geom.pose().apply(vertices), faces, process=False)
        for part in spec.parts
        for geom in part.geoms
        if geom.role != "collision"
        for vertices, faces in [geom.shape.surface()]
    ]
    return sampled(meshes, count, seed)


def sampled(meshes: "Sequence[trimesh.Trimesh]", count: int, seed: int) -> NDArray:
    """Return points sampled uniformly by area on several meshes, shape [count, 3]."""
    return np.vstack(samples_of_each(meshes, count, seed))


def samples_of_each(meshes: "Sequence[trimesh.Trimesh]", count: int, seed: int) -> list[NDArray]:
    """Return the points of `sampled` on each mesh, shape [n, 3] for each."""
    import trimesh

    areas = np.array([mesh.area for mesh in meshes])
    counts = np.random.default_rng(seed).multinomial(count, areas / areas.sum())
    return [
        trimesh.sample.sample_surface(mesh, n, seed=seed + k)[0] if n else np.zeros((0, 3))
        for k, (mesh, n) in enumerate(zip(meshes, counts.tolist(), strict=True))
    ]


def _fitted(
    samples: NDArray, true: NDArray, tree: KDTree, size: float
) -> tuple[NDArray, float, float]:
    """Fit samples to the ground truth.

    Returns:
        The fitted samples divided by the diagonal `size`, the rotation [rad], and the scale.
    """
    goal = true / size
    factor = size / float(np.linalg.norm(np.ptp(samples, axis=0)))
    points = (samples - _middle(samples)) * (factor / size) + _middle(goal)
    turn, scale, last_cost = 0.0, factor, np.inf
    best = points, turn, scale
    for _ in range(ICP_STEPS):
        forth, near = tree.query(points)
        back, nearest = KDTree(points).query(goal)
        cost = float(forth.mean() + back.mean())
        if last_cost - cost < MIN_IMPROVEMENT * cost:
            break
        last_cost = cost
        best = points, turn, scale
        # Pairs of both directions have equal weights, so that neither set shrinks into the other.
        source = np.vstack([points, points[nearest]])
        target = np.vstack([goal[near], goal])
        weight = (
            np.concatenate(
                [np.full(len(points), 1 / len(points)), np.full(len(goal), 1 / len(goal))]
            )[:, None]
            / 2
        )
        a, b = (source * weight).sum(axis=0), (target * weight).sum(axis=0)
        p, q = source - a, target - b
        cosine = float((weight[:, 0] * (p[:, :2] * q[:, :2]).sum(axis=1)).sum())
        sine = float((weight[:, 0] * (p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0])).sum())
        angle = float(np.arctan2(sine, cosine))
        c, s = np.cos(angle), np.sin(angle)
        rotation = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
        rotated = p @ rotation.T
        grown = float((weight * rotated * q).sum() / (weight * rotated**2).sum())
        points = (points - a) @ rotation.T * grown + b
        turn, scale = turn + angle, scale * grown
    else:
        best = points, turn, scale
    return best


def _middle(points: NDArray) -> NDArray:
    return (points.min(axis=0) + points.max(axis=0)) / 2
