"""Simulation of an object, in which all scenarios are rolled out as one batch.

The models of a batch may differ only in the values of their fields. The base of a free object is
therefore fixed by a large armature, instead of being compiled without a free joint. The floor has
no friction: MuJoCo applies the larger friction of two geoms, which is then the object's.
"""

import contextlib
import copy
import itertools
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco import rollout
from numpy.typing import NDArray

from ..config import VerifyOptions
from ..physics.mjcf import START, body_name, start_data, to_mjspec
from ..spec import JointSpec, ObjectSpec, Quat, bounds, joint_value, part_bounds
from ..spec.kinematics import welded
from ..spec.opening import prerequisite_state
from ..spec.pose import IDENTITY, from_axis_angle, quat_mul
from .scenarios import SINGLE_DOF_TYPES, STILL_S, Scenario, SingleJoint, World

FLOOR = "test_floor"
FIXING_ARMATURE = 1e6
"""Armature that fixes a base or a joint, over the object's mass or the joint's inertia."""
TIMESTEP_S = 0.002
"""Time step of the simulation [s]."""
PUSH_S = 0.1
"""Duration of the force that applies the impulse of a push [s]."""
DRIVE_S = 0.5
"""Time in which the force on a free joint moves it across its range [s]."""
HAND_FORCE_N = 100.0
"""Largest force that drives a joint, at the far end of the part, plus half of its weight [N]."""
CONTROL_BYTES = 64 << 20
"""Limit on the memory for the forces of a batch; further scenarios are run in the next batch."""
G = 9.81
FORCES = int(mujoco.mjtState.mjSTATE_QFRC_APPLIED) | int(mujoco.mjtState.mjSTATE_XFRC_APPLIED)
_STATE = int(mujoco.mjtState.mjSTATE_FULLPHYSICS)


@dataclass
class Trajectory:
    """States of an object during one scenario."""

    scenario: Scenario
    time: NDArray
    """Times [s], shape [t]. They end early if the simulation diverged."""
    qpos: NDArray
    """Positions, shape [t, nq]."""
    qvel: NDArray
    """Velocities, shape [t, nv]."""
    energy: NDArray
    """Total energy, potential plus kinetic [J], shape [t]."""
    diverged: bool


class Simulation:
    """An object that is compiled for simulation in each world of the scenarios.

    Args:
        spec: the object.
        options: time step and duration.
        tilt: orientation in which the object rests; scenarios can add a tilt.
    """

    def __init__(self, spec: ObjectSpec, options: VerifyOptions, tilt: Quat = IDENTITY) -> None:
        self.spec, self.options, self.tilt = spec, options, np.array(tilt)
        mjspec = to_mjspec(spec, timestep=TIMESTEP_S)
        floor = mjspec.worldbody.add_geom(name=FLOOR, type=mujoco.mjtGeom.mjGEOM_PLANE)
        floor.size, floor.friction, floor.condim = [0, 0, 1.0], [0.0, 0.0, 0.0], 3
        for kind in (mujoco.mjtSensor.mjSENS_E_POTENTIAL, mujoco.mjtSensor.mjSENS_E_KINETIC):
            mjspec.add_sensor(name=kind.name, type=kind)
        free = mjspec.compile()
        free.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        # From 60 degrees of freedom on, MuJoCo chooses sparse matrices, which take three times as
        # long for a chain of 80 joints.
        free.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
        # With soft dry friction, a stuck joint creeps and would appear to move, so friction is
        # stiff. If damping stops a joint within one step, stiff friction would drive the joint.
        damping = free.dof_damping.reshape(free.nv, -1)[:, 0]
        free.dof_solimp[TIMESTEP_S * damping < free.dof_M0, :2] = 0.9999
        self._fixed_joint_models: dict[tuple[World, frozenset[str]], mujoco.MjModel] = {}
        self.data = mujoco.MjData(free)
        self.root = free.body(spec.name).id
        self.floor = free.geom(FLOOR).id
        self.mass = float(free.body_subtreemass[self.root])
        low, high = bounds(spec, {}, tilt)
        self.size = high - low
        self.models = self._worlds(free)
        self.joints = [
            _single_joint(spec, joint)
            for joint in spec.joints
            if joint.type in SINGLE_DOF_TYPES and not joint.mimic
        ]
        group = welded(spec)
        self.groups = [part.name for part, _ in spec.ordered if group[part.name] == part.name]

    def _worlds(self, free: mujoco.MjModel) -> dict[World, mujoco.MjModel]:
        """Return the model of each world, given the model of the free object."""
        fixed_base = copy.copy(free)
        fixed_base.geom_contype[self.floor] = fixed_base.geom_conaffinity[self.floor] = 0
        armature = np.repeat([1.0, float(self.size @ self.size)], 3) * self.mass * FIXING_ARMATURE
        fixed_base.dof_armature[:6] = armature
        mujoco.mj_setConst(fixed_base, mujoco.MjData(fixed_base))
        # With MuJoCo's default tolerance, a part of a few grams on the heavy base would jitter.
        fixed_base.opt.tolerance = 1e-15
        weightless = copy.copy(fixed_base)
        weightless.opt.gravity[:] = 0.0
        return {"free": free, "fixed_base": fixed_base, "weightless": weightless}

    @property
    def model(self) -> mujoco.MjModel:
        """The model of the free object."""
        return self.models["free"]

    def model_of(self, scenario: Scenario) -> mujoco.MjModel:
        """Return the model of a scenario's world, in which the propped joints are fixed."""
        if not scenario.fixed_joints:
            return self.models[scenario.world]
        key = (scenario.world, scenario.fixed_joints)
        if key not in self._fixed_joint_models:
            model = copy.copy(self.models[scenario.world])
            data = start_data(model)
            mujoco.mj_forward(model, data)
            inertia = np.diag(_mass_matrix(model, data))
            for joint in scenario.fixed_joints:
                _, dof = self.address(joint)
                model.dof_armature[dof] += FIXING_ARMATURE * inertia[dof]
            mujoco.mj_setConst(model, mujoco.MjData(model))
            self._fixed_joint_models[key] = model
        return self._fixed_joint_models[key]

    def joint_of(self, scenario: Scenario) -> SingleJoint:
        """Return the joint that a scenario releases or drives."""
        return next(joint for joint in self.joints if joint.name == scenario.joint)

    def address(self, joint: str) -> tuple[int, int]:
        """Return the indices of a joint's position in qpos and of its velocity in qvel."""
        handle = self.model.joint(f"{self.spec.name}-{joint}")
        return int(handle.qposadr[0]), int(handle.dofadr[0])

    def start(self, scenario: Scenario) -> NDArray:
        """Return the initial state of a scenario, in the layout of `mj_getState`."""
        model, data = self.model_of(scenario), self.data
        mujoco.mj_resetDataKeyframe(model, data, model.key(START).id)
        about_x, about_y = scenario.tilt
        lean = quat_mul(from_axis_angle((1, 0, 0), about_x), from_axis_angle((0, 1, 0), about_y))
        quat = quat_mul(lean, self.tilt)
        low, _ = bounds(self.spec, scenario.joints, tuple(quat.tolist()))
        data.qpos[:3] = [0.0, 0.0, scenario.height - low[2]]
        data.qpos[3:7] = quat
        for joint in self.spec.joints:
            if joint.type not in SINGLE_DOF_TYPES:
                continue
            position, dof = self.address(joint.name)
            value = joint_value(self.spec, joint, scenario.joints)
            if joint.type != "continuous" and joint.mimic is None:
                # A joint that starts beyond its limit would jerk.
                value = float(np.clip(value, joint.lower, joint.upper))
            data.qpos[position] = value
            if scenario.speeds:
                # The position of a mimic joint has an offset, but the speed has none.
                offset = joint_value(self.spec, joint, {})
                data.qvel[dof] = joint_value(self.spec, joint, scenario.speeds) - offset
        packed = np.zeros(mujoco.mj_stateSize(model, _STATE))
        mujoco.mj_getState(model, data, packed, _STATE)
        return packed

    def forces(self, scenario: Scenario, start: NDArray) -> NDArray:
        """Return the forces of a scenario on joints and bodies, shape [t, nv + 6 nbody]."""
        model, data, o = self.model_of(scenario), self.data, self.options
        steps = round(o.duration_s / TIMESTEP_S)
        time = np.arange(steps) * TIMESTEP_S
        joint = np.zeros((steps, model.nv))
        body = np.zeros((steps, model.nbody, 6))
        if scenario.part is not None or scenario.driven:
            mujoco.mj_setState(model, data, start, _STATE)
            mujoco.mj_forward(model, data)
        if scenario.part is not None:
            pushed, during = model.body(body_name(self.spec, scenario.part)).id, PUSH_S
            mass = float(model.body_subtreemass[pushed])
            body[time < during, pushed, :3] = np.array(scenario.impulse) * mass / during
        if scenario.driven and scenario.joint is not None:
            _, dof = self.address(scenario.joint)
            force = self.drive_force(scenario)
            half = STILL_S + (o.duration_s - STILL_S) / 2
            joint[(time >= STILL_S) & (time < half), dof] = force
            joint[time >= half, dof] = -force
        return np.concatenate([joint, body.reshape(steps, -1)], axis=1)

    def drive_force(self, scenario: Scenario) -> float:
        """Return the force [N] or torque [N m] with which a hand drives a joint.

        The force suffices to move the joint through its range in `DRIVE_S` against losses and
        weight, but does not exceed the force of a hand at the far end of the child.
        """
        model = self.model_of(scenario)
        joint = self.joint_of(scenario)
        position, dof = self.address(joint.name)
        data = mujoco.MjData(model)
        load, inertia = 0.0, 0.0
        for value in np.linspace(joint.low, joint.high, 5):
            data.qpos[:] = model.key_qpos[0]
            for name in scenario.fixed_joints:
                data.qpos[self.address(name)[0]] = scenario.joints[name]
            data.qpos[position] = value
            mujoco.mj_forward(model, data)
            inertia = max(inertia, float(_mass_matrix(model, data)[dof, dof]))
            load = max(load, abs(float(data.qfrc_bias[dof])))
        span = joint.high - joint.low
        required = 2 * inertia * span / DRIVE_S**2 + 2 * float(model.dof_frictionloss[dof])
        required += float(model.dof_damping[dof].sum()) * span / DRIVE_S + 1.5 * load
        # Springs and contacts require a larger force.
        required = max(2 * required, 1e-9)
        child = model.body(body_name(self.spec, joint.child)).id
        weight = G * float(model.body_subtreemass[child])
        return min(required, self.moment_arm(joint) * (HAND_FORCE_N + 0.5 * weight) + load)

    def moment_arm(self, single: SingleJoint) -> float:
        """Return the distance [m] from a joint's axis to the far end of the parts that it moves.

        For a sliding joint, return 1.
        """
        joint = self.spec.joint(single.name)
        if joint.type == "prismatic":
            return 1.0
        moving = {joint.child}
        for part, support in self.spec.ordered:
            if support is not None and support.parent in moving:
                moving.add(part.name)
        boxes = np.array([part_bounds(self.spec, self.spec.part(name)) for name in moving])
        low, high = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
        corners = np.array(list(itertools.product(*zip(low, high, strict=True))))
        arm = corners - np.array(joint.pos)
        arm -= np.outer(arm @ np.array(joint.axis), joint.axis)
        return max(float(np.linalg.norm(arm, axis=1).max()), 0.01)

    def run(self, scenarios: Sequence[Scenario], threads: int = 0) -> list[Trajectory]:
        """Roll out all scenarios, in one batch unless the forces need too much memory."""
        threads = threads or os.cpu_count() or 1
        steps = round(self.options.duration_s / TIMESTEP_S)
        size = max(1, CONTROL_BYTES // (8 * steps * (self.model.nv + 6 * self.model.nbody)))
        data = [mujoco.MjData(self.model) for _ in range(threads)]
        trajectories: list[Trajectory] = []
        with without_warnings(), rollout.Rollout(nthread=threads) as pool:
            for first in range(0, len(scenarios), size):
                batch = scenarios[first : first + size]
                starts = np.array([self.start(scenario) for scenario in batch])
                forces = np.array([self.forces(*run) for run in zip(batch, starts, strict=True)])
                models = [self.model_of(scenario) for scenario in batch]
                states, energies = pool.rollout(
                    models, data, starts, forces, control_spec=FORCES, nstep=steps
                )
                recorded = zip(batch, np.array(states), np.array(energies), strict=True)
                trajectories += [self._trajectory(*run) for run in recorded]
        return trajectories

    def _trajectory(self, scenario: Scenario, state: NDArray, energies: NDArray) -> Trajectory:
        time, qpos, qvel = np.split(state, [1, 1 + self.model.nq], axis=1)
        valid = np.all(np.isfinite(np.hstack([state, energies])), axis=1)
        # MuJoCo fills the rest of a diverged run with the last state, so the time is constant.
        valid[1:] &= np.diff(time[:, 0]) > 0
        n = int(np.logical_and.accumulate(valid).sum())
        qvel = qvel[:n, : self.model.nv]
        return Trajectory(
            scenario, time[:n, 0], qpos[:n], qvel, energies[:n].sum(axis=1), n < len(time)
        )


def _single_joint(spec: ObjectSpec, joint: JointSpec) -> SingleJoint:
    is_continuous = joint.type == "continuous"
    low, high = (-np.pi, np.pi) if is_continuous else (float(joint.lower), float(joint.upper))
    prerequisites = prerequisite_state(spec, joint)
    return SingleJoint(joint.name, joint.child, low, high, joint.stiffness > 0, prerequisites)


def _mass_matrix(model: mujoco.MjModel, data: mujoco.MjData) -> NDArray:
    """Return the joint-space inertia matrix in the state of `data`, shape [nv, nv]."""
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    return full


@contextlib.contextmanager
def without_warnings() -> Iterator[None]:
    """Suppress MuJoCo's warnings in the block, because a check reports divergence."""
    previous = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(previous)
