"""Reads the mechanisms of a USD file that uses UsdGeom, UsdShade and UsdPhysics.

A file may contain several objects, in any unit and with Y or Z up. Rigid bodies that are connected
by joints form one object. The mechanism of an object has all joints at zero, independent of the
joint positions in the stage.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Tf, Usd, UsdGeom, UsdPhysics, UsdShade

from ..errors import SpecError
from ..spec.base import Vec3
from ..spec.pose import triple
from .checked_usd import open_usd
from .link_frames import unused
from .mechanism import Assembly, Link, Mechanism, unchecked_site
from .read_usd_joints import JointReader, StageJoint, is_joint, rotation_matrix, state_of
from .read_usd_shapes import shapes_of, unscaled

WORLD = "world"
"""Name of the link that represents the world if a movable joint attaches an object to the world."""
MAX_NUMBER = 1e6
"""Largest absolute value of the entries of a transform: coordinates [m] and scales."""
_Z_UP = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
_LEFT_OUT = ("PointInstancer", "BasisCurves", "NurbsPatch", "Points", "Skeleton", "Volume", "Plane")


@dataclass
class _Body:
    prim: Usd.Prim
    raw: NDArray
    """Transform from the prim's frame to the world frame, with scale [m], shape [4, 4]."""
    rigid: NDArray
    """Transform from the prim's frame to the world frame, without scale [m], shape [4, 4]."""
    dynamic: bool
    shapes: list[tuple[Usd.Prim, NDArray]] = field(default_factory=list)


def read_usd(path: Path, object_path: str | None = None) -> Mechanism:
    """Read the only object in a USD file, or the only object in a prim of the file.

    Args:
        path: the file.
        object_path: path of the prim; the mechanism is in the frame of the prim. If None, the
            default prim (the whole stage if there is none) is read, and the mechanism is in the
            world frame.

    Raises:
        SpecError: the file is broken or hostile, the prim does not exist, or there are several
            objects.
    """
    return one_object(path, open_usd(Path(path)), object_path)


def one_object(path: Path, stage: Usd.Stage, object_path: str | None = None) -> Mechanism:
    """Read the only object of a stage; see `read_usd`."""
    assemblies = read_assemblies(path, stage, object_path, separate=False)
    objects = [assembly for assembly in assemblies if not assembly.no_rigid_body]
    if len(objects) > 1:
        paths = ", ".join(assembly.path for assembly in objects[:8])
        raise SpecError(f"{path} has {len(objects)} objects, not one: {paths}")
    result = (objects or assemblies)[0].mechanism
    if len(assemblies) > 1:
        result.notes.append("geometry outside of rigid bodies is not imported")
    return result


def read_assemblies(
    path: Path, stage: Usd.Stage, object_path: str | None = None, *, separate: bool
) -> list[Assembly]:
    """Read all objects of a stage, with their poses.

    Args:
        path: the stage's file, for messages.
        stage: the stage.
        object_path: path of the top prim, whose descendants are read. If None, the top prim is the
            default prim, or the root of the stage if there is no default prim.
        separate: if True, each object is in the frame of the object's prim, and geometry without a
            rigid body becomes one static object for each child of the top prim. If False, objects
            are in the frame of `object_path` (the world frame if it is None), and geometry without
            a rigid body becomes a single static object.

    Raises:
        SpecError: the prim does not exist, no geometry is visible or collides, or a mesh is
            broken.
    """
    try:
        return _assemblies(path, stage, object_path, separate)
    except (Tf.ErrorException, TypeError, ValueError, AttributeError, OverflowError) as error:
        # The type of an attribute in the file may differ from the type in the schema.
        message = " ".join(str(error).split())[:200]
        raise SpecError(f"{path} has a value that USD's schemas do not allow: {message}") from None


def _assemblies(
    path: Path, stage: Usd.Stage, object_path: str | None, separate: bool
) -> list[Assembly]:
    top = stage.GetPrimAtPath(object_path) if object_path else stage.GetDefaultPrim()
    if object_path and not top:
        raise SpecError(f"{path}: no prim at {object_path}")
    top = top or stage.GetPseudoRoot()
    file_notes: list[str] = []
    upright, to_meters = _world(stage)
    prims = list(Usd.PrimRange(top, Usd.TraverseInstanceProxies()))
    cache = UsdGeom.XformCache()

    def world_transform(prim: Usd.Prim) -> NDArray:
        # USD multiplies row vectors, hence the transpose.
        raw = to_meters @ np.array(cache.GetLocalToWorldTransform(prim)).T
        if not np.isfinite(raw).all() or np.abs(raw).max() > MAX_NUMBER:
            raise SpecError(f"{path}: the transform of {prim.GetPath()} is not finite or too large")
        return raw

    def frame_of(prim: Usd.Prim) -> NDArray:
        return _rigid(world_transform(prim)) @ upright.T

    bodies = _bodies(prims, world_transform)
    reader = JointReader(
        path, stage, world_transform, {p: body.rigid for p, body in bodies.items()}, file_notes
    )
    stage_joints = reader.stage_joints([prim for prim in prims if is_joint(prim)])
    loose: dict[str, _Body] = {}
    for prim in prims:
        if prim.IsA(UsdGeom.Gprim):
            owner = _owner(prim, bodies)
            if owner is None:
                group = _group(prim, top) if separate else top
                name = str(group.GetPath())
                if name not in loose:
                    loose[name] = _Body(group, world_transform(group), frame_of(group), False)
                owner = loose[name]
            owner.shapes.append((prim, world_transform(prim)))
        elif prim.GetTypeName() in _LEFT_OUT:
            file_notes.append(f"{prim.GetPath()} is a {prim.GetTypeName()}, which is not imported")
    file_notes += _unread(prims)
    shared = frame_of(top) if object_path else np.eye(4)
    result = []
    for names, inner_joints in _components(bodies, stage_joints):
        world_joints = [
            joint for joint in stage_joints if not joint.parent and joint.child in names
        ]
        container = _containing_child(top, names)
        frame = frame_of(container) if separate and container else shared
        result.append(_assembly(bodies, names, inner_joints, world_joints, frame, reader))
    for group, body in loose.items():
        frame = body.rigid if separate else shared
        notes: list[str] = []
        link = _link(body, "static", np.linalg.inv(frame), stage, notes)
        if not bodies or any(shape.role != "visual" for shape in link.shapes):
            name = group.rpartition("/")[2] or path.stem
            mechanism = Mechanism(name, {"static": link}, [], [], notes, file_notes)
            result.append(Assembly(group, mechanism, frame, fixed=True, no_rigid_body=True))
        else:
            file_notes += notes
    for assembly in result:
        if not assembly.mechanism.has_shapes:
            file_notes += assembly.mechanism.notes
    result = [assembly for assembly in result if assembly.mechanism.has_shapes]
    if not result:
        raise SpecError(f"{path} has no visible or colliding geometry")
    return result


def gravity_of(stage: Usd.Stage) -> Vec3 | None:
    """Return the gravity of a stage in axes with Z up [m/s^2], or None if it states no gravity."""
    upright, _ = _world(stage)
    for prim in stage.Traverse():
        if prim.IsA(UsdPhysics.Scene):
            scene = UsdPhysics.Scene(prim)
            magnitude = scene.GetGravityMagnitudeAttr().Get()
            direction = np.array(list(scene.GetGravityDirectionAttr().Get() or (0, 0, 0)), float)
            length = float(np.linalg.norm(direction))
            if magnitude is None or not 0 <= magnitude < np.inf or length < 1e-6:
                return None
            meters = float(f"{magnitude:.7g}") * UsdGeom.GetStageMetersPerUnit(stage)
            return triple(np.round(upright[:3, :3] @ direction / length * meters, 7))
    return None


def _world(stage: Usd.Stage) -> tuple[NDArray, NDArray]:
    """Return the transform from the stage's axes to axes with Z up, without and with units.

    The first transform is a rotation; the second one also converts lengths to meters. Both have
    shape [4, 4].
    """
    unit = UsdGeom.GetStageMetersPerUnit(stage)
    upright = _Z_UP if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.y else np.eye(4)
    return upright, upright @ np.diag([unit, unit, unit, 1.0])


def _rigid(raw: NDArray) -> NDArray:
    """Return the rigid part of a transform."""
    rigid, scale = unscaled(raw, even=True)
    if scale is None:
        u, _, v = np.linalg.svd(raw[:3, :3])
        rigid[:3, :3] = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
    return rigid


def _bodies(
    prims: list[Usd.Prim], world_transform: Callable[[Usd.Prim], NDArray]
) -> dict[str, _Body]:
    """Return the rigid bodies by path, including static links as `write_scene_usd` writes them."""
    result = {}
    for prim in prims:
        dynamic = prim.HasAPI(UsdPhysics.RigidBodyAPI)
        # Static links of exported scenes have no RigidBodyAPI but keep their mass attributes.
        static_link = prim.IsA(UsdGeom.Xform) and prim.HasAttribute("physics:mass")
        if dynamic or static_link:
            raw = world_transform(prim)
            enabled = dynamic and UsdPhysics.RigidBodyAPI(prim).GetRigidBodyEnabledAttr().Get()
            kinematic = dynamic and UsdPhysics.RigidBodyAPI(prim).GetKinematicEnabledAttr().Get()
            free = enabled is not False and dynamic and not kinematic
            result[str(prim.GetPath())] = _Body(prim, raw, _rigid(raw), free)
    return result


def _owner(prim: Usd.Prim, bodies: dict[str, _Body]) -> _Body | None:
    while prim and not prim.IsPseudoRoot():
        if (body := bodies.get(str(prim.GetPath()))) is not None:
            return body
        prim = prim.GetParent()
    return None


def _group(prim: Usd.Prim, top: Usd.Prim) -> Usd.Prim:
    """Return the child of the top prim that is the given prim or contains it."""
    while prim != top and prim.GetParent() != top and not prim.GetParent().IsPseudoRoot():
        prim = prim.GetParent()
    return prim


def _components(
    bodies: dict[str, _Body], stage_joints: list[StageJoint]
) -> Iterator[tuple[list[str], list[StageJoint]]]:
    """Yield the bodies and the joints of each object, that is, of each connected component."""
    group = {name: name for name in bodies}

    def head(name: str) -> str:
        while group[name] != name:
            name = group[name]
        return name

    for joint in stage_joints:
        if joint.parent:
            group[head(joint.child)] = head(joint.parent)
    heads = {name: head(name) for name in bodies}
    for component in dict.fromkeys(heads.values()):
        names = [name for name in bodies if heads[name] == component]
        yield (
            names,
            [joint for joint in stage_joints if joint.parent and joint.parent in names],
        )


def _containing_child(top: Usd.Prim, names: list[str]) -> Usd.Prim | None:
    """Return the child of the top prim that contains all bodies of an object, or None."""
    stage = top.GetStage()
    paths = {str(_group(stage.GetPrimAtPath(name), top).GetPath()) for name in names}
    return stage.GetPrimAtPath(paths.pop()) if len(paths) == 1 else None


def _assembly(
    bodies: dict[str, _Body],
    names: list[str],
    stage_joints: list[StageJoint],
    world_joints: list[StageJoint],
    frame: NDArray,
    reader: JointReader,
) -> Assembly:
    """Return the object that bodies form, in the frame `frame` with all joints at zero."""
    file_notes, reader = reader.notes, replace(reader, notes=[])
    to_frame = np.linalg.inv(frame)
    movable = next((joint for joint in world_joints if not joint.fixed), None)
    root = _root(bodies, names, stage_joints, world_joints)
    zero_poses = {root: bodies[root].rigid}
    labels = _labels([bodies[name].prim for name in names])
    links: dict[str, Link] = {}
    used: list[StageJoint] = []
    if movable is not None:
        # If a movable joint attaches the object to the world, the world is the base link.
        child_pose = movable.parent_frame @ np.linalg.inv(movable.child_frame)
        zero_poses = {"": np.eye(4), movable.child: child_pose}
        links[WORLD] = Link(WORLD, mass=1.0, com=np.zeros(3), inertia=np.eye(3))
        used.append(movable)
    waiting = [*stage_joints]
    while ready := [t for t in waiting if (t.parent in zero_poses) != (t.child in zero_poses)]:
        for joint in ready:
            waiting.remove(joint)
            if joint.parent in zero_poses and joint.child in zero_poses:
                reader.notes.append(f"joint {joint.name} closes a loop and is not imported")
                continue
            outward = joint if joint.parent in zero_poses else joint.flipped()
            joint_frame = zero_poses[outward.parent] @ outward.parent_frame
            zero_poses[outward.child] = joint_frame @ np.linalg.inv(outward.child_frame)
            used.append(outward)
    for joint in waiting:
        reader.notes.append(f"joint {joint.name} closes a loop and is not imported")
    sites, stage, notes = [], reader.stage, reader.notes
    for name in names:
        body = bodies[name]
        to_zero = to_frame @ zero_poses[name] @ np.linalg.inv(body.rigid)
        links[labels[name]] = _link(body, labels[name], to_zero, stage, notes)
        if folder := body.prim.GetChild("sites"):
            for point in folder.GetChildren():
                local = UsdGeom.Xformable(point).GetLocalTransformation().ExtractTranslation()
                position = to_frame @ zero_poses[name] @ np.array([*local, 1.0])
                sites.append(unchecked_site(point.GetName(), labels[name], position[:3]))
    ends = {**labels, "": WORLD}
    joints = [
        reader.joint(joint, to_frame @ zero_poses[joint.parent] @ joint.parent_frame, ends)
        for joint in used
    ]
    actual = {name: bodies[name].rigid for name in names} | {"": np.eye(4)}
    state = {}
    for joint, spec in zip(used, joints, strict=True):
        displaced = [to_frame @ actual[e] @ np.linalg.inv(zero_poses[e]) @ frame
                     for e in (joint.parent, joint.child)]  # fmt: skip
        state |= state_of(spec, np.linalg.inv(displaced[0]) @ displaced[1])
    fixed = bool(world_joints) or not any(bodies[name].dynamic for name in names)
    path = _title(bodies[root].prim, names)
    mechanism = Mechanism(path.rpartition("/")[2], links, joints, sites, notes, file_notes)
    return Assembly(path, mechanism, frame, fixed, state)


def _root(
    bodies: dict[str, _Body],
    names: list[str],
    stage_joints: list[StageJoint],
    world_joints: list[StageJoint],
) -> str:
    """Return the root body of an object."""
    children = {joint.child for joint in stage_joints}
    for chosen in (
        [joint.child for joint in world_joints],
        [n for n in names if bodies[n].prim.HasAPI(UsdPhysics.ArticulationRootAPI)],
        [name for name in names if name not in children],
    ):
        if chosen:
            return chosen[0]
    return names[0]


def _title(prim: Usd.Prim, names: list[str]) -> str:
    """Return the path of the prim that contains all bodies of an object."""
    path = prim.GetPath()
    for name in names:
        path = path.GetCommonPrefix(prim.GetStage().GetPrimAtPath(name).GetPath())
    if len(names) == 1 and path.GetParentPath().name == "links":
        path = path.GetParentPath()
    if path.name == "links":
        path = path.GetParentPath()
    return str(prim.GetPath() if path.IsAbsoluteRootPath() else path)


def _labels(prims: list[Usd.Prim]) -> dict[str, str]:
    """Return a unique link name for each prim, derived from the prim's name, by path."""
    result: dict[str, str] = {}
    for prim in prims:
        taken = set(result.values()) | {WORLD}
        result[str(prim.GetPath())] = unused(prim.GetName(), taken)
    return result


def _link(body: _Body, name: str, transform: NDArray, stage: Usd.Stage, notes: list[str]) -> Link:
    """Return the link of a body.

    `transform`, shape [4, 4], moves the body from its pose in the world frame to its pose in the
    mechanism's frame with all joints at zero.
    """
    link = Link(name, origin=(transform @ body.rigid)[:3, 3])
    for prim, raw in body.shapes:
        link.shapes += shapes_of(prim, transform @ raw, notes)
    kilogram = UsdPhysics.GetStageKilogramsPerUnit(stage)
    unit = UsdGeom.GetStageMetersPerUnit(stage)
    mass = UsdPhysics.MassAPI(body.prim)
    stated = mass.GetMassAttr().Get() or 0.0
    if not stated > 0:
        return link
    link.mass = float(stated) * kilogram
    center = np.array(list(mass.GetCenterOfMassAttr().Get() or (np.nan,) * 3))
    if np.isfinite(center).all():
        link.com = (transform @ body.raw @ np.array([*center, 1.0]))[:3]
    moments = np.array(list(mass.GetDiagonalInertiaAttr().Get() or (0.0,) * 3))
    if np.any(moments):
        axes = (transform @ body.rigid)[:3, :3] @ rotation_matrix(mass.GetPrincipalAxesAttr().Get())
        link.inertia = axes @ np.diag(moments * kilogram * unit**2) @ axes.T
    if (link.com is None) != (link.inertia is None):
        stated = "center of mass" if link.inertia is None else "inertia"
        notes.append(
            f"{body.prim.GetPath()} states only its {stated}: center of mass and inertia are "
            "derived from its colliders"
        )
    return link


_READ = ("Physics", "Newton", "Mjc", "PhysxJoint", "PhysxMimic", "MaterialBinding", "Semantics")
_READ_FULLY = ("GeomModelAPI", "CollectionAPI", "NodeDefAPI", "ShadowAPI")


def _unread(prims: list[Usd.Prim]) -> list[str]:
    """Return notes on the cameras, textures and schemas that are not imported."""
    notes = []
    if any(prim.IsA(UsdGeom.Camera) for prim in prims):
        notes.append("cameras are not imported")
    textures = any(
        prim.GetAttribute("info:id").Get() == "UsdUVTexture"
        for prim in prims
        if prim.IsA(UsdShade.Shader)
    )
    if textures:
        notes.append("textures of materials are not imported")
    others = set()
    for prim in prims:
        schemas = prim.GetMetadata("apiSchemas")
        for name in schemas.GetAddedOrExplicitItems() if schemas else ():
            if not name.startswith(_READ) and name.partition(":")[0] not in _READ_FULLY:
                others.add(name.partition(":")[0])
    if others:
        notes.append(f"schemas that are not imported: {', '.join(sorted(others))}")
    return notes
