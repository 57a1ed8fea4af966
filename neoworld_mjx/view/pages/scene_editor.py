"""Edits of a scene by a person: poses, boxes and joint states, recorded as a layout patch."""

import math

import numpy as np
from numpy.typing import ArrayLike

from ...compose.layout_patch import LayoutPatch, ObjectPlacement
from ...spec import (
    Box2D,
    JointSpec,
    SceneObject,
    SceneSpec,
    joint_keys,
    support_frame,
    world_poses,
)
from ...spec.pose import Pose, from_yaw, pose, yaw_of

FREE_RANGE = math.pi
"""Limit of the slider of an unlimited joint, in both directions [rad]."""


class SceneEditor:
    """The edited scene, and the patch that records the edits."""

    def __init__(self, scene: SceneSpec, patch: LayoutPatch):
        """Start with a scene to which the patch has already been applied."""
        self.scene, self.patch = scene, patch

    def handle_pose(self, name: str) -> Pose:
        """Return the pose of a drag handle: origin and heading of its object in the world frame."""
        position = world_poses(self.scene)[name].pos
        return pose(
            position, from_yaw(yaw_of(self._support_frame(name).quat) + self.scene.object(name).yaw)
        )

    def place(self, name: str, pos: ArrayLike, quat: ArrayLike) -> None:
        """Move an object to the pose of its drag handle; keep its height above the support.

        Args:
            name: name of the object.
            pos: position of the handle in the world frame [m], shape [3].
            quat: orientation of the handle (w, x, y, z); only its heading is used.
        """
        obj = self.scene.object(name)
        frame = self._support_frame(name)
        x, y, _ = (float(v) for v in frame.inverse().apply(np.asarray(pos, float)))
        yaw = math.remainder(yaw_of(np.asarray(quat, float)) - yaw_of(frame.quat), 2 * math.pi)
        self._replace(obj.model_copy(update={"xy": (x, y), "yaw": yaw}))
        self.patch = self.patch.merged(name, ObjectPlacement(xy=(x, y), yaw=yaw))

    def set_joint(self, name: str, key: str, value: float) -> None:
        """Set one value of a joint state [rad or m]."""
        obj = self.scene.object(name)
        self._replace(obj.model_copy(update={"joint_state": obj.joint_state | {key: value}}))
        self.patch = self.patch.merged(name, ObjectPlacement(joint_state={key: value}))

    def set_box(self, name: str, box: Box2D) -> None:
        """Set an object's box in the photograph, with which the search compares the projection."""
        self._replace(self.scene.object(name).model_copy(update={"box2d": box}))
        self.patch = self.patch.merged(name, ObjectPlacement(box2d=box))

    def snap(self) -> None:
        """Snap every object onto its support."""
        from ...compose.on_supports import snap

        self.scene = snap(self.scene)

    def _support_frame(self, name: str) -> Pose:
        obj = self.scene.object(name)
        if obj.parent is None:
            return pose()
        parent = self.scene.object(obj.parent)
        return support_frame(parent, world_poses(self.scene)[obj.parent], obj.parent_link)

    def _replace(self, obj: SceneObject) -> None:
        objects = tuple(obj if o.name == obj.name else o for o in self.scene.objects)
        self.scene = self.scene.model_copy(update={"objects": objects})


def joint_range(joint: JointSpec) -> tuple[float, float]:
    """Return the lower and upper end of a joint's slider [rad or m]."""
    if joint.type == "ball":
        limit = joint.upper or FREE_RANGE
        return -limit, limit
    if joint.type == "continuous":
        return -FREE_RANGE, FREE_RANGE
    return joint.lower, joint.upper


def settable_joints(obj: SceneObject) -> list[tuple[JointSpec, str]]:
    """Return the joints of an object that a person can set, with the keys of their values."""
    return [
        (joint, key)
        for joint in obj.spec.joints
        if joint.type != "fixed" and joint.mimic is None
        for key in joint_keys(joint)
    ]
