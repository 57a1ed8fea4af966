"""Colors of supports, measured on pixels that show only the support.

A pixel shows a support if the ray through the pixel hits this support before any other, and if the
pixel is within the support's 2D box and outside the 2D boxes of all objects.
"""

from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import binary_erosion

from ..spec import SceneTree, TreeNode
from ..spec.outlines import inside_edges
from ..spec.pose import conjugate, from_yaw, quat_mul, rotate
from .crops import colour_in_box
from .photo import Photo

RASTER = 320
"""Number of samples along the picture's longer side."""
MARGIN = 0.012
"""Width of the excluded borders around objects and inside supports, as a fraction of the picture's
longer side."""
LEAST_SHARE = 0.004
"""A color is measured if the support alone is visible in at least this fraction of the picture."""


class SupportColour(NamedTuple):
    """Color of a support, and the source of the color."""

    rgb: tuple[float, float, float] | None
    """RGB, 0 to 1. If None, the support has the color of its material."""
    source: Literal["photo", "answer", "material", "box"]
    """Source of the color. `photo`: median of the pixels that show only the support. `answer`:
    color in the response. `material`: color of the material. `box`: median of the support's 2D box
    outside the 2D boxes of objects, for a support without a declared surface."""
    share: float
    """Fraction of the picture that shows only the support."""


def support_colours(photo: Photo, tree: SceneTree) -> dict[str, SupportColour]:
    """Return the color of every support of the environment that is built from its 3D box.

    If enough of a support is visible, the measured color takes precedence over the parsed color.

    Args:
        photo: the photograph.
        tree: the parsed scene.
    """
    supports = [node for node in tree.nodes if node.slab]
    if not supports:
        return {}
    width, height = photo.size
    step = max(1.0, max(photo.size) / RASTER)
    columns, rows = np.arange(step / 2, width, step), np.arange(step / 2, height, step)
    shown = np.stack(np.meshgrid(columns, rows), axis=-1)
    pixels = shown / photo.scale
    rays = tree.camera.rays(pixels.reshape(-1, 2))
    rays = (rays / np.linalg.norm(rays, axis=1, keepdims=True)).reshape(*pixels.shape[:2], 3)
    eye = tree.camera.position()
    distances = np.stack([_distance(node, eye, rays) for node in supports])
    first = np.where(np.isfinite(distances.min(axis=0)), distances.argmin(axis=0), -1)
    margin = MARGIN * max(photo.original_size)
    free = np.ones(first.shape, bool)
    for node in tree.nodes:
        if not node.slab:
            free &= ~_within(node, pixels, margin)
    rgb = photo.rgb[shown[..., 1].astype(int), shown[..., 0].astype(int)]
    erosions = max(1, round(MARGIN * RASTER))
    colours = {}
    for k, node in enumerate(supports):
        visible = (first == k) & free & _within(node, pixels, 0.0)
        visible = np.asarray(binary_erosion(visible, iterations=erosions, border_value=1), bool)
        share = float(visible.mean())
        if node.surface is None:
            colours[node.name] = SupportColour(colour_in_box(photo, tree, node), "box", share)
        elif share >= LEAST_SHARE:
            red, green, blue = (np.median(rgb[visible], axis=0) / 255).tolist()
            colours[node.name] = SupportColour((red, green, blue), "photo", share)
        else:
            source = "material" if node.surface.rgb is None else "answer"
            colours[node.name] = SupportColour(node.surface.rgb, source, share)
    return colours


def _within(
    node: TreeNode, pixels: Float[np.ndarray, "h w 2"], margin: float
) -> Bool[np.ndarray, "h w"]:
    x0, y0, x1, y1 = node.box2d.as_tuple()
    u, v = pixels[..., 0], pixels[..., 1]
    return (u > x0 - margin) & (u < x1 + margin) & (v > y0 - margin) & (v < y1 + margin)


def _distance(
    node: TreeNode, eye: Float[np.ndarray, "3"], rays: Float[np.ndarray, "h w 3"]
) -> Float[np.ndarray, "h w"]:
    """Return the distance along each ray to a support's 3D box [m]; inf if the ray misses it.

    If the outline of a support is not a rectangle, only its top face is considered.
    """
    box = node.box3d
    turn = conjugate(quat_mul(from_yaw(box.yaw), np.array(node.base_tilt)))
    local = rotate(turn, (eye - np.array(box.position))[None])[0]
    d = rotate(turn, rays.reshape(-1, 3))
    d = np.where(np.abs(d) < 1e-12, 1e-12, d)
    half = np.array(box.size) / 2
    middle = np.array([0.0, 0.0, half[2]])
    if node.outline.shape != "rectangle":
        t = (box.size[2] - local[2]) / d[:, 2]
        corners = node.outline.corners() * np.array(box.size[:2])
        on = inside_edges((local + t[:, None] * d)[:, :2], corners, np.roll(corners, -1, axis=0))
        return np.where(on & (t > 0), t, np.inf).reshape(rays.shape[:2])
    low, high = (middle - half - local) / d, (middle + half - local) / d
    near, far = np.minimum(low, high).max(axis=1), np.maximum(low, high).min(axis=1)
    return np.where((near <= far) & (near > 0), near, np.inf).reshape(rays.shape[:2])
