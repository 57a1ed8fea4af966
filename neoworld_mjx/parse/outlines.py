"""Outlines of parsed objects in the picture, from their 3D boxes and categories.

A tight 2D box around a cup is smaller than the projection of the cup's 3D box. The category of an
object therefore gives the shape of its outline within the 3D box: the box itself, an upright
cylinder, a ball, ..., or a shape between box and cylinder if the category is unknown. Occluders and
the picture's border hide sides of a 2D box, which then agree with every outline beyond them.
"""

import numpy as np
import shapely
from jaxtyping import Bool, Float

from ..spec import Box3D, Camera, Quat, SceneTree, TreeNode
from ..spec.pose import IDENTITY, from_yaw, rotate
from .categories import Outline, category_of

NEAR_M = 0.02
"""Distance of the near plane from the camera [m]."""
MAX_SLAB_RATIO = 0.2
"""Maximum ratio of a slab's height to its shorter edge."""
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

# Box3D.corners are ordered like the binary numbers xyz: x varies slowest.
_EDGES = [(i, i | bit) for i in range(8) for bit in (1, 2, 4) if not i & bit]
_ANGLES = np.linspace(0.0, 2 * np.pi, 24, endpoint=False)
_RIM = np.column_stack([np.cos(_ANGLES) / 2, np.sin(_ANGLES) / 2])
BOX_POINTS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0.0, 1.0)])
_UPPER_RIM = np.column_stack([_RIM, np.ones(len(_RIM))])
ROUND_POINTS = np.concatenate([_UPPER_RIM, _UPPER_RIM * [1, 1, 0]])
TAPERED_POINTS = np.concatenate([_UPPER_RIM, _UPPER_RIM * [0.65, 0.65, 0]])
_NARROW_POINTS = np.concatenate([_UPPER_RIM, _UPPER_RIM * [0.4, 0.4, 0]])
BALL_POINTS = np.array(
    [
        [x * np.cos(up), y * np.cos(up), 0.5 + np.sin(up) / 2]
        for up in np.linspace(-np.pi / 2, np.pi / 2, 13)
        for x, y in _RIM
    ]
)
TOUCHING_POINTS = np.array(
    [(-0.5, 0, 0.5), (0.5, 0, 0.5), (0, -0.5, 0.5), (0, 0.5, 0.5), (0, 0, 0), (0, 0, 1)]
)
"""The middles of a box's faces: any shape fills its box in all three directions, but one of an
unknown category, such as a pot with two handles, may fill nothing else of it."""
_HANDLE = np.array([[0.5, y, z] for y in (-0.08, 0.08) for z in (0.35, 0.8)])
_TAIL = np.array([[-0.5, y, z] for y in (-0.15, 0.15) for z in (0.5, 1.0)])
_MIN_HANDLE = 1.1
"""Minimum ratio of length to width of a handled object whose box includes the handle."""


def outline_of(node: TreeNode) -> Outline:
    """Return the outline of a node's category; "loose" if the category is unknown."""
    category = category_of(node.label)
    return "loose" if category is None else category.outline


def is_slab(node: TreeNode) -> bool:
    """Return True if a node is flat, like a floor or the top of a table."""
    length, width, height = node.box3d.size
    return height < MAX_SLAB_RATIO * min(length, width)


def outline_points(node: TreeNode) -> tuple[Float[np.ndarray, "n 3"], float]:
    """Return points on a node's outline in a unit box, and the weight of the box's corners.

    The points are in the frame of `Box3D`. The extent of a node is the weighted mean of the extent
    of the corners and the extent of the points.
    """
    outline = outline_of(node)
    length, width, _ = node.box3d.size
    ratio = min(width / length, 1.0)
    if node.outline.shape != "rectangle":
        flat = node.outline.corners()
        ends = [np.column_stack([flat, np.full(len(flat), z)]) for z in (0.0, 1.0)]
        return np.concatenate(ends), 0.0
    if outline == "box" or node.environment:
        return BOX_POINTS, 1.0
    if outline == "handled" and length > _MIN_HANDLE * width:
        body = TAPERED_POINTS * [ratio, 1, 1] - [(1 - ratio) / 2, 0, 0]
        return np.concatenate([body, _HANDLE]), 0.0
    if outline == "spoon" and length > 2 * width:
        bowl = ROUND_POINTS * [1.4 * ratio, 1, 0.5] + [0.5 - 0.7 * ratio, 0, 0]
        return np.concatenate([bowl, _TAIL]), 0.0
    points = {
        "ball": BALL_POINTS,
        "round": ROUND_POINTS,
        "loose": ROUND_POINTS,
        "spoon": ROUND_POINTS,
    }
    return points.get(outline, TAPERED_POINTS), 0.5 if outline in ("loose", "spoon") else 0.0


def silhouettes(node: TreeNode) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "m 3"]]:
    """Return points of a node's smallest and of its largest outline, in a unit box.

    The extents of the object lie between those of the two outlines.
    """
    points, weight = outline_points(node)
    if outline_of(node) == "tapered" and weight == 0 and node.outline.shape == "rectangle":
        return _NARROW_POINTS, ROUND_POINTS
    if 0 < weight < 1:
        return TOUCHING_POINTS, BOX_POINTS
    if weight == 0 and not np.allclose(node.base_tilt, IDENTITY):
        # The neck or the foot of a lying object may be visible from its end.
        return BALL_POINTS, points
    return points, points


def to_world(
    points: Float[np.ndarray, "n 3"], box: Box3D, tilt: Quat = IDENTITY
) -> Float[np.ndarray, "n 3"]:
    """Transform points in a unit box to the world [m], as `Box3D.corners` transforms corners."""
    local = rotate(tilt, points * np.array(box.size))
    lowest = rotate(tilt, BOX_POINTS * np.array(box.size))[:, 2].min()
    local[:, 2] -= lowest
    return rotate(from_yaw(box.yaw), local) + np.array(box.position)


def visible_box(camera: Camera, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "4"] | None:
    """Return the box in pixels (x0, y0, x1, y1) of the visible part of a convex solid.

    The solid is clipped at the near plane and at the picture's border.

    Args:
        camera: the camera.
        points: points whose convex hull is the solid [m].

    Returns:
        The box, or None if the solid is outside the picture.
    """
    local = (points - camera.position()) @ camera.axes()
    ahead = local[:, 2] > NEAR_M
    if not ahead.any():
        return None
    if not ahead.all():
        front, back = local[ahead][:, None], local[~ahead]
        share = (front[..., 2:] - NEAR_M) / (front[..., 2:] - back[:, 2:])
        crossing = front + share * (back - front)
        local = np.concatenate([local[ahead], crossing.reshape(-1, 3)])
    pixels, size = _pixel(camera, local), np.array([camera.width, camera.height_px], float)
    if (pixels >= 0).all() and (pixels <= size).all():
        return np.concatenate([pixels.min(axis=0), pixels.max(axis=0)])
    shown = shapely.MultiPoint(pixels).convex_hull.intersection(shapely.box(0, 0, *size))
    return None if shown.is_empty else np.array(shown.bounds)


def expected_box(camera: Camera, node: TreeNode) -> Float[np.ndarray, "4"] | None:
    """Return the box in pixels (x0, y0, x1, y1) of a node's unoccluded outline.

    Returns:
        The box, or None if the node is outside the picture.
    """
    corner_box = visible_box(camera, node.box3d.corners(node.base_tilt))
    points, weight = outline_points(node)
    inner = visible_box(camera, to_world(points, node.box3d, node.base_tilt))
    if corner_box is None or inner is None:
        return corner_box
    return weight * corner_box + (1 - weight) * inner


def nearest_outline(
    tree: SceneTree, node: TreeNode, hidden: Bool[np.ndarray, "4"] | None = None
) -> Float[np.ndarray, "4"] | None:
    """Return the box of a node's projected outline that is nearest to its 2D box [px].

    Where the outline is not known, its sides lie anywhere between those of the smallest and of the
    largest outline. A hidden side agrees with every outline that extends beyond it.

    Args:
        tree: the parsed scene.
        node: the object.
        hidden: sides of its 2D box that may be hidden; by default, `hidden_sides`.

    Returns:
        The box (x0, y0, x1, y1); None if the node is outside the picture.
    """
    boxes = [
        visible_box(tree.camera, to_world(points, node.box3d, node.base_tilt))
        for points in silhouettes(node)
    ]
    boxes = [box for box in boxes if box is not None]
    if not boxes:
        return None
    hidden = hidden_sides(tree, node) if hidden is None else hidden
    outward = np.array([-1.0, -1.0, 1.0, 1.0])
    seen, extents = outward * node.box2d.as_tuple(), outward * np.array(boxes)
    least = np.where(hidden, -np.inf, extents.min(axis=0))
    return outward * np.clip(seen, least, extents.max(axis=0))


def edges_in_view(
    camera: Camera, corners: Float[np.ndarray, "8 3"]
) -> list[tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]]:
    """Return the edges of a box as pairs of pixels, clipped at the near plane.

    Args:
        camera: the camera.
        corners: corners of the box [m], in the order of `Box3D.corners`.
    """
    local = (corners - camera.position()) @ camera.axes()
    lines = []
    for i, j in _EDGES:
        a, b = local[i], local[j]
        if a[2] < NEAR_M and b[2] < NEAR_M:
            continue
        if a[2] < NEAR_M:
            a = b + (a - b) * (b[2] - NEAR_M) / (b[2] - a[2])
        elif b[2] < NEAR_M:
            b = a + (b - a) * (a[2] - NEAR_M) / (a[2] - b[2])
        lines.append((_pixel(camera, a), _pixel(camera, b)))
    return lines


def _pixel(camera: Camera, local: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 2"]:
    return local[..., :2] / local[..., 2:3] * camera.focal + camera.center


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
        tree: the parsed scene.
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
    eye, forward = tree.camera.position(), tree.camera.axes()[:, 2]
    nearer, depth = (
        float(((item.box3d.corners(item.base_tilt) - eye) @ forward).mean())
        for item in (other, node)
    )
    return nearer < depth


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
