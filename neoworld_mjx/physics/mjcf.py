"""Conversion of scenes to MuJoCo models, for physics, rendering, checks and exports.

Names in the model, for an object `o`, part `p`, geom `g`, joint `j`, site `s`:

    body    o (the root part), o-p (every other part)      joint   o (free), o-j
    geom    o-g-k (k-th convex piece), o-g-visual          mesh    the name of its geom
    site    o-s                                            equality o-j (a mimic)
    key     start (the scene's poses and joint states)     camera  photo

The frame of a root body is the object's frame. The frame of any other body has its origin at the
anchor of the body's joint, and the object's orientation. Every joint is thus at its body's origin.
"""

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..errors import SpecError
from ..spec import (
    Camera,
    GeomSpec,
    JointSpec,
    ObjectSpec,
    PartSpec,
    SceneObject,
    SceneSpec,
    inertial,
    joint_motion,
    joint_position,
    single_object_scene,
    world_poses,
)
from ..spec.convex import Piece
from ..spec.kinematics import welded
from ..spec.mass import inertia_about, inertia_fault
from ..spec.pose import Pose, pose

COLLISION_GROUP, VISUAL_GROUP = 0, 1
START = "start"
"""Name of the keyframe with the scene's poses and joint states."""
JOINT_FRICTION_IMPEDANCE = 0.999
"""Impedance of dry friction in joints. At MuJoCo's default of 0.9, a lid that friction should hold
creeps by degrees per second, however large the friction."""

PIXEL_M = 1e-5
"""Edge of a pixel of exported sensors with a principal point [m]; images do not depend on it."""
IMPRATIO = 10.0
"""Ratio of the impedances of friction and normal force. Friction that is stiffer than MuJoCo's
default keeps resting objects from creeping."""
CONTACT_TIME_S = 0.01
"""Time constant of contacts [s], half of MuJoCo's default. The depth of a resting contact is
proportional to the square of this constant (MuJoCo's documentation, Solver parameters)."""

GEOM_TYPES = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "ellipsoid": mujoco.mjtGeom.mjGEOM_ELLIPSOID,
    "mesh": mujoco.mjtGeom.mjGEOM_MESH,
}


def to_mjspec(
    scene: SceneSpec | ObjectSpec, *, visual: bool = False, timestep: float = 0.002
) -> mujoco.MjSpec:
    """Convert a scene, or a single free object, to a MuJoCo specification.

    - Each convex piece becomes a collision geom of group 0, with a separate mesh asset if needed.
    - Masses are explicit and come from `spec.inertial`.
    - Parts that are fixed to opposite sides of a moving joint never collide with each other.
      MuJoCo's own filter ensures this for free objects only.
    - An effort limit becomes the joint's actuatorfrcrange, which limits actuators that a user adds.
      Velocity limits have no counterpart.
    - The reference position of every hinge and slide joint is 0. The keyframe "start" contains the
      scene's state.

    Args:
        scene: the scene. A single ObjectSpec becomes a free object at the origin.
        visual: if True, add smooth visual geoms in group 1.
        timestep: time step of the simulation [s].

    Returns:
        A specification that refers to no files. Equal inputs give identical XML.
    """
    if isinstance(scene, ObjectSpec):
        scene = single_object_scene(scene)
    model = mujoco.MjSpec()
    model.modelname = scene.name
    model.compiler.degree = False
    model.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    model.compiler.alignfree = False
    model.option.timestep = timestep
    model.option.gravity = scene.gravity
    model.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    model.option.impratio = IMPRATIO
    if scene.camera is not None:
        _add_camera(model, scene.camera)
    poses = world_poses(scene)
    start: list[float] = []
    for item in scene.objects:
        start += _add_object(model, item, poses[item.name], visual)
    if start:
        model.add_key(name=START, qpos=start)
    return model


def start_data(model: mujoco.MjModel) -> mujoco.MjData:
    """Return data of a compiled scene in its composed state, before any kinematics."""
    data = mujoco.MjData(model)
    if model.nkey:  # a scene without joints has no keyframe
        mujoco.mj_resetDataKeyframe(model, data, model.key(START).id)
    return data


def joint_order(spec: ObjectSpec) -> list[JointSpec]:
    """List the joints that have coordinates, in the order of qpos: depth first."""
    return [joint for _, joint in _depth_first(spec) if joint is not None and joint.type != "fixed"]


def body_name(item: SceneObject | ObjectSpec, part: str) -> str:
    """Return the name of the body of a part of an object."""
    spec = item if isinstance(item, ObjectSpec) else item.spec
    return item.name if part == spec.root else f"{item.name}-{part}"


def object_of_body(model: mujoco.MjModel, names: Sequence[str]) -> NDArray:
    """Return the index of the object of each body, -1 for none, shape [nbody]."""
    owners = [model.body(b).name.split("-", 1)[0] for b in range(model.nbody)]
    return np.array([names.index(name) if name in names else -1 for name in owners], int)


def visual_name(owner: str, geom: GeomSpec) -> str:
    """Return the name of the visual geom for a geom of the object `owner`."""
    return f"{owner}-{geom.name}-visual"


def _add_camera(model: mujoco.MjSpec, camera: Camera) -> None:
    placement = camera.pose()
    lens: dict[str, Any] = {"fovy": math.degrees(camera.fovy)}
    if any(camera.principal):
        # MuJoCo's values are those of the image's middle relative to the principal point.
        x, y = camera.principal
        lens = {
            "focal_pixel": [camera.focal, camera.focal],
            "principal_pixel": [-x, -y],
            "sensor_size": [camera.width * PIXEL_M, camera.height_px * PIXEL_M],
        }
    model.worldbody.add_camera(
        name="photo",
        pos=placement.pos,
        quat=placement.quat,
        resolution=[camera.width, camera.height_px],
        **lens,
    )


def _add_object(
    model: mujoco.MjSpec, item: SceneObject, base_pose: Pose, visual: bool
) -> list[float]:
    """Add one object and return its coordinates in the keyframe."""
    spec = item.spec
    start: list[float] = []
    bodies: dict[str, mujoco.MjsBody] = {}
    origins: dict[str, np.ndarray] = {}
    for part, joint in _depth_first(spec):
        if joint is None:
            origin = np.zeros(3)
            body = model.worldbody.add_body(name=item.name, pos=base_pose.pos, quat=base_pose.quat)
            if not item.static:
                free = body.add_freejoint(name=item.name)
                free.align = mujoco.mjtAlignFree.mjALIGNFREE_FALSE
                start += [*base_pose.pos, *base_pose.quat]
        else:
            origin = np.array(joint.pos)
            body = bodies[joint.parent].add_body(
                name=f"{item.name}-{part.name}", pos=origin - origins[joint.parent]
            )
            if joint.type != "fixed":
                added = _add_joint(body, item.name, joint)
                inertia = inertia_about(joint, inertial(spec, part)) + joint.armature
                # Stiff friction would drive a joint that damping alone stops within a step.
                if joint.friction > 0 and model.option.timestep * joint.damping < inertia:
                    added.solimp_friction[:2] = JOINT_FRICTION_IMPEDANCE
                start += _coordinates(spec, joint, item.joint_state)
        bodies[part.name], origins[part.name] = body, origin
        mass = inertial(spec, part)
        if (fault := inertia_fault(part, mass)) is not None:
            raise SpecError(f"object {item.name}: {fault}")
        body.mass = mass.mass
        body.ipos = np.array(mass.pos) - origin
        body.iquat = mass.quat
        body.inertia = mass.diagonal
        body.explicitinertial = True
        _add_geoms(model, body, item.name, spec, part, origin, visual)
        for site in spec.sites:
            if site.part == part.name:
                body.add_site(name=f"{item.name}-{site.name}", pos=np.array(site.pos) - origin)
    _add_mimics(model, item)
    _add_excludes(model, item)
    return [float(v) for v in start]


def _coordinates(spec: ObjectSpec, joint: JointSpec, joint_state: dict[str, float]) -> list[float]:
    """Return a joint's coordinates in qpos: one value, or the quaternion of a ball joint."""
    value = joint_position(spec, joint, joint_state)
    return joint_motion(joint, value).quat.tolist() if isinstance(value, tuple) else [value]


_JOINTS = {
    "prismatic": mujoco.mjtJoint.mjJNT_SLIDE,
    "ball": mujoco.mjtJoint.mjJNT_BALL,
    "revolute": mujoco.mjtJoint.mjJNT_HINGE,
    "continuous": mujoco.mjtJoint.mjJNT_HINGE,
}


def _add_joint(body: mujoco.MjsBody, owner: str, joint: JointSpec) -> mujoco.MjsJoint:
    limited = joint.type in ("revolute", "prismatic") or (joint.type == "ball" and joint.upper > 0)
    added = body.add_joint(
        name=f"{owner}-{joint.name}",
        type=_JOINTS[joint.type],
        axis=joint.axis,
        limited=int(limited),
        damping=joint.damping,
        frictionloss=joint.friction,
        stiffness=joint.stiffness,
        armature=joint.armature,
    )
    if limited:
        added.range = [joint.lower, joint.upper]
    if joint.effort is not None:
        added.actfrclimited = mujoco.mjtLimited.mjLIMITED_TRUE
        added.actfrcrange = [-joint.effort, joint.effort]
    return added


def _add_geoms(
    model: mujoco.MjSpec,
    body: mujoco.MjsBody,
    owner: str,
    spec: ObjectSpec,
    part: PartSpec,
    origin: np.ndarray,
    visual: bool,
) -> None:
    for geom in part.geoms:
        material = spec.material(geom.material)

        if geom.role != "visual":
            for k, piece in enumerate(geom.shape.pieces()):
                piece_pose = geom.pose().then(pose(piece.pos, piece.quat))
                added = body.add_geom(
                    name=f"{owner}-{geom.name}-{k}",
                    group=COLLISION_GROUP,
                    type=GEOM_TYPES[piece.kind],
                    size=piece.size,
                    pos=piece_pose.pos - origin,
                    quat=piece_pose.quat,
                    condim=3,
                    rgba=material.rgba,
                    solref=[CONTACT_TIME_S, 1.0],
                )
                # Condim 3 ignores torsional and rolling friction.
                added.friction[0] = material.friction
                if piece.kind == "mesh":
                    _add_piece_mesh(model, added.name, piece)
                    added.meshname = added.name
        if visual and geom.role != "collision":
            _add_visual(model, body, visual_name(owner, geom), geom, origin, material.rgba)


def _add_piece_mesh(model: mujoco.MjSpec, name: str, piece: Piece) -> None:
    mesh = model.add_mesh(name=name)
    mesh.uservert = np.array(piece.vertices).ravel()
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX


def _add_visual(
    model: mujoco.MjSpec,
    body: mujoco.MjsBody,
    name: str,
    geom: GeomSpec,
    origin: np.ndarray,
    rgba: tuple[float, ...],
) -> None:
    added = body.add_geom(
        name=name,
        group=VISUAL_GROUP,
        contype=0,
        conaffinity=0,
        mass=0,
        pos=geom.pose().pos - origin,
        quat=geom.quat,
        rgba=rgba,
    )
    primitive = geom.shape.primitive()
    if primitive is not None:
        added.type = GEOM_TYPES[primitive.kind]
        added.size = primitive.size
        return
    vertices, faces = geom.shape.surface()
    mesh = model.add_mesh(name=name)
    mesh.uservert = vertices.ravel()
    mesh.userface = faces.ravel()
    # Open surfaces need this mode; visual geoms have no mass.
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    added.type = mujoco.mjtGeom.mjGEOM_MESH
    added.meshname = name


def _add_mimics(model: mujoco.MjSpec, item: SceneObject) -> None:
    joints = {joint.name: joint for joint in item.spec.joints}
    for joint in joint_order(item.spec):
        if joint.mimic is None:
            continue
        equality = model.add_equality(
            name=f"{item.name}-{joint.name}",
            type=mujoco.mjtEq.mjEQ_JOINT,
            name1=f"{item.name}-{joint.name}",
        )
        equality.data[:5] = [joint.mimic.offset, joint.mimic.multiplier, 0.0, 0.0, 0.0]
        # Without a movable leader the equality constrains the follower to a constant.
        if joints[joint.mimic.joint].type != "fixed":
            equality.name2 = f"{item.name}-{joint.mimic.joint}"


def _add_excludes(model: mujoco.MjSpec, item: SceneObject) -> None:
    for a, b in excluded_pairs(item.spec):
        one, two = body_name(item, a), body_name(item, b)
        model.add_exclude(name=f"{one}:{two}", bodyname1=one, bodyname2=two)


def excluded_pairs(spec: ObjectSpec) -> list[tuple[str, str]]:
    """List pairs of parts that never collide, since they are fixed to opposite sides of a joint."""
    group = welded(spec)
    members: dict[str, list[str]] = {}
    for part in spec.parts:
        members.setdefault(group[part.name], []).append(part.name)
    pairs = []
    for joint in spec.joints:
        if joint.type == "fixed":
            pairs.append((joint.parent, joint.child))
            continue
        pairs += itertools.product(members[group[joint.parent]], members[group[joint.child]])
    return pairs


def _depth_first(spec: ObjectSpec) -> Iterator[tuple[PartSpec, JointSpec | None]]:
    joints = {joint.child: joint for joint in spec.joints}

    def visit(name: str) -> Iterator[tuple[PartSpec, JointSpec | None]]:
        yield spec.part(name), joints.get(name)
        for part in spec.parts:
            joint = joints.get(part.name)
            if joint is not None and joint.parent == name:
                yield from visit(part.name)

    return visit(spec.root)
