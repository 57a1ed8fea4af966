"""Contacts between two convex solids: the axis of least overlap, and points of their intersection.

The collision geoms of a MuJoCo model become solids with one common representation, padded to one
shape, so that code for two solids is traced only once for any number and type of geoms.

MuJoCo finds the axis by a branching search (GJK, EPA). This module instead tests a fixed list of
axes, following the separating axis theorem: the face normals of both solids and the directions
between their nearest parts. Cross products of edges are omitted: if only such an axis separates two
solids, no edge of one solid is inside the other, so there is no contact either.

Contact points are the ends and midpoints of one solid's edges, clipped by the faces of the other
solid. All of them are computed in one pass without branches, for `jax.vmap`. Of 1 464 random pairs
that overlap by 1 to 6 mm, the module misses none. An ellipsoid may be in contact with an edge that
is still some millimeters away.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float, Int
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from ..errors import EngineError
from .array_types import AnyArray

RIM_CORNERS, WALL_FACES = 8, 12
"""Number of corners of the polygon that approximates a cylinder's rim, and number of faces that
approximate its wall. A cylinder is rotated so that a corner and a face point at the other solid.
"""

_GEOM = mujoco.mjtGeom


class Solids(NamedTuple):
    """Convex solids in their geoms' frames at scale 1 [m].

    A solid is the Minkowski sum of the hull of `vert`, a disc about the z axis and an ellipsoid.
    For example, a sphere is a point with radii, and a cylinder is a segment with a disc. Vertices,
    edges and planes are padded with copies of the first one.
    """

    vert: Float[AnyArray, "*solid vert 3"]
    """Vertices."""
    edge: Float[AnyArray, "*solid edge 2 3"]
    """Ends of the edges along which contacts are generated."""
    plane: Float[AnyArray, "*solid face 4"]
    """Outward normals and offsets of the faces. A solid without faces has zero normals."""
    disc: Float[AnyArray, "*solid"]
    """Radius of a cylinder, otherwise 0. A cylinder's edges and planes may be rotated about z."""
    radii: Float[AnyArray, "*solid 3"]
    """Semi-axes of the ellipsoid of a sphere, capsule or ellipsoid, otherwise 0."""
    core: Float[AnyArray, "*solid 2 3"]
    """Ends of the central segment: the axis of a cylinder or capsule, or the center, twice."""


class GeomPairs(NamedTuple):
    """Pairs of geoms that may touch, with the contact parameters that candidates share."""

    first: Int[AnyArray, " pair"]
    second: Int[AnyArray, " pair"]
    solref: Float[AnyArray, "pair 2"]
    solimp: Float[AnyArray, "pair 5"]


def geom_solids(m: mujoco.MjModel) -> Solids:
    """Return the solid of every geom of a model. Geoms that do not collide become points.

    Raises:
        EngineError: a collision geom has an unsupported type.
    """
    solids = [_solid(m, g) if collides(m, g) else _point() for g in range(m.ngeom)] or [_point()]
    rows = {}
    for name in Solids._fields:
        fields = [getattr(solid, name) for solid in solids]
        if name in ("vert", "edge", "plane"):
            max_count = max(len(field) for field in fields)
            fields = [
                np.concatenate([x, np.repeat(x[:1], max_count - len(x), axis=0)]) for x in fields
            ]
        rows[name] = np.stack(fields).astype(np.float32)
    return Solids(**rows)


def collides(m: mujoco.MjModel, geom: int) -> bool:
    """Return whether a geom may collide."""
    return bool(m.geom_contype[geom] | m.geom_conaffinity[geom])


def geom_pairs(m: mujoco.MjModel) -> GeomPairs:
    """List the pairs of geoms that pass MuJoCo's collision filters.

    Raises:
        EngineError: the model has explicit pairs, priorities, margins or a condim other than 3.
    """
    if m.npair or np.any(m.geom_priority) or np.any(m.geom_margin) or np.any(m.geom_condim != 3):
        raise EngineError(
            "engine mjx needs geoms with condim 3 and no explicit pairs, priorities or margins; "
            "use --engine native"
        )
    excluded = set(m.exclude_signature.tolist())
    geoms = [g for g in range(m.ngeom) if collides(m, g)]
    pairs = [
        (a, b) for k, a in enumerate(geoms) for b in geoms[k + 1 :] if _may_touch(m, a, b, excluded)
    ]
    first, second = np.array(pairs, np.int32).reshape(-1, 2).T
    mix = m.geom_solmix[first] + m.geom_solmix[second]
    weight = (m.geom_solmix[first] / np.where(mix > 0, mix, 1.0))[:, None]
    blend = lambda x: (weight * x[first] + (1 - weight) * x[second]).astype(np.float32)
    return GeomPairs(
        first=first,
        second=second,
        solref=blend(m.geom_solref),
        solimp=blend(m.geom_solimp),
    )


def _may_touch(m: mujoco.MjModel, a: int, b: int, excluded: set[int]) -> bool:
    one, two = sorted((int(m.geom_bodyid[a]), int(m.geom_bodyid[b])))
    if (one << 16) + two in excluded:
        return False
    weld, other = int(m.body_weldid[one]), int(m.body_weldid[two])
    parent_weld = lambda w: int(m.body_weldid[m.body_parentid[w]])
    # As in MuJoCo, bodies that are welded together never touch. A child and its parent never touch
    # either, unless the parent is the world.
    related = weld and other and (weld == parent_weld(other) or other == parent_weld(weld))
    types = (m.geom_contype[a] & m.geom_conaffinity[b]) | (
        m.geom_contype[b] & m.geom_conaffinity[a]
    )
    return weld != other and not related and bool(types)


def _solid(m: mujoco.MjModel, geom: int) -> Solids:
    kind, size = int(m.geom_type[geom]), np.array(m.geom_size[geom])
    if kind == _GEOM.mjGEOM_MESH:
        mesh = m.geom_dataid[geom]
        first = m.mesh_vertadr[mesh]
        return _polytope(np.array(m.mesh_vert[first : first + m.mesh_vertnum[mesh]], float))
    if kind == _GEOM.mjGEOM_BOX:
        return _polytope(np.array(np.meshgrid(*([-1.0, 1.0],) * 3)).reshape(3, -1).T * size)
    if kind == _GEOM.mjGEOM_CYLINDER:
        return _cylinder(size[0], size[1])
    if kind == _GEOM.mjGEOM_SPHERE:
        return _point()._replace(radii=np.full(3, size[0]))
    if kind == _GEOM.mjGEOM_ELLIPSOID:
        return _point()._replace(radii=size)
    if kind == _GEOM.mjGEOM_CAPSULE:
        ends = np.array([[0.0, 0.0, -size[1]], [0.0, 0.0, size[1]]])
        return _point()._replace(vert=ends, edge=ends[None], radii=np.full(3, size[0]), core=ends)
    raise EngineError(
        f"engine mjx cannot collide geom {m.geom(geom).name!r} of type {_GEOM(kind).name}; "
        "use --engine native"
    )


def _point() -> Solids:
    zero = np.zeros((1, 3))
    return Solids(
        vert=zero,
        edge=np.zeros((1, 2, 3)),
        plane=np.zeros((1, 4)),
        disc=np.zeros(()),
        radii=np.zeros(3),
        core=np.zeros((2, 3)),
    )


def _cylinder(radius: float, half: float) -> Solids:
    turn = lambda n: 2 * np.pi * np.arange(n) / n
    out = lambda n: np.column_stack([np.cos(turn(n)), np.sin(turn(n)), np.zeros(n)])
    up = np.array([0.0, 0.0, half])
    low, high = radius * out(RIM_CORNERS) - up, radius * out(RIM_CORNERS) + up
    around = lambda ring: np.stack([ring, np.roll(ring, -1, axis=0)], axis=1)
    caps = np.array([[0.0, 0.0, -1.0, half], [0.0, 0.0, 1.0, half]])
    return Solids(
        vert=np.stack([-up, up]),
        edge=np.concatenate([around(low), around(high), np.stack([low, high], axis=1)]),
        plane=np.concatenate(
            [np.column_stack([out(WALL_FACES), np.full(WALL_FACES, radius)]), caps]
        ),
        disc=np.array(radius),
        radii=np.zeros(3),
        core=np.stack([-up, up]),
    )


def _polytope(points: NDArray) -> Solids:
    """Build the convex hull of points. Coplanar triangles form one face."""
    middle, span = points.mean(axis=0), np.ptp(points, axis=0).max()
    hull = ConvexHull((points - middle) / span)
    normals = hull.equations
    face = np.full(len(normals), -1)
    planes: list[NDArray] = []
    for k, row in enumerate(normals):
        if face[k] < 0:
            same = np.all(np.abs(normals - row) < 1e-4, axis=1) & (face < 0)
            face[same] = len(planes)
            planes.append(row)
    sides: dict[tuple[int, int], list[int]] = {}
    for k, (a, b, c) in enumerate(hull.simplices.tolist()):
        for one, two in ((a, b), (b, c), (c, a)):
            sides.setdefault((min(one, two), max(one, two)), []).append(int(face[k]))
    edges = [pair for pair, faces in sides.items() if len(set(faces)) > 1]
    stacked = np.array(planes)
    offset = span * -stacked[:, 3] + stacked[:, :3] @ middle
    # A point in the interior of a face is not a vertex.
    used = np.unique(np.array(edges))
    centre = points[used].mean(axis=0)
    return Solids(
        vert=points[used],
        edge=points[np.array(edges)],
        plane=np.column_stack([stacked[:, :3], offset]),
        disc=np.zeros(()),
        radii=np.zeros(3),
        core=np.stack([centre, centre]),
    )


PAIR_CONTACTS = 4
"""Number of contacts of a pair of solids."""
FACE_TOLERANCE_M = 1e-5
"""Largest distance of a contact point outside a face, so that coincident edges touch [m]."""
AXIS_REFINEMENTS = 4
"""Number of refinements of the axis if there are ellipsoids."""
ZERO_DEPTH_WEIGHT, MIDPOINT_WEIGHT = 0.05, 0.02
"""Weights in the selection of contact points: ZERO_DEPTH_WEIGHT of a point of zero depth relative
to the deepest point, and MIDPOINT_WEIGHT of an edge's midpoint relative to the edge's ends."""

Vec = Float[Array, "3"]


class PosedSolid(NamedTuple):
    """A solid with its pose, relative to a point near both solids [m]."""

    solid: Solids
    pos: Vec
    rot: Float[Array, "3 3"]
    scale: Float[Array, ""]


class Manifold(NamedTuple):
    """Contacts of a pair of solids. Points that do not touch have a positive distance."""

    dist: Float[Array, " point"]
    """Minus the overlap along the normal [m]."""
    pos: Float[Array, "point 3"]
    """Midway between both surfaces [m]."""
    normal: Vec
    """From the first solid towards the second."""


def manifold(one: PosedSolid, two: PosedSolid, ellipsoids: bool = True) -> Manifold:
    """Return the contacts between two convex solids.

    Args:
        one: the first solid.
        two: the second solid.
        ellipsoids: if True, refine the axis. Pass False only if neither solid is an ellipsoid.
    """
    # Both solids are stacked, so that operations on each of them are traced once.
    both = jax.tree.map(lambda *sides: jnp.stack(sides), one, two)
    other = lambda sides: jax.tree.map(lambda x: x[::-1], sides)
    both = jax.vmap(_align_rim)(both, jax.vmap(_nearest_point)(other(both), both))
    normal, gap = _least_overlap(both, AXIS_REFINEMENTS if ellipsoids else 0)
    # Rotate a cylinder so that a corner of its rim is the deepest point.
    towards = jnp.stack([normal, -normal])
    both = jax.vmap(_align_rim)(both, towards)
    pos, depth = jax.vmap(_clip_edges)(both, other(both), towards)
    middle, middle_depth = _core_contact(both, normal, gap)
    pos = jnp.concatenate([pos.reshape(-1, 3), middle[None]])
    ends = jnp.broadcast_to(jnp.array([1.0, MIDPOINT_WEIGHT, 1.0]), depth.shape).reshape(-1)
    weight = jnp.concatenate([ends, jnp.ones(1)])
    depth = jnp.concatenate([depth.reshape(-1), middle_depth[None]])
    return _select_contacts(pos, jnp.where(gap < 0, depth, -1.0), weight, normal)


def _dot(a: AnyArray, b: AnyArray) -> Any:
    # Neither a matrix product, which may use TF32, nor a reduction, which fuses less.
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]


def _world(p: PosedSolid, x: Float[AnyArray, "*n 3"]) -> Float[Array, "*n 3"]:
    """Transform points from a solid's frame at scale 1 to the world."""
    return p.pos + _dot(p.rot, x[..., None, :]) * p.scale


def _ellipsoid_support(p: PosedSolid, n: Float[Array, "*n 3"]) -> tuple[Array, Array]:
    """Return the support function of a solid's ellipsoid along n, and the support points."""
    local = _dot(p.rot.T, n[..., None, :]) * p.solid.radii
    length = jnp.sqrt(_dot(local, local) + 1e-24)
    point = local * p.solid.radii / length[..., None]
    return length * p.scale, _dot(p.rot, point[..., None, :]) * p.scale


def _support_distance(p: PosedSolid, n: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
    """Return the support function of a solid along unit vectors [m]."""
    local = _dot(p.rot.T, n[..., None, :])
    corners = jnp.max(_dot(local[..., None, :], p.solid.vert), axis=-1)
    across = jnp.sqrt(local[..., 0] ** 2 + local[..., 1] ** 2)
    ball = local * p.solid.radii
    reach = corners + p.solid.disc * across + jnp.sqrt(_dot(ball, ball))
    return reach * p.scale + _dot(n, p.pos)


def _align_rim(p: PosedSolid, towards: Vec) -> PosedSolid:
    """Rotate a cylinder about its axis so that a corner of its rims points along a direction."""
    x, y, _ = _dot(p.rot.T, towards)
    length = jnp.sqrt(x * x + y * y)
    turns = (p.solid.disc > 0) & (length > 1e-6)
    c = jnp.where(turns, x / jnp.maximum(length, 1e-12), 1.0)
    s = jnp.where(turns, y / jnp.maximum(length, 1e-12), 0.0)
    a, b = p.rot[:, 0], p.rot[:, 1]
    return p._replace(rot=jnp.stack([c * a + s * b, c * b - s * a, p.rot[:, 2]], axis=1))


def _nearest_point(p: PosedSolid, other: PosedSolid) -> Vec:
    """Return the vector from the center of `other` to the nearest point of p's bounding box."""
    low, high = jnp.min(p.solid.vert, axis=0), jnp.max(p.solid.vert, axis=0)
    disc = p.solid.disc * jnp.array([1.0, 1.0, 0.0])
    margin = p.solid.radii + disc
    centre = jnp.mean(_world(other, other.solid.core), axis=0)
    local = _dot(p.rot.T, centre - p.pos) / p.scale
    return _world(p, jnp.clip(local, low - margin, high + margin)) - centre


def _unit(v: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
    length = jnp.sqrt(_dot(v, v))
    return jnp.where(length > 1e-9, 1.0, 0.0)[..., None] * v / jnp.maximum(length, 1e-9)[..., None]


def _least_overlap(both: PosedSolid, refinements: int) -> tuple[Vec, Array]:
    """Return the axis of least overlap, from the first to the second solid, and the gap on it."""
    faces = jax.vmap(lambda p: _dot(p.rot, p.solid.plane[:, None, :3]))(both)
    core = jax.vmap(lambda p: _world(p, p.solid.core))(both)
    edge = jax.vmap(lambda p: _world(p, p.solid.edge))(both)
    # From one core to the other, and from each core to the nearest edge of the other.
    parts = jnp.concatenate([core[::-1, None], edge[::-1]], axis=1)
    a, b = jax.vmap(_closest_points)(core[:, None], parts)
    away = b - a
    shortest = lambda v: v[jnp.argmin(_dot(v, v))]
    straight, there, back = away[0, 0], shortest(away[0, 1:]), -shortest(away[1, 1:])
    one, two = (jax.tree.map(lambda x, k=k: x[k], both) for k in (0, 1))
    rounded = [_ellipsoid_normal(one, straight), _ellipsoid_normal(one, there)]
    rounded += [_ellipsoid_normal(two, straight), _ellipsoid_normal(two, back)]
    between = _unit(jnp.stack(rounded))
    # If a core is inside the other solid, the direction to the nearest edge points backward.
    inward = _dot(between, jnp.mean(core[1], axis=0) - jnp.mean(core[0], axis=0)) < 0
    between = jnp.where(inward[:, None], -between, between)
    axes = jnp.concatenate([faces[0], -faces[1], between])
    reach = jax.vmap(_support_distance)(both, jnp.stack([axes, -axes]))
    gap = jnp.where(_dot(axes, axes) > 0.5, -reach[0] - reach[1], -jnp.inf)
    best = jnp.argmax(gap)
    axis = axes[best], gap[best]
    if not refinements:
        return axis
    return jax.lax.fori_loop(0, refinements, lambda _, x: _refine_axis(one, two, x), axis)


def _ellipsoid_normal(p: PosedSolid, v: Vec) -> Vec:
    """Return the surface normal of an ellipsoid in a direction from the ellipsoid's center."""
    local = _dot(p.rot.T, v)
    radii = jnp.where(p.solid.radii > 0, p.solid.radii, 1.0)
    return _dot(p.rot, local * (jnp.max(radii) / radii) ** 2)


def _refine_axis(one: PosedSolid, two: PosedSolid, axis: tuple[Vec, Array]) -> tuple[Vec, Array]:
    """Rotate an axis between two solids, unless this decreases the gap along the axis."""
    normal, gap = axis
    ahead, thick = jnp.stack([normal, -normal]), []
    points = []
    for p, n in zip((one, two), ahead, strict=True):
        corner = jnp.argmax(_dot(p.solid.vert, _dot(p.rot.T, n)))
        points.append(_world(p, p.solid.vert[corner]) + _ellipsoid_support(p, n)[1])
        thick.append(jnp.max(p.solid.radii) * p.scale)
    # Exact for two spheres.
    candidate = _unit(points[1] - points[0] + (thick[0] + thick[1]) * normal)
    better = -_support_distance(one, candidate) - _support_distance(two, -candidate)
    improves = (better > gap) & (_dot(candidate, candidate) > 0.5)
    return jnp.where(improves, candidate, normal), jnp.where(improves, better, gap)


def _closest_points(
    one: Float[Array, "a 2 3"], two: Float[Array, "b 2 3"]
) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
    """Return the closest points of pairs of segments; the leading axes are broadcast."""
    p, q = one[:, 0], two[:, 0]
    u, v = one[:, 1] - p, two[:, 1] - q
    w = p - q
    uu, vv, uv = _dot(u, u) + 1e-12, _dot(v, v) + 1e-12, _dot(u, v)
    uw, vw = _dot(u, w), _dot(v, w)
    det = uu * vv - uv * uv
    s = jnp.where(det > 1e-6 * uu * vv, (uv * vw - vv * uw) / jnp.maximum(det, 1e-24), 0.5)
    s = jnp.clip(s, 0.0, 1.0)
    t = jnp.clip((uv * s + vw) / vv, 0.0, 1.0)
    s = jnp.clip((uv * t - uw) / uu, 0.0, 1.0)
    return p + s[:, None] * u, q + t[:, None] * v


def _clip_edges(
    one: PosedSolid, two: PosedSolid, normal: Vec
) -> tuple[Float[Array, "edge 3 3"], Float[Array, "edge 3"]]:
    """Clip the edges of `one` by the faces of `two`.

    Returns:
        Three points of each edge, midway between both surfaces; and the overlap at these points
        along the normal, which points from `one` to `two`. The overlap is negative for an edge
        outside `two`.
    """
    faces = _dot(two.rot, two.solid.plane[:, None, :3])
    solid = _dot(faces, faces) > 0.5
    thick, _ = _ellipsoid_support(one, faces)
    offset = two.solid.plane[:, 3] * two.scale + _dot(faces, two.pos) + thick
    # A solid without faces contains no point.
    offset = jnp.where(solid, offset, -1.0)
    ends = _world(one, one.solid.edge)
    start, stop = (_dot(ends[:, k, None, :], faces) - offset for k in (0, 1))
    change = start - stop
    crossing = start / jnp.where(jnp.abs(change) > 1e-12, change, 1.0)
    before, leaves = start > FACE_TOLERANCE_M, stop > FACE_TOLERANCE_M
    # An edge that never enters is given an entry beyond its end.
    first = jnp.max(jnp.where(before, jnp.where(leaves, 2.0, crossing), 0.0), axis=1)
    last = jnp.min(jnp.where(~before & leaves, crossing, 1.0), axis=1)
    inside = first <= last + 1e-6
    # Where an edge crosses an edge of `two`, the overlap is deepest midway and zero at the ends.
    fraction = jnp.clip(jnp.stack([first, (first + last) / 2, last], axis=1), 0.0, 1.0)
    points = ends[:, 0, None] + fraction[..., None] * (ends[:, 1] - ends[:, 0])[:, None]
    # Distance against the normal after which a point leaves `two` through a face, ...
    over = start[:, None] - fraction[..., None] * change[:, None]
    slope = -_dot(faces, normal)
    away = jnp.min(jnp.where(slope > 1e-3, -over / jnp.maximum(slope, 1e-3), jnp.inf), axis=-1)
    # ... but at most the distance after which the point is in front of all of `two`.
    thick, out = _ellipsoid_support(one, normal)
    ahead = _dot(points, normal) + thick + _support_distance(two, -normal)
    depth = jnp.where(inside[:, None], jnp.minimum(away, ahead), -1.0)
    pos = points + out - normal * (depth[..., None] / 2)
    return pos, depth


def _core_contact(both: PosedSolid, normal: Vec, gap: Array) -> tuple[Vec, Array]:
    """Return the contact of two solids without faces, at the closest points of their cores."""
    one = jax.tree.map(lambda x: x[0], both)
    core = jax.vmap(lambda p: _world(p, p.solid.core))(both)
    a, _ = _closest_points(core[:1], core[1:])
    _, out = _ellipsoid_support(one, normal)
    smooth = jnp.all(both.solid.radii[:, 0] > 0)
    return a[0] + out + normal * (gap / 2), jnp.where(smooth, -gap, -1.0)


def _select_contacts(
    pos: Float[Array, "point 3"],
    depth: Float[Array, " point"],
    point_weight: Float[Array, " point"],
    normal: Vec,
) -> Manifold:
    """Select the deepest point, and more points that are deep and far from one another."""
    flat = pos - _dot(pos, normal)[:, None] * normal
    deepest = jnp.maximum(jnp.max(depth), 1e-9)
    weight = (
        jnp.where(depth > 0, jnp.clip(depth / deepest, 0.0, 1.0) + ZERO_DEPTH_WEIGHT, 0.0)
        * point_weight
    )
    chosen = jnp.argmax(depth)
    apart = jnp.full(depth.shape, jnp.inf)
    rows, dist = [pos[chosen]], [-depth[chosen]]
    for _ in range(PAIR_CONTACTS - 1):
        away = flat - flat[chosen]
        apart = jnp.minimum(apart, _dot(away, away))
        chosen = jnp.argmax(apart * weight)
        rows.append(pos[chosen])
        dist.append(jnp.where(apart[chosen] * weight[chosen] > 1e-10, -depth[chosen], 1.0))
    return Manifold(jnp.stack(dist), jnp.stack(rows), normal)


def manifolds(one: PosedSolid, two: PosedSolid, ellipsoids: bool = True) -> Manifold:
    """Return the contacts of many pairs; see `manifold`."""
    return jax.vmap(lambda a, b: manifold(a, b, ellipsoids))(one, two)
