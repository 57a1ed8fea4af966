"""Joints that are seen open: doors, drawers and lids whose openings are unknowns of the alignment.

A body is what moves rigidly: an object at its composed joint values, or one of the parts that its
open joints move. Bodies 0 to n - 1 are the n objects, without their moving parts.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from ..spec import JointSpec, ObjectSpec, SceneObject, link_poses
from ..spec.kinematics import moving_parts
from ..spec.opening import opening_value
from ..spec.pose import Pose

LEAST_OPENING = 0.05
"""Share of its range by which a joint that is an unknown is open, at least."""


@dataclass(frozen=True)
class OpenJoint:
    """A hinge or slide that is composed open."""

    object: int
    """Index of its object."""
    name: str
    value: float
    """Composed position [rad or m]."""
    closed: float
    """Closed position [rad or m]."""
    lower: float
    """Limits [rad or m]."""
    upper: float
    anchor: tuple[float, float, float] | None
    """Point on the axis of a hinge, as composed, in the object's frame [m]; None for a slide."""

    def limit_beyond(self, change: float) -> float | None:
        """Return the change that reaches the limit which a change exceeds; None within limits."""
        low, high = self.lower - self.value, self.upper - self.value
        return high if change > high else low if change < low else None


class MovingPart(NamedTuple):
    """A part that open joints move."""

    object: int
    part: str
    joints: frozenset[int]
    """Indices of these joints among all open joints."""


def open_joints(items: Mapping[int, SceneObject]) -> tuple[OpenJoint, ...]:
    """Return the joints of objects that are composed open by LEAST_OPENING or more.

    These are hinges and slides with limits that follow no other joint, and of whose moving parts at
    least one can be seen and is not see-through.

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
    """Return the parts that open joints move, by object and in the order of its parts."""
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
    """Return how far each part is from its composed place, in the object's frame at scale 1.

    Args:
        item: the object.
        changes: of the values of its joints [rad or m].
    """
    before = link_poses(item.spec, item.joint_state)
    after = link_poses(item.spec, with_changes(item, changes).joint_state)
    return {name: after[name].then(before[name].inverse()) for name in after}


def with_changes(item: SceneObject, changes: Mapping[str, float]) -> SceneObject:
    """Return an object with some joint values changed [rad or m]."""
    state = {name: item.joint_state.get(name, 0.0) + by for name, by in changes.items()}
    return item.model_copy(update={"joint_state": item.joint_state | state})
