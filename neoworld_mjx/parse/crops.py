"""Crops of objects for the programmer, with outlines of their neighbors and notes on occlusion."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import UInt8

from ..mllm import Picture
from ..spec import SceneTree, TreeNode
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
    picture = Picture.of("crop", enlarged(canvas[top:bottom, left:right], SHOWN_PX))
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
