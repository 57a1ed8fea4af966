"""A parallel gripper that flies freely: its actions and observations, and its start at a handle.

It has the methods of `arm.Arm`, in NumPy or in JAX.
"""

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..errors import SpecError, choices
from ..export.link_frames import Frame, frames, handle_at
from ..physics.gripper import CLOSED_M, OPENING_M, PREFIX, Gripper
from ..spec import SceneObject, SceneSpec, Vec3, bounds, link_poses, world_poses
from ..spec.pose import Pose, from_matrix, rotate
from .arm import SceneState

REACH_M = 1.0
"""Largest displacement of the gripper's target from its initial position along each axis [m]."""
AWAY_M = 0.10
"""Initial distance of a gripper from a handle [m]."""


@dataclass(frozen=True)
class FlyingGripper:
    """Indices and constants of a free-flying gripper in a compiled model."""

    start: Gripper
    hand: int
    """Index of the body whose frame is that of the tool."""
    fingers: NDArray
    """Indices of the fingers' joints in qpos."""
    actuators: NDArray
    """Indices of the actuators of position, rotation vector and fingers, shape [8]."""

    @classmethod
    def of(cls, model: mujoco.MjModel, start: Gripper) -> "FlyingGripper":
        """Return the gripper that was attached to a compiled model."""
        fingers = [model.joint(f"{PREFIX}-{side}").qposadr[0] for side in ("left", "right")]
        hand = model.body(f"{PREFIX}-hand").id
        return cls(start, hand, np.array(fingers), np.arange(model.nu - 8, model.nu))

    @property
    def action_bounds(self) -> tuple[NDArray, NDArray]:
        """Lower and upper bounds of actions, each of shape [7]."""
        high = np.array([REACH_M] * 3 + [np.pi] * 3 + [OPENING_M], np.float32)
        return np.append(-high[:6], np.float32(0.0)), high

    @property
    def hold_action(self) -> NDArray:
        """Action that keeps the initial pose and opening, shape [7]."""
        return np.array([0.0] * 6 + [self.start.opening], np.float32)

    def set_initial(self, qpos: NDArray, ctrl: NDArray) -> None:
        """Set the initial opening, and the controls that hold it, in place."""
        qpos[self.fingers] = ctrl[self.actuators[6:]] = self.start.opening / 2

    def controls(self, action: Any, state: SceneState, xp: Any = np) -> Any:
        """Return the targets of the actuators.

        Args:
            action: within its bounds: translation from the initial position in world axes [m],
                rotation vector from the initial orientation in tool axes [rad], and the distance
                between the pads [m], where 0 closes the gripper with full force.
            state: the present state, on which these targets do not depend.
            xp: `numpy`, or `jax.numpy` for traced arrays.
        """
        half = xp.where(action[-1] > 0, action[-1] / 2, CLOSED_M)
        return xp.concatenate([action[:-1], half[None], half[None]])

    def tool(self, state: SceneState, xp: Any = np) -> tuple[Any, Any]:
        """Return the tool's position [3] m and orientation [4]."""
        return state.xpos[self.hand], state.xquat[self.hand]

    def opening(self, state: SceneState, xp: Any = np) -> Any:
        """Return how far the fingers are open, from 0 to 1."""
        return xp.sum(state.qpos[self.fingers]) / OPENING_M

    def observe(self, state: SceneState, xp: Any = np) -> dict[str, Any]:
        """Return the pose of the tool and the distance between the pads [m]."""
        wide = xp.sum(state.qpos[self.fingers])
        return {"gripper": xp.concatenate([*self.tool(state, xp), wide[None]])}


def handles(scene: SceneSpec) -> dict[str, tuple[SceneObject, Frame]]:
    """Return the object and the frame of each handle of a scene, by name <object>-<frame>."""
    return {
        f"{item.name}-{frame.name}": (item, frame)
        for item in scene.objects
        for frame in frames(item.spec)
        if frame.joint is not None
    }


def facing(scene: SceneSpec, name: str) -> Gripper:
    """Return a gripper in front of a handle that points against the handle's opening direction.

    Raises:
        SpecError: the scene has no handle with this name.
    """
    at = facing_pose(scene, name)
    x, y, z = (float(v) for v in at.apply((0.0, 0.0, -AWAY_M)))
    w, i, j, k = (float(v) for v in at.quat)
    return Gripper((x, y, z), (w, i, j, k), OPENING_M)


def facing_pose(
    scene: SceneSpec, name: str, at: Vec3 | None = None, *, from_side: bool = False
) -> Pose:
    """Return the pose of a tool at a handle that points against the handle's opening direction.

    Args:
        scene: the scene.
        name: name of the handle, such as cabinet-drawer_handle.
        at: another point of the handle's part, which the tool holds instead [m], in the object's
            frame with all joints at zero.
        from_side: if True, the tool comes from the side of the object's box that is nearest to the
            handle instead: the lid of a chest opens upward, and is gripped from the front.

    Raises:
        SpecError: the scene has no handle with this name.
    """
    by_name = handles(scene)
    if name not in by_name:
        raise SpecError(f"scene {scene.name}: handle: {choices(name, sorted(by_name))}")
    item, frame = by_name[name]
    frame = frame if at is None else handle_at(item.spec, frame, at)
    assert frame.joint is not None and frame.half is not None
    world = world_poses(scene)[item.name].then(link_poses(item.spec, item.joint_state)[frame.part])
    point = world.apply(frame.pos)
    joint = item.spec.joint(frame.joint)
    opens, box = np.array(joint.axis), np.array(bounds(item.spec))
    if joint.type != "prismatic":
        opens = np.cross(opens, np.array(frame.pos) - np.array(joint.pos))
        if np.linalg.norm(opens) < 1e-6:
            opens = np.array(joint.axis)
    opens = opens / np.linalg.norm(opens)
    if joint.type == "prismatic" and opens @ (np.array(frame.pos) - box.mean(axis=0)) < 0:
        opens = -opens  # A button moves inward, and is pressed from outside.
    if from_side:
        side, axis = np.unravel_index(np.abs(box - frame.pos).argmin(), box.shape)
        opens = (2.0 * side - 1.0) * np.eye(3)[axis]
    across = _across(opens, np.array(frame.half))
    local_axes = np.column_stack([np.cross(across, -opens), across, -opens])
    axes = np.column_stack([rotate(world.quat, column) for column in local_axes.T])
    return Pose(point, from_matrix(axes))


def _across(opens: NDArray, half: NDArray) -> NDArray:
    """Return the unit vector normal to the opening direction along which a handle is thinnest."""
    best, thinnest = np.zeros(3), np.inf
    for k in range(3):
        axis = np.eye(3)[k] - opens[k] * opens
        length = np.linalg.norm(axis)
        if length > 0.5 and half[k] < thinnest:
            best, thinnest = axis / length, half[k]
    return best
