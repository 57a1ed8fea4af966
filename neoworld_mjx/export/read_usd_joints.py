"""Joints of USD prims: their two frames, and what UsdPhysics, Newton and PhysX say of them.

The axis is that of the token, turned by the local rotation; limits and drives count degrees.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Usd, UsdGeom, UsdPhysics

from ..errors import SpecError
from ..spec import JointSpec, Mimic
from ..spec.pose import angle_between, from_matrix
from .mechanism import triple, unchecked_joint, unchecked_mimic

_FREEDOMS = ("transX", "transY", "transZ", "rotX", "rotY", "rotZ")


@dataclass(frozen=True)
class Tie:
    """A joint between two bodies, by paths; an empty parent is the world."""

    prim: Usd.Prim
    parent: str
    child: str
    here: NDArray
    """Its frame in the parent's [4, 4] m."""
    there: NDArray
    """Its frame in the child's [4, 4] m."""
    reversed: bool = False
    """Whether the file has parent and child the other way round."""

    @property
    def name(self) -> str:
        """The prim's name."""
        return self.prim.GetName()

    @property
    def fixed(self) -> bool:
        """Whether nothing moves."""
        return kind_of(self.prim)[0] == "fixed"

    def flipped(self) -> "Tie":
        """Return the same joint seen from its child."""
        return replace(
            self, parent=self.child, child=self.parent, here=self.there, there=self.here,
            reversed=not self.reversed,
        )  # fmt: skip


def is_joint(prim: Usd.Prim) -> bool:
    """Tell whether a prim is a joint."""
    return prim.IsA(UsdPhysics.Joint)


def kind_of(prim: Usd.Prim) -> tuple[str, str]:
    """Return a joint's type, as a spec's but with "revolute" for "continuous", and its axis."""
    for schema, kind in (
        (UsdPhysics.PrismaticJoint, "prismatic"),
        (UsdPhysics.RevoluteJoint, "revolute"),
    ):
        if prim.IsA(schema):
            return kind, str(schema(prim).GetAxisAttr().Get())
    if prim.IsA(UsdPhysics.SphericalJoint):
        return "ball", "X"
    if prim.IsA(UsdPhysics.FixedJoint):
        return "fixed", "X"
    free = [name for name in _FREEDOMS if not _locked(prim, name)]
    if len(free) == 1:
        return ("prismatic" if free[0].startswith("trans") else "revolute"), free[0][-1]
    return ("fixed", "X") if not free else ("other", "X")


def _locked(prim: Usd.Prim, freedom: str) -> bool:
    limit = UsdPhysics.LimitAPI.Get(prim, freedom)
    if not limit or not prim.HasAPI(UsdPhysics.LimitAPI, freedom):
        return False
    low, high = limit.GetLowAttr().Get(), limit.GetHighAttr().Get()
    return low is not None and high is not None and low > high


@dataclass
class JointReader:
    """What the joints of one stage are read with."""

    path: Path
    stage: Usd.Stage
    placed: Callable[[Usd.Prim], NDArray]
    """Gives a prim's transform to the world, with scale [4, 4] m."""
    bodies: dict[str, NDArray]
    """Rigid transforms of the bodies to the world [4, 4] m, by path."""
    notes: list[str]

    def ties(self, prims: list[Usd.Prim]) -> list[Tie]:
        """Return the joints that hold a body, in the file's order."""
        result = []
        for prim in prims:
            joint = UsdPhysics.Joint(prim)
            first, one = self._side(joint.GetBody0Rel(), joint.GetLocalPos0Attr(),
                                    joint.GetLocalRot0Attr())  # fmt: skip
            second, other = self._side(joint.GetBody1Rel(), joint.GetLocalPos1Attr(),
                                       joint.GetLocalRot1Attr())  # fmt: skip
            if first == second:
                continue
            tie = Tie(prim, first, second, one, other)
            tie = tie if second else tie.flipped()
            if kind_of(prim)[0] == "other":
                self.notes.append(
                    f"joint {prim.GetName()} has several freedoms: "
                    + ("left out" if not tie.parent else "imported as fixed")
                )
                if not tie.parent:
                    continue
            result.append(tie)
        return result

    def _side(
        self, body: Usd.Relationship, at: Usd.Attribute, turn: Usd.Attribute
    ) -> tuple[str, NDArray]:
        """Return the body at one side of a joint, and the joint's frame in it."""
        targets = body.GetTargets()
        prim = self.stage.GetPrimAtPath(targets[0]) if targets else None
        if targets and not prim:
            raise SpecError(f"{self.path}: joint {body.GetPrim().GetPath()} names {targets[0]}, "
                            "which is not there")  # fmt: skip
        raw = self.placed(prim) if prim else self.placed(self.stage.GetPseudoRoot())
        frame = np.eye(4)
        frame[:3, 3] = (raw @ np.array([*(at.Get() or (0, 0, 0)), 1.0]))[:3]
        linear = raw[:3, :3]
        frame[:3, :3] = linear / np.linalg.norm(linear, axis=0) @ _rotation(turn.Get())
        owner = prim
        while owner and str(owner.GetPath()) not in self.bodies:
            owner = owner.GetParent()
            owner = None if owner is None or owner.IsPseudoRoot() else owner
        if not owner:
            return "", frame
        name = str(owner.GetPath())
        return name, np.linalg.inv(self.bodies[name]) @ frame

    def joint(self, tie: Tie, frame: NDArray, labels: dict[str, str]) -> JointSpec:
        """Return a joint, `frame` [4, 4] being its own in the mechanism's frame at rest."""
        prim, (kind, token) = tie.prim, kind_of(tie.prim)
        common: dict[str, Any] = {
            "name": tie.name,
            "parent": labels[tie.parent],
            "child": labels[tie.child],
            "pos": triple(frame[:3, 3]),
        }
        if kind in ("fixed", "other"):
            return unchecked_joint(**common, type="fixed")
        if kind == "ball":
            cone = UsdPhysics.SphericalJoint(prim).GetConeAngle0LimitAttr().Get()
            upper = math.radians(min(max(cone, 0.0), 180.0)) if math.isfinite(cone) else 0.0
            losses = {
                name: abs(_first(prim, f"neoworld:{name}", f"newton:{name}", f"mjc:{name}") or 0.0)
                for name in ("damping", "stiffness", "armature", "friction")
            }
            return unchecked_joint(**common, **losses, type="ball", upper=upper)
        return self._moving(tie, kind, token, frame, common)

    def _moving(
        self, tie: Tie, kind: str, token: str, frame: NDArray, common: dict[str, Any]
    ) -> JointSpec:
        prim, slide = tie.prim, kind == "prismatic"
        metre = UsdGeom.GetStageMetersPerUnit(self.stage)
        kilogram = UsdPhysics.GetStageKilogramsPerUnit(self.stage)
        unit = metre if slide else math.radians(1.0)
        # Of what resists: N s/m and N m s/deg, in the stage's units.
        strength = kilogram * (1.0 if slide else metre**2)
        axis = frame[:3, :3] @ np.eye(3)["XYZ".index(token)]
        lower, upper = _limits(prim, slide, token)
        if tie.reversed:
            axis = -axis
        limited = math.isfinite(lower) and math.isfinite(upper) and lower <= upper
        if slide and not limited:
            raise SpecError(f"{self.path}: joint {tie.name} slides and states no limits")
        if limited and lower == upper:
            self.notes.append(f"joint {tie.name} has no range: imported as fixed")
            return unchecked_joint(**common, type="fixed")
        instance = "linear" if slide else "angular"
        drive = UsdPhysics.DriveAPI.Get(prim, instance)
        applied = bool(drive) and prim.HasAPI(UsdPhysics.DriveAPI, instance)
        damping = _value(drive.GetDampingAttr()) if applied else 0.0
        stiffness = _value(drive.GetStiffnessAttr()) if applied else 0.0
        if stiffness and _value(drive.GetTargetPositionAttr()):
            self.notes.append(f"joint {tie.name}: its drive's target is not imported")
        force = drive.GetMaxForceAttr().Get() if applied else None
        velocity = _first(
            prim, "newton:velocityLimit", f"physxJointAxis:{instance}:maxJointVelocity",
            "physxJoint:maxJointVelocity",
        )  # fmt: skip
        per = unit / metre if slide else unit
        passive = {name: _first(prim, f"mjc:{name}") or 0.0 for name in ("damping", "stiffness")}
        return unchecked_joint(
            **common,
            type="prismatic" if slide else "revolute" if limited else "continuous",
            axis=triple(axis / np.linalg.norm(axis)),
            lower=lower * unit if limited else 0.0,
            upper=upper * unit if limited else 0.0,
            damping=max(damping / per * strength, 0.0) or max(passive["damping"], 0.0),
            stiffness=max(stiffness / per * strength, 0.0) or max(passive["stiffness"], 0.0),
            armature=max(_first(prim, "newton:armature", f"physxJointAxis:{instance}:armature",
                                "physxJoint:armature", "mjc:armature") or 0.0, 0.0),
            friction=max(_first(prim, "newton:friction",
                                f"physxJointAxis:{instance}:staticFrictionEffort",
                                "mjc:frictionloss") or 0.0, 0.0),
            effort=force * strength * (metre if slide else 1.0)
            if force is not None and math.isfinite(force) and force > 0
            else None,
            velocity=velocity * unit
            if velocity is not None and math.isfinite(velocity) and velocity > 0
            else None,
            mimic=self._mimic(prim, unit, tie.reversed),
        )  # fmt: skip

    def _mimic(self, prim: Usd.Prim, unit: float, reversed_: bool) -> Mimic | None:
        """Return the joint that this one follows: Newton's words, else PhysX's."""
        sign = -1.0 if reversed_ else 1.0
        leaders = prim.GetRelationship("newton:mimicJoint").GetTargets()
        factor, offset = _first(prim, "newton:mimicCoef1"), _first(prim, "newton:mimicCoef0")
        factor = 1.0 if factor is None else factor
        for axis in ("rotX", "rotY", "rotZ") if not leaders else ():
            space = f"physxMimicJoint:{axis}"
            if leaders := prim.GetRelationship(f"{space}:referenceJoint").GetTargets():
                factor = -(_first(prim, f"{space}:gearing") or 0.0)
                offset = -(_first(prim, f"{space}:offset") or 0.0)
                break
        leader = self.stage.GetPrimAtPath(leaders[0]) if leaders else None
        if not leader or not is_joint(leader):
            return None
        metre = UsdGeom.GetStageMetersPerUnit(self.stage)
        led = metre if kind_of(leader)[0] == "prismatic" else math.radians(1.0)
        return unchecked_mimic(
            leader.GetName(), sign * factor * unit / led, sign * (offset or 0.0) * unit
        )


def state_of(joint: JointSpec, motion: NDArray) -> dict[str, float]:
    """Return a joint's value, `motion` [4, 4] being the child's displacement in the rest frame."""
    if joint.type == "fixed":
        return {}
    turn = from_matrix(motion[:3, :3])
    if joint.type == "prismatic":
        moved = motion[:3, :3] @ np.array(joint.pos) + motion[:3, 3] - np.array(joint.pos)
        value = {joint.name: float(moved @ np.array(joint.axis))}
    else:
        angle = float(angle_between(np.array([1.0, 0, 0, 0]), turn))
        length = float(np.linalg.norm(turn[1:]))
        vector = angle * turn[1:] / length if length > 1e-12 else np.zeros(3)
        if joint.type == "ball":
            value = {f"{joint.name}.{a}": float(v) for a, v in zip("xyz", vector, strict=True)}
        else:
            value = {joint.name: float(vector @ np.array(joint.axis))}
    return {name: v for name, v in value.items() if abs(v) > 1e-7}


def _limits(prim: Usd.Prim, slide: bool, token: str) -> tuple[float, float]:
    """Return a joint's limits, in degrees or the stage's lengths."""
    if prim.IsA(UsdPhysics.PrismaticJoint) or prim.IsA(UsdPhysics.RevoluteJoint):
        typed = UsdPhysics.PrismaticJoint(prim) if slide else UsdPhysics.RevoluteJoint(prim)
        low, high = typed.GetLowerLimitAttr().Get(), typed.GetUpperLimitAttr().Get()
    else:
        limit = UsdPhysics.LimitAPI.Get(prim, f"{'trans' if slide else 'rot'}{token}")
        low, high = limit.GetLowAttr().Get(), limit.GetHighAttr().Get()
    return (-math.inf if low is None else float(low)), (math.inf if high is None else float(high))


def _value(attribute: Usd.Attribute) -> float:
    value = attribute.Get()
    return float(value) if value is not None and math.isfinite(value) else 0.0


def _first(prim: Usd.Prim, *names: str) -> float | None:
    """Return the first of some attributes that is a number; of other schemas none is registered."""
    for name in names:
        value = prim.GetAttribute(name).Get()
        if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value):
            return float(value)
    return None


def _rotation(quat: Gf.Quatf | None) -> NDArray:
    if quat is None or quat.GetLength() < 1e-6:
        return np.eye(3)
    return np.array(Gf.Matrix3d(Gf.Quatd(quat.GetNormalized()))).T
