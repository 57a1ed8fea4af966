"""Render with flat colors, one light and outlines, without shadows and patterns.

`render_plain` takes a fraction of the time of `rendering.render`. It serves to compare many
candidate layouts. `flat_faces` finds large flat faces of objects in a rendered image.
"""

from typing import cast

import numpy as np
from jaxtyping import Bool, UInt8
from numpy.typing import NDArray
from scipy import ndimage

from ..spec import Camera, SceneSpec
from .appearance import display, geom_rgba, linear
from .lighting import FLOOR_COLOUR, HORIZON
from .ray_caster import RayCaster
from .rendering import Layers, RenderedImage, compile_posed
from .view import View

_AMBIENT, _SKY, _KEY = 0.25, 0.3, 0.55
_OUTLINE = 0.45
"""Factor that darkens the pixels on the border of an object."""


def render_plain(
    scene: SceneSpec, camera: Camera | View, *, width: int | None = None
) -> UInt8[np.ndarray, "height width 3"]:
    """Render a scene with flat colors.

    Args:
        scene: the scene, which is rendered at its poses and joint states.
        camera: the camera.
        width: width of the image [px]; if None, the width of the camera.

    Returns:
        The image in display color (sRGB).
    """
    if isinstance(camera, Camera):
        view = View.of(camera, width)
    else:
        tall = round((width or camera.width) * camera.height / camera.width)
        view = camera.resized(width or camera.width, max(1, tall))
    model, data = compile_posed(scene)
    rows, columns = np.mgrid[: view.height, : view.width]
    pixels = np.stack([columns + 0.5, rows + 0.5], axis=-1).reshape(-1, 2)
    rays = view.rays(pixels)
    caster = RayCaster(model, data)
    hits = caster.hits(view.eye, rays, smooth=False, opaque=True)
    layers = Layers.cast(caster, view.eye, rays, hits.distance, smooth=False)

    colour = linear(geom_rgba(model)[:, :3])
    # The light from above left of the camera makes the three visible sides of a box differ.
    towards = view.axes @ np.array([-0.5, -0.7, -0.5])
    towards /= np.linalg.norm(towards)

    def lit(geom: NDArray, normal: NDArray) -> NDArray:
        facing = np.maximum(normal @ towards, 0.0)
        light = _AMBIENT + _SKY * (0.5 + 0.5 * normal[:, 2]) + _KEY * facing
        return colour[geom] * light[:, None]

    def paint(k: NDArray, behind: NDArray) -> NDArray:
        geom = layers.hits.geom[k]
        alpha = caster.alpha[geom, None]
        return alpha * lit(geom, layers.hits.normal[k]) + (1.0 - alpha) * behind

    picture = np.where(rays[:, 2:] < 0.0, FLOOR_COLOUR, HORIZON)
    body = np.flatnonzero(hits.geom >= 0)
    picture[body] = lit(hits.geom[body], hits.normal[body])
    picture = layers.over(picture, paint)

    root = np.append(model.body_rootid[model.geom_bodyid], -1)
    border = np.zeros(len(rays), bool)
    nearest = layers.nearest()
    front = hits.geom.copy()
    front[layers.ray[nearest]] = layers.hits.geom[nearest]
    for first in (hits.geom, front):
        border |= _borders(root[first].reshape(view.height, view.width)).ravel()
    picture[border] *= _OUTLINE
    return display(picture * view.gain).reshape(view.height, view.width, 3)


def _borders(owner: NDArray) -> NDArray:
    """Return a mask of the pixels [h, w] whose right or lower neighbor shows another object."""
    border = np.zeros(owner.shape, bool)
    border[:, :-1] |= owner[:, :-1] != owner[:, 1:]
    border[:-1] |= owner[:-1] != owner[1:]
    return border


LEAST_SHARE = 0.004
"""Smallest fraction of the image that a face covers."""
LEAST_OF_OBJECT = 0.15
"""Smallest fraction of the object's visible pixels that a face covers. Bands of a round object,
which have nearly equal normals, cover less."""
MOST_FACES = 3
"""Largest number of faces of a box that a camera sees at once."""
SAME_NORMAL = 0.996
"""Smallest cosine between the normals of one face (an angle of 5 degrees)."""
SAME_PLANE = 0.01
"""Largest distance of a point from the plane of its face, relative to the point's depth."""


def flat_faces(image: RenderedImage, view: View) -> Bool[np.ndarray, "row column"]:
    """Return a mask of the pixels that show a large flat face of an object.

    Args:
        image: the rendered image.
        view: the view of the image.
    """
    rows, columns = np.mgrid[: view.height, : view.width]
    rays = view.rays(np.stack([columns + 0.5, rows + 0.5], axis=-1).reshape(-1, 2))
    depth = np.where(np.isfinite(image.depth), image.depth, 0.0).ravel()
    points = view.eye + rays * (depth / (rays @ view.axes[:, 2]))[:, None]
    normals = image.normal.reshape(-1, 3)
    flat = np.zeros(depth.size, bool)
    least = LEAST_SHARE * depth.size
    for k in range(len(image.names)):
        remaining = np.flatnonzero(image.segmentation.ravel() == k)
        least_here = max(least, LEAST_OF_OBJECT * len(remaining))
        for _ in range(MOST_FACES):
            if len(remaining) < least_here:
                break
            same = normals[remaining] @ _most_common(normals[remaining]) > SAME_NORMAL
            if same.sum() < least_here:
                break
            side = remaining[same]
            normal = normals[side].mean(axis=0)
            offsets = (points[side] - points[side[0]]) @ normal
            on_plane = np.abs(offsets - np.median(offsets)) < SAME_PLANE * depth[side]
            if on_plane.sum() >= least_here:
                flat[side[on_plane]] = True
            remaining = remaining[~same]
    # Remove isolated pixels, which belong to details that lie in the plane of a face.
    return cast(Bool[np.ndarray, "row column"], ndimage.binary_opening(flat.reshape(rows.shape)))


def _most_common(normals: np.ndarray) -> np.ndarray:
    """Return the median of the normals [n, 3] in the most common bin; bins are 0.2 wide."""
    _, bins, counts = np.unique(
        np.round(5 * normals), axis=0, return_inverse=True, return_counts=True
    )
    return np.median(normals[bins.ravel() == counts.argmax()], axis=0)
