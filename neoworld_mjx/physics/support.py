"""Snapping: the height at which a child touches its support, for every candidate.

Only the yaw, size and position of a child vary. The underside of the child and the upper surface of
its support are therefore tabulated once, the underside as points and the upper surface as a grid of
heights. Snapping a population is then a gather and a maximum.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from numpy.typing import NDArray

from ..spec import SceneObject, SceneSpec, Shape, link_poses, support_frame
from ..spec.convex import Piece, planes
from ..spec.pose import Pose, conjugate, from_yaw, pose, rotate
from ..spec.shapes import faceted
from .array_types import AnyArray

GRID = 160
"""Number of grid points along each side of a support's height grid."""
UNDERSIDE_POINTS = 192
"""Number of points that represent a child's underside."""
LEVEL_SHARE = 0.8
"""Largest fraction of the underside's points at one height level if there are other levels."""
WALL_M = 0.02
"""Least height of a wall above the top of an enclosed object, such as a book in a shelf [m]."""
LEANING_DEG = 5.0
"""Least tilt of an object that leans in its parent [deg]."""
EDGE_FLOOR_M = 0.005
"""Largest height of the floor above the lowest point of an object that leans in its parent [m].
Such an object stands on an edge, and the wall next to this edge does not count as floor."""
LINE_MARGIN_M = 1e-6
"""Margin around a piece [m] within which lines are tested."""
NO_SURFACE = -1e3
"""Height [m] that marks the absence of a surface."""


class Support(NamedTuple):
    """The surface under one object, in the object's support frame, with the support at scale 1.

    Stacked tables have a leading [object] axis.
    """

    heights: Float[AnyArray, "GRID GRID"]
    """Height of the upper surface at the grid points, x first [m]; NO_SURFACE if there is none."""
    origin: Float[AnyArray, " 2"]
    """Position of grid point (0, 0) [m]."""
    cell: Float[AnyArray, ""]
    """Spacing of grid points [m]."""
    underside: Float[AnyArray, "UNDERSIDE_POINTS 3"]
    """Points of the child's underside, in the child's tilted frame [m]. Unused rows have height
    inf."""


def posed_shapes(
    item: SceneObject, links: set[str] | None = None, *, tilted: bool = False
) -> list[tuple[Shape, Pose]]:
    """List an object's collision shapes with their poses at the object's joint state."""
    part_poses = link_poses(item.spec, item.joint_state)
    tilt = pose((0, 0, 0), item.base_tilt) if tilted else pose()
    return [
        (geom.shape, tilt.then(part_poses[part.name]).then(geom.pose()))
        for part in item.spec.parts
        if links is None or part.name in links
        for geom in part.geoms
        if geom.role != "visual"
    ]


def posed_pieces(
    item: SceneObject, links: set[str] | None = None, *, tilted: bool = True
) -> list[tuple[Piece, Pose]]:
    """List an object's convex pieces; see `posed_shapes`."""
    return [
        (piece, shape_pose.then(pose(piece.pos, piece.quat)))
        for shape, shape_pose in posed_shapes(item, links, tilted=tilted)
        for piece in shape.pieces()
    ]


def vertical_intersections(piece: Piece, piece_pose: Pose, xy: NDArray) -> tuple[NDArray, NDArray]:
    """Intersect vertical lines at positions xy [m], shape [n, 2], with a convex piece at a pose.

    Returns:
        Heights of the lowest and highest point of the piece on each line [m], shape [n]; (inf,
        -inf) if the line misses the piece.
    """
    if piece.kind in ("box", "mesh"):
        corners = _corners(piece, piece_pose)[:, :2]
        near = np.all(
            (xy >= corners.min(axis=0) - LINE_MARGIN_M)
            & (xy <= corners.max(axis=0) + LINE_MARGIN_M),
            axis=1,
        )
        low, high = np.full(len(xy), np.inf), np.full(len(xy), -np.inf)
        if near.any():
            low[near], high[near] = _intersect(piece, piece_pose, xy[near])
        return low, high
    return _intersect(piece, piece_pose, xy)


def _intersect(piece: Piece, piece_pose: Pose, xy: NDArray) -> tuple[NDArray, NDArray]:
    """Intersect all lines with a piece; see `vertical_intersections`."""
    back = conjugate(piece_pose.quat)
    o = rotate(back, np.column_stack([xy, np.zeros(len(xy))]) - piece_pose.pos)
    d = rotate(back, np.array([0.0, 0.0, 1.0]))
    s = np.asarray(piece.size, float)
    if piece.kind in ("box", "mesh"):
        return _through_planes(planes(piece), o, d)
    if piece.kind in ("sphere", "ellipsoid"):
        r = np.full(3, s[0]) if piece.kind == "sphere" else s
        return _through_ball(o / r, d / r)
    side = _through_ball(o[:, :2] / s[0], d[:2] / s[0])
    slab = _through_planes(np.array([[0, 0, 1, s[1]], [0, 0, -1, s[1]]], float), o, d)
    low, high = np.maximum(side[0], slab[0]), np.minimum(side[1], slab[1])
    low, high = np.where(low <= high, low, np.inf), np.where(low <= high, high, -np.inf)
    if piece.kind == "capsule":
        for end in (s[1], -s[1]):
            a, b = _through_ball((o - [0, 0, end]) / s[0], d / s[0])
            low, high = np.minimum(low, a), np.maximum(high, b)
    return low, high


def _through_planes(half_spaces: NDArray, o: NDArray, d: NDArray) -> tuple[NDArray, NDArray]:
    slope, gap = half_spaces[:, :3] @ d, half_spaces[:, 3] - o @ half_spaces[:, :3].T
    with np.errstate(divide="ignore", invalid="ignore"):
        t = gap / slope
    outside = np.any((np.abs(slope) < 1e-12) & (gap < -1e-9), axis=1)
    low = np.max(np.where(slope < -1e-12, t, -np.inf), axis=1)
    high = np.min(np.where(slope > 1e-12, t, np.inf), axis=1)
    # A line along a face or through an edge counts as a hit.
    miss = outside | (low > high + 1e-9)
    return np.where(miss, np.inf, low), np.where(miss, -np.inf, np.maximum(low, high))


def _through_ball(o: NDArray, d: NDArray) -> tuple[NDArray, NDArray]:
    a, b, c = d @ d, o @ d, np.sum(o * o, axis=1) - 1
    if a < 1e-18:
        inside = c <= 0
        return np.where(inside, -np.inf, np.inf), np.where(inside, np.inf, -np.inf)
    disc = b * b - a * c
    root = np.sqrt(np.maximum(disc, 0.0))
    miss = disc < 0
    return np.where(miss, np.inf, (-b - root) / a), np.where(miss, -np.inf, (-b + root) / a)


def underside_points(item: SceneObject) -> NDArray:
    """Sample points of an object's underside, in the object's tilted frame [m], shape [n, 3].

    Unused rows have height inf.
    """
    pieces = posed_pieces(item)
    corners = np.vstack([_corners(piece, piece_pose) for piece, piece_pose in pieces])
    low, high = corners[:, :2].min(axis=0), corners[:, :2].max(axis=0)
    steps = np.stack(
        np.meshgrid(*(np.linspace(a, b, 25) for a, b in zip(low, high, strict=True))), -1
    ).reshape(-1, 2)
    xy = np.unique(np.round(np.vstack([corners[:, :2], steps]), 9), axis=0)
    z = np.min(
        [vertical_intersections(piece, piece_pose, xy)[0] for piece, piece_pose in pieces], axis=0
    )
    points = np.column_stack([xy, z])[np.isfinite(z)]
    if item.relation == "in" and _leans(item):
        # The object stands on its lowest edge. Everything above touches the wall.
        points = points[points[:, 2] <= points[:, 2].min() + EDGE_FLOOR_M]
    if len(points) > UNDERSIDE_POINTS:
        # The lowest points matter most, but the points must cover a wide flat base, and both the
        # rim and the plug of a lid: take spread points of each low level first.
        level = np.round((points[:, 2] - points[:, 2].min()) / (1e-4 + np.ptp(points[:, 2]) / 8))
        points = points[_order_by_level(points[:, :2], level)[:UNDERSIDE_POINTS]]
    pad = np.full((UNDERSIDE_POINTS - len(points), 3), np.inf)
    pad[:, :2] = 0.0
    return np.vstack([points, pad])


def _corners(piece: Piece, piece_pose: Pose) -> NDArray:
    if piece.kind in ("box", "mesh"):
        return piece_pose.apply(faceted(piece))
    s = np.asarray(piece.size, float)
    if piece.kind in ("sphere", "ellipsoid"):
        r = np.full(3, s[0]) if piece.kind == "sphere" else s
        down = rotate(conjugate(piece_pose.quat), np.array([0.0, 0.0, -1.0]))
        lowest = r * r * down / np.linalg.norm(r * down)
        ring = np.vstack([np.eye(3), -np.eye(3)]) * r
        return piece_pose.apply(np.vstack([lowest, ring]))
    turn = 2 * np.pi * np.arange(16) / 16
    ring = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(16)]) * s[0]
    ends = np.vstack([ring + [0, 0, s[1]], ring - [0, 0, s[1]]])
    if piece.kind == "capsule":
        tips = np.array([[0, 0, s[1] + s[0]], [0, 0, -s[1] - s[0]], [0, 0, s[1]], [0, 0, -s[1]]])
        ends = np.vstack([ends, tips])
    return piece_pose.apply(ends)


def _order_by_level(xy: NDArray, level: NDArray) -> NDArray:
    """Return indices that order points by level; the first points of a level cover it evenly.

    If there are several levels, no level has more than the fraction LEVEL_SHARE of the first
    UNDERSIDE_POINTS points.
    """
    first: list[int] = []
    later: list[int] = []
    level_limit = int(LEVEL_SHARE * UNDERSIDE_POINTS)
    for value in np.unique(level):
        rest = np.flatnonzero(level == value)
        gap = np.linalg.norm(xy[rest] - xy[rest].mean(axis=0), axis=1)
        for k in range(min(len(rest), UNDERSIDE_POINTS)):
            point = int(np.argmax(gap))
            (first if k < level_limit else later).append(int(rest[point]))
            gap = np.minimum(gap, np.linalg.norm(xy[rest] - xy[rest[point]], axis=1))
        if len(first) >= UNDERSIDE_POINTS:
            break
    return np.array(first + later)


def support(scene: SceneSpec, item: SceneObject, reach: float) -> Support:
    """Tabulate the surface that supports an object.

    There are two possible surfaces:

    - the outer surface, which is the highest surface under the object's footprint;
    - the inner surface, which is the highest floor inside the parent, such as a lower shelf.

    The inner surface supports an object with relation "in". It also supports any other object that
    fits between this surface and the pieces above, if the composed height is closer to the inner
    than to the outer surface. An object with relation "in" is thus never lifted onto a wall. It
    penetrates the wall instead, and the gradient of D_pen leads it out.

    A surface counts as a wall instead of a floor if it is

    - above the middle of an object with relation "in",
    - more than WALL_M above the top of any other object, or
    - more than EDGE_FLOOR_M above the lowest point of an object that leans in its parent, provided
      that there is a floor below this height.
    """
    parent = scene.object(str(item.parent))
    links = {item.parent_link} if item.parent_link else None
    frame = link_frame(parent, item.parent_link).inverse()
    underside = underside_points(item)
    finite = underside[np.isfinite(underside[:, 2])]
    half = float(np.linalg.norm(finite[:, :2], axis=1).max()) * 1.3 + reach
    origin = np.array(item.xy) - half
    cell = 2 * half / (GRID - 1)
    axis = np.arange(GRID) * cell
    xy = np.stack(np.meshgrid(origin[0] + axis, origin[1] + axis, indexing="ij"), -1).reshape(-1, 2)
    columns = [
        vertical_intersections(piece, frame.then(piece_pose), xy)
        for piece, piece_pose in posed_pieces(parent, links)
    ]
    low, high = np.array([c[0] for c in columns]), np.array([c[1] for c in columns])

    top = max(
        float(_corners(piece, piece_pose)[:, 2].max()) for piece, piece_pose in posed_pieces(item)
    )
    middle = item.z + (finite[:, 2].min() + top) / 2
    outside = np.max(high, axis=0, initial=NO_SURFACE)
    under = low < middle
    # Surfaces above this height are walls and do not hide the floor.
    wall = middle if item.relation == "in" else item.z + top + WALL_M
    floor = under & (high <= wall)
    if item.relation == "in" and _leans(item):
        edge_floor = under & (high <= item.z + finite[:, 2].min() + EDGE_FLOOR_M)
        floor = edge_floor if edge_floor.any() else floor
    inside = np.max(np.where(floor, high, NO_SURFACE), axis=0, initial=NO_SURFACE)
    ceiling = np.min(np.where(under, np.inf, low), axis=0, initial=np.inf)

    rotated = rotate(from_yaw(item.yaw), finite)
    grid_indices = np.clip(
        np.round((rotated[:, :2] + item.xy - origin) / cell), 0, GRID - 1
    ).astype(int)
    cells = grid_indices[:, 0] * GRID + grid_indices[:, 1]
    z_out, z_in = (float(np.max(h[cells] - finite[:, 2])) for h in (outside, inside))
    fits = z_in > NO_SURFACE / 2 and np.min(ceiling[cells]) > z_in + top - 1e-3
    lower = fits and abs(z_in - item.z) <= abs(z_out - item.z)
    heights = inside if lower or item.relation == "in" else outside
    return Support(
        np.asarray(heights.reshape(GRID, GRID), np.float32),
        np.asarray(origin, np.float32),
        np.asarray(cell, np.float32),
        np.asarray(underside, np.float32),
    )


def _leans(item: SceneObject) -> bool:
    up = rotate(np.asarray(item.base_tilt, float), np.array([0.0, 0.0, 1.0]))
    return bool(up[2] < np.cos(np.radians(LEANING_DEG)))


def link_frame(parent: SceneObject, link: str | None) -> Pose:
    """Return the upright frame of a link of a supporting object, relative to the object's frame.

    The frame is rotated about the vertical only. If `link` is None, it is that of the base.
    """
    return support_frame(parent, pose((0, 0, 0), parent.base_tilt), link)


def no_support() -> Support:
    """Return the table of an object without a support."""
    underside = np.zeros((UNDERSIDE_POINTS, 3), np.float32)
    underside[:, 2] = np.inf
    return Support(
        np.full((GRID, GRID), NO_SURFACE, np.float32),
        np.zeros(2, np.float32),
        np.ones((), np.float32),
        underside,
    )


def height_above(
    table: Support,
    xy: Float[Array, " 2"],
    yaw: Float[Array, ""],
    size: Float[Array, ""],
    parent_size: Float[Array, ""],
) -> Float[Array, ""]:
    """Return the height of an object's origin at which the object touches its support.

    Returns:
        Height in the support frame [m]. If no point of the underside is above the support, the
        height is below NO_SURFACE / 2.
    """
    c, s = jnp.cos(yaw), jnp.sin(yaw)
    x, y = table.underside[:, 0] * size, table.underside[:, 1] * size
    i, u, within = _cell(table, 0, (xy[0] + c * x - s * y) / parent_size)
    j, v, between = _cell(table, 1, (xy[1] + s * x + c * y) / parent_size)
    h = table.heights
    a, b, c, d = h[i, j], h[i + 1, j], h[i, j + 1], h[i + 1, j + 1]
    blended = (a * (1 - u) + b * u) * (1 - v) + (c * (1 - u) + d * u) * v
    # Interpolation across an edge of the support would add a slope: take the nearest corner.
    lowest = jnp.minimum(jnp.minimum(a, b), jnp.minimum(c, d))
    highest = jnp.maximum(jnp.maximum(a, b), jnp.maximum(c, d))
    nearest = jnp.where(v > 0.5, jnp.where(u > 0.5, d, c), jnp.where(u > 0.5, b, a))
    surface = jnp.where(highest - lowest < 2.0 * table.cell, blended, nearest)
    surface = jnp.where(within & between, surface, NO_SURFACE)
    # The gradient of an infinite height times the size would be NaN, even if masked.
    used = jnp.isfinite(table.underside[:, 2])
    gap = surface * parent_size - jnp.where(used, table.underside[:, 2], 0.0) * size
    used &= jnp.isfinite(gap) & (surface > NO_SURFACE / 2)
    return jnp.max(jnp.where(used, gap, NO_SURFACE))


def _cell(
    table: Support, axis: int, x: Float[Array, " UNDERSIDE_POINTS"]
) -> tuple[
    Int[Array, " UNDERSIDE_POINTS"],
    Float[Array, " UNDERSIDE_POINTS"],
    Bool[Array, " UNDERSIDE_POINTS"],
]:
    """Return the cells of coordinates [m] along an axis, the fractions within them, and a mask.

    The mask is True for coordinates that are on the grid.
    """
    grid = (x - table.origin[axis]) / table.cell
    low = jnp.clip(jnp.floor(grid), 0, GRID - 2).astype(jnp.int32)
    return low, jnp.clip(grid - low, 0.0, 1.0), (grid >= 0) & (grid <= GRID - 1)
