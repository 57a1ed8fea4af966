"""The model of a robot: read from its files, made simple, and added to the model of a scene."""

from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..errors import SpecError, choices
from ..export.compile_mjcf import check_files, compiled
from ..io.limited_worker import call_limited
from ..physics.mjcf import VISUAL_GROUP
from ..spec.pose import IDENTITY, conjugate, from_matrix, quat_mul, rotate
from .robots import PREFIX, SITES, TOOL, Mount, Robot

RATE = 50.0
"""Natural frequency of the position actuators that replace a file's motors [rad/s]."""
FILTER_S = 0.005
"""Time constant of the filter through which targets reach the actuators of the arm [s], as robots'
controllers smooth commands. A target that jumps shakes what the fingers hold out of them."""
PAD = {"condim": 4, "priority": 1, "friction": [1.0, 0.02, 1e-4], "solref": [0.004, 1.0]}
"""Contacts of fingers, as those of the free gripper (`physics.gripper`)."""
ONE_JAW_M = 0.012
"""Distance of the tool from the site, if only one finger moves and the site is at the other [m]."""
STAND_M = 0.08
"""Half the width of a stand in pictures [m]."""
GROUP = 5
"""Group of the geoms of a robot that collide."""
_MOVES = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))


class RobotSpec(NamedTuple):
    """A robot's specification, ready to be attached, and how its gripper works."""

    spec: mujoco.MjSpec
    arm: tuple[str, ...]
    """Joints between the base and the tool."""
    home: NDArray
    """Positions of the arm's joints [rad or m], shape [arm]."""
    fingers: tuple[str, ...]
    """All other joints."""
    closed: NDArray
    """Positions of the fingers when they are together [rad or m], shape [finger]."""
    opened: NDArray
    grip: tuple[str, ...]
    """Actuators of the fingers."""
    grip_targets: NDArray
    """Controls of these: full force, together, and open, shape [grip, 3]."""


def read_robot(
    robot: Robot, *, visual: bool = False, links: bool = True, mjx: bool = False
) -> RobotSpec:
    """Read a robot's files.

    Every mesh that collides becomes a box or a capsule around it, robots do not collide with
    themselves, and their weight is compensated. Motors of the arm become position actuators with
    the limits of the motors; position actuators stay. Targets of the arm pass through a filter.

    Args:
        robot: the robot.
        visual: if True, keep geoms that do not collide.
        links: if False, only the hand and the fingers collide.
        mjx: if True, set condim 3 and priority 0 on all geoms, as `mjx_step` requires.

    Raises:
        SpecError: a file is broken or hostile, or has no arm with a gripper and a tool site.
    """
    r = _read(robot, visual)
    home = _home(r)
    closed, opened = _stroke(r)
    quat = _tool_axes(r, closed, opened)
    _add_tool(r, quat)
    actuators = list(r.spec.actuators)
    grip, targets = _grip(r, actuators, closed, opened)
    _position_actuators(r, actuators)
    _simplify(r, links, visual)
    for geom in r.spec.geoms if mjx else ():
        geom.condim, geom.priority = 3, 0
    names = [r.model.joint(j).name for j in range(r.model.njnt)]
    return RobotSpec(
        spec=r.spec,
        arm=tuple(names[j] for j in r.arm),
        home=home,
        fingers=tuple(names[j] for j in r.fingers),
        closed=closed,
        opened=opened,
        grip=grip,
        grip_targets=targets,
    )


def attach_robot(
    model: mujoco.MjSpec, robot: RobotSpec, mount: Mount, ground: float | None = None
) -> None:
    """Add a robot to a model specification. Its coordinates follow the existing coordinates.

    Args:
        model: the specification.
        robot: the robot, which can be attached once.
        mount: where its base stands.
        ground: height of the surface below the base [m]; if given, pictures show a stand on it.
    """
    frame = model.worldbody.add_frame(pos=mount.pos, quat=mount.quat)
    model.attach(robot.spec, prefix=f"{PREFIX}-", frame=frame)
    half = 0.0 if ground is None else (mount.pos[2] - ground) / 2
    if half > 0.005:
        stand = frame.add_geom(name=f"{PREFIX}-stand", type=mujoco.mjtGeom.mjGEOM_BOX)
        stand.pos, stand.size = [0.0, 0.0, -half], [STAND_M, STAND_M, half]
        stand.rgba, stand.mass = [0.35, 0.35, 0.37, 1.0], 0.0
        stand.contype, stand.conaffinity, stand.group = 0, 0, VISUAL_GROUP


class _Read(NamedTuple):
    """A robot as it is read."""

    robot: Robot
    spec: mujoco.MjSpec
    """Its specification, which changes; the indices are those of `model`."""
    model: mujoco.MjModel
    """The compiled specification, as it was read."""
    data: mujoco.MjData
    site: mujoco.MjsSite
    """Site between the fingers, in the specification."""
    arm: list[int]
    fingers: list[int]


def _read(robot: Robot, visual: bool) -> _Read:
    """Return a robot whose joints are those of an arm and of its fingers."""
    spec = _specification(robot)
    if not visual:
        for geom in list(spec.geoms):
            default = geom.contype == 0 and geom.conaffinity == 0
            if default or geom.parent == spec.worldbody:
                spec.delete(geom)
    model = _compile(spec, robot)
    site = _tool_site(spec, robot)
    chain = _chain(model, int(model.site_bodyid[site.id]))
    arm = [j for j in range(model.njnt) if model.jnt_bodyid[j] in chain]
    fingers = [j for j in range(model.njnt) if j not in arm]
    for j in (*arm, *fingers):
        if int(model.jnt_type[j]) not in _MOVES:
            raise SpecError(f"robot {robot.file}: joint {model.joint(j).name} is no hinge or slide")
    if not arm or not fingers:
        raise SpecError(f"robot {robot.file}: site {site.name} is not on an arm with fingers")
    return _Read(robot, spec, model, mujoco.MjData(model), site, arm, fingers)


def _specification(robot: Robot) -> mujoco.MjSpec:
    files = [robot.file] + ([robot.hand] if robot.hand else [])
    for file in files if not robot.trusted else ():
        check_files(file)
        _compile_limited(file, file.stat().st_mtime_ns)
    try:
        arm, *hands = (mujoco.MjSpec.from_file(str(file)) for file in files)
        for hand in hands:
            flange = arm.body(robot.flange)
            if flange is None:
                raise SpecError(f"robot {robot.file}: there is no body {robot.flange}")
            arm.attach(hand, prefix="hand-", frame=flange.add_frame())
    except (ValueError, mujoco.FatalError) as error:
        raise SpecError(f"robot {robot.file} is refused by MuJoCo: {error}") from None
    arm.compiler.discardvisual = False
    arm.compiler.fusestatic = False
    return arm


@lru_cache(maxsize=16)
def _compile_limited(file: Path, _changed_ns: int) -> None:
    """Compile a file in a worker with limits, once for each version of it."""
    call_limited(_compiles, file)


def _compiles(path: Path) -> None:
    compiled(path)


def _compile(spec: mujoco.MjSpec, robot: Robot) -> mujoco.MjModel:
    try:
        return spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise SpecError(f"robot {robot.file} is refused by MuJoCo: {error}") from None


def _tool_site(spec: mujoco.MjSpec, robot: Robot) -> mujoco.MjsSite:
    names = [site.name for site in spec.sites]
    for name in (robot.tool,) if robot.tool else SITES:
        if name in names:
            return spec.site(name)
    raise SpecError(
        f"robot {robot.file}: no site between the fingers: "
        + choices(robot.tool or SITES[0], [name for name in names if name] or ["(no site)"])
    )


def _chain(model: mujoco.MjModel, body: int) -> set[int]:
    chain = set()
    while body:
        chain.add(body)
        body = int(model.body_parentid[body])
    return chain


def _home(r: _Read) -> NDArray:
    """Set the data to the arm's initial positions, and return these."""
    robot, model, arm, data = r.robot, r.model, r.arm, r.data
    if model.nkey:
        data.qpos[:] = model.key_qpos[0]
    where = model.jnt_qposadr[arm]
    if robot.home:
        if len(robot.home) != len(arm):
            raise SpecError(f"robot {robot.file}: home has {len(robot.home)} of {len(arm)} joints")
        data.qpos[where] = robot.home
    limited = model.jnt_limited[arm].astype(bool)
    low, high = model.jnt_range[arm].T
    home = np.where(limited, np.clip(data.qpos[where], low, high), data.qpos[where])
    data.qpos[where] = home
    return home


def _stroke(r: _Read) -> tuple[NDArray, NDArray]:
    """Return the positions of the fingers when closed, and when open: farther from the tool."""
    model, data = r.model, r.data
    ends = model.jnt_range[r.fingers].copy()
    for j, row in zip(r.fingers, ends, strict=True):
        distances = []
        for value in row:
            data.qpos[model.jnt_qposadr[j]] = value
            mujoco.mj_kinematics(model, data)
            apart = data.xipos[model.jnt_bodyid[j]] - data.site_xpos[r.site.id]
            distances.append(np.linalg.norm(apart))
        if distances[0] > distances[1]:
            row[:] = row[::-1]
    closed, opened = ends.T
    if r.robot.opened:
        if len(r.robot.opened) != len(r.fingers):
            raise SpecError(f"robot {r.robot.file}: opened has not {len(r.fingers)} joints")
        opened = np.array(r.robot.opened)
    return closed, opened


def _tool_axes(r: _Read, closed: NDArray, opened: NDArray) -> NDArray:
    """Close the fingers, and return the tool's orientation: z out of the palm, y to close along."""
    model, data = r.model, r.data
    data.qpos[model.jnt_qposadr[r.fingers]] = closed
    mujoco.mj_forward(model, data)
    tool, j = data.site_xpos[r.site.id], r.fingers[0]
    axis = data.xaxis[j] * np.sign(opened[0] - closed[0])
    if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE:
        axis = np.cross(axis, tool - data.xanchor[j])
    out = tool - data.xpos[model.body_parentid[model.jnt_bodyid[j]]]
    y = axis / np.linalg.norm(axis)
    z = out - (out @ y) * y
    z = z / np.linalg.norm(z)
    return from_matrix(np.column_stack([np.cross(y, z), y, z]))


def _add_tool(r: _Read, quat: NDArray) -> None:
    """Add the tool's site; if only one finger moves, it is nearer to this finger."""
    site, body = r.site, int(r.model.site_bodyid[r.site.id])
    aside = ONE_JAW_M if len(r.fingers) == 1 else 0.0
    if site.name == TOOL:
        site.name = f"{TOOL}-given"
    local = quat_mul(conjugate(r.data.xquat[body]), quat)
    pos = r.model.site_pos[site.id] + rotate(local, (0.0, aside, 0.0))
    added = r.spec.bodies[body].add_site(name=TOOL, quat=local, pos=pos)
    added.group = GROUP


def _is_position(model: mujoco.MjModel, actuator: int) -> bool:
    return bool(model.actuator_biasprm[actuator, 1] < 0)


def _position_actuators(r: _Read, actuators: list[mujoco.MjsActuator]) -> None:
    """Replace the arm's actuators that control no positions, and filter all targets."""
    model, inertia = r.model, np.zeros((r.model.nv, r.model.nv))
    mujoco.mj_fullM(model, r.data, inertia)
    on_joint = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
    for j in r.arm:
        own = np.flatnonzero(on_joint & (model.actuator_trnid[:, 0] == j)).tolist()
        motors = [a for a in own if not _is_position(model, a)]
        for a in motors:
            r.spec.delete(actuators[a])
        for a in set(own) - set(motors):
            if model.actuator_dyntype[a] == mujoco.mjtDyn.mjDYN_NONE:
                actuators[a].dyntype = mujoco.mjtDyn.mjDYN_FILTEREXACT
                actuators[a].dynprm[0] = FILTER_S
        if len(motors) < len(own):
            continue
        limited = [a for a in own if model.actuator_ctrllimited[a]]
        limit = np.sum(
            np.abs(model.actuator_gear[limited, 0]) * model.actuator_ctrlrange[limited, 1]
        )
        mass = inertia[model.jnt_dofadr[j], model.jnt_dofadr[j]]
        added = r.spec.add_actuator(
            name=f"{model.joint(j).name}-position",
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
            target=model.joint(j).name,
        )
        added.set_to_position(kp=mass * RATE**2, kv=2 * mass * RATE, timeconst=FILTER_S)
        if limited:
            added.forcelimited = 1
            added.forcerange = [-limit, limit]


def _grip(
    r: _Read, actuators: list[mujoco.MjsActuator], closed: NDArray, opened: NDArray
) -> tuple[tuple[str, ...], NDArray]:
    """Return the actuators of the fingers and their controls: full force, together, open."""
    model, data = r.model, mujoco.MjData(r.model)
    lengths, names, targets = [], [], []
    for ends in (closed, opened):
        data.qpos[:] = 0.0
        data.qpos[model.jnt_qposadr[r.fingers]] = ends
        mujoco.mj_fwdPosition(model, data)
        lengths.append(data.actuator_length.copy())
    for a, (shut, wide) in enumerate(zip(*lengths, strict=True)):
        if shut == wide or not _is_position(model, a):
            continue
        gain, stiffness = model.actuator_gainprm[a, 0], -model.actuator_biasprm[a, 1]
        force = stiffness * abs(wide - shut)
        if model.actuator_forcelimited[a]:
            force = model.actuator_forcerange[a, 1]
        control = lambda length, push=0.0, g=gain, k=stiffness: (push + k * length) / g
        full = control(shut, np.sign(shut - wide) * force)
        targets.append([full, control(shut), control(wide)])
        actuator = actuators[a]
        actuator.ctrllimited = 0
        actuator.name = actuator.name or f"grip_{a}"
        names.append(actuator.name)
    if not names:
        raise SpecError(f"robot {r.robot.file}: no position actuator moves the fingers")
    return tuple(names), np.array(targets)


def _simplify(r: _Read, links: bool, visual: bool) -> None:
    """Make colliders simple, and keep what the compiler would derive from removed geoms."""
    spec, model, data = r.spec, r.model, r.data
    hand = int(model.body_weldid[model.site_bodyid[r.site.id]])
    moved = {int(model.jnt_bodyid[j]) for j in r.fingers}
    fingers = {b for b in range(model.nbody) if _chain(model, b) & moved}
    root = {b for b in range(model.nbody) if model.body_weldid[b] == 0}
    for body in spec.bodies:
        if b := body.id:
            body.mass, body.ipos, body.iquat = (
                model.body_mass[b],
                model.body_ipos[b],
                model.body_iquat[b],
            )
            body.inertia = model.body_inertia[b]
            body.fullinertia = [np.nan] * 6
            body.explicitinertial = True
            body.gravcomp = 1.0
    quat = quat_mul(data.xquat[model.site_bodyid[r.site.id]], np.array(spec.site(TOOL).quat))
    # Pictures show the colliders of a robot that has no other geoms.
    bare = visual and bool(np.all(model.geom_contype | model.geom_conaffinity))
    for g, geom in enumerate(list(spec.geoms)):
        body = int(model.geom_bodyid[g])
        in_gripper = body in fingers or int(model.body_weldid[body]) == hand
        collides = bool(model.geom_contype[g] or model.geom_conaffinity[g])
        if not collides:
            geom.group = VISUAL_GROUP
            continue
        touches = geom.name in r.robot.pads or not (in_gripper and r.robot.pads)
        if body in root or not touches or not (in_gripper or links):
            if bare:
                geom.contype, geom.conaffinity, geom.group = 0, 0, VISUAL_GROUP
            else:
                spec.delete(geom)
            continue
        # The robot collides with the scene, whose geoms have contype 1, and not with itself.
        geom.contype, geom.conaffinity = 0, 1
        geom.group = VISUAL_GROUP if bare else GROUP
        if in_gripper:
            for field, value in PAD.items():
                setattr(geom, field, value)
        if not visual:
            geom.material = ""
        if model.geom_type[g] == mujoco.mjtGeom.mjGEOM_MESH:
            _fit(r, geom, g, quat if in_gripper else None, body in fingers)
    unused = () if visual else (spec.meshes, spec.materials, spec.textures)
    for kind in (spec.keys, spec.sensors, *unused):
        for element in list(kind):
            spec.delete(element)


TRIM_M = 0.0005
"""Distance of a finger's box from the plane in which the fingers meet [m]; pads stand out."""


def _fit(r: _Read, geom: mujoco.MjsGeom, g: int, tool: NDArray | None, trim: bool) -> None:
    """Turn a geom of a mesh into a primitive around the mesh.

    Links become capsules along their longest axis. Geoms of the gripper become boxes with the axes
    of the tool, and fingers end where they meet.
    """
    model, data, origin = r.model, r.data, r.data.site_xpos[r.site.id]
    mesh = model.geom_dataid[g]
    first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    own = data.geom_xmat[g].reshape(3, 3)
    points = model.mesh_vert[first : first + count] @ own.T + data.geom_xpos[g]
    body = int(model.geom_bodyid[g])
    axes = IDENTITY
    if tool is None:
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, data.geom_xmat[g])
    else:
        quat = tool
    local = rotate(conjugate(quat), points - origin)
    low, high = local.min(axis=0), local.max(axis=0)
    if tool is not None and trim:
        if high[1] + low[1] > 0:
            low[1] = max(low[1], TRIM_M)
        else:
            high[1] = min(high[1], -TRIM_M)
    half = np.maximum((high - low) / 2, 1e-3)
    center = rotate(quat, (low + high) / 2) + origin
    geom.type = mujoco.mjtGeom.mjGEOM_BOX
    geom.size = half
    if tool is None:
        long = int(half.argmax())
        radius = float(np.delete(half, long).mean())
        geom.type = mujoco.mjtGeom.mjGEOM_CAPSULE
        geom.size = [radius, max(float(half[long]) - radius, 1e-3), 0.0]
        turn = {0: (0.5**0.5, 0.0, 0.5**0.5, 0.0), 1: (0.5**0.5, 0.5**0.5, 0.0, 0.0)}
        axes = turn.get(long, IDENTITY)
    back = conjugate(data.xquat[body])
    geom.meshname = ""
    geom.fromto = [np.nan] * 6
    geom.pos = rotate(back, center - data.xpos[body])
    geom.quat = quat_mul(back, quat_mul(quat, np.array(axes)))
