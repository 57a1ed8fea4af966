"""Read the mechanisms of a USD file, by UsdGeom, UsdShade and UsdPhysics.

A file from elsewhere may hold one object or many, in any unit and with either axis up. Rigid bodies
that joints connect are one object; its joints are read at 0, whatever state the stage is in.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Tf, Usd, UsdGeom, UsdPhysics, UsdShade

from ..errors import SpecError
from ..spec.base import Vec3
from .checked_usd import open_inside
from .mechanism import Assembly, Link, Mechanism, triple, unchecked_site
from .read_usd_joints import JointReader, Tie, is_joint, state_of
from .read_usd_shapes import shapes_of, unscaled

WORLD = "world"
"""Link that stands for the world where a joint moves an object in it."""
MAX_NUMBER = 1e6
"""Largest coordinate [m] and scale that are read."""
_Z_UP = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
_LEFT_OUT = ("PointInstancer", "BasisCurves", "NurbsPatch", "Points", "Skeleton", "Volume", "Plane")


@dataclass
class _Body:
    prim: Usd.Prim
    raw: NDArray
    """Transform of its prim to the world, with scale [4, 4] m."""
    at: NDArray
    """The same without scale."""
    dynamic: bool
    shapes: list[tuple[Usd.Prim, NDArray]] = field(default_factory=list)


def read_usd(path: Path, object_path: str | None = None) -> Mechanism:
    """Read the one object of a USD file, in the world's frame, or of a prim of it, in the prim's.

    Args:
        path: the file.
        object_path: the object's prim; None is the default prim, or all.

    Raises:
        SpecError: the file is broken or hostile, there is no such prim, or it holds several
            objects.
    """
    return one_object(path, open_inside(Path(path)), object_path)


def one_object(path: Path, stage: Usd.Stage, object_path: str | None = None) -> Mechanism:
    """Read the one object of a stage; see `read_usd`."""
    made = read_assemblies(path, stage, object_path, apart=False)
    bodies = [one for one in made if not one.bare]
    if len(bodies) > 1:
        paths = ", ".join(one.path for one in bodies[:8])
        raise SpecError(f"{path} holds {len(bodies)} objects, not one: {paths}")
    result = (bodies or made)[0].mechanism
    if len(made) > 1:
        result.notes.append("geometry outside of rigid bodies is not imported")
    return result


def read_assemblies(
    path: Path, stage: Usd.Stage, object_path: str | None = None, *, apart: bool
) -> list[Assembly]:
    """Read all objects of a stage, each with its place.

    Args:
        path: the stage's file, for messages.
        stage: the stage.
        object_path: the prim below which to read; None is the default prim, or all.
        apart: whether every object has the frame of its own prim, and geometry without a body is
            one static object for each child of the top prim; else all have the frame of
            `object_path`, or of the world, and such geometry is one.

    Raises:
        SpecError: there is no such prim, nothing that could collide or be seen, or a mesh is
            broken.
    """
    try:
        return _assemblies(path, stage, object_path, apart)
    except (Tf.ErrorException, TypeError, ValueError, AttributeError, OverflowError) as error:
        # Values have the types that a file gives them, whatever the schemas say.
        words = " ".join(str(error).split())[:200]
        raise SpecError(f"{path} holds a value that USD's schemas do not allow: {words}") from None


def _assemblies(
    path: Path, stage: Usd.Stage, object_path: str | None, apart: bool
) -> list[Assembly]:
    top = stage.GetPrimAtPath(object_path) if object_path else stage.GetDefaultPrim()
    if object_path and not top:
        raise SpecError(f"{path}: no prim at {object_path}")
    top = top or stage.GetPseudoRoot()
    notes: list[str] = []
    upright, to_metres = _world(stage)
    prims = list(Usd.PrimRange(top, Usd.TraverseInstanceProxies()))
    cache = UsdGeom.XformCache()

    def placed(prim: Usd.Prim) -> NDArray:
        # USD multiplies row vectors, so its matrices are the transposes of ours.
        at = to_metres @ np.array(cache.GetLocalToWorldTransform(prim)).T
        if not np.isfinite(at).all() or np.abs(at).max() > MAX_NUMBER:
            raise SpecError(f"{path}: the place of {prim.GetPath()} is no place")
        return at

    def frame_of(prim: Usd.Prim) -> NDArray:
        return _rigid(placed(prim)) @ upright.T

    bodies = _bodies(prims, placed)
    reader = JointReader(path, stage, placed, {p: body.at for p, body in bodies.items()}, notes)
    ties = reader.ties([prim for prim in prims if is_joint(prim)])
    loose: dict[str, _Body] = {}
    for prim in prims:
        if prim.IsA(UsdGeom.Gprim):
            owner = _owner(prim, bodies)
            if owner is None:
                group = _group(prim, top) if apart else top
                name = str(group.GetPath())
                if name not in loose:
                    loose[name] = _Body(group, placed(group), frame_of(group), False)
                owner = loose[name]
            owner.shapes.append((prim, placed(prim)))
        elif prim.GetTypeName() in _LEFT_OUT:
            notes.append(f"{prim.GetPath()} is a {prim.GetTypeName()}, which is not imported")
    notes += _unread(prims)
    shared = frame_of(top) if object_path else np.eye(4)
    result = []
    for names, tied in _components(bodies, ties):
        held = [tie for tie in ties if not tie.parent and tie.child in names]
        home = _home(top, names)
        frame = frame_of(home) if apart and home else shared
        result.append(_assembly(bodies, names, tied, held, frame, reader))
    for group, body in loose.items():
        frame = body.at if apart else shared
        link = _link(body, "static", np.linalg.inv(frame), stage, notes)
        if not bodies or any(shape.role != "visual" for shape in link.shapes):
            name = group.rpartition("/")[2] or path.stem
            mechanism = Mechanism(name, {"static": link}, [], [], notes)
            result.append(Assembly(group, mechanism, frame, fixed=True, bare=True))
    result = [one for one in result if any(k.shapes for k in one.mechanism.links.values())]
    if not result:
        raise SpecError(f"{path} holds nothing that could collide or be seen")
    return result


def gravity_of(stage: Usd.Stage) -> Vec3 | None:
    """Return the gravity that a stage states [m/s^2], Z up; None where it states none."""
    upright, _ = _world(stage)
    for prim in stage.Traverse():
        if prim.IsA(UsdPhysics.Scene):
            scene = UsdPhysics.Scene(prim)
            size = scene.GetGravityMagnitudeAttr().Get()
            along = np.array(list(scene.GetGravityDirectionAttr().Get() or (0, 0, 0)), float)
            length = float(np.linalg.norm(along))
            if size is None or not 0 <= size < np.inf or length < 1e-6:
                return None
            metres = float(f"{size:.7g}") * UsdGeom.GetStageMetersPerUnit(stage)
            return triple(np.round(upright[:3, :3] @ along / length * metres, 7))
    return None


def _world(stage: Usd.Stage) -> tuple[NDArray, NDArray]:
    """Return the rotation of the stage's axes to ours, and the transform to metres [4, 4]."""
    unit = UsdGeom.GetStageMetersPerUnit(stage)
    turn = _Z_UP if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.y else np.eye(4)
    return turn, turn @ np.diag([unit, unit, unit, 1.0])


def _rigid(raw: NDArray) -> NDArray:
    """Return the rotation and place of a transform, without its scale."""
    at, scale = unscaled(raw, even=True)
    if scale is None:
        u, _, v = np.linalg.svd(raw[:3, :3])
        at[:3, :3] = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
    return at


def _bodies(prims: list[Usd.Prim], placed: Callable[[Usd.Prim], NDArray]) -> dict[str, _Body]:
    """Return rigid bodies by path, and what a scene of ours holds still."""
    result = {}
    for prim in prims:
        dynamic = prim.HasAPI(UsdPhysics.RigidBodyAPI)
        # What cannot move is no rigid body in our scenes, and keeps the attributes of its mass.
        still = prim.IsA(UsdGeom.Xform) and prim.HasAttribute("physics:mass")
        if dynamic or still:
            raw = placed(prim)
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
    """Return the child of the top prim that a prim is in, or is."""
    while prim != top and prim.GetParent() != top and not prim.GetParent().IsPseudoRoot():
        prim = prim.GetParent()
    return prim


def _components(bodies: dict[str, _Body], ties: list[Tie]) -> Iterator[tuple[list[str], list[Tie]]]:
    """Yield the bodies that joints connect, and these joints."""
    group = {name: name for name in bodies}

    def head(name: str) -> str:
        while group[name] != name:
            name = group[name]
        return name

    for tie in ties:
        if tie.parent:
            group[head(tie.child)] = head(tie.parent)
    heads = {name: head(name) for name in bodies}
    for one in dict.fromkeys(heads.values()):
        names = [name for name in bodies if heads[name] == one]
        yield names, [tie for tie in ties if tie.parent and tie.parent in names]


def _home(top: Usd.Prim, names: list[str]) -> Usd.Prim | None:
    """Return the child of the top prim that holds all bodies of an object, if one does."""
    stage = top.GetStage()
    homes = {str(_group(stage.GetPrimAtPath(name), top).GetPath()) for name in names}
    return stage.GetPrimAtPath(homes.pop()) if len(homes) == 1 else None


def _assembly(
    bodies: dict[str, _Body],
    names: list[str],
    ties: list[Tie],
    held: list[Tie],
    frame: NDArray,
    reader: JointReader,
) -> Assembly:
    """Put the bodies of one object to rest and describe them in its frame."""
    into = np.linalg.inv(frame)
    moved = next((tie for tie in held if not tie.fixed), None)
    root = _root(bodies, names, ties, held)
    rest = {root: bodies[root].at}
    labels = _labels([bodies[name].prim for name in names])
    links: dict[str, Link] = {}
    used: list[Tie] = []
    if moved is not None:
        # The world is the base then: what moves in it stands where its joint is at 0.
        rest = {"": np.eye(4), moved.child: moved.here @ np.linalg.inv(moved.there)}
        links[WORLD] = Link(WORLD, mass=1.0, com=np.zeros(3), inertia=np.eye(3))
        used.append(moved)
    waiting = [*ties]
    while ready := [t for t in waiting if (t.parent in rest) != (t.child in rest)]:
        for tie in ready:
            waiting.remove(tie)
            if tie.parent in rest and tie.child in rest:
                reader.notes.append(f"joint {tie.name} closes a loop and is not imported")
                continue
            one = tie if tie.parent in rest else tie.flipped()
            rest[one.child] = rest[one.parent] @ one.here @ np.linalg.inv(one.there)
            used.append(one)
    for tie in waiting:
        reader.notes.append(f"joint {tie.name} closes a loop and is not imported")
    sites, stage, notes = [], reader.stage, reader.notes
    for name in names:
        body = bodies[name]
        links[labels[name]] = _link(
            body, labels[name], into @ rest[name] @ np.linalg.inv(body.at), stage, notes
        )
        if folder := body.prim.GetChild("sites"):
            for point in folder.GetChildren():
                local = UsdGeom.Xformable(point).GetLocalTransformation().ExtractTranslation()
                at = into @ rest[name] @ np.array([*local, 1.0])
                sites.append(unchecked_site(point.GetName(), labels[name], at[:3]))
    ends = {**labels, "": WORLD}
    joints = [reader.joint(tie, into @ rest[tie.parent] @ tie.here, ends) for tie in used]
    actual = {name: bodies[name].at for name in names} | {"": np.eye(4)}
    state = {}
    for tie, joint in zip(used, joints, strict=True):
        displaced = [into @ actual[e] @ np.linalg.inv(rest[e]) @ frame
                     for e in (tie.parent, tie.child)]  # fmt: skip
        state |= state_of(joint, np.linalg.inv(displaced[0]) @ displaced[1])
    fixed = bool(held) or not any(bodies[name].dynamic for name in names)
    home = _title(bodies[root].prim, names)
    mechanism = Mechanism(home.rpartition("/")[2], links, joints, sites, notes)
    return Assembly(home, mechanism, frame, fixed, state)


def _root(bodies: dict[str, _Body], names: list[str], ties: list[Tie], held: list[Tie]) -> str:
    """Choose the body that an object hangs from."""
    children = {tie.child for tie in ties}
    for chosen in (
        [tie.child for tie in held],
        [n for n in names if bodies[n].prim.HasAPI(UsdPhysics.ArticulationRootAPI)],
        [name for name in names if name not in children],
    ):
        if chosen:
            return chosen[0]
    return names[0]


def _title(prim: Usd.Prim, names: list[str]) -> str:
    """Return the path of the prim that is the object: the highest that holds its bodies only."""
    path = prim.GetPath()
    for name in names:
        path = path.GetCommonPrefix(prim.GetStage().GetPrimAtPath(name).GetPath())
    if len(names) == 1 and path.GetParentPath().name == "links":
        path = path.GetParentPath()
    if path.name == "links":
        path = path.GetParentPath()
    return str(prim.GetPath() if path.IsAbsoluteRootPath() else path)


def _labels(prims: list[Usd.Prim]) -> dict[str, str]:
    """Name links by their prims' names, each once."""
    result: dict[str, str] = {}
    for prim in prims:
        name, taken = prim.GetName(), set(result.values()) | {WORLD}
        while name in taken:
            name += "_"
        result[str(prim.GetPath())] = name
    return result


def _link(body: _Body, name: str, at: NDArray, stage: Usd.Stage, notes: list[str]) -> Link:
    """Describe a body; `at` takes the world to the mechanism's frame at rest."""
    link = Link(name, origin=(at @ body.at)[:3, 3])
    for prim, raw in body.shapes:
        link.shapes += shapes_of(prim, at @ raw, notes)
    kilogram = UsdPhysics.GetStageKilogramsPerUnit(stage)
    unit = UsdGeom.GetStageMetersPerUnit(stage)
    mass = UsdPhysics.MassAPI(body.prim)
    stated = mass.GetMassAttr().Get() or 0.0
    if not stated > 0:
        return link
    link.mass = float(stated) * kilogram
    centre = np.array(list(mass.GetCenterOfMassAttr().Get() or (np.nan,) * 3))
    if np.isfinite(centre).all():
        link.com = (at @ body.raw @ np.array([*centre, 1.0]))[:3]
    moments = np.array(list(mass.GetDiagonalInertiaAttr().Get() or (0.0,) * 3))
    if np.any(moments):
        turn = (at @ body.at)[:3, :3] @ _matrix(mass.GetPrincipalAxesAttr().Get())
        link.inertia = turn @ np.diag(moments * kilogram * unit**2) @ turn.T
    if (link.com is None) != (link.inertia is None):
        given = "centre of mass" if link.inertia is None else "inertia"
        notes.append(f"{body.prim.GetPath()} states its {given} alone: derived from its colliders")
    return link


def _matrix(quat: Gf.Quatf | None) -> NDArray:
    if quat is None or quat.GetLength() < 1e-6:
        return np.eye(3)
    return np.array(Gf.Matrix3d(Gf.Quatd(quat.GetNormalized()))).T


_READ = ("Physics", "Newton", "Mjc", "PhysxJoint", "PhysxMimic", "MaterialBinding", "Semantics")
_READ_FULLY = ("GeomModelAPI", "CollectionAPI", "NodeDefAPI", "ShadowAPI")


def _unread(prims: list[Usd.Prim]) -> list[str]:
    """Note what the prims hold that an object's description has no place for."""
    notes = []
    if any(prim.IsA(UsdGeom.Camera) for prim in prims):
        notes.append("cameras are not imported")
    pictures = any(
        prim.GetAttribute("info:id").Get() == "UsdUVTexture"
        for prim in prims
        if prim.IsA(UsdShade.Shader)
    )
    if pictures:
        notes.append("pictures on materials are not imported")
    others = set()
    for prim in prims:
        schemas = prim.GetMetadata("apiSchemas")
        for name in schemas.GetAddedOrExplicitItems() if schemas else ():
            if not name.startswith(_READ) and name.partition(":")[0] not in _READ_FULLY:
                others.add(name.partition(":")[0])
    if others:
        notes.append(f"schemas that are not imported: {', '.join(sorted(others))}")
    return notes
