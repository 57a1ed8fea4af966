"""Canonical colliders of a scene as arrays, and exact distances between colliders.

D_pen is measured on the arrays, which hold convex pieces by kind, regardless of the engine that
simulates the scene. Measures of scenes use MuJoCo's `mj_geomDistance`.
"""

import jax
import mujoco
import numpy as np
from jaxtyping import Float
from neoworld_kernels import Colliders, PieceGroup
from numpy.typing import NDArray

from ..spec import Lathe, SceneObject, SceneSpec, Shape
from ..spec.convex import Piece, box_around, planes
from ..spec.pose import Pose, matrix, pose
from .mjcf import object_of_body, start_data, to_mjspec
from .support import posed_shapes

_KIND = {
    "box": "box",
    "sphere": "capsule",
    "capsule": "capsule",
    "cylinder": "cylinder",
    "ellipsoid": "ellipsoid",
    "mesh": "polytope",
}


def collect_colliders(objects: tuple[SceneObject, ...]) -> Colliders:
    """Collect the convex pieces of all objects, in the objects' frames at their joint states.

    A wedge that a lathe repeats around an axis is stored once.
    """
    rows: dict[str, list[tuple[int, Piece, Pose, int]]] = {kind: [] for kind in Colliders._fields}
    for owner, item in enumerate(objects):
        for shape, shape_pose in posed_shapes(item):
            for piece, repeats in _distinct(shape):
                kind = _KIND[piece.kind] if repeats == 1 else "sector"
                rows[kind].append(
                    (owner, piece, shape_pose.then(pose(piece.pos, piece.quat)), repeats)
                )
    return Colliders(**{kind: _group(rows[kind]) for kind in Colliders._fields})


def _distinct(shape: Shape) -> list[tuple[Piece, int]]:
    # An oval lathe has no rotational symmetry.
    if isinstance(shape, Lathe) and shape.oval == 1.0:
        return shape.distinct_pieces()
    return [(piece, 1) for piece in shape.pieces()]


def _group(rows: list[tuple[int, Piece, Pose, int]]) -> PieceGroup:
    faces = [planes(p) if p.kind == "mesh" else np.zeros((0, 4)) for _, p, _, _ in rows]
    width = max((len(f) for f in faces), default=0)
    table = np.zeros((len(rows), width, 4))
    table[..., 3] = 1e6
    size, extent = np.zeros((len(rows), 3)), np.zeros((len(rows), 2, 3))
    for k, (_, piece, _, repeats) in enumerate(rows):
        table[k, : len(faces[k])] = faces[k]
        size[k, : len(piece.size)] = piece.size
        extent[k] = _extent(piece, repeats)
        if repeats > 1:
            size[k, 0] = repeats
    f32 = lambda value, shape: jax.device_put(np.array(value, np.float32).reshape(shape))
    return PieceGroup(
        owner=jax.device_put(np.array([owner for owner, _, _, _ in rows], np.int32)),
        pos=f32([piece_pose.pos for _, _, piece_pose, _ in rows], (-1, 3)),
        rot=f32([matrix(piece_pose.quat) for _, _, piece_pose, _ in rows], (-1, 3, 3)),
        size=f32(size, (-1, 3)),
        planes=f32(table, (len(rows), width, 4)),
        extent=f32(extent, (-1, 2, 3)),
    )


def _extent(piece: Piece, repeats: int) -> NDArray:
    """Return the bounding box of a piece and its repeats about the z axis, in the piece's frame."""
    if repeats == 1:
        return np.array(box_around(piece, pose()))
    x, y, z = np.array(piece.vertices).T
    radius = np.hypot(x, y).max()
    return np.array([[-radius, -radius, z.min()], [radius, radius, z.max()]])


NUDGE = np.array([0.36, 0.48, 0.80]) * 1e-6
"""Displacement of a geom for which MuJoCo returns no valid distance [m]."""
TOUCH_M = 1e-3
"""Largest gap between bounding spheres at which geoms are tested for penetration [m]."""
SNAP_GAP_M, SNAP_ROUNDS = 1e-4, 30
"""Clearance of an object that is snapped exactly [m], and largest number of steps towards it."""


def start_state(scene: SceneSpec, timestep: float = 0.002) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Compile a scene, and return its model and its composed state after `mj_forward`."""
    model = to_mjspec(scene, timestep=timestep).compile()
    data = start_data(model)
    mujoco.mj_forward(model, data)
    return model, data


def object_of_geom(scene: SceneSpec, model: mujoco.MjModel) -> NDArray:
    """Return the object that owns each geom, -1 for none, shape [ngeom]."""
    return object_of_body(model, [item.name for item in scene.objects])[model.geom_bodyid]


def pair_distance(
    model: mujoco.MjModel, data: mujoco.MjData, first: NDArray, second: NDArray, reach: float = 0.05
) -> float:
    """Return the smallest signed distance [m] between two sets of geoms, at most `reach`.

    A negative distance is a penetration depth. Pairs of geoms whose bounding spheres or boxes are
    farther apart are skipped.
    """
    nearest = reach
    rows = np.argwhere(_sphere_gaps(model, data, first, second) < reach)
    a, b = first[rows[:, 0]], second[rows[:, 1]]
    gaps = _box_gaps(model, data, a, b)
    for k in np.argsort(gaps, kind="stable").tolist():
        if gaps[k] >= nearest:
            break
        nearest = min(nearest, geom_distance(model, data, int(a[k]), int(b[k]), nearest))
    return float(nearest)


def _sphere_gaps(
    model: mujoco.MjModel, data: mujoco.MjData, first: NDArray, second: NDArray
) -> NDArray:
    """Return the gaps [first, second] between the bounding spheres of geoms [m]."""
    apart = np.linalg.norm(data.geom_xpos[second] - data.geom_xpos[first, None], axis=-1)
    return apart - model.geom_rbound[second] - model.geom_rbound[first, None]


def _box_gaps(
    model: mujoco.MjModel, data: mujoco.MjData, a: NDArray, b: NDArray
) -> Float[np.ndarray, " pair"]:
    """Return the largest gap between the bounding boxes of pairs of geoms along their axes [m].

    The distance of two geoms is at least this gap. It is negative for boxes that may overlap.
    """
    half = model.geom_aabb[:, 3:]
    turn = data.geom_xmat.reshape(-1, 3, 3)
    center = data.geom_xpos + np.einsum("gij,gj->gi", turn, model.geom_aabb[:, :3])
    offset = center[b] - center[a]
    relative = np.abs(np.einsum("nji,njk->nik", turn[a], turn[b]))
    along = lambda g: np.abs(np.einsum("nji,nj->ni", turn[g], offset))
    own = along(a) - half[a] - np.einsum("nij,nj->ni", relative, half[b])
    other = along(b) - half[b] - np.einsum("nij,ni->nj", relative, half[a])
    return np.maximum(own.max(axis=1), other.max(axis=1))


def geom_distance(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    a: int,
    b: int,
    reach: float,
    ends: NDArray | None = None,
) -> float:
    """Return the signed distance [m] of two geoms, at most `reach`.

    If `ends` [6] is given, the nearest points of `a` and of `b` are written to it [m].

    If the center of one geom lies on the surface or at the center of the other geom, MuJoCo 3.17
    returns the distance between the centers, however deep the penetration. The true distance is
    always smaller, so such a result is recognized, and the distance is measured again with one geom
    displaced by a micrometer.
    """
    between = float(np.linalg.norm(data.geom_xpos[a] - data.geom_xpos[b]))
    if between > max(model.geom_rbound[a], model.geom_rbound[b]):
        return mujoco.mj_geomDistance(model, data, a, b, reach, ends)
    distance = mujoco.mj_geomDistance(model, data, a, b, between + reach, ends)
    if distance >= between * (1 - 1e-9):
        position = data.geom_xpos[a].copy()
        data.geom_xpos[a] = position + NUDGE
        distance = mujoco.mj_geomDistance(model, data, a, b, reach, ends)
        data.geom_xpos[a] = position
    return min(distance, reach)


def object_depths(
    scene: SceneSpec, model: mujoco.MjModel, data: mujoco.MjData
) -> dict[tuple[str, str], float]:
    """Return the penetration depth [m] of every pair of objects, in the state of `data`.

    Pairs of environment supports, and pairs that do not touch, are omitted.
    """
    owner = object_of_geom(scene, model)
    collides = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    geoms = [np.flatnonzero((owner == k) & collides) for k in range(len(scene.objects))]
    fixed = np.array([item.environment for item in scene.objects], bool)
    depths = {}
    for i, a in enumerate(scene.objects):
        later = np.flatnonzero((owner > i) & collides)
        later = later[~(fixed[i] & fixed[owner[later]])]
        reached = (_sphere_gaps(model, data, geoms[i], later) < TOUCH_M).any(axis=0)
        for j in np.unique(owner[later[reached]]).tolist():
            depth = -pair_distance(model, data, geoms[i], geoms[j], reach=TOUCH_M)
            if depth > 0:
                depths[(a.name, scene.objects[j].name)] = depth
    return depths


def snap_exactly(scene: SceneSpec) -> SceneSpec:
    """Lower every snapped object onto its support, parents first, leaving SNAP_GAP_M.

    Lowering an object by its distance from the support never overshoots. An object that penetrates
    its support is raised until it no longer does. If raising does not even halve the penetration,
    as for a sideways overlap, the object keeps its height.
    """
    model, data = start_state(scene)
    owner = object_of_geom(scene, model)
    ancestors = np.eye(len(scene.objects), dtype=bool)
    for index, item in enumerate(scene.objects):
        if item.parent is not None:
            ancestors[index] |= ancestors[scene.index(item.parent)]
    objects = list(scene.objects)
    for index, item in enumerate(scene.objects):
        if item.parent is None or item.relation == "attached" or item.environment:
            continue
        geoms = np.flatnonzero(owner == index)
        support = np.flatnonzero(owner == scene.index(item.parent))
        # Descendants are translated with the object, so nothing is recompiled.
        descendant_geoms = np.flatnonzero((owner >= 0) & ancestors[owner, index])
        height, distances = item.z, []
        for _ in range(SNAP_ROUNDS):
            distance = pair_distance(model, data, geoms, support, reach=0.02)
            distances.append(distance)
            if distance >= 0.02 or abs(distance - SNAP_GAP_M) < 5e-6:
                break
            height += SNAP_GAP_M - distance
            data.geom_xpos[descendant_geoms, 2] += SNAP_GAP_M - distance
        if distances[-1] < min(distances[0] / 2, 0.0):
            data.geom_xpos[descendant_geoms, 2] -= height - item.z
            height = item.z
        objects[index] = item.model_copy(update={"z": height})
    return scene.model_copy(update={"objects": tuple(objects)})
