"""Opening, closing and turning: a joint of a template's object is worked by its handle."""

from functools import partial

from neoworld_mjx.spec import SceneSpec, joint_position

from ..engines.table_scenes import TOP
from .plan_format import TaskPlan
from .predicates import JointBetween
from .reference import Hold, work_joint
from .task import ManipulationTask, Prepared, TaskKind
from .task_scenes import put, scene_of, size_of

OPEN, CLOSED = 0.75, 0.1
"""Bounds of a joint that is open and one that is closed, as shares of its range."""
OPENED = "OpenCabinetDrawer-v1 of ManiSkill: min_open_frac 0.75 and its speeds"
CLOSED_SOURCE = "own bound, the converse of OpenCabinetDrawer-v1 of ManiSkill; its speeds"
TURNED = "own bound, a sixth of a turn at least; speeds of OpenCabinetDrawer-v1 of ManiSkill"
AIM = 0.92
"""Share of its range that a reference plan opens a joint to."""
LEAST_TURN, TURN = 1.05, 1.4
"""What a joint without limits must be turned by, and is in reference plans [rad]."""


def open_joint(template: str, joint: str, hold: Hold, *, yaw: float = 0.0) -> Prepared:
    """A joint from its lower limit to at least OPEN of its range."""
    scene = _alone(template, yaw, {})
    goal = JointBetween(object=template, joint=joint, low=OPEN, high=1.05, source=OPENED)

    def plan(made: SceneSpec) -> TaskPlan:
        moving = made.object(template).spec.joint(joint)
        target = moving.lower + AIM * (moving.upper - moving.lower)
        return work_joint(made, template, joint, target, hold)

    return Prepared(scene, goal, plan)


def close_joint(
    template: str, joint: str, hold: Hold, *, yaw: float = 0.0, share: float = 0.6
) -> Prepared:
    """A joint that stands at a share of its range, to at most CLOSED of it."""
    spec = _alone(template, yaw, {}).object(template).spec
    moving = spec.joint(joint)
    start = moving.lower + share * (moving.upper - moving.lower)
    scene = _alone(template, yaw, {joint: start})
    goal = JointBetween(object=template, joint=joint, low=-0.1, high=CLOSED, source=CLOSED_SOURCE)

    def plan(made: SceneSpec) -> TaskPlan:
        shut = made.object(template).spec.joint(joint).lower
        return work_joint(made, template, joint, shut, hold)

    return Prepared(scene, goal, plan)


def turn_joint(template: str, joint: str, hold: Hold, *, yaw: float = 0.0) -> Prepared:
    """A joint by at least LEAST_TURN, or to the last quarter of its range."""
    scene = _alone(template, yaw, {})
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

    def plan(made: SceneSpec) -> TaskPlan:
        return work_joint(made, template, joint, _value(made, template, joint) + TURN, hold)

    return Prepared(scene, goal, plan)


def _value(scene: SceneSpec, name: str, joint: str) -> float:
    """Where a joint that is no ball stands [rad or m]."""
    item = scene.object(name)
    value = joint_position(item.spec, item.spec.joint(joint), item.joint_state)
    assert not isinstance(value, tuple)
    return value


def _alone(template: str, yaw: float, state: dict[str, float]) -> SceneSpec:
    """The object, fastened, with a cup beside it."""
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


def _row(
    name: str,
    kind: TaskKind,
    instruction: str,
    template: str,
    joint: str,
    hold: Hold,
    **more: float,
) -> ManipulationTask:
    work = {"opening": open_joint, "closing": close_joint, "turning": turn_joint}[kind]
    make = partial(work, template, joint, hold, **more)
    return ManipulationTask(name, kind, instruction, template, make)


_open = partial(_row, kind="opening")
_close = partial(_row, kind="closing")
_turn = partial(_row, kind="turning")
_poke = Hold("poke", "+x")

JOINTS = (
    _open(
        name="open_cabinet_drawer",
        instruction="Pull the middle drawer of the cabinet open.",
        template="drawer_cabinet",
        joint="drawer_2_slide",
        hold=Hold("grip", "-x", "+z", "drawer_2_2"),
        yaw=0.3,
    ),
    _open(
        name="open_nightstand_door",
        instruction="Open the door of the nightstand.",
        template="nightstand",
        joint="door_hinge",
        hold=Hold("grip", "-x", "+y", "door_1"),
    ),
    _open(
        name="open_microwave",
        instruction="Open the microwave oven.",
        template="microwave",
        joint="hinge",
        hold=Hold("grip", "-x", "+y", "door_2"),
        yaw=-0.2,
    ),
    _open(
        name="open_chest",
        instruction="Lift the lid of the treasure chest.",
        template="treasure_chest",
        joint="lid_hinge",
        hold=Hold("grip", "-x", "+y", "lid_6"),
    ),
    _open(
        name="open_wardrobe",
        instruction="Open one door of the wardrobe.",
        template="wardrobe",
        joint="hinge_1",
        hold=Hold("grip", "-x", "+y", "door_1_3"),
    ),
    _open(
        name="open_refrigerator",
        instruction="Open the large door of the refrigerator.",
        template="refrigerator",
        joint="fridge_door_hinge",
        hold=Hold("grip", "+y", "+x"),
    ),
    _open(
        name="open_dishwasher",
        instruction="Fold the door of the dishwasher down.",
        template="dishwasher",
        joint="door_hinge",
        hold=Hold("grip", "-x", "+z"),
    ),
    _open(
        name="open_oven",
        instruction="Fold the door of the oven down.",
        template="oven",
        joint="hinge",
        hold=Hold("grip", "-x", "+z", "door_2"),
    ),
    _open(
        name="open_washing_machine",
        instruction="Open the round door of the washing machine.",
        template="washing_machine",
        joint="door_hinge",
        hold=Hold("grip", "-x", "+y", "door_3"),
    ),
    _open(
        name="open_jewellery_box",
        instruction="Lift the lid of the jewellery box.",
        template="jewellery_box",
        joint="lid_hinge",
        hold=Hold("grip", "-x", "+z"),
        yaw=0.4,
    ),
    _open(
        name="open_till",
        instruction="Pull the till of the cash register open.",
        template="cash_register",
        joint="till_slide",
        hold=Hold("grip", "-x", "+z", "till_2"),
    ),
    _open(
        name="open_mailbox",
        instruction="Open the door of the mailbox.",
        template="mailbox",
        joint="door_hinge",
        hold=Hold("grip", "-z", "+x"),
    ),
    _open(
        name="open_clock_door",
        instruction="Open the door of the mantel clock.",
        template="mantel_clock",
        joint="door_hinge",
        hold=Hold("grip", "+y", "+x"),
    ),
    _open(
        name="open_tube_rack_lid",
        instruction="Open the lid of the test tube rack.",
        template="test_tube_rack",
        joint="lid_hinge",
        hold=Hold("grip", "-x", "+z"),
    ),
    _close(
        name="close_cabinet_drawer",
        instruction="Push the open drawer of the cabinet shut.",
        template="drawer_cabinet",
        joint="drawer_2_slide",
        hold=_poke,
    ),
    _close(
        name="close_microwave",
        instruction="Close the microwave oven.",
        template="microwave",
        joint="hinge",
        hold=_poke,
    ),
    _close(
        name="close_laptop",
        instruction="Close the laptop.",
        template="laptop",
        joint="hinge",
        hold=_poke,
        yaw=0.3,
    ),
    _close(
        name="close_refrigerator",
        instruction="Close the door of the refrigerator.",
        template="refrigerator",
        joint="fridge_door_hinge",
        hold=_poke,
    ),
    _close(
        name="close_wardrobe",
        instruction="Close the door of the wardrobe.",
        template="wardrobe",
        joint="hinge_1",
        hold=_poke,
    ),
    _close(
        name="close_paper_tray",
        instruction="Push the paper tray into the printer.",
        template="printer",
        joint="paper_tray_1_slide",
        hold=_poke,
    ),
    _close(
        name="close_oven",
        instruction="Close the door of the oven.",
        template="oven",
        joint="hinge",
        hold=_poke,
    ),
    _close(
        name="close_safe",
        instruction="Close the door of the safe.",
        template="safe",
        joint="door_hinge",
        hold=_poke,
    ),
    _turn(
        name="turn_faucet",
        instruction="Swing the spout of the faucet to the side.",
        template="kitchen_faucet",
        joint="spout_turn",
        hold=_poke,
    ),
    _turn(
        name="turn_safe_handle",
        instruction="Turn the handle of the safe.",
        template="safe",
        joint="handle_turn",
        hold=Hold("grip", "-x", "+z", "handle_3"),
    ),
    _turn(
        name="turn_globe",
        instruction="Turn the globe by a quarter.",
        template="desk_globe",
        joint="spin",
        hold=Hold("side", "+y"),
    ),
    _turn(
        name="turn_oven_knob",
        instruction="Turn the first knob of the oven.",
        template="oven",
        joint="turn_1",
        hold=Hold("grip", "-x", "+y"),
    ),
    _turn(
        name="turn_shower_tap",
        instruction="Open the first tap of the shower.",
        template="shower_head",
        joint="tap_1_turn",
        hold=Hold("grip", "-z", "+y"),
    ),
    _turn(
        name="unscrew_bottle",
        instruction="Turn the cap of the bottle.",
        template="bottle",
        joint="unscrew",
        hold=Hold("grip", "-z", "+y"),
    ),
    _turn(
        name="raise_mailbox_flag",
        instruction="Raise the flag of the mailbox.",
        template="mailbox",
        joint="flag_turn",
        hold=Hold("grip", "+y", "+z"),
    ),
    _turn(
        name="turn_crane",
        instruction="Swing the jib of the crane to the side.",
        template="crane_toy",
        joint="slew",
        hold=Hold("poke", "+x", geom="jib_18"),
    ),
)
