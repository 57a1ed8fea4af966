"""Dry friction that holds joints at their parsed positions against gravity.

Friction holds a half-open part at rest. The friction in a program may be too small at the parsed
size and opening. The joint then moves in every rollout, whatever the layout is.
"""

from ..errors import SpecError
from ..physics.exact import start_state
from ..spec import JointSpec, SceneObject, SceneSpec, joint_position

MARGIN = 1.5
"""Ratio of the raised friction to the load."""
AT_LIMIT = 1e-3
"""Distance from a limit within which a joint counts as being at the limit [rad or m]."""
NEGLIGIBLE = 1e-9
"""Largest load that counts as zero, because of rounding [N m or N]."""


def hold_joints(obj: SceneObject) -> tuple[SceneObject, dict[str, tuple[float, float]]]:
    """Raise the dry friction of joints that gravity would move from their composed positions.

    Joints with springs, ball joints and mimic joints do not change. The load of a mimic joint acts
    on the joint that it follows.

    Args:
        obj: an object in its composed orientation.

    Returns:
        The object, and the friction of each changed joint before and after [N m or N].

    Raises:
        SpecError: MuJoCo cannot compile the object.
    """
    joints = [j for j in obj.spec.joints if j.type != "fixed"]
    if not joints:
        return obj, {}
    loads = joint_loads(obj)
    changes: dict[str, tuple[float, float]] = {}
    for joint in joints:
        load = loads[joint.name]
        free = joint.type != "ball" and joint.mimic is None and joint.stiffness == 0
        if not free or abs(load) < NEGLIGIBLE or _blocked(obj, joint, load):
            continue
        if joint.friction < MARGIN * abs(load):
            changes[joint.name] = joint.friction, MARGIN * abs(load)
    if not changes:
        return obj, {}
    held_joints = tuple(
        j.model_copy(update={"friction": changes[j.name][1]}) if j.name in changes else j
        for j in obj.spec.joints
    )
    spec = obj.spec.model_copy(update={"joints": held_joints})
    return obj.model_copy(update={"spec": spec}), changes


def with_joint_friction(obj: SceneObject, notes: list[str]) -> SceneObject:
    """Return an object with enough friction to hold its joints; append a note for each change."""
    holding, changes = hold_joints(obj)
    for joint, (before, after) in changes.items():
        unit = "N" if obj.spec.joint(joint).type == "prismatic" else "N m"
        notes.append(
            f"{obj.name}: composition raised the dry friction of joint {joint} from {before:.2g} "
            f"to {after:.2g} {unit}, because gravity would move it from its parsed position"
        )
    return holding


def joint_loads(obj: SceneObject) -> dict[str, float]:
    """Return the gravity load of each movable joint, without springs [N m or N].

    Positive loads move a joint toward its upper limit. The load of a mimic joint is added to the
    joint that it follows. The load of a ball joint is 0.
    """
    as_root = {"parent": None, "parent_link": None, "relation": "on", "environment": True}
    alone = SceneSpec(name="held", objects=(obj.model_copy(update=as_root),))
    try:
        model, data = start_state(alone)
    except ValueError as error:
        raise SpecError(f"{obj.name}: {error}") from None
    moving = [joint for joint in obj.spec.joints if joint.type != "fixed"]
    loads = dict.fromkeys((joint.name for joint in moving), 0.0)
    for joint in moving:
        if joint.type == "ball":
            continue
        address = int(model.joint(f"{obj.name}-{joint.name}").dofadr[0])
        leader, ratio = joint, 1.0
        while leader.mimic is not None:
            ratio *= leader.mimic.multiplier
            leader = obj.spec.joint(leader.mimic.joint)
        loads[leader.name] -= ratio * float(data.qfrc_bias[address])
    return loads


def _blocked(obj: SceneObject, joint: JointSpec, load: float) -> bool:
    """Return whether a joint is at the limit that its load pushes against."""
    if joint.type == "continuous":
        return False
    value = joint_position(obj.spec, joint, obj.joint_state)
    assert not isinstance(value, tuple)
    return value > joint.upper - AT_LIMIT if load > 0 else value < joint.lower + AT_LIMIT
