"""Heights of objects on their supports, and distances of what is attached from its wall."""

import numpy as np
from numpy.typing import NDArray

from ..physics.layout import Layout, arrange
from ..physics.photo_view import direction_in_wall
from ..physics.placed import VERTICAL
from ..physics.scene_arrays import snapped_heights
from ..spec import SceneObject, SceneSpec, bounds, world_poses
from ..spec.pose import from_yaw, quat_mul


def snap(scene: SceneSpec) -> SceneSpec:
    """Place every object on the surface under its footprint, with a clearance of 0.1 mm."""
    arrangement = arrange(scene)
    z = snapped_heights(arrangement, Layout.zero(1, len(scene.objects)))[0]
    objects = [
        obj.model_copy(update={"z": float(h)}) if flag else obj
        for obj, h, flag in zip(scene.objects, z, arrangement.snapped, strict=True)
    ]
    return scene.model_copy(update={"objects": tuple(objects)})


def put_down(scene: SceneSpec) -> SceneSpec:
    """Place the objects of an aligned scene on the surfaces under them, and against their walls.

    An object keeps its height if the surface under it is at another level than the one that it
    stands on, by more than `settling_displacement` allows. A tube that overlaps the wall of its
    hole by a millimeter stays in the hole: settling moves it out of the wall.
    """
    scene, objects = against_walls(scene), []
    for item, snapped in zip(scene.objects, snap(scene).objects, strict=True):
        size = float(np.linalg.norm(np.subtract(*bounds(item.spec, item.joint_state))))
        near = abs(snapped.z - item.z) <= VERTICAL[0] * size + VERTICAL[1]
        objects.append(snapped if near else item)
    return scene.model_copy(update={"objects": tuple(objects)})


def against_walls(scene: SceneSpec) -> SceneSpec:
    """Move what is attached to a wall along the wall's normal, until it touches the wall.

    A photograph shows neither distance, and a cabinet inside its wall could never be valid. The
    face is the one that the camera sees.
    """
    poses, camera = world_poses(scene), scene.camera
    objects = []
    for item in scene.objects:
        along = direction_in_wall(scene, item)
        if along.any() and camera is not None:
            wall = scene.object(item.parent or "")
            if wall.environment and item.known != "pose":
                viewer = poses[wall.name].inverse().apply(camera.position())
                item = _touching(item, wall, int(np.argmin(np.abs(along))), viewer)
        objects.append(item)
    return scene.model_copy(update={"objects": tuple(objects)})


def _touching(item: SceneObject, wall: SceneObject, axis: int, viewer: NDArray) -> SceneObject:
    """Return an object that touches the face of its wall across `axis` that the viewer sees."""
    own = bounds(item.spec, item.joint_state, tuple(quat_mul(from_yaw(item.yaw), item.base_tilt)))
    faces = bounds(wall.spec)
    front = int(viewer[axis] > np.mean(faces, axis=0)[axis])
    xy = list(item.xy)
    xy[axis] = float(faces[front][axis] - own[1 - front][axis])
    return item.model_copy(update={"xy": tuple(xy)})
