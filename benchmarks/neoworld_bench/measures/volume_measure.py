"""Chamfer distance, F-score and voxel IoU of posed meshes with published settings.

Both meshes are mapped by the transform that fits the true mesh's bounding box into [-1, 1]^3. They
are not aligned with each other. The settings are those of MessyKitchens' evaluation
(docs/IOU_METRICS.md), which follows PartCrafter: 64 voxels along the edge of length 2, 10 000
samples, F-score at 0.1.
"""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

if TYPE_CHECKING:
    import trimesh

GRIDS, EDGE = 64, 2.0
PITCH = EDGE / GRIDS
F_THRESHOLD = 0.1
VOLUME_SAMPLES = 10_000
MOST_VOXELS = 30_000_000
"""Maximum number of voxels of a mesh's bounding box, because a mesh that is much too large would
exhaust the memory."""

Points = Float[np.ndarray, "n 3"]


class VolumeMeasure(NamedTuple):
    """Comparison of two meshes in the normalized frame of the true mesh."""

    chamfer: float
    """Sum over both directions of the mean distance (not squared) to the nearest sample of the
    other mesh."""
    f_score: float
    """Harmonic mean, over both directions, of the fractions of samples within F_THRESHOLD of the
    other mesh's samples."""
    voxel_iou: float
    """Intersection over union of the filled voxels with edge length PITCH."""


def volume_measure(predicted: "trimesh.Trimesh", truth: "trimesh.Trimesh") -> VolumeMeasure:
    """Compare two posed meshes.

    Args:
        predicted: predicted mesh, in the frame of the true mesh.
        truth: true mesh, at any scale.

    Raises:
        ValueError: a mesh has too many voxels.
    """
    import trimesh

    a, b = normalized(predicted, truth), normalized(truth, truth)
    points = [trimesh.sample.sample_surface(mesh, VOLUME_SAMPLES, seed=0)[0] for mesh in (a, b)]
    distances = surface_distances(*points)
    return VolumeMeasure(
        float(distances[0].mean() + distances[1].mean()),
        f_score(*distances, F_THRESHOLD),
        voxel_iou(a, b),
    )


def normalized(mesh: "trimesh.Trimesh", frame: "trimesh.Trimesh") -> "trimesh.Trimesh":
    """Return a mesh in the frame in which another mesh's box is centered and fits [-1, 1]^3."""
    low, high = np.asarray(frame.bounds, float)
    result = mesh.copy()
    result.apply_translation(-(low + high) / 2)
    result.apply_scale(2.0 / float((high - low).max()))
    return result


def surface_distances(
    a: Points, b: Float[np.ndarray, "m 3"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " m"]]:
    """Return the distance of each sample to the nearest of the other set, in both directions."""
    return KDTree(b).query(a)[0], KDTree(a).query(b)[0]


def f_score(
    forth: Float[np.ndarray, " n"], back: Float[np.ndarray, " m"], threshold: float
) -> float:
    """Return the harmonic mean of the fractions of distances below a threshold."""
    precision, recall = float((forth < threshold).mean()), float((back < threshold).mean())
    both = precision + recall
    return 2 * precision * recall / both if both else 0.0


def voxel_iou(a: "trimesh.Trimesh", b: "trimesh.Trimesh", pitch: float = PITCH) -> float:
    """Return the intersection over union of the filled voxels of two meshes in one frame.

    Raises:
        ValueError: a mesh has too many voxels.
    """
    voxels_a, voxels_b = filled_voxels(a, pitch), filled_voxels(b, pitch)
    low = np.minimum(voxels_a.min(axis=0), voxels_b.min(axis=0))
    shape = np.maximum(voxels_a.max(axis=0), voxels_b.max(axis=0)) - low + 1
    keys = [
        np.unique(np.ravel_multi_index((voxels - low).T, shape)) for voxels in (voxels_a, voxels_b)
    ]
    common = len(np.intersect1d(*keys, assume_unique=True))
    return common / (len(keys[0]) + len(keys[1]) - common)


def filled_voxels(mesh: "trimesh.Trimesh", pitch: float) -> Int[np.ndarray, "n 3"]:
    """Return the indices of the voxels that a mesh touches or encloses, shape [n, 3].

    Raises:
        ValueError: the mesh has too many voxels.
    """
    if np.prod(np.asarray(mesh.extents) / pitch + 1) > MOST_VOXELS:
        raise ValueError(f"a mesh of {np.round(mesh.extents, 2)} has too many voxels of {pitch:g}")
    grid = mesh.voxelized(pitch)
    assert grid is not None
    return np.round(grid.fill().points / pitch).astype(np.int64)
