"""Read the mechanism of an object in a USD file, by UsdPhysics alone; shapes are not read."""

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Usd, UsdPhysics

from ..errors import ExportError
from ..spec import JointSpec, Mimic
from ..spec.pose import Pose, matrix, pose, rotate
from .mechanism import Link, Mechanism, triple


def read_usd(path: Path, object_path: str | None = None) -> Mechanism:
    """Read an object of a USD file of ours, exported object or scene.

    Joints are read from UsdPhysics alone: axis token through the local rotation, limits in degrees.
    Link frames are put back to rest, so an open drawer in a scene reads like a closed one.

    Args:
        path: the file.
        object_path: the object's prim; None is the default prim.

    Raises:
        ExportError: there is no such prim, or its rigid bodies are no tree of joints.
    """
    stage = Usd.Stage.Open(str(path))
    top = stage.GetPrimAtPath(object_path) if object_path else stage.GetDefaultPrim()
    if not top:
        raise ExportError(f"{path}: no prim at {object_path or 'the default'}")
    prims = [p for p in Usd.PrimRange(top) if p.IsA(UsdPhysics.Joint)]
    bodies = {str(p.GetPath()): p for p in Usd.PrimRange(top) if p.HasAPI(UsdPhysics.RigidBodyAPI)}
    ties: dict[str, tuple[str, str, Pose, Pose]] = {}
    for prim in prims:
        one = UsdPhysics.Joint(prim)
        sides = [rel.GetTargets() for rel in (one.GetBody0Rel(), one.GetBody1Rel())]
        if not all(sides):
            continue
        frames = [
            pose(list(at.Get()), _wxyz(turn.Get()))
            for at, turn in (
                (one.GetLocalPos0Attr(), one.GetLocalRot0Attr()),
                (one.GetLocalPos1Attr(), one.GetLocalRot1Attr()),
            )
        ]
        parent, child = (str(side[0]) for side in sides)
        ties[str(prim.GetPath())] = (parent, child, frames[0], frames[1])
    children = {child for _, child, _, _ in ties.values()}
    roots = [body for body in bodies if body not in children]
    if len(roots) != 1:
        raise ExportError(f"{path}: an object has one root link, this has {roots or 'none'}")
    root = roots[0]
    rest = {root: pose()}
    while len(rest) < len(bodies):
        ready = [t for t in ties.values() if t[0] in rest and t[1] not in rest]
        if not ready:
            raise ExportError(
                f"{path}: rigid bodies without a joint: {sorted(set(bodies) - set(rest))}"
            )
        for parent, child, here, there in ready:
            rest[child] = rest[parent].then(here).then(there.inverse())
    joints = []
    for prim in prims:
        tie = ties.get(str(prim.GetPath()))
        if tie is not None:
            anchor = rest[tie[0]].then(tie[2])
            joints.append(_joint(prim, anchor, bodies[tie[0]].GetName(), bodies[tie[1]].GetName()))
    links = {}
    for body, prim in bodies.items():
        mass = UsdPhysics.MassAPI(prim)
        at = rest[body]
        turn = matrix(at.quat) @ matrix(_wxyz(mass.GetPrincipalAxesAttr().Get()))
        links[prim.GetName()] = Link(
            prim.GetName(),
            mass=float(mass.GetMassAttr().Get()),
            com=at.apply(list(mass.GetCenterOfMassAttr().Get())),
            inertia=turn @ np.diag(list(mass.GetDiagonalInertiaAttr().Get())) @ turn.T,
            origin=at.pos,
        )
    return Mechanism(top.GetName(), links, joints)


def _joint(prim: Usd.Prim, anchor: Pose, parent: str, child: str) -> JointSpec:
    common: dict[str, Any] = {
        "name": prim.GetName(),
        "parent": parent,
        "child": child,
        "pos": triple(anchor.pos),
    }
    if prim.IsA(UsdPhysics.FixedJoint):
        return JointSpec(**common, type="fixed")
    if prim.IsA(UsdPhysics.SphericalJoint):
        cone = UsdPhysics.SphericalJoint(prim).GetConeAngle0LimitAttr().Get()
        kept: dict[str, Any] = {
            name: prim.GetAttribute(f"{space}:{name}").Get() or 0.0
            for name, space in (
                ("damping", "neoworld"),
                ("stiffness", "neoworld"),
                ("armature", "newton"),
                ("friction", "newton"),
            )
        }
        return JointSpec(**common, **kept, type="ball", upper=math.radians(max(cone, 0.0)))
    slide = prim.IsA(UsdPhysics.PrismaticJoint)
    typed = UsdPhysics.PrismaticJoint(prim) if slide else UsdPhysics.RevoluteJoint(prim)
    unit = 1.0 if slide else math.radians(1.0)
    along = np.eye(3)["XYZ".index(typed.GetAxisAttr().Get())]
    lower, upper = typed.GetLowerLimitAttr().Get(), typed.GetUpperLimitAttr().Get()
    limited = math.isfinite(lower) and math.isfinite(upper)
    drive = UsdPhysics.DriveAPI.Get(prim, "linear" if slide else "angular")
    force = drive.GetMaxForceAttr().Get() if drive else None

    def extra(name: str) -> float | None:
        return prim.GetAttribute(f"newton:{name}").Get()

    velocity = extra("velocityLimit")
    mimic = None
    leaders = prim.GetRelationship("newton:mimicJoint").GetTargets()
    if leaders:
        leader = prim.GetStage().GetPrimAtPath(leaders[0])
        led = 1.0 if leader.IsA(UsdPhysics.PrismaticJoint) else math.radians(1.0)
        mimic = Mimic(
            joint=leader.GetName(),
            multiplier=(extra("mimicCoef1") or 0.0) * unit / led,
            offset=(extra("mimicCoef0") or 0.0) * unit,
        )
    return JointSpec(
        **common,
        type="prismatic" if slide else "revolute" if limited else "continuous",
        axis=triple(rotate(anchor.quat, along)),
        lower=lower * unit if limited else 0.0,
        upper=upper * unit if limited else 0.0,
        damping=drive.GetDampingAttr().Get() / unit if drive else 0.0,
        stiffness=drive.GetStiffnessAttr().Get() / unit if drive else 0.0,
        armature=extra("armature") or 0.0,
        friction=extra("friction") or 0.0,
        effort=force if force is not None and math.isfinite(force) else None,
        velocity=velocity * unit if velocity is not None else None,
        mimic=mimic,
    )


def _wxyz(quat: Gf.Quatf) -> NDArray:
    return np.array([quat.GetReal(), *quat.GetImaginary()], float)


__all__ = ["read_usd"]
