"""A reconstructed scene in the frame of its camera: its points by ray casting, and its objects with
the true objects that they match."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import linear_sum_assignment

from neoworld_mjx.measure import iou_2d
from neoworld_mjx.render.ray_caster import RayCaster
from neoworld_mjx.render.rendering import compile_posed, object_of_geoms
from neoworld_mjx.spec import Camera, SceneSpec

from ..measures.pose_measure import IDENTITY, Intrinsics, Similarity
from .true_views import PosedObject

LEAST_OVERLAP = 0.3
"""Least intersection over union of the image boxes of a pair that no name decides."""


class ScenePoints(NamedTuple):
    """Depth and object at each pixel of a camera."""

    points: Float[np.ndarray, "h w 3"]
    """In the camera's frame: x right, y down, z ahead [m]; inf for the background."""
    segmentation: Int[np.ndarray, "h w"]
    """Index of the object; -1 for the background."""
    names: tuple[str, ...]


def intrinsics_of(camera: Camera, width: int, height: int) -> Intrinsics:
    """Return the intrinsics of a scene's camera for an image of another size."""
    resized = camera.resized(width, height)
    cx, cy = (resized.center - 0.5).tolist()
    return Intrinsics(resized.focal, resized.focal, cx, cy)


def scene_points(
    scene: SceneSpec, camera: Camera, intrinsics: Intrinsics, size: tuple[int, int]
) -> ScenePoints:
    """Cast a ray through the center of every pixel.

    Args:
        scene: the scene in its poses.
        camera: its place and direction; its field of view is not used.
        intrinsics: of the image.
        size: width and height of the image [px].
    """
    model, data = compile_posed(scene)
    directions = intrinsics.directions(*size)
    eye, axes = camera.position(), camera.axes()
    # The directions have depth 1, so that the distance along them is the depth.
    hits = RayCaster(model, data).hits(eye, directions.reshape(-1, 3) @ axes.T, smooth=False)
    depth = hits.distance.reshape(directions.shape[:2])
    owner, names = object_of_geoms(model)
    geom = hits.geom.reshape(depth.shape)
    hit = geom >= 0
    points = np.where(hit[..., None], directions * np.where(hit, depth, 0.0)[..., None], np.inf)
    return ScenePoints(points, np.where(hit, owner[np.maximum(geom, 0)], -1).astype(int), names)


def in_camera(camera: Camera, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Return world points in the camera's frame: x right, y down, z ahead [m]."""
    return (points - camera.position()) @ camera.axes()


class PosedMesh(NamedTuple):
    """Visible surface of a reconstructed object."""

    vertices: Float[np.ndarray, "v 3"]
    """In the frame of the reconstruction's camera [m]."""
    faces: Int[np.ndarray, "f 3"]

    @property
    def centroid(self) -> Float[np.ndarray, " 3"]:
        """Centroid of the surface, which turns and scales with it [m]."""
        return surface_centroid(self.vertices, self.faces)


def matched(
    reconstructed: Mapping[str, PosedMesh],
    true: Sequence[PosedObject],
    made_camera: Intrinsics,
    true_camera: Intrinsics,
) -> dict[str, str]:
    """Return the name of the reconstructed object by that of the true one.

    Equal names come first. Of the rest, the Hungarian method pairs objects by the overlap of their
    boxes in the image.

    Args:
        reconstructed: reconstructed objects by name.
        true: true objects.
        made_camera: intrinsics of the reconstruction, for an image of the true size.
        true_camera: true intrinsics.
    """
    pairs = {item.name: item.name for item in true if item.name in reconstructed}
    unmatched = [item for item in true if item.name not in pairs]
    free = [name for name in reconstructed if name not in pairs]
    if not unmatched or not free:
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
