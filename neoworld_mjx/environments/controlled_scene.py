"""Scenes with actuators: their actions, observations and initial states."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, TypedDict, get_args

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..errors import SpecError, choices
from ..export.drives import Drive, drives
from ..export.write_mjcf import add_frames
from ..physics.gripper import PREFIX, Gripper, attach_gripper
from ..physics.mjcf import to_mjspec
from ..physics.model import SceneModel, compile_scene
from ..spec import SceneSpec, read_scene, world_bounds, world_poses
from ..spec.pose import quat_mul, rotate
from .arm import Arm, Control, SceneState, compiled_arm, settled_act
from .flying_gripper import FlyingGripper, facing
from .robot_model import attach_robot, read_robot
from .robots import PREFIX as ROBOT
from .robots import Mount, Robot, find_robot
from .simplified_scene import Colliders, scene_without, with_coarse_colliders

FREE_TARGET = np.pi
"""Largest absolute target position of a joint without limits [rad]."""


@dataclass(frozen=True)
class ControlledScene:
    """Scene with actuators: drives of its joints, and a flying gripper or a robot."""

    scene: SceneModel
    model: mujoco.MjModel
    initial_qpos: NDArray
    """Initial qpos of the model, without reset noise, shape [nq]."""
    initial_ctrl: NDArray
    """Controls that hold the initial state without reset noise, shape [nu]."""
    drives: tuple[Drive, ...]
    """Drives, in the order of their targets in an action; those of the gripper or robot follow."""
    effector: FlyingGripper | Arm | None
    collider_errors: dict[str, float] = field(default_factory=dict)
    """About how far coarse colliders exceed the exact ones [m], by object."""

    @property
    def gripper(self) -> Gripper | None:
        """Initial state of the flying gripper, if there is one."""
        return self.effector.start if isinstance(self.effector, FlyingGripper) else None

    @property
    def arm(self) -> Arm | None:
        """The robot, if there is one."""
        return self.effector if isinstance(self.effector, Arm) else None

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
    def action_bounds(self) -> tuple[NDArray, NDArray]:
        """Lower and upper bounds of actions, each of shape [action]."""
        ranges = [drive.range or (-FREE_TARGET, FREE_TARGET) for drive in self.drives]
        low, high = np.array(ranges, np.float32).reshape(-1, 2).T
        if self.effector is not None:
            bounds = self.effector.action_bounds
            low, high = (np.append(a, b) for a, b in zip((low, high), bounds, strict=True))
        return low, high

    @cached_property
    def hold_action(self) -> NDArray:
        """Action whose targets are the initial state without reset noise, shape [action]."""
        own = np.array([drive.target for drive in self.drives], np.float32)
        return own if self.effector is None else np.append(own, self.effector.hold_action)

    def initial_data(self) -> mujoco.MjData:
        """Return the initial state without reset noise, after `mj_forward`."""
        data = mujoco.MjData(self.model)
        data.qpos[:], data.ctrl[:] = self.initial_qpos, self.initial_ctrl
        data.act[:] = settled_act(self.model, data.ctrl)
        mujoco.mj_forward(self.model, data)
        return data

    def controls(self, action: Any, state: SceneState, xp: Any = np) -> Any:
        """Clip an action to its bounds and convert it to actuator targets, shape [nu].

        Args:
            action: targets of the drives, then the action of the gripper or robot, shape [action].
            state: the present state, without a batch axis.
            xp: `numpy`, or `jax.numpy` for traced arrays.
        """
        low, high = self.action_bounds
        a = xp.clip(action, low, high)
        if self.effector is None:
            return a
        n = len(self.drives)
        return xp.concatenate([a[:n], self.effector.controls(a[n:], state, xp)])

    def tool(self, state: SceneState, xp: Any = np) -> tuple[Any, Any]:
        """Return the position [3] m and orientation [4] of the tool of the gripper or robot.

        Its z axis points out of the palm, and its fingers close along y.
        """
        return self._hand.tool(state, xp)

    def opening(self, state: SceneState, xp: Any = np) -> Any:
        """Return how far the fingers of the gripper or robot are open, from 0 to 1."""
        return self._hand.opening(state, xp)

    @property
    def _hand(self) -> FlyingGripper | Arm:
        if self.effector is None:
            raise SpecError(f"scene {self.scene.spec.name} has no gripper and no robot")
        return self.effector

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
        if self.effector is not None:
            result |= self.effector.observe(state, xp)
        return {name: value.astype(np.float32) for name, value in result.items()}


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
    for name, value, valid in (("colliders", colliders, Colliders), ("control", control, Control)):
        if value not in get_args(valid):
            raise SpecError(f"{name}: {choices(value, get_args(valid))}")
    compiled = compile_scene(spec, timestep=0.002)
    for item in spec.objects:
        if item.name in (PREFIX, ROBOT):
            raise SpecError(
                f"scene {spec.name}: an object has the name {item.name}, which the gripper needs"
            )
    if robot is not None and gripper is not None:
        raise SpecError("give a gripper or a robot, not both")
    model = to_mjspec(spec, visual=visual, timestep=0.004 if mjx else 0.002)
    for key in list(model.keys):
        model.delete(key)
    for item in spec.objects:
        add_frames(model, item.name, item.spec)
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
        attach_robot(model, parts, mount, _surface_below(spec, mount) if visual else None)
    if not scene_drives and hand is None and parts is None:
        raise SpecError(f"scene {spec.name} has no joints to drive: add a gripper or a robot")
    mjm = model.compile()
    qpos, ctrl = np.array(mjm.qpos0, float), np.zeros(mjm.nu)
    scene_start = np.asarray(compiled.static.start, float)
    qpos[: len(scene_start)] = scene_start
    ctrl[: len(scene_drives)] = [drive.target for drive in scene_drives]
    effector: FlyingGripper | Arm | None = None
    if hand is not None:
        effector = FlyingGripper.of(mjm, hand)
    elif parts is not None and mount is not None:
        effector = compiled_arm(mjm, parts, mount, control)
    if effector is not None:
        effector.set_initial(qpos, ctrl)
    return ControlledScene(compiled, mjm, qpos, ctrl, scene_drives, effector, errors)


def _surface_below(scene: SceneSpec, mount: Mount) -> float | None:
    """Return the top of the environment below a base [m]; None if there is nothing."""
    poses, tops = world_poses(scene), []
    for item in (item for item in scene.objects if item.environment):
        low, high = world_bounds(item, poses[item.name])
        if np.all((low[:2] < mount.pos[:2]) & (mount.pos[:2] < high[:2])):
            tops += [float(high[2])] if high[2] < mount.pos[2] + 0.005 else []
    return max(tops, default=None)


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
