"""A scene with actuators: what actions mean, what is observed, and where episodes start."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import NDArray

from ..errors import SpecError
from ..export.write_drives import Drive, drives
from ..physics.gripper import CLOSED_M, OPENING_M, PREFIX, Gripper, attach_gripper
from ..physics.layout import Layout
from ..physics.mjcf import to_mjspec
from ..physics.model import SceneModel, compile_scene
from ..physics.model_fields import model_fields
from ..spec import SceneSpec, read_scene
from .facing import facing

FREE_TARGET = np.pi
"""Targets of joints without limits go as far as this, both ways [rad]."""
REACH_M = 1.0
"""How far from its start a gripper's target may be, along each axis [m]."""


@dataclass(frozen=True)
class ResetNoise:
    """Standard deviations of what every reset adds to the scene."""

    xy: float = 0.0
    """Of every movable object's position [m]."""
    yaw: float = 0.0
    """Of its heading [rad]."""
    joints: float = 0.0
    """Of every joint, over its range, or over a turn without one."""


@dataclass(frozen=True)
class ControlledScene:
    """A scene with drives of its joints, or a gripper, or both."""

    scene: SceneModel
    model: mujoco.MjModel
    start: NDArray
    """qpos of the scene as it was composed, [nq]."""
    drives: tuple[Drive, ...]
    """Drives in the order of actions; the gripper's seven numbers come after them."""
    gripper: Gripper | None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the objects, in the order in which their poses are observed."""
        return self.scene.names

    @cached_property
    def bodies(self) -> NDArray:
        """Root bodies of the objects, [object]."""
        return np.array([self.model.body(name).id for name in self.names])

    @cached_property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints that are observed: all of the scene's but balls."""
        kinds = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
        every = [self.model.joint(j) for j in range(self.model.njnt)]
        own = [j for j in every if not j.name.startswith(f"{PREFIX}-")]
        return tuple(j.name for j in own if int(j.type[0]) in kinds)

    @cached_property
    def qpos_of_joints(self) -> NDArray:
        """Where the observed joints are in qpos, [joint]."""
        return np.array([self.model.joint(n).qposadr[0] for n in self.joints], int)

    @cached_property
    def dof_of_joints(self) -> NDArray:
        """Where the observed joints are in qvel, [joint]."""
        return np.array([self.model.joint(n).dofadr[0] for n in self.joints], int)

    @cached_property
    def action_bounds(self) -> tuple[NDArray, NDArray]:
        """Least and largest actions, [action]."""
        ranges = [drive.range or (-FREE_TARGET, FREE_TARGET) for drive in self.drives]
        if self.gripper is not None:
            ranges += [(-REACH_M, REACH_M)] * 3 + [(-np.pi, np.pi)] * 3 + [(0.0, OPENING_M)]
        low, high = np.array(ranges, np.float32).reshape(-1, 2).T
        return low, high

    @cached_property
    def hold(self) -> NDArray:
        """The action that keeps everything where an episode without noise starts, [action]."""
        tail = [] if self.gripper is None else [0.0] * 6 + [self.gripper.opening]
        return np.array([drive.held for drive in self.drives] + tail, np.float32)

    def controls(self, action: Any, xp: Any = np) -> Any:
        """Turn an action [action], held within its bounds, into targets of the actuators [nu].

        Args:
            action: targets of the drives, then the gripper's seven numbers.
            xp: `numpy`, or `jax.numpy` for traced arrays.
        """
        low, high = self.action_bounds
        a = xp.clip(action, low, high)
        if self.gripper is None:
            return a
        half = xp.where(a[-1] > 0, a[-1] / 2, CLOSED_M)
        return xp.concatenate([a[:-1], half[None], half[None]])

    def reset_state(self, key: Array, noise: ResetNoise) -> Float[Array, " nq"]:
        """Draw the qpos of an episode's start. Traceable.

        Objects move in their parents' frames, with what is on them, and are snapped to heights
        as candidates of the search are; joints keep their ranges.
        """
        start = jnp.asarray(self.start, jnp.float32)
        keys = jax.random.split(key, 3)
        count = len(self.names)
        free = self.scene.optimised
        if noise.xy or noise.yaw:
            layout = Layout(
                noise.xy * jax.random.normal(keys[0], (1, count, 2)) * free[:, None],
                noise.yaw * jax.random.normal(keys[1], (1, count)) * free,
                jnp.zeros((1, count)),
            )
            placed = model_fields(self.scene, self.scene.place(layout))["qpos"][0]
            start = start.at[: placed.shape[0]].set(placed)
        if noise.joints and len(self.joints):
            joints = [self.model.joint(name) for name in self.joints]
            limited = np.array([bool(self.model.jnt_limited[j.id]) for j in joints])
            low, high = np.array([self.model.jnt_range[j.id] for j in joints]).T
            width = np.where(limited, high - low, 2 * np.pi)
            draw = noise.joints * width * jax.random.normal(keys[2], (len(joints),))
            moved = start[self.qpos_of_joints] + draw
            kept = jnp.where(limited, jnp.clip(moved, low, high), moved)
            start = start.at[self.qpos_of_joints].set(kept)
        return start


def controlled_scene(
    run: Path | str | SceneSpec,
    *,
    gripper: Gripper | str | None = None,
    drive_joints: bool | None = None,
    mjx: bool = False,
) -> ControlledScene:
    """Compile a scene with actuators.

    Args:
        run: a run folder, a scene.json or a scene.
        gripper: where a free gripper starts; the name of a handle, <object>-<frame>, puts it in
            front of that; None is none.
        drive_joints: whether joints have position actuators; by default where there is no gripper,
            as a drawer that is held cannot be pulled.
        mjx: whether it is for `mjx_step`.

    Raises:
        SpecError: there is no scene, no such handle, nothing to act on, or an object has the
            gripper's name.
    """
    spec = run if isinstance(run, SceneSpec) else read_scene(Path(run))
    compiled = compile_scene(spec, timestep=0.004 if mjx else 0.002)
    if any(item.name == PREFIX for item in spec.objects):
        raise SpecError(f"scene {spec.name}: {PREFIX} is the gripper's name, not an object's")
    model = to_mjspec(spec, timestep=0.004 if mjx else 0.002)
    for key in list(model.keys):
        model.delete(key)
    if not mjx:
        model.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        model.option.impratio = 10.0
    held = facing(spec, gripper) if isinstance(gripper, str) else gripper
    wanted = drive_joints if drive_joints is not None else held is None
    every = drives(spec) if wanted else ()
    for drive in every:
        _add(model, drive)
    if held is not None:
        attach_gripper(model, held, mjx=mjx)
    if not every and held is None:
        raise SpecError(f"scene {spec.name} has no joints to drive: give it a gripper")
    mjm = model.compile()
    start = np.array(mjm.qpos0, float)
    own = np.asarray(compiled.static.start, float)
    start[: len(own)] = own
    if held is not None:
        for side in ("left", "right"):
            start[mjm.joint(f"{PREFIX}-{side}").qposadr[0]] = held.opening / 2
    return ControlledScene(compiled, mjm, start, every, held)


def _add(model: mujoco.MjSpec, drive: Drive) -> None:
    added = model.add_actuator(
        name=drive.name,
        trntype=mujoco.mjtTrn.mjTRN_JOINT,
        target=drive.joint,
        gear=[float(drive.axis == axis) for axis in "xyz"] + [0.0] * 3
        if drive.axis
        else [1.0] + [0.0] * 5,
    )
    added.set_to_position(kp=drive.stiffness, kv=drive.damping)
    if drive.effort is not None:
        added.forcelimited = 1
        added.forcerange = [-drive.effort, drive.effort]
