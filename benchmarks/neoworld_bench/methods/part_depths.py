"""P-Pen: penetration between the parts of an articulated object while its joints move."""

from dataclasses import replace

from neoworld_mjx.checks.joint_sweep import sweep_combinations, sweep_joints
from neoworld_mjx.checks.part_distances import Probe
from neoworld_mjx.checks.static_checks import is_placeholder
from neoworld_mjx.config import JointSweepOptions
from neoworld_mjx.spec import ObjectSpec

P_PEN_M = 1e-3
"""Penetration of two parts above which an object counts in P-Pen [m]."""
_DEEPEST_M = 10.0
"""Allowed penetration [m] that no pair reaches, so that every pair is also measured in motion."""


def articulated(spec: ObjectSpec) -> bool:
    """Return True if an object has a joint that moves."""
    return any(joint.type != "fixed" for joint in spec.joints)


def part_depth(spec: ObjectSpec) -> float:
    """Return the deepest penetration of two parts of an object [m]; 0 if no parts overlap.

    Parts are measured with all joints at zero, over the range of every joint, and with all joints
    moved at once. In states with all joints moved, only penetrations over P_PEN_M count. Pairs of a
    parent and a child count, and so do overlaps that the object's program allows. Parts that are
    fixed to each other may overlap.
    """
    o = JointSweepOptions()
    placeholders = [part.name for part in spec.parts if is_placeholder(part)]
    free = o.model_copy(update={"max_depth_m": _DEEPEST_M})
    sweep = sweep_joints(Probe(spec), free, ignored=placeholders)
    overlaps = [*sweep.at_rest.values()]
    for swept in sweep.ranges:
        overlaps += swept.deepest.values()
    strict = replace(sweep, allowed=dict.fromkeys(sweep.allowed, P_PEN_M))
    overlaps += sweep_combinations(strict, o).values()
    return max((overlap.depth for overlap in overlaps if overlap.depth > 0), default=0.0)
