"""Scenes with actuators: their actions, observations and initial states.

A free gripper may start in front of a handle, with one finger on each side of the handle; a robot
stands where it is mounted.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, TypedDict

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import NDArray

from ..errors import SpecError, choices
from ..export.link_frames import Frame, frames
from ..export.write_drives import Drive, drives
from ..export.write_mjcf import add_frames
from ..physics.array_types import AnyArray
from ..physics.gripper import CLOSED_M, OPENING_M, PREFIX, Gripper, attach_gripper
from ..physics.layout import Layout
from ..physics.mjcf import IMPRATIO, to_mjspec
from ..physics.model import SceneModel, compile_scene
from ..physics.model_fields import model_fields
from ..physics.posterior import pose_factor
from ..spec import SceneObject, SceneSpec, bounds, link_poses, read_scene, world_poses
from ..spec.correlation import EACH
from ..spec.pose import Pose, from_matrix, pose, quat_mul, rotate
from .arm import Arm, Control, SceneState, compiled_arm
from .robot_model import attach_robot, read_robot
from .robots import PREFIX as ROBOT
from .robots import TOOL, Mount, Robot, find_robot
from .simplified_scene import Colliders, scene_without, with_coarse_colliders

AWAY_M = 0.10
"""Initial distance of a gripper from a handle [m]."""


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


def facing_pose(scene: SceneSpec, name: str) -> Pose:
    """Return the pose of a tool at a handle that points against the handle's opening direction.

    Raises:
        SpecError: the scene has no handle with this name.
    """
    by_name = handles(scene)
    if name not in by_name:
        raise SpecError(f"scene {scene.name}: handle: {choices(name, sorted(by_name))}")
    item, frame = by_name[name]
    assert frame.joint is not None and frame.half is not None
    world = world_poses(scene)[item.name].then(link_poses(item.spec, item.joint_state)[frame.part])
    point = world.apply(frame.pos)
    joint = item.spec.joint(frame.joint)
    opens = np.array(joint.axis)
    if joint.type != "prismatic":
        opens = np.cross(opens, np.array(frame.pos) - np.array(joint.pos))
        if np.linalg.norm(opens) < 1e-6:
            opens = np.array(joint.axis)
    opens = opens / np.linalg.norm(opens)
    middle = np.mean(bounds(item.spec), axis=0)
    if joint.type == "prismatic" and opens @ (np.array(frame.pos) - middle) < 0:
        opens = -opens  # A button moves inward, and is pressed from outside.
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


FREE_TARGET = np.pi
"""Largest absolute target position of a joint without limits [rad]."""
REACH_M = 1.0
"""Largest displacement of the gripper's target from its initial position along each axis [m]."""


@dataclass(frozen=True)
class ResetNoise:
    """Standard deviations of the noise that every reset adds to the scene."""

    xy: float = 0.0
    """Standard deviation of the x and y position of each movable object [m]."""
    yaw: float = 0.0
    """Standard deviation of the yaw of each movable object [rad]."""
    joints: float = 0.0
    """Standard deviation of each joint position, as a fraction of the joint's range (of a full turn
    for a joint without limits)."""
    photo: float = 0.0
    """Factor of additional noise of the position and yaw of each aligned object, fixed objects
    included. At 1, the noise has the standard deviations and correlations that the photograph
    leaves, as the draws of `neoworld_mjx.sample`. A round object is not turned, because every
    heading looks the same. Sizes do not vary."""
    camera: float = 0.0
    """Factor of the noise of the camera in pictures, at 1 as the photograph leaves it. It is drawn
    together with `photo`, so both at 1 have the correlations of the estimate."""


class InitialState(NamedTuple):
    """Initial state of an episode."""

    qpos: Float[AnyArray, " nq"]
    body_pos: Float[AnyArray, "nbody 3"]
    """Position of each body in its parent body [m]; noise moves the roots of fixed objects."""
    body_quat: Float[AnyArray, "nbody 4"]
    camera: Float[AnyArray, " 4"]
    """Change of the camera of pictures; see `posterior.Draws.camera`."""


@dataclass(frozen=True)
class ControlledScene:
    """Scene whose joints have drives, to which a gripper or a robot is added, or both."""

    scene: SceneModel
    model: mujoco.MjModel
    initial_qpos: NDArray
    """Initial qpos of the model, without reset noise, shape [nq]."""
    drives: tuple[Drive, ...]
    """Drives, in the order of their targets in an action; those of the gripper or robot follow."""
    gripper: Gripper | None
    arm: Arm | None = None
    collider_errors: dict[str, float] = field(default_factory=dict)
    """About how far coarse colliders exceed the exact ones [m], by object."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the objects, in the order of the observed poses."""
        return self.scene.names

    @cached_property
    def bodies(self) -> NDArray:
        """Indices of the objects' root bodies, shape [object]."""
        return np.array([self.model.body(name).id for name in self.names])

    @cached_property
    def joints(self) -> tuple[str, ...]:
        """Names of the observed joints: all hinges and slides of the scene."""
        kinds = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
        joints = [self.model.joint(j) for j in range(self.model.njnt)]
        return tuple(
            joint.name
            for joint in joints
            if int(joint.type[0]) in kinds
            and not joint.name.startswith((f"{PREFIX}-", f"{ROBOT}-"))
        )

    @cached_property
    def qpos_of_joints(self) -> NDArray:
        """Indices of the observed joints in qpos, shape [joint]."""
        return np.array([self.model.joint(n).qposadr[0] for n in self.joints], int)

    @cached_property
    def dof_of_joints(self) -> NDArray:
        """Indices of the observed joints in qvel, shape [joint]."""
        return np.array([self.model.joint(n).dofadr[0] for n in self.joints], int)

    @cached_property
    def pose_factor(self) -> Float[np.ndarray, "value normal"]:
        """Factor of the covariance that the photograph leaves; see `physics.posterior`."""
        return pose_factor(self.scene.spec).astype(np.float32)

    @cached_property
    def fixed(self) -> NDArray:
        """Indices of the objects that have a fixed base but are no environment supports."""
        movable, optimised = (np.asarray(x) for x in (self.scene.movable, self.scene.optimised))
        return np.flatnonzero(optimised & ~movable)

    @cached_property
    def action_bounds(self) -> tuple[NDArray, NDArray]:
        """Lower and upper bounds of actions, each of shape [action]."""
        ranges = [drive.range or (-FREE_TARGET, FREE_TARGET) for drive in self.drives]
        if self.gripper is not None:
            ranges += [(-REACH_M, REACH_M)] * 3 + [(-np.pi, np.pi)] * 3 + [(0.0, OPENING_M)]
        low, high = np.array(ranges, np.float32).reshape(-1, 2).T
        if self.arm is not None:
            bounds = self.arm.action_bounds
            low, high = (np.append(a, b) for a, b in zip((low, high), bounds, strict=True))
        return low, high

    @cached_property
    def hold_action(self) -> NDArray:
        """Action whose targets are the initial state without reset noise, shape [action]."""
        tail = [] if self.gripper is None else [0.0] * 6 + [self.gripper.opening]
        own = np.array([drive.target for drive in self.drives] + tail, np.float32)
        return own if self.arm is None else np.append(own, self.arm.hold_action)

    @cached_property
    def initial_ctrl(self) -> NDArray:
        """Controls that hold the initial state without reset noise, shape [nu]."""
        ctrl = np.zeros(self.model.nu)
        ctrl[: len(self.drives)] = [drive.target for drive in self.drives]
        if self.arm is not None:
            self.arm.initial_controls(ctrl)
        elif self.gripper is not None:
            ctrl[-2:] = self.gripper.opening / 2
        return ctrl

    def controls(self, action: Any, state: SceneState, xp: Any = np) -> Any:
        """Clip an action to its bounds and convert it to actuator targets, shape [nu].

        Args:
            action: targets of the drives, then the seven targets of the gripper, or the action of
                the robot (`Arm.controls`), shape [action].
            state: the present state, without a batch axis.
            xp: `numpy`, or `jax.numpy` for traced arrays.
        """
        low, high = self.action_bounds
        a = xp.clip(action, low, high)
        if self.arm is not None:
            count = len(self.drives)
            joints, grip = self.arm.controls(a[count:], state, xp)
            order = np.concatenate([self.arm.actuators, self.arm.grip_actuators])
            return xp.concatenate([a[:count], xp.concatenate([joints, grip])[np.argsort(order)]])
        if self.gripper is None:
            return a
        half = xp.where(a[-1] > 0, a[-1] / 2, CLOSED_M)
        return xp.concatenate([a[:-1], half[None], half[None]])

    @property
    def robot_root(self) -> int:
        """Index of the robot's first body."""
        return int(self.model.body_rootid[self.model.site(f"{ROBOT}-{TOOL}").bodyid[0]])

    @cached_property
    def initial_root(self) -> Pose:
        """Pose of that body as it was mounted."""
        at = self.model.body(self.robot_root)
        return pose(at.pos.copy(), at.quat.copy())

    def tool(self, state: SceneState, xp: Any = np) -> tuple[Any, Any]:
        """Return the position [3] m and orientation [4] of the tool of the gripper or robot.

        Its z axis points out of the palm, and its fingers close along y.
        """
        if self.arm is not None:
            return self.arm.tool(state, xp)
        if self.gripper is None:
            raise SpecError(f"scene {self.scene.spec.name} has no gripper and no robot")
        hand = self.model.body(f"{PREFIX}-hand").id
        return state.xpos[hand], state.xquat[hand]

    @cached_property
    def sites(self) -> tuple[str, ...]:
        """Names of the handles and sites of the scene and the robot."""
        return tuple(self.model.site(k).name for k in range(self.model.nsite))

    def site(self, state: SceneState, name: str, xp: Any = np) -> tuple[Any, Any]:
        """Return the position [3] m and orientation [4] of a handle or site.

        Args:
            state: the state.
            name: one of `sites`, such as cabinet-drawer_handle.
            xp: `numpy`, or `jax.numpy` for traced arrays.

        Raises:
            SpecError: there is no site with this name.
        """
        if name not in self.sites:
            where = f"scene {self.scene.spec.name}: site"
            raise SpecError(f"{where}: {choices(name, sorted(self.sites))}")
        site = self.model.site(name)
        body = int(self.model.site_bodyid[site.id])
        quat = state.xquat[body]
        pos = state.xpos[body] + rotate(quat, xp.asarray(site.pos), xp)
        return pos, quat_mul(quat, xp.asarray(site.quat), xp)

    def opening(self, state: SceneState, xp: Any = np) -> Any:
        """Return how far the fingers of the gripper or robot are open, from 0 to 1."""
        if self.arm is not None:
            return self.arm.opening(state, xp)
        return xp.sum(state.qpos[self.qpos_of_fingers]) / OPENING_M

    def observe(self, state: SceneState, xp: Any = np) -> dict[str, Any]:
        """Return the observations of a state, in float32.

        - poses [object, 7]: position [m] and quaternion (w, x, y, z) of each object's root body;
        - joints, joint_velocities [joint]: positions [rad or m] and velocities [rad/s or m/s];
        - gripper [8], with a gripper or a robot: pose of the tool, and the distance between the
          pads [m], of a robot the share from 0 to 1 to which its fingers are open;
        - robot_joints, robot_velocities, robot_targets [arm], with a robot: positions, velocities,
          and the targets relative to the positions [rad or m].
        """
        result = {
            "poses": xp.concatenate([state.xpos[self.bodies], state.xquat[self.bodies]], axis=1),
            "joints": state.qpos[self.qpos_of_joints],
            "joint_velocities": state.qvel[self.dof_of_joints],
        }
        arm = self.arm
        if arm is not None:
            here = state.qpos[arm.qpos]
            result["robot_joints"], result["robot_velocities"] = here, state.qvel[arm.dof]
            result["robot_targets"] = state.ctrl[arm.actuators] * arm.gains - here
            tool = [*self.tool(state, xp), arm.opening(state, xp)[None]]
            result["gripper"] = xp.concatenate(tool)
        elif self.gripper is not None:
            wide = xp.sum(state.qpos[self.qpos_of_fingers])
            result["gripper"] = xp.concatenate([*self.tool(state, xp), wide[None]])
        return {name: value.astype(np.float32) for name, value in result.items()}

    @cached_property
    def qpos_of_fingers(self) -> NDArray:
        """Indices of the gripper's fingers in qpos, shape [2]."""
        sides = ("left", "right")
        return np.array([self.model.joint(f"{PREFIX}-{side}").qposadr[0] for side in sides])

    def reset_state(self, key: Array, noise: ResetNoise) -> InitialState:
        """Sample the initial state of an episode. JAX can trace this method.

        Each object moves in the frame of its parent, together with the objects on it, and is
        placed at the height of its support. Joint positions are clipped to the joints' ranges.
        """
        qpos = jnp.asarray(self.initial_qpos, jnp.float32)
        pos, quat = (jnp.asarray(x) for x in (self.model.body_pos, self.model.body_quat))
        keys = jax.random.split(key, 4)
        count, scene = len(self.names), self.scene
        camera = jnp.zeros(EACH)
        if noise.xy or noise.yaw or noise.photo or noise.camera:
            own = noise.xy * jax.random.normal(keys[0], (1, count, 2)) * scene.movable[:, None]
            turn = noise.yaw * jax.random.normal(keys[1], (1, count)) * scene.movable
            factor = self.pose_factor
            values = factor @ jax.random.normal(keys[3], (factor.shape[1],))
            camera = noise.camera * values[:EACH]
            drawn = noise.photo * values[EACH:].reshape(1, count, EACH)
            drawn = drawn * scene.optimised[:, None]
            layout = Layout(own + drawn[..., :2], turn + drawn[..., 2], jnp.zeros((1, count)))
            placed = scene.place(layout)
            scene_qpos = model_fields(scene, placed)["qpos"][0]
            qpos = qpos.at[: scene_qpos.shape[0]].set(scene_qpos)
            roots = self.bodies[self.fixed]
            pos = pos.at[roots].set(placed.pos[0, self.fixed])
            quat = quat.at[roots].set(placed.quat[0, self.fixed])
        if noise.joints and len(self.joints):
            joints = [self.model.joint(name) for name in self.joints]
            limited = np.array([bool(self.model.jnt_limited[j.id]) for j in joints])
            low, high = np.array([self.model.jnt_range[j.id] for j in joints]).T
            width = np.where(limited, high - low, 2 * np.pi)
            draw = noise.joints * width * jax.random.normal(keys[2], (len(joints),))
            sampled = qpos[self.qpos_of_joints] + draw
            clipped = jnp.where(limited, jnp.clip(sampled, low, high), sampled)
            qpos = qpos.at[self.qpos_of_joints].set(clipped)
        return InitialState(qpos, pos, quat, camera)


class SceneOptions(TypedDict, total=False):
    """Arguments that environments pass on to `controlled_scene`."""

    gripper: Gripper | str | None
    robot: Robot | Path | str | None
    mount: Mount | None
    control: Control
    drive_joints: bool | None
    colliders: Colliders


def controlled_scene(
    run: Path | str | SceneSpec,
    *,
    gripper: Gripper | str | None = None,
    robot: Robot | Path | str | None = None,
    mount: Mount | None = None,
    control: Control = "tool",
    drive_joints: bool | None = None,
    without: Sequence[str] = (),
    colliders: Colliders = "exact",
    mjx: bool = False,
    links: bool = True,
    visual: bool = False,
) -> ControlledScene:
    """Compile a scene with actuators.

    Args:
        run: a run folder, a scene.json or a scene.
        gripper: initial pose of a free-flying gripper, or the name <object>-<frame> of the handle
            that the gripper faces. If None, no gripper is added.
        robot: name (panda, so101, ur5e) or MJCF file of an arm with a gripper.
        mount: pose of the robot's base.
        control: what an action of the robot moves; see `Arm.controls`.
        drive_joints: if True, add position actuators to the joints. If None, add them only if there
            is no gripper or robot, because position actuators resist a pull.
        without: objects that are left out.
        colliders: exact, or coarse; see `with_coarse_colliders`.
        mjx: if True, compile a model that `mjx_step` can simulate.
        links: if False, only the hand and the fingers of the robot collide.
        visual: if True, add geoms that do not collide, for pictures.

    Raises:
        SpecError: there is no scene, the handle or the robot does not exist, there is nothing to
            actuate, or an object has the name of the gripper or robot.
    """
    spec = scene_without(run if isinstance(run, SceneSpec) else read_scene(Path(run)), without)
    hand = facing(spec, gripper) if isinstance(gripper, str) else gripper
    errors: dict[str, float] = {}
    if colliders == "coarse":
        spec, errors = with_coarse_colliders(spec)
    elif colliders != "exact":
        raise SpecError(f"colliders: {choices(colliders, ['exact', 'coarse'])}")
    timestep = 0.004 if mjx else 0.002
    compiled = compile_scene(spec, timestep=timestep)
    for item in spec.objects:
        if item.name in (PREFIX, ROBOT):
            raise SpecError(
                f"scene {spec.name}: an object has the name {item.name}, which the gripper needs"
            )
    if robot is not None and gripper is not None:
        raise SpecError("give a gripper or a robot, not both")
    model = to_mjspec(spec, visual=visual, timestep=timestep)
    for key in list(model.keys):
        model.delete(key)
    for item in spec.objects:
        add_frames(model, item.name, item.spec)
    if not mjx:
        model.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        model.option.impratio = IMPRATIO
    driven = drive_joints if drive_joints is not None else hand is None and robot is None
    scene_drives = drives(spec) if driven else ()
    for drive in scene_drives:
        _add_actuator(model, drive)
    if hand is not None:
        attach_gripper(model, hand, mjx=mjx)
    parts = None
    if robot is not None:
        if mount is None:
            raise SpecError("a robot needs a mount, such as nw.Mount((x, y, z), yaw)")
        parts = read_robot(find_robot(robot), visual=visual, links=links, mjx=mjx)
        attach_robot(model, parts, mount)
    if not scene_drives and hand is None and parts is None:
        raise SpecError(f"scene {spec.name} has no joints to drive: add a gripper or a robot")
    mjm = model.compile()
    qpos = np.array(mjm.qpos0, float)
    scene_start = np.asarray(compiled.static.start, float)
    qpos[: len(scene_start)] = scene_start
    if hand is not None:
        for side in ("left", "right"):
            qpos[mjm.joint(f"{PREFIX}-{side}").qposadr[0]] = hand.opening / 2
    arm = None
    if parts is not None and mount is not None:
        arm = compiled_arm(mjm, parts, mount, control)
        if mount.home:
            arm = replace(arm, home=arm.checked_home(mount.home))
        qpos[arm.qpos], qpos[arm.fingers] = arm.home, arm.opened
    return ControlledScene(compiled, mjm, qpos, scene_drives, hand, arm, errors)


def _add_actuator(model: mujoco.MjSpec, drive: Drive) -> None:
    actuator = model.add_actuator(
        name=drive.name,
        trntype=mujoco.mjtTrn.mjTRN_JOINT,
        target=drive.joint,
        gear=[float(drive.axis == axis) for axis in "xyz"] + [0.0] * 3
        if drive.axis
        else [1.0] + [0.0] * 5,
    )
    actuator.set_to_position(kp=drive.stiffness, kv=drive.damping)
    if drive.effort is not None:
        actuator.forcelimited = 1
        actuator.forcerange = [-drive.effort, drive.effort]
