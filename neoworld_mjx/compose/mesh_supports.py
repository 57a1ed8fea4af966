"""Compose a scene of posed objects without stated supports, such as meshes of another method.

The support of an object is the highest surface below its middle, within its footprint. Wide objects
that carry others and have nothing below them are supports. All other objects without a support
stand on a floor.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..errors import SpecError
from ..io.names import identifier
from ..spec import (
    Box,
    GeomSpec,
    Material,
    ObjectSpec,
    PartSpec,
    SceneObject,
    SceneSpec,
    bounds,
    world_poses,
)
from ..spec.pose import Pose, angle_between, conjugate, from_yaw, quat_mul, rotate, yaw_of
from .mesh_sizes import fit_sizes
from .on_supports import snap
from .resting_pose import resting_tilt

if TYPE_CHECKING:
    import trimesh

FOOTPRINT_GRID = 9
"""Number of rays along each side of an object's footprint."""
MIN_HIT_FRACTION = 0.15
"""Least share of an object's rays that must hit its support. An object hit by fewer rays is a
neighbor."""
MIN_AREA_RATIO = 4.0
"""Least area of a support that is not fixed in the given scene, relative to the largest footprint
that it carries."""
MARGIN_M = 0.5
"""Distance by which the floor extends beyond the objects [m]."""
FLOOR_M = 0.1
"""Thickness of the floor [m]."""


@dataclass(frozen=True)
class FoundSupports:
    """A scene at its given poses, and the supports of its objects."""

    scene: SceneSpec
    """The given objects with fixed supports, and a floor if an object needs one."""
    parents: dict[str, str]
    """Name of the support of every free object."""
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Supported:
    """A scene whose objects stand on supports."""

    scene: SceneSpec
    notes: tuple[str, ...]
    """Notes on supports, on the floor, and on corrected tilts and sizes."""


def find_supports(scene: SceneSpec) -> FoundSupports:
    """Find the support of each object of a scene, and fix the supports that cannot move.

    Args:
        scene: objects at their poses in the world, without parents; fixed objects are supports.

    Raises:
        SpecError: the scene has no object that is free to move, or already states parents.
    """
    if any(item.parent is not None for item in scene.objects):
        raise SpecError(f"scene {scene.name} already states its supports; refine the scene instead")
    if all(item.static for item in scene.objects):
        raise SpecError(f"scene {scene.name} has no object that is free to move")
    parents = _parents(scene)
    supports = _supports(scene, parents)
    notes = [f"{name} is a support: it carries others" for name in sorted(supports)]
    objects = [
        item.model_copy(update={"environment": True}) if item.name in supports else item
        for item in scene.objects
    ]
    unsupported = [item.name for item in objects if not item.static and item.name not in parents]
    if unsupported:
        floor = _floor(scene, unsupported)
        objects.append(floor)
        notes.append(f"{floor.name} is added below what nothing carries: {', '.join(unsupported)}")
        parents |= dict.fromkeys(unsupported, floor.name)
    return FoundSupports(
        scene.model_copy(update={"objects": tuple(objects)}), parents, tuple(notes)
    )


def with_supports(
    supports: FoundSupports, *, resting: Collection[str] = (), sizes: bool = False
) -> Supported:
    """Return a scene with every object on its support.

    Each object is tilted about its middle to the nearest resting pose (`resting_tilt`). Headings
    and horizontal positions do not change, and heights follow from the supports.

    Args:
        supports: the objects and their supports.
        resting: names of the objects that rest at their given poses. Such an object keeps its pose
            if the objects that carry it keep theirs.
        sizes: if True, correct sizes by the given heights (`fit_sizes`).
    """
    scene, parents = supports.scene, supports.parents
    fixed = {n for n in resting if all(m in resting for m in _chain(n, parents) if m in parents)}
    composed, notes = _compose(scene, parents, fixed)
    changes: list[str] = []
    if sizes:
        scene, changes = fit_sizes(scene, composed, fixed)
    if changes:
        composed, notes = _compose(scene, parents, fixed)
    return Supported(composed, (*supports.notes, *notes, *changes))


def _compose(
    scene: SceneSpec, parents: Mapping[str, str], fixed: Collection[str]
) -> tuple[SceneSpec, list[str]]:
    """Put objects onto their supports, from the bottom up; return the scene, and notes on tilts."""
    poses, notes = world_poses(scene), list[str]()
    objects = [item for item in scene.objects if item.static]
    frames = {item.name: poses[item.name] for item in objects}
    free = [item for item in scene.objects if not item.static]
    for item in sorted(free, key=lambda item: len(_chain(item.name, parents))):
        parent = parents[item.name]
        placed, note = _place(
            item, poses[item.name], parent, frames[parent], as_given=item.name in fixed
        )
        objects.append(placed)
        pos = frames[parent].pos + rotate(
            from_yaw(yaw_of(frames[parent].quat)), np.array([*placed.xy, placed.z])
        )
        frames[item.name] = Pose(pos, from_yaw(placed.yaw + yaw_of(frames[parent].quat)))
        notes += note
    composed = scene.model_copy(update={"objects": tuple(objects)})
    snapped = [
        unsnapped if unsnapped.name in fixed else snapped_item
        for unsnapped, snapped_item in zip(objects, snap(composed).objects, strict=True)
    ]
    return composed.model_copy(update={"objects": tuple(snapped)}), notes


def _place(
    item: SceneObject, pose: Pose, parent: str, frame: Pose, *, as_given: bool
) -> tuple[SceneObject, list[str]]:
    """Return an object in its parent's frame, in a resting pose unless `as_given`; and notes."""
    yaw = yaw_of(pose.quat)
    tilt = quat_mul(conjugate(from_yaw(yaw)), pose.quat)
    tilt = tuple((tilt / np.linalg.norm(tilt)).tolist())
    rest_tilt = tilt if as_given else resting_tilt(item.spec, item.joint_state, tilt)
    notes = []
    if rest_tilt is None:
        notes.append(f"{item.name} has no resting pose near its tilt, which is kept")
        rest_tilt = tilt
    else:
        angle = np.degrees(angle_between(np.array(rest_tilt), np.array(tilt)))
        if angle > 0.1:
            notes.append(f"{item.name} is turned upright by {angle:.1f} deg")
    # The object turns about its middle, which does not move.
    low, high = bounds(item.spec, item.joint_state)
    middle = (low + high) / 2
    quat = quat_mul(from_yaw(yaw), np.array(rest_tilt))
    pos = pose.apply(middle) - rotate(quat, middle)
    heading = yaw_of(frame.quat)
    x, y, z = rotate(from_yaw(-heading), pos - frame.pos).tolist()
    update = {
        "parent": parent,
        "xy": (x, y),
        "z": z,
        "yaw": float(yaw - heading),
        "base_tilt": rest_tilt,
    }
    return item.model_copy(update=update), notes


def _parents(scene: SceneSpec) -> dict[str, str]:
    """Return the support of each free object with another object below it."""
    import trimesh

    poses, meshes = world_poses(scene), {}
    for item in scene.objects:
        parts = [
            trimesh.Trimesh(poses[item.name].apply(geom.pose().apply(vertices)), faces)
            for part in item.spec.parts
            for geom in part.geoms
            for vertices, faces in [geom.shape.surface()]
        ]
        meshes[item.name] = trimesh.util.concatenate(parts)
    parents = {}
    for item in scene.objects:
        if item.static:
            continue
        item_mesh = meshes[item.name]
        rays = _footprint(item_mesh)
        best: tuple[float, str] | None = None
        for other, mesh in meshes.items():
            if other == item.name or not _above(item_mesh, mesh):
                continue
            heights = _heights(mesh, rays)
            if len(heights) >= MIN_HIT_FRACTION * len(rays):
                height = float(np.quantile(heights, 0.9))
                if best is None or height > best[0]:
                    best = height, other
        # Interlocking objects must not form a cycle of supports.
        if best is not None and item.name not in _chain(best[1], parents):
            parents[item.name] = best[1]
    return parents


def _chain(name: str, parents: Mapping[str, str]) -> list[str]:
    """Return the names of an object and of all objects that carry it, from top to bottom."""
    names = [name]
    while names[-1] in parents:
        names.append(parents[names[-1]])
    return names


def _footprint(mesh: "trimesh.Trimesh") -> NDArray:
    """Return origins of rays that point down, over a mesh's footprint, shape [n, 3].

    The origins are at half of the mesh's height, in the world frame [m].
    """
    from shapely import MultiPoint, contains_xy

    (x0, y0, z0), (x1, y1, z1) = mesh.bounds
    steps = (np.arange(FOOTPRINT_GRID) + 0.5) / FOOTPRINT_GRID
    x, y = (grid.ravel() for grid in np.meshgrid(x0 + steps * (x1 - x0), y0 + steps * (y1 - y0)))
    inside = contains_xy(MultiPoint(mesh.vertices[:, :2]).convex_hull, x, y)
    x, y = (x[inside], y[inside]) if inside.any() else (x, y)
    return np.column_stack([x, y, np.full(len(x), (z0 + z1) / 2)])


def _above(upper: "trimesh.Trimesh", other: "trimesh.Trimesh") -> bool:
    """Return whether a mesh's middle is above another mesh's bottom, and their footprints overlap.

    The bounding boxes of the meshes are compared.
    """
    (a0, a1), (b0, b1) = upper.bounds, other.bounds
    overlap = np.minimum(a1[:2], b1[:2]) - np.maximum(a0[:2], b0[:2])
    return bool((overlap > 0).all() and (a0[2] + a1[2]) / 2 > b0[2])


def _heights(mesh: "trimesh.Trimesh", origins: NDArray) -> NDArray:
    """Return the height of the first hit of each ray that hits the mesh [m]."""
    down = np.tile([0.0, 0.0, -1.0], (len(origins), 1))
    points, _, _ = mesh.ray.intersects_location(origins, down, multiple_hits=False)
    return np.asarray(points).reshape(-1, 3)[:, 2]


def _supports(scene: SceneSpec, parents: dict[str, str]) -> set[str]:
    """Return the free objects that carry others, have nothing below them, and are wide."""
    result = set()
    for item in scene.objects:
        carried = [scene.object(name) for name, other in parents.items() if other == item.name]
        if item.static or item.name in parents or not carried:
            continue
        if _area(item) >= MIN_AREA_RATIO * max(_area(other) for other in carried):
            result.add(item.name)
    return result


def _area(item: SceneObject) -> float:
    low, high = bounds(item.spec, item.joint_state)
    return float(np.prod(np.subtract(high, low)[:2]))


def _floor(scene: SceneSpec, names: list[str]) -> SceneObject:
    """Return a floor with its top at the median height of some objects' lowest points."""
    poses, corners = world_poses(scene), []
    lowest = []
    for item in scene.objects:
        low, high = bounds(item.spec, item.joint_state, tuple(poses[item.name].quat.tolist()))
        corners += [poses[item.name].pos + low, poses[item.name].pos + high]
        if item.name in names:
            lowest.append(float((poses[item.name].pos + low)[2]))
    low, high = np.min(corners, axis=0) - MARGIN_M, np.max(corners, axis=0) + MARGIN_M
    material = Material(name="floor", density=1000, friction=0.6, rgba=(0.6, 0.6, 0.6, 1))
    size = (float(high[0] - low[0]), float(high[1] - low[1]), FLOOR_M)
    geom = GeomSpec(
        name="floor", shape=Box(size=size), pos=(0, 0, FLOOR_M / 2), material=material.name
    )
    name = identifier("floor", "object", {item.name for item in scene.objects})
    spec = ObjectSpec(
        name=name, materials=(material,), parts=(PartSpec(name="floor", geoms=(geom,)),)
    )
    return SceneObject(
        name=name,
        spec=spec,
        environment=True,
        xy=(float(low[0] + high[0]) / 2, float(low[1] + high[1]) / 2),
        z=float(np.median(lowest)) - FLOOR_M,
    )
