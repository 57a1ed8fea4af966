"""P-Pen: penetration of the parts of an articulated object as its joints move."""

from dataclasses import replace

from neoworld_mjx.checks.joint_sweep import sweep_joints, sweep_together
from neoworld_mjx.checks.part_distances import Probe
from neoworld_mjx.checks.static_checks import is_placeholder
from neoworld_mjx.config import JointSweepOptions
from neoworld_mjx.spec import ObjectSpec

P_PEN_M = 1e-3
"""Depth [m] over which an object counts in P-Pen."""
_DEEPEST_M = 10.0
"""An allowed depth [m] that no pair reaches, so that every pair is measured in motion, too."""


def articulated(spec: ObjectSpec) -> bool:
    """Return True if an object has a joint that moves."""
    return any(joint.type != "fixed" for joint in spec.joints)


def part_depth(spec: ObjectSpec, options: JointSweepOptions | None = None) -> float:
    """Return the deepest overlap of two parts of an object [m], 0 where none overlap.

    Parts are measured at rest, over the range of every joint, and with all joints moved at once;
    parent and child count. Parts that are fastened to each other may overlap. Of states with all
    joints moved only what is over P_PEN_M counts. What the object's program allows counts as well.

    Args:
        spec: the object.
        options: how finely ranges are swept.
    """
    o = options or JointSweepOptions()
    bare = [part.name for part in spec.parts if is_placeholder(part)]
    free = o.model_copy(update={"max_depth_m": _DEEPEST_M})
    sweep = sweep_joints(Probe(spec), free, ignored=bare)
    overlaps = [*sweep.at_rest.values()]
    for swept in sweep.ranges:
        overlaps += swept.deepest.values()
    strict = replace(sweep, allowed=dict.fromkeys(sweep.allowed, P_PEN_M))
    overlaps += sweep_together(strict, o).values()
    return max((overlap.depth for overlap in overlaps if overlap.depth > 0), default=0.0)
