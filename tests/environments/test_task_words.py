"""Tasks from sentences, by the names of a scene or by a model."""

import json

import pytest

from neoworld_mjx.environments.predicates import JointBetween, Located
from neoworld_mjx.environments.task_words import task_of, task_request
from neoworld_mjx.errors import SpecError
from neoworld_mjx.mllm import Panel
from neoworld_mjx.mllm.replay import Replay, Tape
from neoworld_mjx.spec import Box, ObjectSpec, SceneObject, SceneSpec, world_poses
from tests.support.mechanisms import WOOD, geom, joint, part, single


@pytest.fixture(scope="module")
def scene():
    """A cabinet with two drawers, a can and a tray, on a table."""
    parts, joints = [part("body", geom("body", Box(size=(0.3, 0.3, 0.3)), (0, 0, 0.15)))], []
    for k, name in enumerate(("drawer_top", "drawer_bottom")):
        at = (0.2, 0.0, 0.2 - 0.1 * k)
        parts.append(part(name, geom(f"{name}_front", Box(size=(0.02, 0.2, 0.08)), at)))
        joints.append(joint(f"{name}_slide", "prismatic", "body", name, at, (1, 0, 0), upper=0.4))
    cabinet = ObjectSpec(
        name="cabinet", materials=(WOOD,), parts=tuple(parts), joints=tuple(joints)
    )
    on = {"parent": "table", "z": 0.0501}
    return SceneSpec(
        objects=(
            SceneObject(
                name="table", spec=single("table", Box(size=(2, 2, 0.1)), 0.0), environment=True
            ),
            SceneObject(name="cabinet", spec=cabinet, fixed_base=True, **on),
            SceneObject(
                name="can",
                spec=single("can", Box(size=(0.05, 0.05, 0.1)), 0.05),
                xy=(0.4, 0.4),
                **on,
            ),
            SceneObject(
                name="tray",
                spec=single("tray", Box(size=(0.2, 0.2, 0.02)), 0.01),
                xy=(0.4, -0.4),
                **on,
            ),
        )
    )


@pytest.mark.parametrize(
    ("words", "joint_name", "bounds"),
    [
        ("Open the top drawer", "drawer_top_slide", (0.8, 1.1)),
        ("open the bottom drawer of the cabinet by 60 %", "drawer_bottom_slide", (0.6, 1.1)),
        ("pull the top drawer open by 10 cm", "drawer_top_slide", (0.25, 1.1)),
        ("open the top drawer halfway", "drawer_top_slide", (0.5, 1.1)),
        ("open cabinet-drawer_top 0.7", "drawer_top_slide", (0.7, 1.1)),
        ("push the bottom drawer closed", "drawer_bottom_slide", (-0.1, 0.1)),
        ("close the bottom drawer to 20 %", "drawer_bottom_slide", (-0.1, 0.2)),
        ("press cabinet-drawer_top 0.3", "drawer_top_slide", (0.3, 1.1)),
    ],
)
def test_joints_are_named_by_their_words(scene, words, joint_name, bounds):
    task = task_of(scene, words)
    assert isinstance(task.goal, JointBetween) and task.goal.joint == joint_name
    assert (task.goal.low, task.goal.high) == pytest.approx(bounds)
    assert task.instruction == words


@pytest.mark.parametrize(
    ("words", "moved", "relative_to"),
    [
        ("place the can on the tray", "can", "tray"),
        ("move the can onto the tray", "can", "tray"),
        ("stack the tray on top of the cabinet", "tray", "cabinet"),
        ("stack can tray", "can", "tray"),
        ("lift the can by 5 cm", "can", "table"),
        ("push the can", "can", "table"),
    ],
)
def test_objects_are_named_by_their_words(scene, words, moved, relative_to):
    goal = task_of(scene, words).goal
    assert isinstance(goal, Located)
    assert (goal.object, goal.relative_to) == (moved, relative_to)


@pytest.mark.parametrize(
    ("words", "by"),
    [
        ("push can", (0.1, 0.0)),
        ("push can 0.2", (0.2, 0.0)),
        ("push the can by 5 cm", (0.05, 0.0)),
        ("push can 0.1 -0.05", (0.1, -0.05)),
        ("push can 0 -12 cm", (0.0, -0.12)),
    ],
)
def test_a_push_goes_as_far_as_is_said(scene, words, by):
    goal, base = task_of(scene, words).goal, world_poses(scene)["table"]
    moved = base.apply(goal.target) - world_poses(scene)["can"].pos
    assert moved == pytest.approx((*by, 0.0), abs=1e-9)


def test_a_number_of_a_name_is_no_amount(scene):
    renamed = scene.model_copy(
        update={
            "objects": tuple(
                item.model_copy(update={"name": "can_2"}) if item.name == "can" else item
                for item in scene.objects
            )
        }
    )
    assert task_of(renamed, "lift can_2").goal.low == pytest.approx(0.1)
    assert task_of(renamed, "lift can 2 by 20 cm").goal.low == pytest.approx(0.2)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            "open the drawer",
            "fits several joints: got 'the drawer', valid are: cabinet-drawer_top",
        ),
        (
            "lift the cup",
            "names no object of the scene: got 'the cup', valid are: table, cabinet",
        ),
        ("open cabinet-drawer_topp 0.8", "did you mean 'cabinet-drawer_top'"),
        ("sing", "no verb of a task; valid are: reach, open"),
        ("put the can away", "say on or in which object"),
        ("lift the table", "fixed and cannot be moved"),
        ("open cabinet-drawer_top 80", "80 is no share of the joint's range, such as 0.8 or 80 %"),
        ("open cabinet-drawer_top -0.5", "-0.5 is no share"),
        ("close cabinet-drawer_top 3", "3 is no share"),
        ("lift can 10", "10 is no height in m"),
        ("push can 3 0", "3 is no displacement along x"),
        ("place can on can", "cannot be placed on or in itself"),
        ("don't open the top drawer", "say what to do"),
    ],
)
def test_words_that_fit_nothing_are_refused_with_the_choices(scene, words, message):
    with pytest.raises(SpecError, match=message):
        task_of(scene, words)


def test_a_model_names_the_task_where_words_do_not_match(scene):
    words = "I need something from the lower compartment"
    request = task_request(scene, words)
    tape = Tape(format=1, made="by hand")
    answer = {"kind": "open", "name": "cabinet-drawer_bottom", "amount": 0.75}
    tape.put(request, json.dumps(answer), "m")
    with Panel(Replay(tape, "tape")) as panel:
        task = task_of(scene, words, panel)
    assert isinstance(task.goal, JointBetween)
    assert (task.goal.joint, task.goal.low) == ("drawer_bottom_slide", 0.75)
    wrong = Tape(format=1, made="by hand")
    wrong.put(request, json.dumps(answer | {"name": "cabinet-door"}), "m")
    with Panel(Replay(wrong, "tape")) as panel, pytest.raises(SpecError, match="cabinet-drawer_b"):
        task_of(scene, words, panel)
