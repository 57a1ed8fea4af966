"""Opening, closing and turning tasks: a joint of a template's object is moved by its handle."""

from neoworld_mjx.environments.predicates import JointBetween
from neoworld_mjx.spec import SceneSpec, joint_position

from ..engines.table_scenes import TOP
from .plan_format import TaskPlan
from .reference import Hold, work_joint
from .task import Prepared
from .task_scenes import put, scene_of, size_of

OPEN, CLOSED = 0.75, 0.1
"""Bounds of a joint that is open and one that is closed, as shares of its range."""
OPENED = "OpenCabinetDrawer-v1 of ManiSkill: min_open_frac 0.75 and its speeds"
CLOSED_SOURCE = "own bound, the converse of OpenCabinetDrawer-v1 of ManiSkill; its speeds"
TURNED = "own bound, a sixth of a turn at least; speeds of OpenCabinetDrawer-v1 of ManiSkill"
AIM = 0.92
"""Share of its range that a reference plan opens a joint to."""
LEAST_TURN, TURN = 1.05, 1.4
"""Minimum turn of a joint without limits, and its turn in reference plans [rad]."""


def open_joint(template: str, joint: str, hold: Hold, *, yaw: float = 0.0) -> Prepared:
    """Open a joint from its lower limit to at least OPEN of its range."""
    scene = _scene_with_cup(template, yaw, {})
    goal = JointBetween(object=template, joint=joint, low=OPEN, high=1.05, source=OPENED)

    def plan(reconstructed: SceneSpec) -> TaskPlan:
        moving = reconstructed.object(template).spec.joint(joint)
        target = moving.lower + AIM * (moving.upper - moving.lower)
        return work_joint(reconstructed, template, joint, target, hold)

    return Prepared(scene, goal, plan)


def close_joint(
    template: str, joint: str, hold: Hold, *, yaw: float = 0.0, share: float = 0.6
) -> Prepared:
    """Close a joint from a share of its range to at most CLOSED of it."""
    spec = _scene_with_cup(template, yaw, {}).object(template).spec
    moving = spec.joint(joint)
    start = moving.lower + share * (moving.upper - moving.lower)
    scene = _scene_with_cup(template, yaw, {joint: start})
    goal = JointBetween(object=template, joint=joint, low=-0.1, high=CLOSED, source=CLOSED_SOURCE)

    def plan(reconstructed: SceneSpec) -> TaskPlan:
        shut = reconstructed.object(template).spec.joint(joint).lower
        return work_joint(reconstructed, template, joint, shut, hold)

    return Prepared(scene, goal, plan)


def turn_joint(template: str, joint: str, hold: Hold, *, yaw: float = 0.0) -> Prepared:
    """Turn a joint by at least LEAST_TURN, or to the last quarter of its range."""
    scene = _scene_with_cup(template, yaw, {})
    moving = scene.object(template).spec.joint(joint)
    if moving.type != "continuous":
        return open_joint(template, joint, hold, yaw=yaw)
    value = _value(scene, template, joint)
    goal = JointBetween(
        object=template,
        joint=joint,
        low=value + LEAST_TURN,
        high=value + 7.0,
        absolute=True,
        source=TURNED,
    )

    def plan(reconstructed: SceneSpec) -> TaskPlan:
        return work_joint(
            reconstructed, template, joint, _value(reconstructed, template, joint) + TURN, hold
        )

    return Prepared(scene, goal, plan)


def _value(scene: SceneSpec, name: str, joint: str) -> float:
    """Return the value of a joint other than a ball [rad or m]."""
    item = scene.object(name)
    value = joint_position(item.spec, item.spec.joint(joint), item.joint_state)
    assert not isinstance(value, tuple)
    return value


def _scene_with_cup(template: str, yaw: float, state: dict[str, float]) -> SceneSpec:
    """Return a scene of the fixed object and a cup next to it."""
    item = put(template, (0.0, 0.0), yaw=yaw, fixed=True, state=state)
    bare = scene_of(template, item)
    edges = size_of(bare, template)
    beside = -float(max(edges[0], edges[1])) / 2 - 0.25
    return scene_of(
        template,
        item,
        put("mug", (beside, beside), z=TOP),
        size=float(2 * abs(beside) + 0.6),
    )
