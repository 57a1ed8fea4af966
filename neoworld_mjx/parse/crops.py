"""Crops of objects and colors of supports, as the photograph shows them.

A crop has outlines of the object's neighbors and a note on occlusion. A color is measured on pixels
that show only the support. A pixel shows a support if the ray through the pixel hits this support
before any other, and if the pixel is within the support's 2D box and outside the 2D boxes of all
objects.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
import shapely
from jaxtyping import Bool, Float, UInt8
from scipy.ndimage import binary_erosion

from ..mllm import Picture
from ..spec import SceneTree, TreeNode
from ..spec.pose import conjugate, from_yaw, quat_mul, rotate
from .photo import Photo, enlarged

MARGIN = 0.12
"""Margin on every side, as a fraction of the longer side of the object's 2D box."""
LEAST_PX = 8
"""Minimum margin [px]."""
MARK = (90, 90, 90)
"""Color of the outlines of other objects."""
SHOWN_PX = 448
"""Minimum length of a crop's longer side [px]; smaller crops are enlarged, up to eightfold."""

Window = tuple[int, int, int, int]


@dataclass(frozen=True)
class Crop:
    """An object cut out of the photo."""

    picture: Picture
    """The crop, with the label "crop" by which requests refer to it."""
    note: str
    """Phrase that names occluders, and edges of the picture that cut the object off; else empty."""
    window: tuple[float, float, float, float]
    """Window of the crop in pixels of the original photo (x0, y0, x1, y1)."""


def crops(photo: Photo, tree: SceneTree) -> dict[str, Crop]:
    """Return the crop of every object, by node name.

    Small crops are enlarged in integer arithmetic, so every machine gives the same bytes. The 2D
    boxes of other objects, but not of environment supports, are outlined in gray.
    """
    return {node.name: _crop(photo, tree, node) for node in tree.nodes}


def _crop(photo: Photo, tree: SceneTree, node: TreeNode) -> Crop:
    left, top, right, bottom = window = _window(photo, node)
    canvas = np.array(photo.rgb)
    for other in tree.nodes:
        if other.name != node.name and not other.environment:
            _outline(canvas, _pixel_box(photo, other))
    picture = Picture("crop", enlarged(canvas[top:bottom, left:right], SHOWN_PX))
    x0, y0, x1, y1 = (v / photo.scale for v in window)
    return Crop(picture, _note(tree, node), (x0, y0, x1, y1))


def _window(photo: Photo, node: TreeNode) -> Window:
    """Return a node's 2D box with a margin, in integer pixels of the resized picture."""
    width, height = photo.size
    x0, y0, x1, y1 = _pixel_box(photo, node)
    margin = max(LEAST_PX, round(MARGIN * max(x1 - x0, y1 - y0)))
    left, top = max(0, x0 - margin), max(0, y0 - margin)
    return left, top, min(width, x1 + margin), min(height, y1 + margin)


def colour_in_box(photo: Photo, tree: SceneTree, node: TreeNode) -> tuple[float, float, float]:
    """Return the median RGB, 0 to 1, of a node's 2D box outside the boxes of other objects."""
    free = np.zeros(photo.rgb.shape[:2], bool)
    x0, y0, x1, y1 = _pixel_box(photo, node)
    free[y0:y1, x0:x1] = True
    for other in tree.nodes:
        if other.name != node.name and not other.environment:
            a, b, c, d = _pixel_box(photo, other)
            free[b:d, a:c] = False
    chosen = photo.rgb[free] if free.any() else photo.rgb[y0:y1, x0:x1].reshape(-1, 3)
    red, green, blue = (float(v) / 255 for v in np.median(chosen, axis=0))
    return red, green, blue


def _outline(canvas: UInt8[np.ndarray, "h w 3"], box: Window) -> None:
    x0, y0, x1, y1 = box
    canvas[y0:y1, [x0, x1 - 1]] = MARK
    canvas[[y0, y1 - 1], x0:x1] = MARK


def _pixel_box(photo: Photo, node: TreeNode) -> Window:
    """Return a node's 2D box in integer pixels of the resized picture; each side is at least 1."""
    width, height = photo.size
    x0, y0, x1, y1 = (v * photo.scale for v in node.box2d.as_tuple())
    left, top = min(int(x0), width - 1), min(int(y0), height - 1)
    return left, top, max(left + 1, min(round(x1), width)), max(top + 1, min(round(y1), height))


def _note(tree: SceneTree, node: TreeNode) -> str:
    camera = tree.camera
    x0, y0, x1, y1 = node.box2d.as_tuple()
    cut = [
        side
        for side, beyond in (
            ("left", x0 <= 1),
            ("top", y0 <= 1),
            ("right", x1 >= camera.width - 1),
            ("bottom", y1 >= camera.height_px - 1),
        )
        if beyond
    ]
    phrases = []
    if node.occluded_by:
        hidden = [f"{name}{_covered_part(tree.node(name), node)}" for name in node.occluded_by]
        phrases.append(f"partly hidden by {', '.join(hidden)}")
    elif node.occluded and not cut:
        phrases.append("partly hidden")
    if cut:
        phrases.append(f"cut off by the picture's {' and '.join(cut)} edge")
    return "; ".join(phrases)


def _covered_part(other: TreeNode, node: TreeNode) -> str:
    """Describe how much of a node's box another box covers, and which of 3 x 3 cells it is in."""
    box, over = np.array(node.box2d.as_tuple()), np.array(other.box2d.as_tuple())
    low, high = np.maximum(box[:2], over[:2]), np.minimum(box[2:], over[2:])
    if (low >= high).any():
        return ""
    sides = box[2:] - box[:2]
    share = float(np.prod((high - low) / sides))
    across, down = np.floor(((low + high) / 2 - box[:2]) / sides * 3).astype(int).tolist()
    words = [("upper", "", "lower")[min(down, 2)], ("left", "", "right")[min(across, 2)]]
    place = " ".join(word for word in words if word) or "middle"
    return f" (its box covers {share:.0%} of this one's, {place})"


RASTER = 320
"""Number of samples along the picture's longer side."""
BOX_MARGIN = 0.012
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
    margin = BOX_MARGIN * max(photo.original_size)
    free = np.ones(first.shape, bool)
    for node in tree.nodes:
        if not node.slab:
            free &= ~_within(node, pixels, margin)
    rgb = photo.rgb[shown[..., 1].astype(int), shown[..., 0].astype(int)]
    erosions = max(1, round(BOX_MARGIN * RASTER))
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
        x, y, _ = (local + t[:, None] * d).T
        on = shapely.contains_xy(shapely.Polygon(corners), x, y)
        return np.where(on & (t > 0), t, np.inf).reshape(rays.shape[:2])
    low, high = (middle - half - local) / d, (middle + half - local) / d
    near, far = np.minimum(low, high).max(axis=1), np.maximum(low, high).min(axis=1)
    return np.where((near <= far) & (near > 0), near, np.inf).reshape(rays.shape[:2])
