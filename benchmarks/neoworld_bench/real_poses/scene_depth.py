"""Points of a scene in the pixels of a camera, by ray casting."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from neoworld_mjx.render.ray_caster import RayCaster
from neoworld_mjx.render.rendering import compile_posed, object_of_geoms
from neoworld_mjx.spec import Camera, SceneSpec

from ..measures.depth_measure import Intrinsics


class ScenePoints(NamedTuple):
    """Depth and object at each pixel of a camera."""

    points: Float[np.ndarray, "h w 3"]
    """In the camera's frame: x right, y down, z ahead [m]; inf for the background."""
    segmentation: Int[np.ndarray, "h w"]
    """Index of the object; -1 for the background."""
    names: tuple[str, ...]


def intrinsics_of(camera: Camera, width: int, height: int) -> Intrinsics:
    """Return the intrinsics of a scene's camera for an image of another size."""
    focal = camera.focal * height / camera.height_px
    return Intrinsics(focal, focal, (width - 1) / 2, (height - 1) / 2)


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
