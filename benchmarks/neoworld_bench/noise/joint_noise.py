"""Errors of joints in programs: missing and extra joints; wrong types, axes, pivots and ranges.

Errors are added one by one, so that the object always passes the checks of programs.
Rates and magnitudes were measured on twelve objects with 29 joints (docs/results.md, "Objects
from pictures").
"""

import math
from collections.abc import Callable, Iterator

import numpy as np
from pydantic import ValidationError

from neoworld_mjx.checks.compile_checks import check
from neoworld_mjx.checks.signals import Allowance, has_errors
from neoworld_mjx.config import ProgramOptions
from neoworld_mjx.program.assemble import default_losses
from neoworld_mjx.spec import (
    GeomSpec,
    JointSpec,
    ObjectSpec,
    PartSpec,
    bounds,
    inertial,
    part_bounds,
)

from .parse_noise import NoiseLog

TRIES = 8
"""Maximum number of samples of an error until one passes the checks."""
Variant = Callable[[ObjectSpec, np.random.Generator], ObjectSpec | None]


class Draft:
    """An object to which errors are added one by one.

    An error is kept only if the object with it passes the checks.
    """

    def __init__(
        self,
        spec: ObjectSpec,
        allowances: tuple[Allowance, ...],
        rng: np.random.Generator,
        log: NoiseLog,
    ) -> None:
        """Start from an object without errors, and the overlaps that its program allows."""
        self.spec, self.rng, self._allowances, self._log = spec, rng, allowances, log

    def change(self, kind: str, variant: Variant, *, noted: bool = True) -> None:
        """Add an error to the object.

        Args:
            kind: name of the error in the log.
            variant: function that samples an object with the error, or returns None if the object
                cannot have this error.
            noted: if True, the log notes that the error was injected. Errors that every object has
                are not noted.
        """
        for _ in range(TRIES):
            try:
                changed = variant(self.spec, self.rng)
                if changed is None or changed == self.spec:
                    return
                changed = ObjectSpec.model_validate(changed.model_dump())
            except ValidationError:
                continue
            if self._passes(changed):
                self.spec = changed
                if noted:
                    self._log.injected.append(kind)
                return
        self._log.refused.append(kind)

    def _passes(self, spec: ObjectSpec) -> bool:
        parts = {part.name for part in spec.parts}
        remaining = [a for a in self._allowances if {a.first, a.second} <= parts]
        return not has_errors(check(spec, ProgramOptions(), None, remaining))


MISSED = 2 / 29
"""Rate of missing joints. Measured: in each of three runs, the programs had 27 of the 29 true
joints (27 hits)."""
EXTRA = 4 / 12
"""Rate of an extra joint in an object with joints. Measured: four extra joints in twelve
objects."""
OTHER_TYPE = 1 / (27 + 2)
"""Rate of joints with a wrong type. Measured: none of 27 hits. The rate 1/(n + 2) is the mean of
Laplace's rule of succession."""
ACROSS = 1 / 54
"""Rate of joints with a perpendicular axis. Measured: one (a toggle) of the 54 hits of two runs."""
SLANTED, SLANT_DEG = 1 / 27, 8.4
"""Rate of joints with a slanted axis, and the angle [deg]. Measured: one of the 27 hits of the
first run, a lever on a slope that was estimated by eye. The axes of the other hits were exact."""
PIVOT = 0.0102
"""Standard deviation of the pivot along each of the two directions perpendicular to the axis, as a
fraction of the object's diagonal. Measured: a mean distance of .0128 over 16 revolute hits."""
RANGE = 0.26
"""Standard deviation of the logarithm of a range. Measured: mean overlaps with the true range of
.82, .84 and .81 in three runs. Ranges with this deviation and a common lower end have about this
overlap."""
TURN_RAD, SLIDE = 0.5, 0.3
"""Range of a joint that the ground truth lacks: an angle [rad], or a fraction of the sliding part's
size."""


def wrong_joints(draft: Draft) -> None:
    """Add errors to the joints of an object.

    Args:
        draft: the object. The errors "joint missing", "joint type", "joint axis" and "joint extra"
            are added to its log.
    """
    rng = draft.rng
    names = [joint.name for joint in free_joints(draft.spec)]
    for name in names:
        missed, other, across, slanted = rng.uniform(size=4)
        if missed < MISSED:
            draft.change("joint missing", lambda s, r, n=name: with_joint(s, fastened(s, n)))
            continue
        if other < OTHER_TYPE:
            draft.change("joint type", lambda s, r, n=name: with_joint(s, of_other_type(s, n)))
        if across < ACROSS:
            draft.change("joint axis", lambda s, r, n=name: with_joint(s, across_axis(s, n, r)))
        if slanted < SLANTED:
            draft.change("joint axis", lambda s, r, n=name: with_joint(s, slanted_axis(s, n, r)))
        draft.change("pivot", lambda s, r, n=name: with_joint(s, off_pivot(s, n, r)), noted=False)
        draft.change("range", lambda s, r, n=name: with_joint(s, off_range(s, n, r)), noted=False)
    if names and rng.uniform() < EXTRA:
        draft.change("joint extra", with_extra_joint)


def free_joints(spec: ObjectSpec) -> list[JointSpec]:
    """Return the moving joints that neither depend on other joints nor are referenced by them."""
    referenced = {name for joint in spec.joints for name in joint.after} | {
        joint.mimic.joint for joint in spec.joints if joint.mimic is not None
    }
    return [
        joint
        for joint in spec.joints
        if joint.type not in ("fixed", "ball")
        and joint.mimic is None
        and joint.name not in referenced
    ]


def with_joint(spec: ObjectSpec, changed: JointSpec) -> ObjectSpec:
    """Return an object with one joint replaced, and without the intent of this joint."""
    joint = JointSpec.model_validate(changed.model_dump() | {"intent": None})
    joints = tuple(joint if old.name == joint.name else old for old in spec.joints)
    return spec.model_copy(update={"joints": joints})


def fastened(spec: ObjectSpec, name: str) -> JointSpec:
    """Return a fixed joint in place of a moving one."""
    joint = spec.joint(name)
    return JointSpec(name=name, type="fixed", parent=joint.parent, child=joint.child)


def of_other_type(spec: ObjectSpec, name: str) -> JointSpec:
    """Return a prismatic joint in place of a revolute one, or the reverse."""
    joint, size = spec.joint(name), _child_size(spec, name)
    plain: dict[str, object] = {"stiffness": 0.0, "armature": 0.0}
    plain |= {"effort": None, "velocity": None, "lower": 0.0}
    if joint.type == "prismatic":
        low, high = part_bounds(spec, spec.part(joint.child))
        middle = tuple(((low + high) / 2).tolist())
        plain |= {"type": "revolute", "pos": middle, "upper": TURN_RAD}
    else:
        plain |= {"type": "prismatic", "upper": SLIDE * float(np.abs(joint.axis) @ size)}
    return _with_usual_losses(spec, joint.model_copy(update=plain))


def across_axis(spec: ObjectSpec, name: str, rng: np.random.Generator) -> JointSpec:
    """Return a joint whose axis is replaced by one of two perpendicular axes."""
    joint = spec.joint(name)
    first, second = _across(np.array(joint.axis))
    way = (first, second)[int(rng.integers(2))] * rng.choice((-1.0, 1.0))
    return joint.model_copy(update={"axis": tuple(way.tolist())})


def slanted_axis(spec: ObjectSpec, name: str, rng: np.random.Generator) -> JointSpec:
    """Return a joint with its axis tilted by SLANT_DEG in a random direction."""
    joint = spec.joint(name)
    axis, turn = np.array(joint.axis), rng.uniform(0, 2 * math.pi)
    first, second = _across(axis)
    off = math.radians(SLANT_DEG)
    way = math.cos(off) * axis
    way += math.sin(off) * (math.cos(turn) * first + math.sin(turn) * second)
    return joint.model_copy(update={"axis": tuple(way.tolist())})


def off_pivot(spec: ObjectSpec, name: str, rng: np.random.Generator) -> JointSpec:
    """Return a joint with a displaced pivot; joints that do not rotate are returned unchanged."""
    joint = spec.joint(name)
    if joint.type not in ("revolute", "continuous"):
        return joint
    low, high = bounds(spec)
    step = PIVOT * float(np.linalg.norm(high - low)) * rng.normal(size=2)
    position = np.array(joint.pos) + step @ np.array(_across(np.array(joint.axis)))
    return joint.model_copy(update={"pos": tuple(position.tolist())})


def off_range(spec: ObjectSpec, name: str, rng: np.random.Generator) -> JointSpec:
    """Return a joint with a longer or shorter range; joints without limits are unchanged."""
    joint = spec.joint(name)
    if joint.type not in ("revolute", "prismatic"):
        return joint
    factor = math.exp(RANGE * rng.normal())
    return joint.model_copy(update={"lower": joint.lower * factor, "upper": joint.upper * factor})


def with_extra_joint(spec: ObjectSpec, rng: np.random.Generator) -> ObjectSpec | None:
    """Return an object in which one shape becomes a separate moving part; None if impossible."""
    options = list(_loose_shapes(spec))
    if not options:
        return None
    part, geom = options[int(rng.integers(len(options)))]
    others = tuple(other for other in part.geoms if other is not geom)
    alone = PartSpec(name="extra_part", geoms=(geom,))
    low, high = part_bounds(spec, alone)
    axis = np.eye(3)[int(rng.integers(3))]
    fields = {"name": "extra_joint", "parent": part.name, "child": alone.name}
    fields |= {"pos": ((low + high) / 2).tolist(), "axis": axis.tolist()}
    if rng.uniform() < 0.5:
        fields |= {"type": "revolute", "upper": TURN_RAD}
    else:
        fields |= {"type": "prismatic", "upper": SLIDE * float(axis @ (high - low))}
    parts = [p.model_copy(update={"geoms": others}) if p is part else p for p in spec.parts]
    separated = spec.model_copy(update={"parts": (*parts, alone)})
    joint = _with_usual_losses(separated, JointSpec.model_validate(fields))
    return separated.model_copy(update={"joints": (*spec.joints, joint)})


def _with_usual_losses(spec: ObjectSpec, joint: JointSpec) -> JointSpec:
    """Return a joint with the damping and dry friction that a program has by default."""
    losses = default_losses(joint, inertial(spec, spec.part(joint.child)))
    return joint.model_copy(update=dict(zip(("damping", "friction"), losses, strict=True)))


def _loose_shapes(spec: ObjectSpec) -> Iterator[tuple[PartSpec, GeomSpec]]:
    for part in spec.parts:
        colliding = [geom for geom in part.geoms if geom.role == "both"]
        if part.mass is None and len(colliding) > 1:
            yield from ((part, geom) for geom in colliding)


def _child_size(spec: ObjectSpec, name: str) -> np.ndarray:
    low, high = part_bounds(spec, spec.part(spec.joint(name).child))
    return high - low


def _across(axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return two unit vectors [3] perpendicular to an axis and to each other."""
    other = np.eye(3)[int(np.argmin(np.abs(axis)))]
    first = np.cross(axis, other)
    first /= np.linalg.norm(first)
    return first, np.cross(axis, first)
