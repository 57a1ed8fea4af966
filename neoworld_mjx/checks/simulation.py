"""Simulate an object: one model for all of its scenarios, rolled out as one batch.

The models of a batch differ in the values of their fields alone, so an object can be free, held or
weightless: a large armature holds its base. The floor has no friction; MuJoCo takes the larger
friction of two geoms, here the object's.
"""

import contextlib
import copy
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco import rollout
from numpy.typing import NDArray

from ..config import VerifyOptions
from ..physics.mjcf import START, body_name, to_mjspec
from ..spec import JointSpec, ObjectSpec, Quat, bounds, joint_value, part_bounds
from ..spec.kinematics import welded
from ..spec.opening import prerequisite_state
from ..spec.pose import IDENTITY, from_axis_angle, quat_mul
from .scenarios import SINGLE, STILL_S, Moving, Scenario, World, slope_at

FLOOR = "floor_of_the_trial"
HOLDING_MASS = 1e6
"""Effective mass of a held base or joint, over its own."""
CONTROL_BYTES = 64 << 20
"""Largest memory for the forces of a batch; further scenarios are rolled out after it."""
G = 9.81
FORCES = int(mujoco.mjtState.mjSTATE_QFRC_APPLIED) | int(mujoco.mjtState.mjSTATE_XFRC_APPLIED)
_STATE = int(mujoco.mjtState.mjSTATE_FULLPHYSICS)


@dataclass
class Trajectory:
    """States of an object over one scenario."""

    scenario: Scenario
    time: NDArray
    """[t] s; ends early if the simulation diverged."""
    qpos: NDArray
    """[t, nq]"""
    qvel: NDArray
    """[t, nv]"""
    energy: NDArray
    """[t] J."""
    broke: bool
    """Whether the simulation diverged."""


class Simulation:
    """An object compiled for simulation, free, held and weightless.

    Args:
        spec: the object.
        options: time step and duration.
        tilt: its resting orientation, to which scenarios add their tilt.
        joint_state: positions [rad or m] of joints that a scenario does not set.
    """

    def __init__(
        self,
        spec: ObjectSpec,
        options: VerifyOptions,
        tilt: Quat = IDENTITY,
        joint_state: dict[str, float] | None = None,
    ) -> None:
        self.spec, self.options, self.tilt = spec, options, np.array(tilt)
        self.state = dict(joint_state or {})
        mjspec = to_mjspec(spec, timestep=options.timestep_s)
        floor = mjspec.worldbody.add_geom(name=FLOOR, type=mujoco.mjtGeom.mjGEOM_PLANE)
        floor.size, floor.friction, floor.condim = [0, 0, 1.0], [0.0, 0.0, 0.0], 3
        for kind in (mujoco.mjtSensor.mjSENS_E_POTENTIAL, mujoco.mjtSensor.mjSENS_E_KINETIC):
            mjspec.add_sensor(name=kind.name, type=kind)
        free = mjspec.compile()
        free.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        # Soft dry friction creeps, so that a stuck joint would seem to move. Where damping stops a
        # joint within a step, however, stiff friction would drive it.
        damping = free.dof_damping.reshape(free.nv, -1)[:, 0]
        free.dof_solimp[options.timestep_s * damping < free.dof_M0, :2] = 0.9999
        self._propped: dict[tuple[World, frozenset[str]], mujoco.MjModel] = {}
        self.data = mujoco.MjData(free)
        self.root = free.body(spec.name).id
        self.floor = free.geom(FLOOR).id
        self.mass = float(free.body_subtreemass[self.root])
        low, high = bounds(spec, self.state, tilt)
        self.size = high - low
        self.models = self._worlds(free)
        self.joints = [self._moving(j) for j in spec.joints if j.type in SINGLE and not j.mimic]
        group = welded(spec)
        self.groups = [p.name for p, _ in spec.ordered if group[p.name] == p.name]

    def _worlds(self, free: mujoco.MjModel) -> dict[World, mujoco.MjModel]:
        """Return copies of the model of the free object for each world."""
        held = copy.copy(free)
        held.geom_contype[self.floor] = held.geom_conaffinity[self.floor] = 0
        heavy = np.repeat([1.0, float(self.size @ self.size)], 3) * self.mass * HOLDING_MASS
        held.dof_armature[:6] = heavy
        mujoco.mj_setConst(held, mujoco.MjData(held))
        # At MuJoCo's default tolerance a part of a few grams on so heavy a base would jitter.
        held.opt.tolerance = 1e-15
        weightless = copy.copy(held)
        weightless.opt.gravity[:] = 0.0
        # By default contacts creep under a steady force; on the slope they must stick until they
        # slide.
        gripping = copy.copy(free)
        gripping.opt.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        gripping.opt.impratio = 100.0
        return {"free": free, "held": held, "weightless": weightless, "gripping": gripping}

    def _moving(self, joint: JointSpec) -> Moving:
        turns = joint.type == "continuous"
        low, high = (-np.pi, np.pi) if turns else (joint.lower, joint.upper)
        opened = prerequisite_state(self.spec, joint)
        return Moving(joint.name, joint.child, float(low), float(high), joint.stiffness > 0, opened)

    @property
    def model(self) -> mujoco.MjModel:
        """Model in which the object is free."""
        return self.models["free"]

    def model_of(self, scenario: Scenario) -> mujoco.MjModel:
        """Return the model of a scenario: that of its world, with propped joints held."""
        if not scenario.propped:
            return self.models[scenario.world]
        key = (scenario.world, scenario.propped)
        if key not in self._propped:
            model = copy.copy(self.models[scenario.world])
            data, full = mujoco.MjData(model), np.zeros((model.nv, model.nv))
            mujoco.mj_resetDataKeyframe(model, data, model.key(START).id)
            mujoco.mj_forward(model, data)
            mujoco.mj_fullM(model, data, full)
            for joint in scenario.propped:
                _, dof = self.address(joint)
                model.dof_armature[dof] += HOLDING_MASS * full[dof, dof]
            mujoco.mj_setConst(model, mujoco.MjData(model))
            self._propped[key] = model
        return self._propped[key]

    def joint_of(self, scenario: Scenario) -> Moving:
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
        quat = quat_mul(
            quat_mul(
                from_axis_angle((1, 0, 0), scenario.tilt[0]),
                from_axis_angle((0, 1, 0), scenario.tilt[1]),
            ),
            self.tilt,
        )
        state = {**self.state, **scenario.joints}
        low, _ = bounds(self.spec, state, tuple(quat.tolist()))
        data.qpos[:3] = [0.0, 0.0, scenario.height - low[2]]
        data.qpos[3:7] = quat
        for joint in self.spec.joints:
            if joint.type not in SINGLE:
                continue
            at, dof = self.address(joint.name)
            value = joint_value(self.spec, joint, state)
            if joint.type != "continuous" and joint.mimic is None:
                # From beyond its limit a joint would start with a jerk.
                value = float(np.clip(value, joint.lower, joint.upper))
            data.qpos[at] = value
            if scenario.speeds:
                # The value of a follower has an offset, its speed has none.
                offset = joint_value(self.spec, joint, {})
                data.qvel[dof] = joint_value(self.spec, joint, scenario.speeds) - offset
        packed = np.zeros(mujoco.mj_stateSize(model, _STATE))
        mujoco.mj_getState(model, data, packed, _STATE)
        return packed

    def forces(self, scenario: Scenario, start: NDArray) -> NDArray:
        """Return the forces of a scenario [t, nv + 6 nbody]: on joints, then on bodies."""
        model, data, o = self.model_of(scenario), self.data, self.options
        steps = round(o.duration_s / o.timestep_s)
        time = np.arange(steps) * o.timestep_s
        joint = np.zeros((steps, model.nv))
        body = np.zeros((steps, model.nbody, 6))
        if scenario.part is not None or scenario.driven:
            mujoco.mj_setState(model, data, start, _STATE)
            mujoco.mj_forward(model, data)
        if scenario.part is not None:
            b = model.body(body_name(self.spec, scenario.part)).id
            mass = float(model.body_subtreemass[b])
            pushed = time < o.push_duration_s
            body[pushed, b, :3] = np.array(scenario.impulse) * mass / o.push_duration_s
            if scenario.twist:
                inertia = self._about_vertical(b)
                body[pushed, b, 5] = scenario.twist * inertia / o.push_duration_s
        if scenario.driven and scenario.joint is not None:
            _, dof = self.address(scenario.joint)
            half = STILL_S + (o.duration_s - STILL_S) / 2
            joint[(time >= STILL_S) & (time < half), dof] = self.drive_force(scenario)
            joint[time >= half, dof] = -self.drive_force(scenario)
        if scenario.slope:
            angle = slope_at(time, o.duration_s)
            pull = np.zeros((steps, 3))
            pull[:, 1], pull[:, 2] = G * np.sin(angle), G * (1 - np.cos(angle))
            body[:, self.root :, :3] = pull[:, None] * model.body_mass[self.root :, None]
        return np.concatenate([joint, body.reshape(steps, -1)], axis=1)

    def _about_vertical(self, body: int) -> float:
        """Return the inertia [kg m^2] of a body's subtree about the vertical."""
        model, data, total = self.model, self.data, 0.0
        centre = data.subtree_com[body]
        below = {body}
        for b in range(body, model.nbody):
            if b == body or int(model.body_parentid[b]) in below:
                below.add(b)
                arm = data.xipos[b] - centre
                turn = data.ximat[b].reshape(3, 3)
                own = float((turn[2] ** 2) @ model.body_inertia[b])
                total += own + float(model.body_mass[b]) * float(arm[:2] @ arm[:2])
        return total

    def drive_force(self, scenario: Scenario) -> float:
        """Return the force [N] or torque [N m] with which a hand would drive a joint.

        It suffices to cross the range in `joint_push_s` against losses and weight, but is at most
        that of a hand at the child's far end.
        """
        model, o = self.model_of(scenario), self.options
        moving = self.joint_of(scenario)
        at, dof = self.address(moving.name)
        data = mujoco.MjData(model)
        load, inertia = 0.0, 0.0
        for value in np.linspace(moving.low, moving.high, 5):
            data.qpos[:] = model.key_qpos[0]
            for joint in scenario.propped:
                data.qpos[self.address(joint)[0]] = scenario.joints[joint]
            data.qpos[at] = value
            mujoco.mj_forward(model, data)
            full = np.zeros((model.nv, model.nv))
            mujoco.mj_fullM(model, data, full)
            inertia = max(inertia, float(full[dof, dof]))
            load = max(load, abs(float(data.qfrc_bias[dof])))
        span = moving.high - moving.low
        need = 2 * inertia * span / o.joint_push_s**2 + 2 * float(model.dof_frictionloss[dof])
        need += float(model.dof_damping[dof].sum()) * span / o.joint_push_s + 1.5 * load
        # Springs and contacts need more.
        need = max(2 * need, 1e-9)
        child = model.body(body_name(self.spec, moving.child)).id
        weight = G * float(model.body_subtreemass[child])
        return min(need, self.moment_arm(moving) * (o.hand_force_n + 0.5 * weight) + load)

    def moment_arm(self, moving: Moving) -> float:
        """Return the distance [m] from a joint's axis to the far end of the parts that it moves.

        It is 1 for a joint that slides.
        """
        joint = self.spec.joint(moving.name)
        if joint.type == "prismatic":
            return 1.0
        moved = {joint.child}
        for part, carrier in self.spec.ordered:
            if carrier is not None and carrier.parent in moved:
                moved.add(part.name)
        boxes = [part_bounds(self.spec, self.spec.part(name)) for name in moved]
        low = np.min([box[0] for box in boxes], axis=0)
        high = np.max([box[1] for box in boxes], axis=0)
        corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1])
                            for z in (low[2], high[2])])  # fmt: skip
        arm = corners - np.array(joint.pos)
        arm -= np.outer(arm @ np.array(joint.axis), joint.axis)
        return max(float(np.linalg.norm(arm, axis=1).max()), 0.01)

    def run(self, scenarios: Sequence[Scenario], threads: int = 0) -> list[Trajectory]:
        """Roll out all scenarios, in one batch unless their forces take too much memory."""
        threads = threads or os.cpu_count() or 1
        steps = round(self.options.duration_s / self.options.timestep_s)
        bytes_per_run = 8 * steps * (self.model.nv + 6 * self.model.nbody)
        chunk = max(1, CONTROL_BYTES // bytes_per_run)
        trajectories: list[Trajectory] = []
        data = [mujoco.MjData(self.model) for _ in range(threads)]
        with without_warnings(), rollout.Rollout(nthread=threads) as pool:
            for first in range(0, len(scenarios), chunk):
                batch = scenarios[first : first + chunk]
                starts = np.array([self.start(scenario) for scenario in batch])
                forces = np.array(
                    [
                        self.forces(scenario, start)
                        for scenario, start in zip(batch, starts, strict=True)
                    ]
                )
                models = [self.model_of(scenario) for scenario in batch]
                states, sensed = pool.rollout(
                    models, data, starts, forces, control_spec=FORCES, nstep=steps
                )
                trajectories += [
                    self._trajectory(scenario, *recorded)
                    for scenario, *recorded in zip(
                        batch, np.array(states), np.array(sensed), strict=True
                    )
                ]
        return trajectories

    def _trajectory(self, scenario: Scenario, state: NDArray, sensed: NDArray) -> Trajectory:
        nq, nv = self.model.nq, self.model.nv
        time = state[:, 0]
        good = np.asarray(np.isfinite(state).all(axis=1) & np.isfinite(sensed).all(axis=1))
        # MuJoCo fills the rest of a diverged run with its last state, where time stands still.
        good[1:] &= np.diff(time) > 0
        good = np.logical_and.accumulate(good)
        n = int(good.sum())
        return Trajectory(
            scenario,
            time[:n],
            state[:n, 1 : 1 + nq],
            state[:n, 1 + nq : 1 + nq + nv],
            sensed[:n].sum(axis=1),
            n < len(time),
        )


@contextlib.contextmanager
def without_warnings() -> Iterator[None]:
    """Silence MuJoCo's warnings: a check reports divergence."""
    previous = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(previous)
