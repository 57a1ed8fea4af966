"""Faults to inject into valid objects: kinds, magnitudes, and the faults that must be reported."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from neoworld_mjx.checks.joint_checks import on_edge
from neoworld_mjx.checks.verdict import Fault
from neoworld_mjx.spec import (
    AuthoredInertia,
    Box,
    GeomSpec,
    JointSpec,
    ObjectSpec,
    PartSpec,
    bounds,
    inertial,
    part_bounds,
    recentred,
)
from neoworld_mjx.spec.kinematics import moving_parts, with_joint

Inject = Callable[[ObjectSpec, float], "ObjectSpec | None"]


@dataclass(frozen=True)
class Kind:
    """One kind of fault."""

    name: str
    causes: tuple[Fault, ...]
    """Reported faults that identify it."""
    magnitudes: tuple[float, float, float]
    inject: Inject
    repairable: bool
    """True if a patch can express its repair."""


def _joint(spec: ObjectSpec, *types: str, opens: bool = False) -> JointSpec | None:
    for joint in spec.joints:
        declared = joint.intent is not None and joint.intent.opens is not None
        if joint.type in types and (declared or not opens):
            return joint
    return None


def _change(spec: ObjectSpec, joint: JointSpec | None, **fields: object) -> ObjectSpec | None:
    return None if joint is None else with_joint(spec, joint.model_copy(update=fields))


def _part(spec: ObjectSpec, name: str, **fields: object) -> ObjectSpec:
    parts = tuple(p.model_copy(update=fields) if p.name == name else p for p in spec.parts)
    return spec.model_copy(update={"parts": parts})


def reversed_axis(spec: ObjectSpec, _: float) -> ObjectSpec | None:
    """Reverse the axis of a joint with a declared opening direction."""
    joint = _joint(spec, "revolute", "prismatic", opens=True)
    axis = None if joint is None else tuple(-v for v in joint.axis)
    return _change(spec, joint, axis=axis)


def leaning_axis(spec: ObjectSpec, degrees: float) -> ObjectSpec | None:
    """Turn the axis of a sliding joint away from its declared opening direction."""
    joint = _joint(spec, "prismatic", "revolute", opens=True)
    if joint is None or joint.intent is None or joint.intent.opens is None:
        return None
    axis, side = np.array(joint.axis), np.array(joint.intent.opens)
    if joint.type == "prismatic":
        other = np.cross(side, (0, 0, 1.0)) if abs(side[2]) < 0.9 else np.array([1.0, 0, 0])
        angle = np.radians(degrees)
        turned = np.cos(angle) * axis + np.sin(angle) * other / np.linalg.norm(other)
        return _change(spec, joint, axis=tuple(turned.tolist()))
    if degrees < 180:
        return None
    return _change(spec, joint, axis=tuple((-axis).tolist()))


def shifted_pivot(spec: ObjectSpec, share: float) -> ObjectSpec | None:
    """Move the axis of a turning joint out of its child, by a share of the child's diagonal."""
    joint = _joint(spec, "revolute", "continuous")
    if joint is None:
        return None
    low, high = part_bounds(spec, spec.part(joint.child))
    axis, at = np.array(joint.axis), np.array(joint.pos)
    out = at - (low + high) / 2
    out -= (out @ axis) * axis
    if np.linalg.norm(out) < 0.1 * np.linalg.norm(high - low):
        out = np.cross(axis, (0.3, 0.5, 0.8))
    out /= np.linalg.norm(out)
    # Measured from the edge of the child in that direction.
    corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
    beyond = float(((corners - at) @ out).max())
    far = at + out * (max(beyond, 0.0) + share * float(np.linalg.norm(high - low)))
    return _change(spec, joint, pos=tuple(far.tolist()))


def inner_pivot(spec: ObjectSpec, share: float) -> ObjectSpec | None:
    """Move a hinge from its edge towards the middle of its child, by a share of the distance."""
    joint = _joint(spec, "revolute", opens=True)
    if joint is None:
        return None
    low, high = part_bounds(spec, spec.part(joint.child))
    if not on_edge(joint, low, high):
        return None
    pivot, axis = np.array(joint.pos), np.array(joint.axis)
    direction = (low + high) / 2 - pivot
    direction -= (direction @ axis) * axis
    # Along the face against the parent, so that the hinge stays on it.
    direction *= np.abs(direction) >= np.abs(direction).max()
    return _change(spec, joint, pos=tuple((pivot + share * direction).tolist()))


def limits_into_parent(spec: ObjectSpec, share: float) -> ObjectSpec | None:
    """Extend a joint's range beyond closed, by a share of it."""
    joint = _joint(spec, "revolute", "prismatic", opens=True)
    if joint is None:
        return None
    if joint.type == "revolute" and not on_edge(joint, *part_bounds(spec, spec.part(joint.child))):
        return None  # A lever may turn in either direction.
    excess = share * (joint.upper - joint.lower)
    if joint.type == "prismatic" and share >= 0.05:
        excess = max(excess, 0.004)
    return _change(spec, joint, lower=joint.lower - excess)


def narrow_limits(spec: ObjectSpec, share: float) -> ObjectSpec | None:
    """Reduce a joint's range to a share of it."""
    joint = _joint(spec, "revolute", "prismatic")
    return _change(spec, joint, upper=None if joint is None else joint.upper * share)


def undamped(spec: ObjectSpec, share: float) -> ObjectSpec | None:
    """Reduce a joint's damping and friction to a share of them."""
    joint = _joint(spec, "revolute", "prismatic", "continuous")
    if joint is None:
        return None
    return _change(spec, joint, damping=share * joint.damping, friction=share * joint.friction)


def _authored(spec: ObjectSpec, part: PartSpec, factor: float) -> PartSpec:
    own = inertial(spec, part)
    a, b, c = own.diagonal
    inertia = AuthoredInertia(pos=own.pos, moments=(factor * a, factor * b, factor * c))
    return part.model_copy(update={"mass": own.mass, "inertia": inertia})


def odd_inertia(spec: ObjectSpec, factor: float) -> ObjectSpec | None:
    """Author the inertia of the last part as a multiple of the real one."""
    part = spec.parts[-1]
    own = inertial(spec, part)
    if abs(own.quat[0]) < 1 - 1e-9:
        return None
    parts = (*spec.parts[:-1], _authored(spec, part, factor))
    return spec.model_copy(update={"parts": parts})


def heavy(spec: ObjectSpec, factor: float) -> ObjectSpec | None:
    """Multiply the mass of the last part."""
    part = spec.parts[-1]
    derived = inertial(spec, part.model_copy(update={"mass": None})).mass
    return _part(spec, part.name, mass=factor * derived)


def large_collider(spec: ObjectSpec, factor: float) -> ObjectSpec | None:
    """Scale the colliders of the last part about its middle; the visible shapes stay."""
    part = spec.parts[-1]
    low, high = part_bounds(spec, part)
    middle = (low + high) / 2
    geoms = []
    for geom in part.geoms:
        at = middle + factor * (np.array(geom.pos) - middle)
        update = {"name": f"{geom.name}_c", "shape": geom.shape.scaled(factor), "role": "collision"}
        geoms.append(geom.model_copy(update={**update, "pos": tuple(at.tolist())}))
        geoms.append(geom.model_copy(update={"role": "visual"}))
    return _part(spec, part.name, geoms=tuple(geoms))


def missing_collider(spec: ObjectSpec, share: float) -> ObjectSpec | None:
    """Remove a share of the extent of the last part's colliders; its middle stays."""
    part = spec.parts[-1]
    low, high = part_bounds(spec, part)
    size = (1 - share) * (high - low)
    if size.min() < 1e-4:
        size = np.maximum(size, 1e-3)
    block = GeomSpec(
        name=f"{part.name}_rest",
        shape=Box(size=tuple(size.tolist())),
        pos=tuple(((low + high) / 2).tolist()),
        material=part.geoms[0].material,
        role="collision",
    )
    visible = tuple(geom.model_copy(update={"role": "visual"}) for geom in part.geoms)
    return _part(spec, part.name, geoms=(*visible, block))


def _moved(spec: ObjectSpec, joint: JointSpec, offset: NDArray) -> ObjectSpec:
    """Move the parts below a joint, but not the joint."""
    below = moving_parts(spec, joint)
    parts = tuple(
        p.model_copy(
            update={
                "geoms": tuple(
                    g.model_copy(update={"pos": tuple((np.array(g.pos) + offset).tolist())})
                    for g in p.geoms
                )
            }
        )
        if p.name in below
        else p
        for p in spec.parts
    )
    return spec.model_copy(update={"parts": parts})


def _outward(spec: ObjectSpec, joint: JointSpec) -> NDArray:
    """Return the unit vector along which a child leaves its parent soonest."""
    low, high = part_bounds(spec, spec.part(joint.child))
    lowest, highest = part_bounds(spec, spec.part(joint.parent))
    distances = np.concatenate([highest - low, high - lowest])
    best = int(np.argmin(distances))
    direction = np.zeros(3)
    direction[best % 3] = 1.0 if best < 3 else -1.0
    return direction


def detached(spec: ObjectSpec, share: float) -> ObjectSpec | None:
    """Move a child out of its parent and a share of the object's diagonal further."""
    joint = _joint(spec, "revolute", "prismatic", "continuous")
    if joint is None:
        return None
    low, high = part_bounds(spec, spec.part(joint.child))
    lowest, highest = part_bounds(spec, spec.part(joint.parent))
    direction = _outward(spec, joint)
    axis = int(np.argmax(np.abs(direction)))
    inside = highest[axis] - low[axis] if direction[axis] > 0 else high[axis] - lowest[axis]
    low, high = bounds(spec)
    return recentred(
        _moved(
            spec, joint, direction * (max(inside, 0) + share * float(np.linalg.norm(high - low)))
        )
    )


def interpenetrating(spec: ObjectSpec, share: float) -> ObjectSpec | None:
    """Move a child into its parent by a share of its least extent, at least 2 mm."""
    joint = _joint(spec, "revolute", "continuous", "prismatic")
    if joint is None:
        return None
    low, high = part_bounds(spec, spec.part(joint.child))
    direction = -_outward(spec, joint)
    deep = max(share * float((high - low).min()), 0.003 if share >= 0.2 else 0.0)
    if joint.type == "prismatic":
        # A drawer goes through the floor of its carcass.
        direction = np.array([0.0, 0.0, -1.0])
    return recentred(_moved(spec, joint, direction * (deep + 0.001)))


def wrong_type(spec: ObjectSpec, which: float) -> ObjectSpec | None:
    """Give a joint the first, second or third of the wrong types."""
    joint = _joint(spec, "revolute", "prismatic")
    if joint is None:
        return None
    others = [t for t in ("continuous", "prismatic", "revolute", "fixed") if t != joint.type]
    kind = others[int(which) - 1]
    update: dict[str, object] = {"type": kind}
    if kind in ("continuous", "fixed"):
        update |= {"lower": 0.0, "upper": 0.0}
    return _change(spec, joint, **update)


def off_balance(spec: ObjectSpec, share: float) -> ObjectSpec | None:
    """Put the object on a foot next to its centre of mass, by a share of its half width."""
    low, high = bounds(spec)
    total = sum(inertial(spec, p).mass for p in spec.parts)
    weighed = [inertial(spec, p).mass * np.array(inertial(spec, p).pos) for p in spec.parts]
    centre = np.sum(weighed, axis=0) / total
    width = 0.3 * (high - low)[:2].min()
    # Tall enough that it leans far before another part touches the ground.
    tall = max(0.25 * (high - low)[2], 0.3 * float((high - low)[:2].max()))
    edge = centre[1] + share * (high[1] - low[1]) / 2
    root = spec.part(spec.root)
    foot = GeomSpec(
        name="test_foot",
        shape=Box(size=(float(width), float(width), float(tall))),
        pos=(float(centre[0]), float(edge + width / 2), float(low[2] - tall / 2)),
        material=root.geoms[0].material,
    )
    return recentred(_part(spec, root.name, geoms=(*root.geoms, foot)))


def stuck(spec: ObjectSpec, factor: float) -> ObjectSpec | None:
    """Give a joint a multiple of the friction that a hand overcomes at the far end of its child."""
    joint = _joint(spec, "revolute", "prismatic")
    if joint is None:
        return None
    low, high = part_bounds(spec, spec.part(joint.child))
    arm = 1.0 if joint.type == "prismatic" else float(np.linalg.norm(high - low))
    weight = 9.81 * inertial(spec, spec.part(joint.child)).mass
    return _change(spec, joint, friction=factor * arm * (100.0 + weight))


def slippery(spec: ObjectSpec, friction: float) -> ObjectSpec | None:
    """Give all materials another friction."""
    if any(joint.type == "continuous" for joint in spec.joints):
        return None
    materials = tuple(m.model_copy(update={"friction": friction}) for m in spec.materials)
    return spec.model_copy(update={"materials": materials})


KINDS: tuple[Kind, ...] = (
    Kind("axis_reversed", (Fault.AXIS_REVERSED,), (1.0, 1.0, 1.0), reversed_axis, False),
    Kind(
        "joint_into_parent",
        (Fault.JOINT_INTO_PART, Fault.AXIS_REVERSED),
        (90.0, 135.0, 180.0),
        leaning_axis,
        False,
    ),
    Kind("pivot_shifted_out", (Fault.PIVOT_OFF,), (0.12, 0.3, 0.6), shifted_pivot, True),
    Kind("pivot_shifted_in", (Fault.PIVOT_OFF,), (0.3, 0.6, 1.0), inner_pivot, True),
    Kind(
        "limits_into_carcass", (Fault.LIMIT_INTO_PART,), (0.1, 0.3, 0.8), limits_into_parent, True
    ),
    Kind("limits_narrow", (Fault.LIMITS_NARROW,), (0.6, 0.3, 0.1), narrow_limits, True),
    Kind("no_damping", (Fault.JOINT_UNDAMPED,), (1e-4, 1e-5, 0.0), undamped, True),
    Kind("inertia", (Fault.INERTIA_IMPOSSIBLE,), (0.01, 1e-4, -1.0), odd_inertia, True),
    Kind("mass", (Fault.MASS_IMPLAUSIBLE,), (20.0, 100.0, 1000.0), heavy, True),
    Kind("collider_large", (Fault.COLLIDER_LARGE,), (1.2, 1.5, 2.0), large_collider, True),
    Kind("collider_missing", (Fault.COLLIDER_MISSING,), (0.4, 0.7, 0.95), missing_collider, True),
    Kind("part_detached", (Fault.PART_DETACHED,), (0.04, 0.1, 0.3), detached, True),
    Kind("part_interpenetrating", (Fault.PARTS_OVERLAP,), (0.2, 0.5, 0.9), interpenetrating, True),
    Kind("joint_type", (Fault.JOINT_TYPE,), (1.0, 2.0, 3.0), wrong_type, False),
    Kind("off_balance", (Fault.OFF_BALANCE,), (0.1, 0.25, 0.5), off_balance, False),
    Kind("joint_stuck", (Fault.JOINT_STUCK,), (2.0, 5.0, 50.0), stuck, True),
    Kind("friction", (Fault.FRICTION_IMPLAUSIBLE,), (0.03, 0.01, 0.0), slippery, False),
)
