"""Collision geoms of a MuJoCo model as convex solids with one common representation.

All solids are padded to the same shape, so code that takes two solids is traced only once for any
number and type of geoms.
"""

from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float, Int
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
    """Pairs of geoms that may touch, with MuJoCo's contact parameters."""

    first: Int[AnyArray, " pair"]
    second: Int[AnyArray, " pair"]
    friction: Float[AnyArray, "pair 5"]
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
    friction = np.maximum(m.geom_friction[first], m.geom_friction[second])
    blend = lambda x: (weight * x[first] + (1 - weight) * x[second]).astype(np.float32)
    return GeomPairs(
        first=first,
        second=second,
        friction=friction[:, [0, 0, 1, 2, 2]].astype(np.float32),
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
