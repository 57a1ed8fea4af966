"""Data of the photograph: the camera, 2D boxes, depths, and standard deviations of poses."""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ..spec import Camera, ObjectSpec, SceneObject, SceneSpec, bounds, support_frame, world_poses
from ..spec.pose import yaw_of
from .array_types import AnyArray
from .sampling import surface_samples

BOX_SAMPLES = 256
"""Number of surface samples that determine the 2D box of an object without a parsed box."""

BORDER_PX = 2.0
"""Distance from the image border within which a box counts as cut by the border."""


class PhotoView(NamedTuple):
    """The photograph's camera, and the boxes and depths of all objects."""

    axes: Float[AnyArray, "3 3"]
    """Columns are the camera's right, down and forward axes in the world."""
    position: Float[AnyArray, " 3"]
    """[m]"""
    focal: Float[AnyArray, ""]
    """[px]"""
    edges: Float[AnyArray, " 4"]
    """Edges of the image: left, top, right, bottom relative to the principal point [px]."""
    boxes: Float[AnyArray, "object 4"]
    """2D boxes: left, top, right, bottom relative to the principal point [px]."""
    parsed: Bool[AnyArray, " object"]
    """True for parsed boxes, which bound the visible part. Other boxes bound the whole object."""
    depth: Float[AnyArray, " object"]
    """Depth along the viewing direction [m]."""
    scored: Bool[AnyArray, " object"]
    """True for scored objects: all but environment supports."""
    fully_visible: Bool[AnyArray, " object"]
    """True for objects that are entirely visible."""
    occludes: Bool[AnyArray, " object"]
    """True for objects that occlude other objects. Transparent objects do not."""


def photo_view(spec: SceneSpec) -> PhotoView:
    """Collect the photograph's boxes and depths; compute missing ones from the composed scene."""
    camera = spec.camera or default_camera(spec)
    half = np.tile([camera.width / 2, camera.height_px / 2], 2)
    center = np.tile(camera.center, 2)
    poses = world_poses(spec)
    boxes, depth, parsed = [], [], []
    for item in spec.objects:
        box, distance = item.box2d and item.box2d.as_tuple(), item.depth
        if box is None or distance is None:
            points = np.asarray(surface_samples(item, BOX_SAMPLES), float)
            pixels, distances = camera.project(poses[item.name].apply(points))
            box = [*pixels.min(axis=0), *pixels.max(axis=0)] if box is None else box
            distance = distances.mean() if distance is None else distance
        boxes.append(np.array(box) - center)
        depth.append(distance)
        parsed.append(item.box2d is not None)
    boxes, depth = np.array(boxes), np.array(depth, float)
    scored = np.array([not item.environment for item in spec.objects])
    occluded = np.array([item.occluded for item in spec.objects])
    middle = np.tile(camera.principal, 2)
    inside_image = np.abs(boxes + middle) < half - BORDER_PX
    fully_visible = ~occluded & (inside_image.all(axis=1) | ~np.array(parsed))
    occludes = np.array([not see_through(item.spec) for item in spec.objects])
    return PhotoView(
        axes=camera.axes(),
        position=camera.position(),
        focal=np.array(camera.focal),
        edges=np.array([-half[0], -half[1], half[0], half[1]]) - middle,
        boxes=boxes,
        parsed=np.array(parsed),
        depth=depth,
        scored=scored,
        fully_visible=fully_visible,
        occludes=occludes,
    )


def photo_deviations(
    scene: SceneSpec,
) -> tuple[Float[np.ndarray, "object 2 2"], Float[np.ndarray, "object 2"]]:
    """Return the standard deviations of every object; zeros for objects that were not aligned.

    The yaw of an object that looks the same at every heading has the deviation 0: another heading
    would change only the poses of the objects on it, whose own deviations are known.

    Returns:
        Deviations of the positions, shape [object, 2, 2], and of the yaw [rad] and the log scale,
        shape [object, 2]. The columns of each 2x2 matrix are the deviations along and across the
        viewing direction, as vectors in the frame of the object's support [m]; of an object on a
        wall, zero and the deviation along the wall.
    """
    poses = world_poses(scene)
    axes, yaw_and_scale = np.zeros((len(scene.objects), 2, 2)), np.zeros((len(scene.objects), 2))
    eye = np.zeros(2) if scene.camera is None else scene.camera.position()[:2]
    for k, item in enumerate(scene.objects):
        uncertainty = item.uncertainty
        if uncertainty is None or item.parent is None:
            continue
        frame = support_frame(scene.object(item.parent), poses[item.parent], item.parent_link)
        x, y = poses[item.name].pos[:2] - eye
        along = math.atan2(y, x) - yaw_of(frame.quat)
        c, s = math.cos(along), math.sin(along)
        axes[k] = np.array([[c, -s], [s, c]]) * [uncertainty.along, uncertainty.across]
        in_wall = direction_in_wall(scene, item)
        if in_wall.any():
            axes[k] = np.column_stack([np.zeros(2), in_wall * uncertainty.across])
        yaw_and_scale[k] = uncertainty.yaw or 0.0, uncertainty.log_scale
    return axes, yaw_and_scale


def direction_in_wall(scene: SceneSpec, item: SceneObject) -> Float[np.ndarray, " 2"]:
    """Return the horizontal direction in the wall to which an object is attached, or zero.

    It is a unit vector in the frame of the object's support.
    """
    if item.relation != "attached" or item.parent is None:
        return np.zeros(2)
    low, high = bounds(scene.object(item.parent).spec)
    thinnest = int(np.argmin(np.subtract(high, low)))
    return np.zeros(2) if thinnest == 2 else np.eye(2)[1 - thinnest]


def see_through(spec: ObjectSpec) -> bool:
    """Return whether all visible geoms of an object are see-through."""
    visible_geoms = [geom for part in spec.parts for geom in part.geoms if geom.role != "collision"]
    return bool(visible_geoms) and all(
        spec.material(geom.material).see_through for geom in visible_geoms
    )


def default_camera(scene: SceneSpec) -> Camera:
    """Return a camera that shows a scene without one, from above the origin."""
    far = max(float(np.abs(pose.pos).max()) for pose in world_poses(scene).values())
    return Camera(width=600, height_px=400, fovy=0.8, height=1.0 + far, pitch=0.6)
