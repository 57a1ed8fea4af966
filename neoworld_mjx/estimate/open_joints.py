"""Open joints: doors, drawers and lids whose openings are unknowns of the alignment.

A body moves rigidly. It is either an object without the parts that its open joints move, or one of
these parts. Bodies 0 to n - 1 are the n objects; the moving parts follow.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from ..spec import JointSpec, ObjectSpec, SceneObject, link_poses
from ..spec.kinematics import moving_parts
from ..spec.opening import opening_value
from ..spec.pose import Pose

LEAST_OPENING = 0.05
"""Least opening of a joint that is an unknown, relative to the joint's range."""


@dataclass(frozen=True)
class OpenJoint:
    """A hinge or slide that is open in the composed scene."""

    object: int
    """Index of the joint's object."""
    name: str
    value: float
    """Composed position [rad or m]."""
    closed: float
    """Closed position [rad or m]."""
    lower: float
    """Lower and upper limit, extended to include `value` [rad or m]."""
    upper: float
    anchor: tuple[float, float, float] | None
    """Point on the composed axis of a hinge, in the object's frame [m]; None for a slide."""

    def limit_beyond(self, change: float) -> float | None:
        """Return the change to the limit that `change` exceeds; None if it is within the limits."""
        low, high = self.lower - self.value, self.upper - self.value
        return high if change > high else low if change < low else None


class MovingPart(NamedTuple):
    """A part that open joints move."""

    object: int
    part: str
    joints: frozenset[int]
    """Indices of the joints that move the part, among all open joints."""


def open_joints(items: Mapping[int, SceneObject]) -> tuple[OpenJoint, ...]:
    """Return the joints that are open by at least LEAST_OPENING in the composed scene.

    Only hinges and slides with limits are returned. They follow no other joint, and at least one
    geom of their moving parts is visible and opaque.

    Args:
        items: objects by index.
    """
    return tuple(
        OpenJoint(
            k,
            joint.name,
            value,
            opening_value(joint, 0.0),
            min(joint.lower, value),
            max(joint.upper, value),
            _anchor(item, joint),
        )
        for k, item in items.items()
        for joint in item.spec.joints
        if (value := item.joint_state.get(joint.name, 0.0)) and _is_unknown(item.spec, joint, value)
    )


def _anchor(item: SceneObject, joint: JointSpec) -> tuple[float, float, float] | None:
    if joint.type == "prismatic":
        return None
    x, y, z = link_poses(item.spec, item.joint_state)[joint.parent].apply(joint.pos).tolist()
    return x, y, z


def _is_unknown(spec: ObjectSpec, joint: JointSpec, value: float) -> bool:
    if joint.type not in ("revolute", "prismatic") or joint.mimic is not None:
        return False
    opening = abs(value - opening_value(joint, 0.0)) / (joint.upper - joint.lower)
    return opening >= LEAST_OPENING and any(
        geom.role != "collision" and not spec.material(geom.material).see_through
        for name in moving_parts(spec, joint)
        for geom in spec.part(name).geoms
    )


def parts_moved(
    items: Mapping[int, SceneObject], joints: tuple[OpenJoint, ...]
) -> tuple[MovingPart, ...]:
    """Return the parts that open joints move, ordered by object and by part."""
    found = []
    for k in sorted({joint.object for joint in joints}):
        spec = items[k].spec
        movers = {
            j: moving_parts(spec, spec.joint(joint.name))
            for j, joint in enumerate(joints)
            if joint.object == k
        }
        for part in spec.parts:
            moved_by = frozenset(j for j, names in movers.items() if part.name in names)
            if moved_by:
                found.append(MovingPart(k, part.name, moved_by))
    return tuple(found)


def part_motions(item: SceneObject, changes: Mapping[str, float]) -> dict[str, Pose]:
    """Return the motion of each part from its composed pose, in the object's frame at scale 1.

    Args:
        item: the object.
        changes: changes of the object's joint values [rad or m], by name.
    """
    before = link_poses(item.spec, item.joint_state)
    after = link_poses(item.spec, with_changes(item, changes).joint_state)
    return {name: after[name].then(before[name].inverse()) for name in after}


def with_changes(item: SceneObject, changes: Mapping[str, float]) -> SceneObject:
    """Return an object with changes [rad or m] added to its joint values, by name."""
    state = {name: item.joint_state.get(name, 0.0) + by for name, by in changes.items()}
    return item.model_copy(update={"joint_state": item.joint_state | state})
