"""The scene tree of posed objects without stated supports, such as meshes of another method.

The tree takes the place of a parse (Step 1), and the objects that of programs (Steps 2 and 3). The
support of an object is the highest surface below its middle, within its footprint. Wide objects
that carry others and have nothing below them are supports. All other objects without a support
stand on a floor. A scene is in doubt, and refused, if its unit of length or a solid that encloses
objects would lead to another scene than was meant.
"""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..checks.static_checks import distance_outside
from ..errors import SpecError
from ..export.importing import ImportedScene
from ..io.names import identifier
from ..physics.support import posed_pieces
from ..spec import (
    Box,
    Box2D,
    Box3D,
    Camera,
    GeomSpec,
    Material,
    ObjectSpec,
    PartSpec,
    PartState,
    SceneObject,
    SceneSpec,
    SceneTree,
    TreeNode,
    bounds,
    world_bounds,
    world_poses,
)
from ..spec.opening import opening_share
from ..spec.pose import from_yaw, pose, rotate, triple
from ..spec.scale import scale, scaled_state
from ..spec.scene import transformed_scene

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
MIN_BOX_PX = 2.0
"""Least edge of a projected box [px]; a smaller box, or one outside of the image, is the whole
image."""


@dataclass(frozen=True)
class MeshTree:
    """A scene of posed objects as a tree."""

    tree: SceneTree
    objects: dict[str, ObjectSpec]
    """The object of each node, by name."""
    given: SceneSpec
    """The objects at their given poses, with fixed supports, and a floor if an object needs one."""
    notes: tuple[str, ...]


def mesh_tree(scene: SceneSpec, camera: Camera | None = None) -> MeshTree:
    """Return the tree of a scene of posed objects.

    Args:
        scene: objects at their poses in the world, without parents; fixed objects are supports.
        camera: camera of the scene's photograph. The scene is then moved vertically, so that the
            top of its main support is at z = 0, as in scenes of photographs. The 2D boxes are
            projections of the objects. Without a camera, the tree has a camera of no meaning, as
            have its 2D boxes.

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
        item.model_copy(update={"environment": True})
        if item.static or item.name in supports
        else item
        for item in scene.objects
    ]
    unsupported = [item.name for item in objects if not item.static and item.name not in parents]
    if unsupported:
        floor = _floor(scene, unsupported)
        objects.append(floor)
        notes.append(f"{floor.name} is added below what nothing carries: {', '.join(unsupported)}")
        parents |= dict.fromkeys(unsupported, floor.name)
    given = scene.model_copy(update={"objects": tuple(objects)})
    if camera is not None:
        top = _main_top(given, parents)
        given = transformed_scene(given, pose((0.0, 0.0, -top)))
        camera = camera.model_copy(update={"height": camera.height - top})
        given = given.model_copy(update={"camera": camera})
    view = camera or Camera(width=640, height_px=480, fovy=0.8, height=1.0, pitch=0.6)
    nodes = tuple(_node(item, given, parents.get(item.name), view) for item in given.objects)
    tree = SceneTree(camera=view, nodes=nodes)
    return MeshTree(tree, {item.name: item.spec for item in given.objects}, given, tuple(notes))


def _node(item: SceneObject, scene: SceneSpec, parent: str | None, camera: Camera) -> TreeNode:
    """Return the node from which composition gives an object its given pose."""
    at = world_poses(scene)[item.name]
    low, high = bounds(item.spec, item.joint_state)
    bottom = np.array([*((low + high) / 2)[:2], low[2]])
    # Composition turns an upright box about the object's origin.
    position = np.array([*item.xy, item.z]) + rotate(from_yaw(item.yaw), bottom)
    corners = np.array(list(itertools.product(*zip(low, high, strict=True))))
    return TreeNode(
        name=item.name,
        label=item.name,
        parent=parent,
        environment=item.environment,
        box2d=_box2d(camera, at.apply(corners)),
        box3d=Box3D(
            position=triple(position),
            size=triple(high - low),
            yaw=item.yaw,
        ),
        base_tilt=item.base_tilt,
        articulation=tuple(_states(item)),
    )


def _states(item: SceneObject) -> list[PartState]:
    """Return the positions of an object's hinges and slides as openings."""
    return [
        PartState(
            part=joint.name,
            type=joint.type,
            opening=opening_share(joint, item.joint_state[joint.name]),
        )
        for joint in item.spec.joints
        if joint.type in ("revolute", "continuous", "prismatic") and joint.name in item.joint_state
    ]


def _box2d(camera: Camera, corners: NDArray) -> Box2D:
    """Return the projection of an object's corners, clipped to the image [px]."""
    size = np.array([camera.width, camera.height_px], float)
    pixels, depth = camera.project(corners)
    low, high = np.clip([pixels.min(axis=0), pixels.max(axis=0)], 0, size)
    if depth.min() <= 0 or np.any(high - low < MIN_BOX_PX):
        low, high = np.zeros(2), size
    return Box2D(x0=float(low[0]), y0=float(low[1]), x1=float(high[0]), y1=float(high[1]))


def _main_top(scene: SceneSpec, parents: Mapping[str, str]) -> float:
    """Return the height of the top of the support that carries most objects [m]."""
    carried = list(parents.values())
    main = max(
        (item for item in scene.objects if item.static), key=lambda item: carried.count(item.name)
    )
    return main.z + float(bounds(main.spec, main.joint_state, main.base_tilt)[1][2])


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
        low, high = world_bounds(item, poses[item.name])
        corners += [low, high]
        if item.name in names:
            lowest.append(float(low[2]))
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


USUAL_M = (0.004, 3.0)
"""Usual range of the median longest edge of the free objects of a scene [m]."""
UNITS = {"centimeters": 0.01, "millimeters": 0.001, "kilometers": 1000.0}
LIFT_M = 0.3
"""Least height by which an object in a solid would be lifted for the solid to be in doubt [m]."""


def scaled_scene(imported: ImportedScene, s: float) -> ImportedScene:
    """Return an imported scene with all lengths multiplied by `s`, including the camera's place.

    Raises:
        SpecError: `s` is not a positive finite number.
    """
    if not 0 < s < float("inf"):
        raise SpecError(f"--scale: got {s:g}, expected a positive number, such as 0.01")
    objects = [
        item.model_copy(
            update={
                "spec": scale(item.spec, s),
                "xy": (s * item.xy[0], s * item.xy[1]),
                "z": s * item.z,
                "joint_state": scaled_state(item.spec, item.joint_state, s),
            }
        )
        for item in imported.spec.objects
    ]
    camera = imported.camera
    if camera is not None and camera.pose is not None:
        pose = np.array(camera.pose)
        pose[:3, 3] *= s
        a, b, c, d = (tuple(row) for row in pose.tolist())
        camera = camera.model_copy(update={"pose": (a, b, c, d)})
    spec = imported.spec.model_copy(update={"objects": tuple(objects)})
    return replace(imported, spec=spec, camera=camera)


def doubt_unit(scene: SceneSpec, remedy: str = "") -> None:
    """Raise a SpecError if the sizes of the free objects suggest another unit than meters.

    Args:
        scene: the scene.
        remedy: what the user can do; by default, the flag --scale of rescues.
    """
    edges = {
        item.name: float(np.ptp(bounds(item.spec, item.joint_state), axis=0).max())
        for item in scene.objects
        if not item.static
    }
    median = float(np.median(list(edges.values()))) if edges else 1.0
    if USUAL_M[0] <= median <= USUAL_M[1]:
        return
    sizes = ", ".join(f"{name} {edge:.3g} m" for name, edge in list(edges.items())[:3])
    fitting = [u for u, s in UNITS.items() if USUAL_M[0] * 5 < median * s < USUAL_M[1]]
    unit = fitting[0] if fitting else ("millimeters" if median > 1 else "kilometers")
    if not remedy:
        remedy = f"If so, add --scale {UNITS[unit]:g}; if the sizes are right, add --scale 1"
    raise SpecError(f"{scene.name} has unusual sizes ({sizes}): is it in {unit}? {remedy}")


def doubt_solids(scene: SceneSpec) -> None:
    """Raise a SpecError if a collider contains free objects, such as a room that is one solid.

    Objects that are only sunk in their support are not in doubt.
    """
    poses = world_poses(scene)
    for outer in scene.objects:
        place = poses[outer.name]
        solids = [(piece, place.then(at)) for piece, at in posed_pieces(outer, tilted=False)]
        top = world_bounds(outer, place)[1][2]
        inside = {}
        for item in scene.objects:
            low, high = world_bounds(item, poses[item.name])
            lift = float(top - low[2])
            if item is outer or item.static or lift < max(LIFT_M, float(high[2] - low[2])):
                continue
            corners = np.array(list(itertools.product(*zip(low, high, strict=True))))
            if np.all(distance_outside(corners, solids) < 0):
                inside[item.name] = lift
        if inside:
            moves = ", ".join(f"{name} by {lift:.2g} m" for name, lift in inside.items())
            raise SpecError(
                f"scene {scene.name}: the collider of {outer.name} is solid and encloses objects, "
                f"which would be lifted onto it ({moves}): leave out {outer.name}, or export its "
                "floor and walls as separate objects"
            )
