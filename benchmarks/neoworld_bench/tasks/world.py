"""A scene with a free gripper in MuJoCo: compiling them together, and reading states."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from neoworld_mjx.environments.robots import PREFIX as ROBOT
from neoworld_mjx.errors import SpecError
from neoworld_mjx.physics.gripper import PREFIX, Gripper, attach_gripper
from neoworld_mjx.physics.mjcf import COLLISION_GROUP, START, VISUAL_GROUP, body_name, to_mjspec
from neoworld_mjx.spec import SceneSpec
from neoworld_mjx.spec.pose import Pose, conjugate, rotate

from .plan_format import TaskPlan

IMPRATIO = 10.0
"""Stiffness of friction over that of the normal force, as in exported files: what is held does not
creep out of the fingers."""
TIMESTEP = 0.002
_BALL = int(mujoco.mjtJoint.mjJNT_BALL)
_SLIDE = int(mujoco.mjtJoint.mjJNT_SLIDE)


class World:
    """One simulation: a scene in its composed state, with the gripper of a plan or without one."""

    def __init__(
        self,
        scene: SceneSpec,
        plan: TaskPlan | None,
        *,
        visual: bool = False,
        model: mujoco.MjModel | None = None,
    ) -> None:
        """Start a simulation of a plan, or of `model`, a compiled scene with a gripper or robot."""
        self.scene, self.xp = scene, np
        self.model = _compile(scene, plan, visual) if model is None else model
        self.data = mujoco.MjData(self.model)
        start = _start(scene)
        self.data.qpos[: len(start)] = start
        if plan is not None:
            for side in ("left", "right"):
                self.data.joint(f"{PREFIX}-{side}").qpos[0] = plan.opening / 2
            self.command(np.zeros(3), np.zeros(3), plan.opening)
        mujoco.mj_forward(self.model, self.data)
        bodies = [self.model.body(b).name.split("-", 1)[0] for b in self.model.geom_bodyid]
        self._gripper = ROBOT if ROBOT in bodies else PREFIX
        owners = [*(item.name for item in scene.objects), self._gripper]
        self._owner = [owners.index(name) if name in owners else -1 for name in bodies]
        self._owners = owners
        self._items = {item.name: item for item in scene.objects}
        self._start_q = self.data.qpos.copy()

    def command(self, displacement: NDArray, turn: NDArray, opening: float) -> None:
        """Set the targets of all actuators.

        Args:
            displacement: of the tool from its start, in the world [3] m.
            turn: rotation vector from its start, in the tool's axes at the start [3] rad.
            opening: distance of the pads [m]; 0 asks for more than closed, so for all their force.
        """
        targets = self.data.ctrl
        names = ("x", "y", "z", "turn_x", "turn_y", "turn_z", "left", "right")
        half = opening / 2 if opening > 0 else -0.02
        for name, value in zip(names, (*displacement, *turn, half, half), strict=True):
            targets[self.model.actuator(f"{PREFIX}-{name}").id] = value

    def pose(self, name: str, part: str | None = None) -> Pose:
        """Return the pose of an object's root part, or of a part, whose frame at rest is that."""
        item = self._items[name]
        if part is None:
            body = self.data.body(name)
            return Pose(body.xpos.copy(), body.xquat.copy())
        body = self.data.body(body_name(item, part))
        joint = next((j for j in item.spec.joints if j.child == part), None)
        offset = np.zeros(3) if joint is None else -np.array(joint.pos)
        quat = body.xquat.copy()
        return Pose(body.xpos + rotate(quat, offset), quat)

    def tool(self) -> Pose:
        """Return the pose of the tool frame."""
        body = self.data.body(f"{PREFIX}-hand")
        return Pose(body.xpos.copy(), body.xquat.copy())

    def tool_position(self) -> NDArray:
        """Return the position of the tool [m]."""
        return self.tool().pos

    def speed(self, name: str) -> tuple[float, float]:
        """Return the speeds of an object's root [m/s], [rad/s]."""
        velocity = np.zeros(6)
        body = self.model.body(name).id
        mujoco.mj_objectVelocity(self.model, self.data, mujoco.mjtObj.mjOBJ_BODY, body, velocity, 0)
        return float(np.linalg.norm(velocity[3:])), float(np.linalg.norm(velocity[:3]))

    def touches(self, name: str, other: str) -> np.bool_:
        """Return True if two objects touch."""
        return np.bool_(other in self.touched(name))

    def held(self, name: str) -> np.bool_:
        """Return True if the gripper touches an object."""
        return self.touches(name, self._gripper)

    def touched(self, name: str) -> set[str]:
        """Return the objects, and the gripper, that an object touches."""
        one = self._owners.index(name)
        result = set()
        for a, b in self.data.contact.geom[: self.data.ncon]:
            pair = (self._owner[a], self._owner[b])
            if one in pair and pair[0] != pair[1] and min(pair) >= 0:
                result.add(self._owners[pair[0] if pair[1] == one else pair[1]])
        return result

    def depth_of_gripper(self) -> tuple[float, str]:
        """Return how deep the gripper is in an object [m], and in which."""
        deepest, where = 0.0, ""
        last = len(self._owners) - 1
        for k in range(self.data.ncon):
            contact = self.data.contact[k]
            pair = sorted((self._owner[contact.geom1], self._owner[contact.geom2]))
            if pair[1] == last and 0 <= pair[0] < last and -contact.dist > deepest:
                deepest, where = -float(contact.dist), self._owners[pair[0]]
        return deepest, where

    def joint(self, name: str, joint: str, *, fraction: bool) -> tuple[float, float, bool]:
        """Return a joint's value, its rate [rad/s or m/s], and whether it slides.

        A ball's value is the angle away from rest [rad].
        """
        index = self.model.joint(f"{name}-{joint}").id
        q, dof = self.model.jnt_qposadr[index], self.model.jnt_dofadr[index]
        kind = self.model.jnt_type[index]
        if kind == _BALL:
            value = 2 * float(np.arccos(min(1.0, abs(self.data.qpos[q]))))
            return value, float(np.linalg.norm(self.data.qvel[dof : dof + 3])), False
        value = float(self.data.qpos[q])
        if fraction:
            low, high = self.model.jnt_range[index]
            if not self.model.jnt_limited[index]:
                raise SpecError(f"joint {name}/{joint} has no range to take a fraction of")
            value = (value - low) / (high - low)
        return float(value), abs(float(self.data.qvel[dof])), bool(kind == _SLIDE)

    def diverged(self) -> bool:
        """True if the state is no longer made of finite numbers."""
        return not (np.isfinite(self.data.qpos).all() and np.isfinite(self.data.qvel).all())


def _start(scene: SceneSpec) -> list[float]:
    model = to_mjspec(scene)
    return list(model.key(START).qpos) if model.keys else []


def _compile(scene: SceneSpec, plan: TaskPlan | None, visual: bool) -> mujoco.MjModel:
    if any(item.name == PREFIX for item in scene.objects):
        raise SpecError(f"scene {scene.name}: {PREFIX} is the gripper's name, not an object's")
    model = to_mjspec(scene, visual=visual, timestep=TIMESTEP)
    for key in list(model.keys):  # of a model without the gripper
        model.delete(key)
    model.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    model.option.impratio = IMPRATIO
    if plan is not None:
        w, x, y, z = plan.quat.tolist()
        start = Gripper(plan.position, (w, x, y, z))
        attach_gripper(model, start, group=VISUAL_GROUP if visual else COLLISION_GROUP)
    try:
        compiled = model.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise SpecError(f"scene {scene.name} does not compile: {error}") from None
    compiled.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    return compiled


def in_start_axes(plan: TaskPlan, world_vector: NDArray) -> NDArray:
    """Turn a rotation vector in the world's axes into the tool's axes at its start."""
    return rotate(conjugate(plan.quat), world_vector)
