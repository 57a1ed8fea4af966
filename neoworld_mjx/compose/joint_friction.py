"""Hold joints where the photograph shows them: dry friction for what gravity pulls at them.

What stands half open at rest is held there by something. A program states a friction for the
object that it imagined; at the parsed size and opening it may be too little, and the joint moves
in every rollout, wherever the search puts the object.
"""

from ..errors import SpecError
from ..physics.exact import start_state
from ..spec import JointSpec, SceneObject, SceneSpec, joint_position

MARGIN = 1.5
"""Friction over the load that it holds."""
AT_LIMIT = 1e-3
"""Distance [rad or m] within which a joint is at its limit, which holds it."""
NEGLIGIBLE = 1e-9
"""Load [N m or N] of nothing but rounding errors."""


def hold_joints(obj: SceneObject) -> tuple[SceneObject, dict[str, tuple[float, float]]]:
    """Raise the dry friction of joints that would not stay where they are composed.

    Joints that springs move, balls and followers stay as they are; a follower's load is its
    leader's.

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
    own = tuple(
        j.model_copy(update={"friction": changes[j.name][1]}) if j.name in changes else j
        for j in obj.spec.joints
    )
    spec = obj.spec.model_copy(update={"joints": own})
    return obj.model_copy(update={"spec": spec}), changes


def joint_loads(obj: SceneObject) -> dict[str, float]:
    """Return how gravity pulls at each joint that moves, springs left out [N m or N].

    Positive loads move a joint towards its upper limit. A follower's load is its leader's; that of
    a ball joint is 0.
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
    """Tell whether a joint's limit holds its load."""
    if joint.type == "continuous":
        return False
    value = joint_position(obj.spec, joint, obj.joint_state)
    assert not isinstance(value, tuple)
    return value > joint.upper - AT_LIMIT if load > 0 else value < joint.lower + AT_LIMIT
