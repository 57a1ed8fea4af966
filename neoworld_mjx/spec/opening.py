"""Opening of joints: parsed openings, prerequisites, and the direction of opening."""

import numpy as np

from .joint import JointSpec
from .kinematics import joint_motion, part_bounds
from .object import ObjectSpec
from .tree import PartState, TreeNode


def matching_joint(spec: ObjectSpec, part: str, kind: str) -> JointSpec | None:
    """Return the joint that matches a parsed part by name or, otherwise, the only one of its kind.

    Return None if no joint matches, or if several joints have this kind.
    """
    # A ball joint has no open position.
    moving = [j for j in spec.joints if j.type not in ("fixed", "ball") and j.mimic is None]
    for joint in moving:
        if part in (joint.name, joint.child):
            return joint
    same = [joint for joint in moving if joint.type == kind]
    return same[0] if len(same) == 1 else None


def opening_value(joint: JointSpec, opening: float) -> float:
    """Return the position [rad or m] of a joint that is open by a fraction of its range.

    The closed position is the position within the limits that is nearest to 0. The open position is
    the limit farthest from the closed position. The range of a continuous joint is one revolution.
    """
    if joint.type == "continuous":
        return float(2 * np.pi * opening)
    closed = float(np.clip(0.0, joint.lower, joint.upper))
    far = joint.upper if joint.upper - closed >= closed - joint.lower else joint.lower
    return closed + opening * (far - closed)


def opening_share(joint: JointSpec, value: float) -> float:
    """Return the fraction of its range, from 0 to 1, by which a joint at a position is open.

    This is the inverse of `opening_value`, clipped to the range.
    """
    span = opening_value(joint, 1.0) - opening_value(joint, 0.0)
    return float(np.clip((value - opening_value(joint, 0.0)) / span, 0.0, 1.0)) if span else 0.0


def parsed_state(spec: ObjectSpec, node: TreeNode) -> tuple[dict[str, float], list[PartState]]:
    """Return the parsed joint values [rad or m], and the parsed parts that match no joint."""
    state: dict[str, float] = {}
    unmatched = []
    for part in node.articulation:
        joint = matching_joint(spec, part.part, part.type)
        if joint is None:
            unmatched.append(part)
        else:
            state[joint.name] = opening_value(joint, part.opening)
    return state, unmatched


def prerequisite_state(spec: ObjectSpec, joint: JointSpec) -> dict[str, float]:
    """Return the open positions [rad or m] of all direct and indirect prerequisites of a joint."""
    by_name = {other.name: other for other in spec.joints}
    state: dict[str, float] = {}
    waiting = list(joint.after)
    while waiting:
        other = by_name[waiting.pop()]
        if other.name not in state:
            state[other.name] = opening_value(other, 1.0)
            waiting += other.after
    return state


def with_prerequisites(
    spec: ObjectSpec, state: dict[str, float], *, opening: bool
) -> dict[str, float]:
    """Return a state in which the prerequisites of every joint away from 0 are open.

    Args:
        spec: the object.
        state: joint values [rad or m].
        opening: if True, open the prerequisites of such a joint; if False, move the joint to 0
            unless its prerequisites are open.
    """
    state = dict(state)
    waiting = [joint for joint in spec.joints if joint.after]
    for _ in waiting:
        for joint in waiting:
            keys = [name for name in state if name.partition(".")[0] == joint.name]
            needed = prerequisite_state(spec, joint)
            if opening and any(state[name] for name in keys):
                state |= needed
            elif any(state.get(name, 0.0) != value for name, value in needed.items()):
                state |= dict.fromkeys(keys, 0.0)
    return state


MIN_TRAVEL = 0.15
"""Smallest displacement of a turning part's center that defines a direction, relative to the
displacement of a point whose distance from the axis is half the diagonal of the bounding box."""


def opening_alignment(spec: ObjectSpec, joint: JointSpec) -> float | None:
    """Return the cosine between the initial displacement of a joint's child and `intent.opens`.

    The displacement is that of the center of the child's bounding box if the joint moves by a tenth
    of its range, but at most by 0.1 rad or 0.1 m. Return None if the joint's axis passes near this
    center.
    """
    low, high = part_bounds(spec, spec.part(joint.child))
    width = 2 * np.pi if joint.type == "continuous" else joint.upper - joint.lower
    middle = (low + high) / 2
    displacement = joint_motion(joint, 0.1 * min(width, 1.0)).apply(middle) - middle
    length = float(np.linalg.norm(displacement))
    if joint.type != "prismatic":
        reach = 0.1 * min(width, 1.0) * float(np.linalg.norm(high - low)) / 2
        if length < MIN_TRAVEL * reach:
            return None
    goal = np.array(joint.intent.opens if joint.intent and joint.intent.opens else (0, 0, 0), float)
    return float(displacement @ goal / max(length * float(np.linalg.norm(goal)), 1e-12))
