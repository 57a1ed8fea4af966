"""What a mechanism is whatever its format, and how to read it from URDF and MJCF (USD: `read_usd`).

Everything is in the object's frame with all joints at 0, so that the same object read from URDF,
MJCF and USD gives the same numbers.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..errors import ExportError, choices
from ..physics.mjcf import body_name
from ..spec import JointSpec, JointType, Mimic, ObjectSpec, ball_vector, inertial, joint_motion
from ..spec.pose import Pose, matrix, pose, rotate


@dataclass(frozen=True)
class Link:
    """A rigid body."""

    mass: float
    """[kg]"""
    com: NDArray
    """Centre of mass [m], [3]."""
    inertia: NDArray
    """About it [kg m^2], [3, 3]."""
    origin: NDArray
    """Of the link's own frame in the file [m], [3]."""


@dataclass(frozen=True)
class Mechanism:
    """A tree of links; joints are described as in an ObjectSpec."""

    root: str
    links: dict[str, Link]
    joints: dict[str, JointSpec]

    def poses(self, values: dict[str, float]) -> dict[str, Pose]:
        """Return how each link is displaced from rest, joints at `values` [rad or m], mimics too."""
        moved = {self.root: pose()}
        waiting = list(self.joints.values())
        while waiting:
            ready = [joint for joint in waiting if joint.parent in moved]
            if not ready:
                raise ExportError(
                    "links hang on nothing: " + ", ".join(sorted(j.child for j in waiting))
                )
            for joint in ready:
                ball = joint.type == "ball"
                value = ball_vector(joint, values) if ball else self._value(joint, values)
                moved[joint.child] = moved[joint.parent].then(joint_motion(joint, value))
            waiting = [
                joint for joint in waiting if joint.parent not in moved or joint not in ready
            ]
        return moved

    def _value(self, joint: JointSpec, values: dict[str, float]) -> float:
        if joint.mimic is None:
            return values.get(joint.name, 0.0)
        leader = self.joints[joint.mimic.joint]
        return joint.mimic.multiplier * self._value(leader, values) + joint.mimic.offset


def mechanism(spec: ObjectSpec) -> Mechanism:
    """Describe an object."""
    origins = {joint.child: np.array(joint.pos) for joint in spec.joints}
    links = {}
    for part in spec.parts:
        mass = inertial(spec, part)
        turn = matrix(mass.quat)
        links[part.name] = Link(
            mass.mass,
            np.array(mass.pos),
            turn @ np.diag(mass.diagonal) @ turn.T,
            origins.get(part.name, np.zeros(3)),
        )
    return Mechanism(spec.root, links, {joint.name: joint for joint in spec.joints})


def read_urdf(path: Path) -> Mechanism:
    """Read a URDF file with yourdfpy; efforts and velocities as written.

    Raises:
        ExportError: a joint is of a type, or lacks a limit, that we have no counterpart for.
    """
    import yourdfpy

    robot = yourdfpy.URDF.load(
        str(path), load_meshes=False, build_collision_scene_graph=False
    ).robot
    children = {joint.child for joint in robot.joints}
    roots = [link.name for link in robot.links if link.name not in children]
    if len(roots) != 1:
        raise ExportError(
            f"{path}: a mechanism needs one root link, got {', '.join(roots) or 'none'}"
        )
    frames: dict[str, NDArray] = {roots[0]: np.eye(4)}
    joints: dict[str, JointSpec] = {}
    waiting = list(robot.joints)
    while waiting:
        joint = next(joint for joint in waiting if joint.parent in frames)
        waiting.remove(joint)
        local = np.eye(4) if joint.origin is None else joint.origin
        frames[joint.child] = frames[joint.parent] @ local
        joints[joint.name] = _urdf_joint(path, joint, frames[joint.child])
    links = {}
    for link in robot.links:
        at, own = frames[link.name], link.inertial
        if own is None:
            links[link.name] = Link(0.0, at[:3, 3], np.zeros((3, 3)), at[:3, 3])
            continue
        place = at if own.origin is None else at @ own.origin
        turn = place[:3, :3]
        inertia = np.zeros((3, 3)) if own.inertia is None else np.array(own.inertia)
        links[link.name] = Link(
            float(own.mass or 0.0), place[:3, 3], turn @ inertia @ turn.T, at[:3, 3]
        )
    return Mechanism(roots[0], links, joints)


def _urdf_joint(path: Path, joint: Any, at: NDArray) -> JointSpec:
    if joint.type not in get_args(JointType):
        raise ExportError(f"{path}: joint {joint.name}: {choices(joint.type, get_args(JointType))}")
    limit, dynamics, mimic = joint.limit, joint.dynamics, joint.mimic
    bounded = joint.type in ("revolute", "prismatic")
    if bounded and (limit is None or limit.lower is None or limit.upper is None):
        raise ExportError(f"{path}: joint {joint.name} is {joint.type} and lacks lower or upper")
    return JointSpec(
        name=joint.name,
        type=joint.type,
        parent=joint.parent,
        child=joint.child,
        pos=triple(at[:3, 3]),
        axis=triple(at[:3, :3] @ joint.axis) if joint.type != "fixed" else (0, 0, 1),
        lower=limit.lower if bounded else 0.0,
        upper=limit.upper if bounded else 0.0,
        damping=dynamics.damping or 0.0 if dynamics else 0.0,
        friction=dynamics.friction or 0.0 if dynamics else 0.0,
        # Some files write 0 for "none", which would mean a joint that cannot be driven.
        effort=limit.effort or None if limit else None,
        velocity=limit.velocity or None if limit else None,
        mimic=None
        if mimic is None
        else Mimic(
            joint=mimic.joint,
            multiplier=1.0 if mimic.multiplier is None else mimic.multiplier,
            offset=mimic.offset or 0.0,
        ),
    )


def read_mjcf(path: Path, spec: ObjectSpec, name: str | None = None) -> Mechanism:
    """Read an object of an MJCF file of ours, exported object or scene.

    Args:
        path: the file.
        spec: the object that should be there; only names of parts and joints are taken from it.
        name: the object's name in a scene; None is its own.

    Raises:
        ExportError: the file lacks the object or one of its parts or joints.
    """
    model = mujoco.MjModel.from_xml_path(str(path))
    owner = name or spec.name
    rest = mujoco.MjData(model)
    rest.qpos[:] = model.qpos0
    mujoco.mj_kinematics(model, rest)
    mujoco.mj_comPos(model, rest)

    def find(kind: mujoco.mjtObj, what: str) -> int:
        found = mujoco.mj_name2id(model, kind, what)
        if found < 0:
            raise ExportError(f"{path}: no {kind.name[6:].lower()} named {what!r}")
        return found

    def body(part: str) -> int:
        full = body_name(spec, part).removeprefix(spec.name)
        return find(mujoco.mjtObj.mjOBJ_BODY, owner + full)

    root = body(spec.root)
    base = Pose(rest.xpos[root], rest.xquat[root]).inverse()
    links = {}
    for part in spec.parts:
        b = body(part.name)
        turn = matrix(base.quat) @ rest.ximat[b].reshape(3, 3)
        links[part.name] = Link(
            float(model.body_mass[b]),
            base.apply(rest.xipos[b]),
            turn @ np.diag(model.body_inertia[b]) @ turn.T,
            base.apply(rest.xpos[b]),
        )
    joints = {}
    ties = {
        int(model.eq_obj1id[e]): e
        for e in range(model.neq)
        if model.eq_type[e] == mujoco.mjtEq.mjEQ_JOINT
    }
    for joint in spec.joints:
        common: dict[str, Any] = {"name": joint.name, "parent": joint.parent, "child": joint.child}
        b = body(joint.child)
        if model.body_parentid[b] != body(joint.parent):
            raise ExportError(f"{path}: {joint.child} does not hang on {joint.parent}")
        if model.body_jntnum[b] == 0:
            at = triple(base.apply(rest.xpos[b]))
            joints[joint.name] = JointSpec(**common, type="fixed", pos=at)
            continue
        j = find(mujoco.mjtObj.mjOBJ_JOINT, f"{owner}/{joint.name}")
        slide = model.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE
        ball = model.jnt_type[j] == mujoco.mjtJoint.mjJNT_BALL
        limited = bool(model.jnt_limited[j])
        dof = model.jnt_dofadr[j]
        hinge = "revolute" if limited else "continuous"
        joints[joint.name] = JointSpec(
            **common,
            type="ball" if ball else "prismatic" if slide else hinge,
            pos=triple(base.apply(rest.xanchor[j])),
            axis=(0, 0, 1) if ball else triple(rotate(base.quat, rest.xaxis[j])),
            lower=float(model.jnt_range[j, 0]) if limited else 0.0,
            upper=float(model.jnt_range[j, 1]) if limited else 0.0,
            damping=float(model.dof_damping[dof]),
            friction=float(model.dof_frictionloss[dof]),
            stiffness=float(model.jnt_stiffness[j]),
            armature=float(model.dof_armature[dof]),
            effort=float(model.jnt_actfrcrange[j, 1]) if model.jnt_actfrclimited[j] else None,
            mimic=_mjcf_mimic(model, ties[j], owner) if j in ties else None,
        )
    return Mechanism(spec.root, links, joints)


def _mjcf_mimic(model: mujoco.MjModel, e: int, owner: str) -> Mimic:
    leader = model.joint(int(model.eq_obj2id[e])).name.removeprefix(f"{owner}/")
    return Mimic(
        joint=leader, multiplier=float(model.eq_data[e, 1]), offset=float(model.eq_data[e, 0])
    )


def triple(values: NDArray) -> tuple[float, float, float]:
    """Turn three numbers of NumPy into plain ones."""
    x, y, z = (float(v) for v in values)
    return x, y, z


__all__ = [
    "Link",
    "Mechanism",
    "mechanism",
    "read_mjcf",
    "read_urdf",
    "triple",
]
