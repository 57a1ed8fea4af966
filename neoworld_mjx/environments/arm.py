"""A robot arm in a compiled model: its tool, and controls that move the tool or the joints.

All functions take one state without a batch axis, in NumPy or in JAX, where they can be jitted and
vmapped. They need no simulator: poses of bodies give the Jacobian.
"""

from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from ..errors import SpecError
from ..physics.array_types import AnyArray
from ..spec.pose import Pose, length, pose, quat_mul, rotate
from .robot_model import RobotSpec
from .robots import PREFIX, TOOL, Mount

Control = Literal["tool", "joints"]

MOVE_M, TURN_RAD = 0.02, 0.08
"""Change of the tool's pose in one control step by an action of 1 [m], [rad]."""
LEASH_RAD = 0.15
"""Largest distance of a joint's target from its position [rad or m]. It bounds forces of contacts
in which the arm cannot follow, and how long they last."""
DAMPING = 0.015
"""Damping of the least-squares solution; lengths are in m, angles are scaled by `ANGLE_M`."""
ANGLE_M = 0.15
"""Length that weighs like an angle of 1 rad. Arms with less than six joints thus follow positions
more closely than orientations."""
POSTURE = 0.05
"""Share of the distance to the initial posture by which redundant joints return, for an action of
length 1."""

TOWARD = 0.3
"""Share of the distance to a pose that `Arm.toward` asks for in one step."""


class SceneState(NamedTuple):
    """State of one world: all that the next step, controls, observations and tasks need.

    All engines share it, and worlds can be reset, gathered and stored like any arrays.
    """

    qpos: Float[AnyArray, " nq"]
    qvel: Float[AnyArray, " nv"]
    act: Float[AnyArray, " na"]
    qacc_warmstart: Float[AnyArray, " nv"]
    ctrl: Float[AnyArray, " nu"]
    """Controls of the step that led to the state."""
    xpos: Float[AnyArray, "nbody 3"]
    """Positions of the bodies at `qpos` [m]."""
    xquat: Float[AnyArray, "nbody 4"]


def scene_state(data: Any) -> SceneState:
    """Return the state of an `MjData` or an `mjx.Data`."""
    return SceneState(*(getattr(data, name) for name in SceneState._fields))


def copied(state: SceneState) -> SceneState:
    """Return a copy of a state, whose arrays MuJoCo overwrites in the next step."""
    return SceneState(*(np.array(values) for values in state))


def settled_act(model: mujoco.MjModel, ctrl: Any, xp: Any = np) -> Any:
    """Return the activations of actuators whose filters have settled at controls, shape [na]."""
    filters = (mujoco.mjtDyn.mjDYN_FILTER, mujoco.mjtDyn.mjDYN_FILTEREXACT)
    filtered = np.flatnonzero(np.isin(model.actuator_dyntype, filters))
    share = np.zeros((model.na, model.nu), np.float32)
    share[model.actuator_actadr[filtered], filtered] = 1.0
    return xp.asarray(share) @ ctrl


@dataclass(frozen=True)
class Arm:
    """Indices and constants of a robot in a compiled model; arrays are per joint of the arm."""

    mount: Mount
    control: Control
    joints: tuple[str, ...]
    bodies: NDArray
    axes: NDArray
    """Axes in the frames of the bodies, shape [arm, 3]."""
    anchors: NDArray
    """Anchors in the frames of the bodies [m], shape [arm, 3]."""
    slides: NDArray
    qpos: NDArray
    dof: NDArray
    actuators: NDArray
    gains: NDArray
    """Position per unit of control [rad or m]."""
    low: NDArray
    high: NDArray
    home: NDArray
    root: int
    """Index of the robot's first body."""
    root_pose: Pose
    """Pose of that body in the frame of the mount."""
    base: int
    """Index of the body that carries the first joint."""
    tool_body: int
    tool_pos: NDArray
    """Pose of the tool in its body: z points out of the palm, and the fingers close along y."""
    tool_quat: NDArray
    fingers: NDArray
    """Indices of the fingers' joints in qpos."""
    closed: NDArray
    opened: NDArray
    grip_actuators: NDArray
    grip_targets: NDArray
    """Controls of full force, fingers together, and open, shape [grip, 3]."""

    @property
    def action_bounds(self) -> tuple[NDArray, NDArray]:
        """Lower and upper bounds of actions, each of shape [action]."""
        if self.control == "tool":
            return -np.ones(7, np.float32), np.ones(7, np.float32)
        low, high = (np.append(end, one) for end, one in ((self.low, -1), (self.high, 1)))
        return low.astype(np.float32), high.astype(np.float32)

    @property
    def hold_action(self) -> NDArray:
        """Action that keeps the initial posture with an open gripper, shape [action]."""
        still = np.zeros(6) if self.control == "tool" else self.home
        return np.append(still, 1.0).astype(np.float32)

    def set_initial(self, qpos: NDArray, ctrl: NDArray) -> None:
        """Set the initial posture with an open gripper, and the controls that hold it, in place."""
        qpos[self.qpos], qpos[self.fingers] = self.home, self.opened
        ctrl[self.actuators] = self.home / self.gains
        ctrl[self.grip_actuators] = self.grip_targets[:, 2]

    def tool(self, state: SceneState, xp: Any = np) -> tuple[Any, Any]:
        """Return the tool's position [3] m and orientation [4]."""
        quat = state.xquat[self.tool_body]
        pos = state.xpos[self.tool_body] + rotate(quat, xp.asarray(self.tool_pos), xp)
        return pos, quat_mul(quat, xp.asarray(self.tool_quat), xp)

    def opening(self, state: SceneState, xp: Any = np) -> Any:
        """Return how far the fingers are open, from 0 to 1."""
        share = (state.qpos[self.fingers] - self.closed) / (self.opened - self.closed)
        return xp.mean(share)

    def jacobian(self, state: SceneState, xp: Any = np) -> Any:
        """Return the tool's Jacobian [6, arm]: translation [m], then rotation [rad], in the world.

        Motions are per unit of each joint.
        """
        quat = state.xquat[self.bodies]
        axes = rotate(quat, xp.asarray(self.axes), xp)
        anchors = state.xpos[self.bodies] + rotate(quat, xp.asarray(self.anchors), xp)
        lever = self.tool(state, xp)[0] - anchors
        slides = xp.asarray(self.slides)[:, None]
        linear = xp.where(slides, axes, xp.cross(axes, lever))
        return xp.concatenate([linear, xp.where(slides, 0.0, axes)], axis=1).T

    def controls(self, action: Any, state: SceneState, xp: Any = np) -> Any:
        """Return the targets of the arm's and the gripper's actuators, in the model's order.

        Args:
            action: within its bounds; with `control="tool"`, the change of the tool's pose:
                translation and rotation vector in the axes of the robot's base, in units of
                `MOVE_M` and `TURN_RAD`; with `control="joints"`, the targets of the joints
                [rad or m]. Then the gripper: 1 opens, 0 moves the fingers together, -1 closes
                with full force.
            state: the present state; its controls hold the targets so far.
            xp: `numpy`, or `jax.numpy` for traced arrays.
        """
        a, (full, shut, wide) = action, self.grip_targets.T
        grip = (
            shut + xp.maximum(a[-1], 0.0) * (wide - shut) + xp.minimum(a[-1], 0.0) * (shut - full)
        )
        targets = a[:-1] if self.control == "joints" else self._targets(a, state, xp)
        order = np.argsort(np.concatenate([self.actuators, self.grip_actuators]))
        return xp.concatenate([targets / self.gains, grip])[order]

    def _targets(self, a: Any, state: SceneState, xp: Any) -> Any:
        """Return the joints' targets of a change of the tool's pose [rad or m]."""
        here = state.qpos[self.qpos]
        aimed = state.ctrl[self.actuators] * self.gains
        aimed = xp.clip(aimed, here - LEASH_RAD, here + LEASH_RAD)
        base = state.xquat[self.base]
        move = rotate(base, a[:3], xp) * MOVE_M
        turn = rotate(base, a[3:6], xp) * TURN_RAD
        drift = POSTURE * xp.sqrt(xp.sum(a[:6] ** 2)) * (self.home - aimed)
        step = self._joint_step(xp.concatenate([move, turn]), drift, state, xp)
        return xp.clip(aimed + step, self.low, self.high)

    def observe(self, state: SceneState, xp: Any = np) -> dict[str, Any]:
        """Return positions and velocities of the joints, and targets relative to the positions."""
        here = state.qpos[self.qpos]
        return {
            "robot_joints": here,
            "robot_velocities": state.qvel[self.dof],
            "robot_targets": state.ctrl[self.actuators] * self.gains - here,
            "gripper": xp.concatenate([*self.tool(state, xp), self.opening(state, xp)[None]]),
        }

    def toward(
        self,
        state: SceneState,
        pos: Any,
        quat: Any,
        grip: Any,
        xp: Any = np,
        *,
        limit: float = 1.0,
    ) -> Any:
        """Return the action that moves the tool toward a pose, as scripted motions use.

        Args:
            state: the present state.
            pos: position of the tool [m].
            quat: orientation of the tool.
            grip: action of the gripper.
            xp: `numpy` or `jax.numpy`.
            limit: largest size of an entry of the action; slow motions keep hold of things.
        """
        here, now = self.tool(state, xp)
        back = np.array([1.0, -1.0, -1.0, -1.0])
        turn = quat_mul(quat, now * back, xp)
        turn = turn * xp.where(turn[0] < 0, -1.0, 1.0)
        sine = length(turn[1:], xp)
        angle = 2 * xp.arctan2(sine, turn[0]) / xp.maximum(sine, 1e-9)
        base = state.xquat[self.base] * back
        move = rotate(base, pos - here, xp) / MOVE_M
        twist = xp.concatenate([move, rotate(base, turn[1:] * angle, xp) / TURN_RAD])
        return xp.append(xp.clip(TOWARD * twist, -limit, limit), grip)

    def _joint_step(self, twist: Any, drift: Any, state: SceneState, xp: Any) -> Any:
        """Solve for the joints' motion: damped least squares, with a drift in the null space."""
        scale = np.array([1.0] * 3 + [ANGLE_M] * 3)
        jacobian = self.jacobian(state, xp) * scale[:, None]
        gram = jacobian @ jacobian.T + DAMPING**2 * np.eye(6)
        rest = twist * scale - jacobian @ drift
        return xp.clip(jacobian.T @ _solve(gram, rest, xp) + drift, -LEASH_RAD, LEASH_RAD)


def _solve(a: Any, b: Any, xp: Any) -> Any:
    """Solve a x = b for a positive definite matrix by Cholesky factors, unrolled.

    Under `jax.vmap` this compiles to one elementwise kernel, where `jnp.linalg.solve` calls a
    library for each batch.
    """
    n = len(b)
    lower: list[list[Any]] = [[None] * n for _ in range(n)]
    y: list[Any] = []
    for i in range(n):
        for j in range(i + 1):
            rest = a[i, j] - sum(lower[i][k] * lower[j][k] for k in range(j))
            lower[i][j] = xp.sqrt(rest) if i == j else rest / lower[j][j]
        y.append((b[i] - sum(lower[i][k] * y[k] for k in range(i))) / lower[i][i])
    x: list[Any] = [None] * n
    for i in reversed(range(n)):
        x[i] = (y[i] - sum(lower[k][i] * x[k] for k in range(i + 1, n))) / lower[i][i]
    return xp.stack(x)


def compiled_arm(
    model: mujoco.MjModel, robot: RobotSpec, mount: Mount, control: Control = "tool"
) -> Arm:
    """Return the arm of a robot that was attached to a compiled model.

    Raises:
        SpecError: the mount has an initial posture of another number of joints.
    """
    joints = [model.joint(f"{PREFIX}-{name}").id for name in robot.arm]
    fingers = [model.joint(f"{PREFIX}-{name}").id for name in robot.fingers]
    grip = [model.actuator(f"{PREFIX}-{name}").id for name in robot.grip]
    driven = {
        int(model.actuator_trnid[a, 0]): a
        for a in range(model.nu)
        if model.actuator_trntype[a] == mujoco.mjtTrn.mjTRN_JOINT
    }
    actuators = [driven[j] for j in joints]
    gear = model.actuator_gear[actuators, 0]
    gains = model.actuator_gainprm[actuators, 0] / -model.actuator_biasprm[actuators, 1] / gear
    limited = model.jnt_limited[joints].astype(bool)[:, None]
    low, high = np.where(limited, model.jnt_range[joints], [-2 * np.pi, 2 * np.pi]).T
    home = np.array(mount.home) if mount.home else robot.home
    if len(home) != len(joints):
        raise SpecError(f"mount: home has {len(home)} of {len(joints)} joints")
    tool = model.site(f"{PREFIX}-{TOOL}").id
    root = int(model.body_rootid[model.site_bodyid[tool]])
    root_pose = pose(model.body_pos[root], model.body_quat[root])
    return Arm(
        mount=mount,
        control=control,
        joints=tuple(f"{PREFIX}-{name}" for name in robot.arm),
        bodies=model.jnt_bodyid[joints],
        axes=model.jnt_axis[joints],
        anchors=model.jnt_pos[joints],
        slides=model.jnt_type[joints] == mujoco.mjtJoint.mjJNT_SLIDE,
        qpos=model.jnt_qposadr[joints],
        dof=model.jnt_dofadr[joints],
        actuators=np.array(actuators),
        gains=gains,
        low=low,
        high=high,
        home=np.clip(home, low, high),
        root=root,
        root_pose=pose(mount.pos, mount.quat).inverse().then(root_pose),
        base=int(model.body_parentid[model.jnt_bodyid[joints[0]]]),
        tool_body=int(model.site_bodyid[tool]),
        tool_pos=model.site_pos[tool],
        tool_quat=model.site_quat[tool],
        fingers=model.jnt_qposadr[fingers],
        closed=robot.closed,
        opened=robot.opened,
        grip_actuators=np.array(grip),
        grip_targets=robot.grip_targets,
    )
