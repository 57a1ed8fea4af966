"""Joints that gravity would move are held where the parse shows them, and others do not change."""

import math

import pytest

from neoworld_mjx.compose.resting_pose import MARGIN, hold_joints, joint_loads
from neoworld_mjx.measure import measured
from neoworld_mjx.spec import Box, ObjectSpec, SceneObject, SceneSpec, inertial
from tests.support import scenes
from tests.support.mechanisms import WOOD, geom, joint, part

LID = 0.2
"""Depth of the lid, whose hinge is at its back edge [m]."""
OPEN = math.radians(40)


def chest(**hinge) -> ObjectSpec:
    """A block with a lid that opens about its back edge."""
    spec = {"upper": 2.0, "axis": (0, -1, 0), "pos": (-LID / 2, 0, 0.1)} | hinge
    return ObjectSpec(
        name="chest",
        materials=(WOOD,),
        parts=(
            part("body", geom("block", Box(size=(LID, 0.3, 0.1)), (0, 0, 0.05))),
            part("lid", geom("board", Box(size=(LID, 0.3, 0.02)), (0, 0, 0.11))),
        ),
        joints=(joint("hinge", "revolute", "body", "lid", **spec),),
    )


def placed(spec: ObjectSpec, **fields) -> SceneObject:
    return SceneObject(name="chest", spec=spec, parent="table", z=0.02, **fields)


def lid_turn(obj: SceneObject) -> float:
    """Return the passive rotation of the lid in 2 s [deg]."""
    table = SceneObject(name="table", spec=scenes.table(), environment=True)
    scene = SceneSpec(objects=(table, obj.model_copy(update={"fixed_base": True})))
    return measured(scene).joint_turn_deg["chest-hinge"]


def test_an_open_lid_stays_at_its_parsed_angle():
    lid = placed(chest(friction=0.01), joint_state={"hinge": OPEN})
    weight = inertial(lid.spec, lid.spec.part("lid")).mass * 9.81
    load = joint_loads(lid)["hinge"]
    # About the back edge, half way up the lid's thickness at its middle.
    arm = LID / 2 * math.cos(OPEN) - 0.01 * math.sin(OPEN)
    assert load == pytest.approx(-weight * arm, rel=1e-6)
    assert lid_turn(lid) > 30
    holding, changes = hold_joints(lid)
    assert changes == {"hinge": (0.01, pytest.approx(MARGIN * abs(load)))}
    # Dry friction sticks; with MuJoCo's soft friction the lid would creep by degrees.
    assert lid_turn(holding) < 0.1
    assert hold_joints(holding) == (holding, {})


@pytest.mark.parametrize(
    ("hinge", "state"),
    [
        ({}, 0.0),  # Closed: at its limit.
        ({"upper": OPEN, "axis": (0, 0, 1)}, 0.3),  # A door: no load.
        ({"stiffness": 3.0}, OPEN),  # A joint with a spring.
        ({"friction": 50.0}, OPEN),
        ({"lower": -OPEN, "upper": 0.0, "axis": (0, 1, 0)}, 0.0),  # Closed at its upper limit.
    ],
)
def test_joints_without_a_load_do_not_change(hinge, state):
    obj = placed(chest(**hinge), joint_state={"hinge": state})
    assert hold_joints(obj) == (obj, {})
