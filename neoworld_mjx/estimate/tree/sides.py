"""Sides of 2D boxes that show an object's outline, uncut by occluders and the picture's border."""

from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float

from ...spec import Box3D, Camera, Quat, SceneTree, TreeNode
from .projection import outline_points, to_world

SIDES = ("left", "top", "right", "bottom")
EDGE = 0.01
"""Distance from the picture's border within which the border may cut a box, relative to the
picture's longer side."""
HIDDEN_FRACTION = 1 / 3
"""Fraction of a side within the box of a named occluder above which the side counts as hidden."""
HIDDEN_FRACTION_UNNAMED = 0.6
"""The same fraction for a nearer object that the response does not name as an occluder."""
CUT_OFF = 0.02
"""Distance outside the picture at which an extreme point counts as cut off, relative to the
picture's longer side."""


def hidden_sides(tree: SceneTree, node: TreeNode) -> Bool[np.ndarray, "4"]:
    """Return a mask of the sides of a 2D box (left, top, right, bottom) that may be hidden.

    A side counts as hidden in each of these cases:

    - The side lies at the picture's border.
    - The border cuts the object, and the extreme point of the 3D outline on this side lies outside
      the picture.
    - An object in front covers much of the side: an occluder that the response names, the container
      of the object, or a nearer object whose 2D box overlaps.

    If the response lists the cut sides, the list replaces the last case. If the response marks the
    object as occluded, but names no occluder and no side lies at the border, every side counts as
    hidden.

    Args:
        tree: the parsed scene, or a fit of it.
        node: the object whose sides are tested.
    """
    camera = tree.camera
    edge = EDGE * max(camera.width, camera.height_px)
    box = np.array(node.box2d.as_tuple())
    frame = np.array([0.0, 0.0, camera.width, camera.height_px])
    outward = np.array([-1.0, -1.0, 1.0, 1.0])
    at_border = outward * (frame - box) <= edge
    hidden = at_border | _cut_points(tree, node, at_border)
    if node.cues.cut_sides is not None:
        # The border may cut a side even if the response does not list it.
        return hidden | np.array([side in node.cues.cut_sides for side in SIDES])
    if node.occluded and not _occluders(node) and not at_border.any():
        return np.ones(4, bool)
    return hidden | _covered_sides(tree, node, box, edge)


def _occluders(node: TreeNode) -> set[str]:
    """Return the names of the objects that occlude an object according to the response."""
    names = set(node.occluded_by)
    if node.relation == "in" and node.parent is not None:
        names.add(node.parent)
    return names


def _covered_sides(
    tree: SceneTree, node: TreeNode, box: Float[np.ndarray, "4"], edge: float
) -> Bool[np.ndarray, "4"]:
    """Return a mask of the sides of a box that the boxes of possible occluders cover."""
    names, hidden = _occluders(node), np.zeros(4, bool)
    boxes = np.array([other.box2d.as_tuple() for other in tree.nodes])
    fractions = _covered_fractions(box, boxes, edge)
    for k in np.flatnonzero((fractions >= HIDDEN_FRACTION).any(axis=1)):
        other = tree.nodes[k]
        if other.name == node.name:
            continue
        if other.name in names:
            hidden |= fractions[k] >= HIDDEN_FRACTION
        elif (fractions[k] >= HIDDEN_FRACTION_UNNAMED).any() and _is_nearer(tree, other, node):
            hidden |= fractions[k] >= HIDDEN_FRACTION_UNNAMED
    return hidden


def _cut_points(
    tree: SceneTree, node: TreeNode, at_border: Bool[np.ndarray, "4"]
) -> Bool[np.ndarray, "4"]:
    """Return a mask of the sides of a cut object whose extreme points are outside the picture."""
    if not at_border.any():
        return np.zeros(4, bool)
    camera = tree.camera
    points, _ = outline_points(node)
    pixels, depth = camera.project(to_world(points, node.box3d, node.base_tilt))
    if depth.min() <= 0:
        return np.ones(4, bool)
    size = np.array([camera.width, camera.height_px], float)
    slack = CUT_OFF * size.max()
    outside = ((pixels < -slack) | (pixels > size + slack)).any(axis=1)
    low, high = pixels.argmin(axis=0), pixels.argmax(axis=0)
    return outside[np.array([*low, *high])]


def _is_nearer(tree: SceneTree, other: TreeNode, node: TreeNode) -> bool:
    """Return True if `other` is nearer than `node`, and neither is the parent of the other."""
    if other.environment or node.environment:
        return False
    if other.parent == node.name or node.parent == other.name:
        return False
    camera = tree.camera
    nearer, depth = (
        _depth(camera, item.box3d, item.base_tilt)  # pyright: ignore[reportArgumentType]
        for item in (other, node)
    )
    return nearer < depth


@lru_cache(maxsize=1024)  # Many pairs of objects compare their depths.
def _depth(camera: Camera, box: Box3D, tilt: Quat) -> float:
    """Return the mean depth of a box's corners [m]."""
    eye, axis = camera.position(), camera.axes()[:, 2]
    return float(((box.corners(tilt) - eye) @ axis).mean())


def _covered_fractions(
    box: Float[np.ndarray, "4"], occluders: Float[np.ndarray, "n 4"], slack: float
) -> Float[np.ndarray, "n 4"]:
    """Return the fraction of each side of a box that lies in other boxes, grown by `slack`."""
    enlarged = occluders + slack * np.array([-1.0, -1.0, 1.0, 1.0])
    low, high = np.maximum(enlarged[:, :2], box[:2]), np.minimum(enlarged[:, 2:], box[2:])
    # Vertical sides extend along y, horizontal ones along x.
    overlap = (np.maximum(high - low, 0.0) / (box[2:] - box[:2]))[:, [1, 0, 1, 0]]
    within = (np.tile(enlarged[:, :2], 2) <= box) & (box <= np.tile(enlarged[:, 2:], 2))
    return np.where(within, overlap, 0.0)
