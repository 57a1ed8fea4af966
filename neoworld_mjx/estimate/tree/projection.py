"""Projection of 3D boxes by the parsed camera: visible boxes, edges, and outlines of objects.

A tight 2D box around a cup is smaller than the projection of the cup's 3D box. The category of an
object therefore gives the shape of its outline within the 3D box: the box itself, an upright
cylinder, a ball, ..., or a shape between box and cylinder if the category is unknown.

Extents of the visible part of a surface, from edges clipped at the picture's border.

If the border cuts an object, the object's visible box ends where its edges leave the picture. This
determines the object's position as accurately as a fully visible outline does.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import ConvexHull, QhullError

from ...spec import Box3D, Camera, Quat, TreeNode
from ...spec.pose import IDENTITY, from_yaw, rotate
from .categories import Outline, category_of

NEAR_M = 0.02
"""Distance of the near plane from the camera [m]."""

# Box3D.corners are ordered like the binary numbers xyz: x varies slowest.
_EDGES = [(i, i | bit) for i in range(8) for bit in (1, 2, 4) if not i & bit]
_FACES = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))


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


def outline_points(node: TreeNode) -> tuple[Float[np.ndarray, "n 3"], float]:
    """Return points on a node's outline in a unit box, and the weight of the box's corners.

    The points are in the frame of `Box3D`. The extent of a node is the weighted mean of the extent
    of the corners and the extent of the points.
    """
    outline = outline_of(node)
    length, width, _ = node.box3d.size
    ratio = min(width / length, 1.0)
    if outline == "handled" and length > _MIN_HANDLE * width:
        body = TAPERED_POINTS * [ratio, 1, 1] - [(1 - ratio) / 2, 0, 0]
        return np.concatenate([body, _HANDLE]), 0.0
    if outline == "spoon" and length > 2 * width:
        bowl = ROUND_POINTS * [1.4 * ratio, 1, 0.5] + [0.5 - 0.7 * ratio, 0, 0]
        return np.concatenate([bowl, _TAIL]), 0.0
    if outline == "box":
        return BOX_POINTS, 1.0
    points = {
        "ball": BALL_POINTS,
        "round": ROUND_POINTS,
        "loose": ROUND_POINTS,
        "spoon": ROUND_POINTS,
    }
    return points.get(outline, TAPERED_POINTS), 0.5 if outline in ("loose", "spoon") else 0.0


class Silhouette(NamedTuple):
    """Smallest and largest outline of an object, between which its true extents lie.

    Points are in the frame of `Box3D`; outlines of categories are scaled to a unit box.
    """

    inner: Float[np.ndarray, "a 3"]
    outer: Float[np.ndarray, "b 3"]
    lowest: Float[np.ndarray, "c 3"]
    """Points; the lowest of them is at the height of the box."""
    round: bool = False
    """True if the silhouette does not depend on the heading."""


def silhouette_of(node: TreeNode) -> Silhouette:
    """Return the smallest and the largest silhouette of a node's outline or category."""
    if node.outline.shape != "rectangle":
        flat = node.outline.corners()
        ends = np.vstack([np.column_stack([flat, np.full(len(flat), z)]) for z in (0.0, 1.0)])
        return Silhouette(ends, ends, BOX_POINTS)
    points, weight = outline_points(node)
    outline = outline_of(node)
    if outline == "tapered":
        return Silhouette(_NARROW_POINTS, ROUND_POINTS, BOX_POINTS, True)
    if 0 < weight < 1:
        return Silhouette(TOUCHING_POINTS, BOX_POINTS, BOX_POINTS)
    outer = inner = points
    if weight < 1 and not np.allclose(node.base_tilt, IDENTITY):
        # The neck or the foot of a lying object may be visible from its end.
        inner = BALL_POINTS
    # The silhouette of a round object depends on its heading only if its box is not square.
    return Silhouette(inner, outer, BOX_POINTS, outline in ("round", "ball"))


def expected_box(camera: Camera, node: TreeNode) -> Float[np.ndarray, "4"] | None:
    """Return the box in pixels (x0, y0, x1, y1) of a node's unoccluded outline.

    Returns:
        The box, or None if the node is outside the picture.
    """
    box = node.box3d
    if node.outline.shape != "rectangle":
        return _outlined_box(camera, node)
    corner_box = visible_box(camera, box.corners(node.base_tilt))
    points, weight = outline_points(node)
    if corner_box is None or weight == 1 or node.environment:
        return corner_box
    pixels, depth = camera.project(to_world(points, box, node.base_tilt))
    if depth.min() < NEAR_M:
        return corner_box
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    inner = np.clip(np.concatenate([low, high]), 0, [camera.width, camera.height_px] * 2)
    if inner[0] >= inner[2] or inner[1] >= inner[3]:
        return corner_box
    return weight * corner_box + (1 - weight) * inner


def to_world(
    points: Float[np.ndarray, "n 3"], box: Box3D, tilt: Quat = IDENTITY
) -> Float[np.ndarray, "n 3"]:
    """Transform points in a unit box to the world [m], as `Box3D.corners` transforms corners."""
    local = rotate(tilt, points * np.array(box.size))
    lowest = rotate(tilt, BOX_POINTS * np.array(box.size))[:, 2].min()
    local[:, 2] -= lowest
    return rotate(from_yaw(box.yaw), local) + np.array(box.position)


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


def _outlined_box(camera: Camera, node: TreeNode) -> Float[np.ndarray, "4"] | None:
    """Return the box in pixels of a support whose outline does not fill its 3D box."""
    flat = node.outline.corners()
    n = len(flat)
    ends = np.vstack([np.column_stack([flat, np.full(n, z)]) for z in (0.0, 1.0)])
    sides = [(i, (i + 1) % n, n + (i + 1) % n, n + i) for i in range(n)]
    faces = [tuple(range(n)), tuple(range(n, 2 * n)), *sides]
    return visible_box(camera, to_world(ends, node.box3d, node.base_tilt), faces)


def visible_box(
    camera: Camera, corners: Float[np.ndarray, "n 3"], faces: Sequence[tuple[int, ...]] = _FACES
) -> Float[np.ndarray, "4"] | None:
    """Return the box in pixels (x0, y0, x1, y1) of the visible part of a 3D box or another solid.

    The faces are clipped at the near plane and at the picture's edges.

    Args:
        camera: the camera.
        corners: corners of the solid [m]; for a box, in the order of `Box3D.corners`.
        faces: indices of each face's corners, in order around the face; by default, the faces of a
            box.

    Returns:
        The box, or None if the solid is outside the picture.
    """
    local = (corners - camera.position()) @ camera.axes()
    if local[:, 2].min() > NEAR_M:
        pixels = _pixel(camera, local)
        if (pixels >= 0).all() and (pixels <= [camera.width, camera.height_px]).all():
            return np.concatenate([pixels.min(axis=0), pixels.max(axis=0)])
    near_plane = np.array([0.0, 0.0, 1.0, -NEAR_M])
    sides = [
        np.array([1.0, 0.0, 0.0, 0.0]),
        np.array([-1.0, 0.0, 0.0, camera.width]),
        np.array([0.0, 1.0, 0.0, 0.0]),
        np.array([0.0, -1.0, 0.0, camera.height_px]),
    ]
    clipped = []
    for face in faces:
        polygon = _clip(local[list(face)], near_plane)
        if len(polygon) == 0:
            continue
        flat = np.column_stack([_pixel(camera, polygon), np.zeros(len(polygon))])
        for side in sides:
            flat = _clip(flat, side)
        clipped.append(flat[:, :2])
    points = np.concatenate(clipped) if clipped else np.zeros((0, 2))
    if len(points) == 0:
        return None
    return np.concatenate([points.min(axis=0), points.max(axis=0)])


def _pixel(camera: Camera, local: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 2"]:
    return local[..., :2] / local[..., 2:3] * camera.focal + camera.center


def _clip(
    polygon: Float[np.ndarray, "n 3"], plane: Float[np.ndarray, "4"]
) -> Float[np.ndarray, "m 3"]:
    """Clip a convex polygon by a plane (normal, offset), keeping the positive side."""
    if len(polygon) == 0:
        return polygon
    height = polygon @ plane[:3] + plane[3]
    clipped = []
    for k in range(len(polygon)):
        j = (k + 1) % len(polygon)
        if height[k] >= 0:
            clipped.append(polygon[k])
        if (height[k] >= 0) != (height[j] >= 0):
            fraction = height[k] / (height[k] - height[j])
            clipped.append(polygon[k] + fraction * (polygon[j] - polygon[k]))
    return np.array(clipped).reshape(-1, 3)


class Wireframe(NamedTuple):
    """Points of a surface, and the edges between them."""

    points: Float[np.ndarray, "n 3"]
    edges: Int[np.ndarray, "e 2"]
    """Indices of the two points of each edge."""


def hull_wireframe(points: Float[np.ndarray, "_ 3"]) -> Wireframe:
    """Return the edges of the convex hull of points; if the points are coplanar, all pairs."""
    try:
        hull = ConvexHull(points)
    except QhullError:
        return Wireframe(points, np.column_stack(np.triu_indices(len(points), 1)))
    triangles = hull.simplices
    pairs = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    return Wireframe(points, np.unique(np.sort(pairs, axis=1), axis=0))


class CutSurfaces(NamedTuple):
    """Surfaces of the objects that the picture's border may cut."""

    rows: Int[np.ndarray, " s"]
    """Index of each surface's object."""
    points: Float[np.ndarray, "s p 3"]
    edges: Int[np.ndarray, "e 2"]
    """Indices of the points of each edge among the points of all surfaces."""
    owners: Int[np.ndarray, " e"]
    """Index of each edge's surface, ascending."""


def stack_surfaces(frames: Mapping[int, Wireframe]) -> CutSurfaces:
    """Stack wireframes, given by index of their object."""
    points = stacked([frame.points for frame in frames.values()])
    edges = [k * points.shape[1] + frame.edges for k, frame in enumerate(frames.values())]
    return CutSurfaces(
        np.array(list(frames), int),
        points,
        np.concatenate([np.zeros((0, 2), int), *edges]),
        np.arange(len(frames)).repeat([len(e) for e in edges]),
    )


def stacked(points: Sequence[Float[np.ndarray, "_ 3"]]) -> Float[np.ndarray, "n m 3"]:
    """Stack point sets; shorter sets repeat points, which does not change their extents."""
    longest = max((len(p) for p in points), default=0)
    return np.array([np.resize(p, (longest, 3)) for p in points]).reshape(len(points), longest, 3)


def extents_in_picture(
    camera: Camera,
    view: Float[np.ndarray, "s p 3"],
    edges: Int[np.ndarray, "e 2"],
    owners: Int[np.ndarray, " e"],
) -> Float[np.ndarray, "s 4"]:
    """Return the box (x0, y0, x1, y1) of the part of each surface within the picture [px].

    Args:
        camera: the camera.
        view: the surfaces' points in the camera frame (right, down, forward) [m].
        edges: indices of the two points of each edge among the points of all surfaces.
        owners: index of each edge's surface, ascending.

    Returns:
        The boxes; NaN for a surface outside the picture.
    """
    count = len(view)
    ends = view.reshape(-1, 3)[edges]
    depth = ends[..., 2] - NEAR_M
    ahead = np.any(depth > 0, axis=1)
    ends, depth, owners = ends[ahead], depth[ahead], owners[ahead]
    crosses = np.any(depth < 0, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        fraction = (depth[:, 0] / (depth[:, 0] - depth[:, 1]))[:, None]
        crossing = np.where(
            crosses[:, None], ends[:, 0] + fraction * (ends[:, 1] - ends[:, 0]), 0.0
        )
    ends = np.where((depth < 0)[..., None], crossing[:, None], ends)
    size = np.array([camera.width, camera.height_px], float)
    pixels = ends[..., :2] / np.maximum(ends[..., 2:], NEAR_M) * camera.focal + camera.center
    # The line from a to b is within the picture from fraction `enter` to `leave` of its length.
    a, b = pixels[:, 0], pixels[:, 1]
    enter, leave = np.zeros(len(a)), np.ones(len(a))
    for axis in range(2):
        for inside_a, inside_b in (
            (a[:, axis], b[:, axis]),
            (size[axis] - a[:, axis], size[axis] - b[:, axis]),
        ):
            with np.errstate(divide="ignore", invalid="ignore"):
                t = inside_a / (inside_a - inside_b)
            enter = np.where((inside_a < 0) & (inside_b >= 0), np.maximum(enter, t), enter)
            leave = np.where((inside_b < 0) & (inside_a >= 0), np.minimum(leave, t), leave)
            leave = np.where((inside_a < 0) & (inside_b < 0), -1.0, leave)
    shown = enter <= leave
    a, direction, visible_owners = a[shown], (b - a)[shown], owners[shown]
    shown_ends = [a + enter[shown, None] * direction, a + leave[shown, None] * direction]
    low, high = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    for points in shown_ends:
        np.minimum.at(low, visible_owners, points)
        np.maximum.at(high, visible_owners, points)
    for surface, corner in _covered_corners(pixels, owners, count, size):
        low[surface] = np.minimum(low[surface], corner)
        high[surface] = np.maximum(high[surface], corner)
    box = np.concatenate([low, high], axis=1)
    return np.where(np.isfinite(box), box, np.nan)


def _covered_corners(
    pixels: Float[np.ndarray, "k 2 2"],
    owners: Int[np.ndarray, " k"],
    count: int,
    size: Float[np.ndarray, "2"],
) -> Iterator[tuple[int, Float[np.ndarray, "2"]]]:
    """Yield the corners of the picture [px] that surfaces cover, each with its surface's index."""
    low, high = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    np.minimum.at(low, owners, pixels.min(axis=1))
    np.maximum.at(high, owners, pixels.max(axis=1))
    corners = np.array([[0, 0], [size[0], 0], size, [0, size[1]]])
    candidates = ((low[:, None] <= corners) & (corners <= high[:, None])).all(axis=2)
    for surface, corner in zip(*np.nonzero(candidates), strict=True):
        rows = slice(*np.searchsorted(owners, [surface, surface + 1]))
        if _surrounds(pixels[rows].reshape(-1, 2), corners[corner]):
            yield int(surface), corners[corner]


def _surrounds(points: Float[np.ndarray, "n 2"], spot: Float[np.ndarray, "2"]) -> bool:
    """Return True if the point `spot` lies in the convex hull of other points."""
    if len(points) == 0:
        return False
    angles = np.sort(np.arctan2(points[:, 1] - spot[1], points[:, 0] - spot[0]))
    gaps = np.diff(angles, append=angles[0] + 2 * np.pi)
    return bool(gaps.max() < np.pi)
