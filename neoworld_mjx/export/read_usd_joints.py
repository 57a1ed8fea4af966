"""Reads joints of USD stages: frames, and attributes of UsdPhysics, Newton, PhysX and MuJoCo.

The axis of a joint is the coordinate axis that the joint's axis token names, rotated by the joint's
local rotation. Limits and drives of angular joints are in degrees.
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
from ..spec.pose import angle_between, from_matrix, triple
from .mechanism import unchecked_joint, unchecked_mimic

_FREEDOMS = ("transX", "transY", "transZ", "rotX", "rotY", "rotZ")


@dataclass(frozen=True)
class StageJoint:
    """Joint between two bodies, which are given by their paths. An empty parent is the world."""

    prim: Usd.Prim
    parent: str
    child: str
    parent_frame: NDArray
    """Pose of the joint's frame in the parent's frame [m], shape [4, 4]."""
    child_frame: NDArray
    """Pose of the joint's frame in the child's frame [m], shape [4, 4]."""
    reversed: bool = False
    """True if the parent is body 1 in the file."""

    @property
    def name(self) -> str:
        """Name of the prim."""
        return self.prim.GetName()

    @property
    def fixed(self) -> bool:
        """True if the joint has no degree of freedom."""
        return kind_of(self.prim)[0] == "fixed"

    def flipped(self) -> "StageJoint":
        """Return the joint with parent and child exchanged."""
        return replace(
            self, parent=self.child, child=self.parent, parent_frame=self.child_frame,
            child_frame=self.parent_frame, reversed=not self.reversed,
        )  # fmt: skip


def is_joint(prim: Usd.Prim) -> bool:
    """Return True if a prim is a joint."""
    return prim.IsA(UsdPhysics.Joint)


def kind_of(prim: Usd.Prim) -> tuple[str, str]:
    """Return the type and the axis token of a joint.

    The type is "prismatic", "revolute" (with or without limits), "ball", "fixed" or "other".
    """
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
    return ("other" if free else "fixed"), "X"


def _locked(prim: Usd.Prim, freedom: str) -> bool:
    limit = UsdPhysics.LimitAPI.Get(prim, freedom)
    if not limit or not prim.HasAPI(UsdPhysics.LimitAPI, freedom):
        return False
    low, high = limit.GetLowAttr().Get(), limit.GetHighAttr().Get()
    return low is not None and high is not None and low > high


@dataclass
class JointReader:
    """Reader of the joints of one stage."""

    path: Path
    stage: Usd.Stage
    world_transform: Callable[[Usd.Prim], NDArray]
    """Function that returns the transform from a prim's frame to the world frame, with scale [m],
    shape [4, 4]."""
    bodies: dict[str, NDArray]
    """Rigid transform from each body's frame to the world frame [m], shape [4, 4], by path."""
    notes: list[str]

    def stage_joints(self, prims: list[Usd.Prim]) -> list[StageJoint]:
        """Return the joints that connect a body to another body or to the world, in file order."""
        result = []
        for prim in prims:
            schema = UsdPhysics.Joint(prim)
            first, first_frame = self._side(
                schema.GetBody0Rel(), schema.GetLocalPos0Attr(), schema.GetLocalRot0Attr()
            )
            second, second_frame = self._side(
                schema.GetBody1Rel(), schema.GetLocalPos1Attr(), schema.GetLocalRot1Attr()
            )
            if first == second:
                continue
            joint = StageJoint(prim, first, second, first_frame, second_frame)
            joint = joint if second else joint.flipped()
            if kind_of(prim)[0] == "other":
                outcome = "imported as fixed" if joint.parent else "skipped"
                self.notes.append(
                    f"joint {prim.GetName()} has several degrees of freedom: {outcome}"
                )
                if not joint.parent:
                    continue
            result.append(joint)
        return result

    def _side(
        self, body: Usd.Relationship, position: Usd.Attribute, rotation: Usd.Attribute
    ) -> tuple[str, NDArray]:
        """Return the path of the body on one side of a joint, and the joint's frame in the body."""
        targets = body.GetTargets()
        prim = self.stage.GetPrimAtPath(targets[0]) if targets else None
        if targets and not prim:
            raise SpecError(
                f"{self.path}: joint {body.GetPrim().GetPath()} names {targets[0]}, "
                "which does not exist"
            )
        raw = self.world_transform(prim or self.stage.GetPseudoRoot())
        frame = np.eye(4)
        frame[:3, 3] = (raw @ np.array([*(position.Get() or (0, 0, 0)), 1.0]))[:3]
        linear = raw[:3, :3]
        frame[:3, :3] = linear / np.linalg.norm(linear, axis=0) @ rotation_matrix(rotation.Get())
        owner = prim
        while owner and str(owner.GetPath()) not in self.bodies:
            owner = owner.GetParent()
            owner = None if owner is None or owner.IsPseudoRoot() else owner
        if not owner:
            return "", frame
        name = str(owner.GetPath())
        return name, np.linalg.inv(self.bodies[name]) @ frame

    def joint(self, joint: StageJoint, frame: NDArray, labels: dict[str, str]) -> JointSpec:
        """Convert a joint of the stage to a `JointSpec`.

        Args:
            joint: the joint in the stage.
            frame: pose of the joint's frame in the mechanism's frame, with all joints at zero [m],
                shape [4, 4].
            labels: link name of each body, by path of the body.

        Raises:
            SpecError: the joint is prismatic and has no limits.
        """
        kind, token = kind_of(joint.prim)
        common: dict[str, Any] = {
            "name": joint.name,
            "parent": labels[joint.parent],
            "child": labels[joint.child],
            "pos": triple(frame[:3, 3]),
        }
        if kind in ("fixed", "other"):
            return unchecked_joint(**common, type="fixed")
        if kind == "ball":
            return unchecked_joint(**common, **_ball_fields(joint.prim), type="ball")
        slide = kind == "prismatic"
        axis = frame[:3, :3] @ np.eye(3)["XYZ".index(token)]
        lower, upper = _limits(joint.prim, slide, token)
        limited = math.isfinite(lower) and math.isfinite(upper) and lower <= upper
        if slide and not limited:
            raise SpecError(f"{self.path}: joint {joint.name} is prismatic and has no limits")
        if limited and lower == upper:
            self.notes.append(f"joint {joint.name} has no range: imported as fixed")
            return unchecked_joint(**common, type="fixed")
        units = self._units(slide)
        return unchecked_joint(
            **common,
            **_passive_fields(joint.prim, "linear" if slide else "angular"),
            **self._drive_fields(joint, units, "linear" if slide else "angular"),
            type="prismatic" if slide else "revolute" if limited else "continuous",
            axis=triple((-axis if joint.reversed else axis) / np.linalg.norm(axis)),
            lower=lower * units.position if limited else 0.0,
            upper=upper * units.position if limited else 0.0,
            velocity=_velocity(joint.prim, "linear" if slide else "angular", units.position),
            mimic=self._mimic(joint.prim, units.position, joint.reversed),
        )

    def _units(self, slide: bool) -> "_Units":
        meter = UsdGeom.GetStageMetersPerUnit(self.stage)
        kilogram = UsdPhysics.GetStageKilogramsPerUnit(self.stage)
        if slide:
            return _Units(meter, 1.0, kilogram, meter)
        degree = math.radians(1.0)
        return _Units(degree, degree, kilogram * meter**2, 1.0)

    def _drive_fields(
        self, joint: StageJoint, units: "_Units", instance: str
    ) -> dict[str, float | None]:
        """Return the damping, stiffness and effort of a joint's drive.

        If the drive states no damping or stiffness, MuJoCo's attribute is used.
        """
        drive = UsdPhysics.DriveAPI.Get(joint.prim, instance)
        applied = bool(drive) and joint.prim.HasAPI(UsdPhysics.DriveAPI, instance)
        damping = _value(drive.GetDampingAttr()) if applied else 0.0
        stiffness = _value(drive.GetStiffnessAttr()) if applied else 0.0
        if stiffness and _value(drive.GetTargetPositionAttr()):
            self.notes.append(f"joint {joint.name}: its drive's target is not imported")
        force = _value(drive.GetMaxForceAttr()) if applied else 0.0
        return {
            "damping": max(damping / units.per * units.strength, 0.0)
            or _first(joint.prim, "mjc:damping"),
            "stiffness": max(stiffness / units.per * units.strength, 0.0)
            or _first(joint.prim, "mjc:stiffness"),
            "effort": force * units.strength * units.length if force > 0 else None,
        }

    def _mimic(self, prim: Usd.Prim, unit: float, reversed_: bool) -> Mimic | None:
        """Return the `Mimic` of a joint from Newton's attributes or, without them, from PhysX's."""
        sign = -1.0 if reversed_ else 1.0
        leaders = prim.GetRelationship("newton:mimicJoint").GetTargets()
        factor, offset = _number(prim, "newton:mimicCoef1"), _number(prim, "newton:mimicCoef0")
        factor = 1.0 if factor is None else factor
        for axis in ("rotX", "rotY", "rotZ") if not leaders else ():
            space = f"physxMimicJoint:{axis}"
            if leaders := prim.GetRelationship(f"{space}:referenceJoint").GetTargets():
                factor = -(_number(prim, f"{space}:gearing") or 0.0)
                offset = -(_number(prim, f"{space}:offset") or 0.0)
                break
        leader = self.stage.GetPrimAtPath(leaders[0]) if leaders else None
        if not leader or not is_joint(leader):
            return None
        leader_unit = self._units(kind_of(leader)[0] == "prismatic").position
        return unchecked_mimic(
            leader.GetName(), sign * factor * unit / leader_unit, sign * (offset or 0.0) * unit
        )


@dataclass(frozen=True)
class _Units:
    """Factors that convert a stage's joint quantities to SI units."""

    position: float
    """Factor of positions, limits and velocities: the unit of length [m], or a degree [rad]."""
    per: float
    """Divisor of damping and stiffness: a degree [rad] for a hinge. It is 1 for a slide, because
    the unit of length cancels."""
    strength: float
    """Factor of damping, stiffness and effort."""
    length: float
    """Further factor of effort: the unit of length for a slide, otherwise 1."""


def _ball_fields(prim: Usd.Prim) -> dict[str, float]:
    """Return the upper limit, damping, stiffness, armature and friction of a ball joint."""
    cone = UsdPhysics.SphericalJoint(prim).GetConeAngle0LimitAttr().Get()
    upper = math.radians(min(max(cone, 0.0), 180.0)) if math.isfinite(cone) else 0.0
    fields = ("damping", "stiffness", "armature", "friction")
    spaces = ("neoworld", "newton", "mjc")
    return {"upper": upper} | {
        field: abs(_number(prim, *(f"{space}:{field}" for space in spaces)) or 0.0)
        for field in fields
    }


def _passive_fields(prim: Usd.Prim, instance: str) -> dict[str, float]:
    """Return the armature and dry friction of a joint, for which UsdPhysics has no attributes."""
    physx = f"physxJointAxis:{instance}"
    return {
        "armature": _first(
            prim, "newton:armature", f"{physx}:armature", "physxJoint:armature", "mjc:armature"
        ),
        "friction": _first(
            prim, "newton:friction", f"{physx}:staticFrictionEffort", "mjc:frictionloss"
        ),
    }


def _velocity(prim: Usd.Prim, instance: str, unit: float) -> float | None:
    velocity = _first(
        prim,
        "newton:velocityLimit",
        f"physxJointAxis:{instance}:maxJointVelocity",
        "physxJoint:maxJointVelocity",
    )
    return velocity * unit if velocity > 0 else None


def state_of(joint: JointSpec, motion: NDArray) -> dict[str, float]:
    """Return the position of a joint by name; components below 1e-7 are omitted.

    Args:
        joint: the joint.
        motion: rigid displacement of the child, relative to the parent, from the pose with all
            joints at zero, in the mechanism's frame [m], shape [4, 4].
    """
    if joint.type == "fixed":
        return {}
    if joint.type == "prismatic":
        shift = motion[:3, :3] @ np.array(joint.pos) + motion[:3, 3] - np.array(joint.pos)
        value = {joint.name: float(shift @ np.array(joint.axis))}
    else:
        quat = from_matrix(motion[:3, :3])
        angle = float(angle_between(np.array([1.0, 0, 0, 0]), quat))
        length = float(np.linalg.norm(quat[1:]))
        vector = angle * quat[1:] / length if length > 1e-12 else np.zeros(3)
        if joint.type == "ball":
            value = {f"{joint.name}.{a}": float(v) for a, v in zip("xyz", vector, strict=True)}
        else:
            value = {joint.name: float(vector @ np.array(joint.axis))}
    return {name: v for name, v in value.items() if abs(v) > 1e-7}


def _limits(prim: Usd.Prim, slide: bool, token: str) -> tuple[float, float]:
    """Return the limits of a joint, in degrees or in the stage's unit of length."""
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


def _number(prim: Usd.Prim, *names: str) -> float | None:
    """Return the first of the named attributes that is a finite number; None if there is none."""
    for name in names:
        value = prim.GetAttribute(name).Get()
        if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value):
            return float(value)
    return None


def _first(prim: Usd.Prim, *names: str) -> float:
    """Return the result of `_number`, or 0 if the result is None or negative."""
    return max(_number(prim, *names) or 0.0, 0.0)


def rotation_matrix(quat: Gf.Quatf | None) -> NDArray:
    """Return the rotation matrix [3, 3] of a USD quaternion, or the identity if None or zero."""
    if quat is None or quat.GetLength() < 1e-6:
        return np.eye(3)
    return np.array(Gf.Matrix3d(Gf.Quatd(quat.GetNormalized()))).T
