"""Which joints the parse means, and where they stand when it shows them open."""

import numpy as np

from .object import Joint, ObjectSpec
from .tree import PartState, TreeNode


def joint_meant(spec: ObjectSpec, part: str, kind: str) -> Joint | None:
    """Return the joint that moves a part of the parse: by name, or the only one of its kind."""
    # A ball has no "open": it stays as it is drawn.
    still = ("fixed", "ball")
    moving = [joint for joint in spec.joints if joint.type not in still and joint.mimic is None]
    for joint in moving:
        if part in (joint.name, joint.child):
            return joint
    same = [joint for joint in moving if joint.type == kind]
    return same[0] if len(same) == 1 else None


def opening_value(joint: Joint, opening: float) -> float:
    """Return where a joint stands when opened by a share of its range [rad or m].

    Closed is 0, or the limit nearest to it; open is the limit furthest from that, by convention the
    positive one. A continuous joint turns once.
    """
    if joint.type == "continuous":
        return float(2 * np.pi * opening)
    closed = float(np.clip(0.0, joint.lower, joint.upper))
    far = joint.upper if joint.upper - closed >= closed - joint.lower else joint.lower
    return closed + opening * (far - closed)


def parsed_state(spec: ObjectSpec, node: TreeNode) -> tuple[dict[str, float], list[PartState]]:
    """Return how an object's joints stand in the photograph.

    Args:
        spec: the object, at any size.
        node: what the parse says of it.

    Returns:
        Joint values [rad or m], and the parts of the parse that no joint fits.
    """
    state: dict[str, float] = {}
    left = []
    for part in node.articulation:
        joint = joint_meant(spec, part.part, part.type)
        if joint is None:
            left.append(part)
        else:
            state[joint.name] = opening_value(joint, part.opening)
    return state, left


__all__ = ["joint_meant", "opening_value", "parsed_state"]
