"""Boxes of a scene: their overlap, and the moves of objects between two scenes.

2D boxes in images, upright 3D boxes with a yaw, and the visible boxes of a scene's objects, which
are compared with the parsed boxes of the photograph.
"""

import math
from collections.abc import Collection, Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from shapely import Polygon

from ..spec import Box2D, Box3D, Camera, SceneSpec, TreeNode, bounds, world_poses
from ..spec.pose import ArrayLike, angle_between, yaw_of
from ..spec.room import RECTANGLE, SupportOutline


def iou_2d(a: Box2D | ArrayLike, b: Box2D | ArrayLike) -> float:
    """Return the intersection over union of two boxes in pixels (x0, y0, x1, y1)."""
    first, second = _corners(a), _corners(b)
    common = intersection_2d(first, second)
    union = _area(first) + _area(second) - common
    return common / union if union > 0 else 0.0


def intersection_2d(a: Box2D | ArrayLike, b: Box2D | ArrayLike) -> float:
    """Return the intersection area [px^2] of two boxes in pixels."""
    first, second = _corners(a), _corners(b)
    sides = np.minimum(first[2:], second[2:]) - np.maximum(first[:2], second[:2])
    return float(np.prod(np.maximum(sides, 0.0)))


def footprint(box: Box3D, outline: SupportOutline = RECTANGLE) -> NDArray:
    """Return the corners of an upright box's footprint [m], counterclockwise, shape [n, 2].

    The footprint has the shape of `outline`; by default, it is a rectangle.
    """
    local = outline.corners() * np.array(box.size[:2])
    c, s = np.cos(box.yaw), np.sin(box.yaw)
    return local @ np.array([[c, s], [-s, c]]) + np.array(box.position[:2])


def support_footprint(node: TreeNode) -> NDArray:
    """Return the corners of a node's footprint [m], counterclockwise, shape [n, 2].

    The footprint has the shape of the node's outline. The footprint of a tilted node is that of the
    upright bounding box.
    """
    box = upright(node)
    return footprint(box, node.outline if box is node.box3d else RECTANGLE)


def polygon_intersection(a: NDArray, b: NDArray) -> float:
    """Return the intersection area of two polygons [m^2], given by their corners [m], [n, 2]."""
    return Polygon(a).intersection(Polygon(b)).area


def intersection_3d(a: Box3D, b: Box3D) -> float:
    """Return the intersection volume [m^3] of two upright boxes."""
    low = max(a.position[2], b.position[2])
    high = min(a.position[2] + a.size[2], b.position[2] + b.size[2])
    if high <= low:
        return 0.0
    return polygon_intersection(footprint(a), footprint(b)) * (high - low)


def upright(node: TreeNode) -> Box3D:
    """Return the upright bounding box of a node's tilted box. Both boxes have the same yaw."""
    box = node.box3d
    if abs(node.base_tilt[0]) > 1 - 1e-12:
        return box
    local = Box3D(position=(0, 0, 0), size=box.size, yaw=0).corners(node.base_tilt)
    low, high = local.min(axis=0), local.max(axis=0)
    middle = (low + high)[:2] / 2
    c, s = np.cos(box.yaw), np.sin(box.yaw)
    x, y, z = box.position
    return Box3D(
        position=(
            float(x + c * middle[0] - s * middle[1]),
            float(y + s * middle[0] + c * middle[1]),
            z,
        ),
        size=tuple((high - low).tolist()),
        yaw=box.yaw,
    )


def _corners(box: Box2D | ArrayLike) -> NDArray:
    return np.asarray(box.as_tuple() if isinstance(box, Box2D) else box, float)


def _area(box: NDArray) -> float:
    return float(max(box[2] - box[0], 0.0) * max(box[3] - box[1], 0.0))


VISIBLE_PX = 960
"""Width of the images in which visible boxes are measured [px]."""
OWN_SIDE_PX = 1.0
"""Distance up to which the visible and the whole box of an object end at the same side [px]."""


def visible_box_iou(scene: SceneSpec) -> dict[str, float]:
    """Return the intersection over union of each object's visible box and its parsed box.

    Both boxes bound the part of the object that the photograph's camera sees, which excludes
    occluded parts and parts beyond the image border. The value of an invisible object is 0.
    Environment supports and objects without a parsed box are omitted. The result is empty if the
    scene has no camera.
    """
    if scene.camera is None:
        return {}
    scored = {
        item.name: item.box2d
        for item in scene.objects
        if item.box2d is not None and not item.environment
    }
    boxes = visible_boxes(scene, scene.camera, scored)
    return {name: iou_2d(boxes[name], box) for name, box in scored.items()}


def visible_boxes(
    scene: SceneSpec, camera: Camera, names: Collection[str]
) -> dict[str, Float[np.ndarray, " 4"]]:
    """Return the boxes of the visible parts of objects, in the camera's pixels.

    See-through objects occlude nothing. A side where an object itself or the image ends is exact; a
    side at an occluder is accurate to a pixel of an image VISIBLE_PX wide. The box of an invisible
    object has zero area.

    Args:
        scene: the scene.
        camera: its camera.
        names: names of the objects.
    """
    from ..physics.photo_view import see_through
    from ..render import visible_surface
    from ..render.rasterize import WorldMesh, draw_objects, window_of

    poses, meshes = world_poses(scene), dict[str, WorldMesh]()
    for item in scene.objects:
        vertices, triangles = visible_surface(item.spec, item.joint_state)
        meshes[item.name] = WorldMesh(poses[item.name].apply(vertices), triangles)
    opaque = [item.name for item in scene.objects if not see_through(item.spec)]
    frame, scale = np.array([camera.width, camera.height_px]), VISIBLE_PX / camera.width
    owner = draw_objects([meshes[name] for name in opaque], camera, VISIBLE_PX).owner
    found = {}
    for name in names:
        drawn, index = owner, opaque.index(name) if name in opaque else len(opaque)
        if name not in opaque:
            drawn = draw_objects(
                [meshes[each] for each in (*opaque, name)], camera, VISIBLE_PX
            ).owner
        if not (drawn == index).any():
            found[name] = np.zeros(4)
            continue
        rows, columns = window_of(drawn == index)
        seen = np.array([columns.start, rows.start, columns.stop, rows.stop]) / scale
        whole = _projected(meshes[name].vertices, camera, frame)
        found[name] = np.where(np.abs(whole - seen) * scale <= OWN_SIDE_PX, whole, seen)
    return found


def _projected(points: NDArray, camera: Camera, frame: NDArray) -> Float[np.ndarray, " 4"]:
    """Return the box around points before a camera, within its image [px]."""
    pixels, depth = camera.project(points)
    ahead = np.clip(pixels[depth > 0], 0, frame)
    return np.concatenate([ahead.min(axis=0), ahead.max(axis=0)])


def box_iou(parsed: Mapping[str, float], composed: SceneSpec, refined: SceneSpec) -> dict[str, Any]:
    """Compare the boxes of a run with the parsed 2D boxes, by intersection over union.

    Args:
        parsed: value of each object of the parse, see `parse.checks.agreement`.
        composed: the composed scene, whose visible boxes are compared.
        refined: the refined scene, whose visible boxes are compared.

    Returns:
        "parsed", "composed" and "refined" are the means over all objects, or None if there are no
        objects. "worst" is the name and value of the worst object of the refined scene. "objects"
        contains the three values of each object, by name.
    """
    steps = {
        "parsed": parsed,
        "composed": visible_box_iou(composed),
        "refined": visible_box_iou(refined),
    }
    means = {step: float(np.mean([*v.values()])) if v else None for step, v in steps.items()}
    last = steps["refined"]
    worst = min(last, key=lambda name: last[name], default=None)
    return {
        **means,
        "worst": None if worst is None else {"name": worst, "value": last[worst]},
        "objects": {
            name: {step: values.get(name) for step, values in steps.items()} for name in last
        },
    }


class Move(NamedTuple):
    """Displacement, scaling and rotation of one object."""

    distance_m: float
    """Distance between the object's origins in the two scenes, in the world frame."""
    size_ratio: float
    """New size divided by old size, as the geometric mean over the axes."""
    yaw_deg: float
    turn_deg: float
    """Angle between the object's orientations, including the tilt."""


def object_moves(before: SceneSpec, after: SceneSpec) -> dict[str, Move]:
    """Return the move of every object that both scenes contain, except environment supports."""
    old, new = ({item.name: item for item in scene.objects} for scene in (before, after))
    poses_before, poses_after = world_poses(before), world_poses(after)
    result = {}
    for name, item in old.items():
        if item.environment or name not in new:
            continue
        a, b = poses_before[name], poses_after[name]
        sizes = [np.subtract(*bounds(o.spec, o.joint_state)) for o in (new[name], item)]
        turn = math.remainder(yaw_of(b.quat) - yaw_of(a.quat), 2 * math.pi)
        result[name] = Move(
            float(np.linalg.norm(np.subtract(b.pos, a.pos))),
            float(np.prod(sizes[0] / sizes[1])) ** (1 / 3),
            math.degrees(turn),
            math.degrees(float(angle_between(a.quat, b.quat))),
        )
    return result
