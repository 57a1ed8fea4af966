"""Pairs of reconstructed and true objects, and the similarity between their frames."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import linear_sum_assignment

from neoworld_mjx.errors import SpecError, choices
from neoworld_mjx.measure import iou_2d

from ..measures.depth_measure import IDENTITY, Intrinsics, Similarity, least_squares_similarity
from .true_views import PosedObject

LEAST_OVERLAP = 0.3
"""Least intersection over union of the image boxes of a pair that no name decides."""
LEAST_SPREAD = 0.05
"""Least second extent of the objects' centroids, over the first, for a similarity from them."""


class PosedMesh(NamedTuple):
    """Visible surface of a reconstructed object."""

    vertices: Float[np.ndarray, "v 3"]
    """In the frame of the reconstruction's camera, or of its scene [m]."""
    faces: Int[np.ndarray, "f 3"]

    @property
    def centroid(self) -> Float[np.ndarray, " 3"]:
        """Centroid of the surface, which turns and scales with it [m]."""
        return surface_centroid(self.vertices, self.faces)


def matched(
    reconstructed: Mapping[str, PosedMesh],
    true: Sequence[PosedObject],
    stated: Mapping[str, str],
    *,
    made_camera: Intrinsics | None = None,
    true_camera: Intrinsics | None = None,
) -> dict[str, str]:
    """Return the name of the reconstructed object by that of the true one.

    Stated pairs come first, then equal names. Of the rest, the Hungarian method pairs objects by
    the overlap of their boxes in the image, which needs both cameras.

    Args:
        reconstructed: reconstructed objects by name.
        true: true objects.
        stated: name of the true object by that of the reconstructed one.
        made_camera: intrinsics of the reconstruction, for an image of the true size.
        true_camera: true intrinsics.

    Raises:
        SpecError: a stated name does not exist, or stands in two pairs.
    """
    names = [item.name for item in true]
    pairs: dict[str, str] = {}
    for name, true_name in stated.items():
        if name not in reconstructed:
            raise SpecError(f"matches: {choices(name, list(reconstructed))}")
        if true_name not in names:
            raise SpecError(f"matches: {choices(true_name, names)}")
        if true_name in pairs:
            raise SpecError(f"matches: {true_name} stands in two pairs")
        pairs[true_name] = name
    for name in names:
        if name in reconstructed and name not in pairs and name not in pairs.values():
            pairs[name] = name
    unmatched = [item for item in true if item.name not in pairs]
    free = [name for name in reconstructed if name not in pairs.values()]
    if made_camera is None or true_camera is None or not unmatched or not free:
        return pairs
    boxes = [_image_box(reconstructed[name].vertices, made_camera) for name in free]
    overlap = np.array(
        [[iou_2d(_image_box(item.posed, true_camera), box) for box in boxes] for item in unmatched]
    )
    for row, column in zip(*linear_sum_assignment(-overlap), strict=True):
        if overlap[row, column] >= LEAST_OVERLAP:
            pairs[unmatched[row].name] = free[column]
    return pairs


def scale_of(reconstructed: Sequence[PosedMesh], true: Sequence[PosedObject]) -> Similarity:
    """Return the scale about the camera that brings pairs of objects to the true distance."""
    ratios = [
        np.linalg.norm(_centroid(item)) / np.linalg.norm(mesh.centroid)
        for mesh, item in zip(reconstructed, true, strict=True)
    ]
    return IDENTITY._replace(scale=float(np.median(ratios))) if ratios else IDENTITY


def similarity_of(reconstructed: Sequence[PosedMesh], true: Sequence[PosedObject]) -> Similarity:
    """Return the least-squares similarity of the centroids of pairs of objects.

    Raises:
        SpecError: fewer than three pairs, or their centroids lie on a line.
    """
    p = np.array([mesh.centroid for mesh in reconstructed]).reshape(-1, 3)
    q = np.array([_centroid(item) for item in true]).reshape(-1, 3)
    extents = np.linalg.svd(q - q.mean(axis=0), compute_uv=False) if len(q) >= 3 else [1.0, 0.0]
    if extents[1] < LEAST_SPREAD * extents[0]:
        raise SpecError(
            f"{len(q)} pairs of objects do not determine a similarity: three that lie on no line "
            "do; name pairs in matches.json, or take --align none or scale"
        )
    return least_squares_similarity(p, q)


def surface_centroid(
    vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]
) -> Float[np.ndarray, " 3"]:
    """Return the centroid of a surface [m]; of the vertices where it has no area."""
    a, b, c = vertices[faces].transpose(1, 0, 2)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    if area.sum() <= 0:
        return vertices.mean(axis=0)
    return area @ (a + b + c) / 3 / area.sum()


def _centroid(item: PosedObject) -> Float[np.ndarray, " 3"]:
    return surface_centroid(item.posed, item.faces)


def _image_box(points: Float[np.ndarray, "n 3"], camera: Intrinsics) -> Float[np.ndarray, " 4"]:
    pixels = camera.project(points)
    return np.concatenate([pixels.min(axis=0), pixels.max(axis=0)])
