"""Manipulation tasks: plans, the gripper, success conditions, and the page."""

import json
import math

import numpy as np
import pytest
from neoworld_bench.tasks import (
    TaskPlan,
    ToolMove,
    all_tasks,
    execute,
    find_task,
    task_names,
    wait,
)
from neoworld_bench.tasks.execution import moved
from neoworld_bench.tasks.predicates import JointBetween, Leaning
from neoworld_bench.tasks.task_checks import TaskRow, summarised
from neoworld_bench.tasks.task_page import PAGE, page
from neoworld_bench.tasks.task_scenes import put, scene_of, task_programs
from neoworld_bench.tasks.world import World
from pydantic import ValidationError

from neoworld_mjx import cli
from neoworld_mjx.errors import ConfigError, SpecError
from neoworld_mjx.program import build

STAY = ToolMove(opening=0.05, seconds=0.2)


def plan(**changes):
    given = {"position": (0, 0, 0.5), "opening": 0.05, "moves": (STAY,)}
    return TaskPlan(**(given | changes))


@pytest.fixture(scope="module")
def cubes():
    return find_task("cube_on_cube")


def test_reference_plan_succeeds_and_waiting_fails(cubes):
    outcome = execute(cubes.scene, cubes.plan, cubes.predicate)
    assert outcome.success and outcome.held == 1 and outcome.progress == 1
    assert outcome.seconds == pytest.approx(cubes.plan.seconds + 2.0, abs=0.05)
    waiting = wait(cubes.scene, cubes.predicate)
    assert not waiting.success and waiting.drift_m < 0.001


def test_reference_plan_fails_for_a_displaced_object(cubes):
    outcome = execute(cubes.displaced(1.0), cubes.plan, cubes.predicate)
    assert not outcome.success and outcome.held == 0 and outcome.progress < 0.9
    assert "upper within" in outcome.reason


def test_held_object_does_not_count_as_placed(cubes):
    held = cubes.plan.model_copy(update={"moves": cubes.plan.moves[:5]})
    outcome = execute(cubes.scene, held, cubes.predicate)
    assert not outcome.success and outcome.progress == 1


def test_plan_that_starts_inside_an_object_fails_and_names_it(cubes):
    inside = plan(position=(0.15, 0.05, 0.03), opening=0.0)
    outcome = execute(cubes.scene, inside, cubes.predicate)
    assert not outcome.success and "deep in lower" in outcome.reason and outcome.seconds == 0


def test_drawer_is_pushed_shut():
    task = find_task("close_cabinet_drawer")
    value = World(task.scene, None).joint("drawer_cabinet", "drawer_2_slide", fraction=True)[0]
    assert value == pytest.approx(0.6)
    assert not wait(task.scene, task.predicate).success
    assert execute(task.scene, task.plan, task.predicate).success


def test_gripper_tracks_opening_and_pose():
    scene = scene_of("cup", put("mug"))
    way = ToolMove(displacement=(0.1, -0.05, 0.05), turn=(0, 0, 0.8), opening=0.03, seconds=1)
    seen = {}

    def watch(world, _):
        left, right = (
            world.data.joint(f"end_effector-{side}").qpos[0] for side in ("left", "right")
        )
        seen["opening"], seen["tool"] = left + right, world.tool()

    given = plan(position=(0.3, 0.3, 0.4), moves=(way,))
    execute(scene, given, Leaning(object="mug", tilt=(0, 1), source="test"), watch=watch)
    assert seen["opening"] == pytest.approx(0.03, abs=1e-3)
    np.testing.assert_allclose(seen["tool"].pos, (0.4, 0.25, 0.45), atol=1e-3)
    closing = seen["tool"].apply((0, 1, 0)) - seen["tool"].pos
    np.testing.assert_allclose(closing, (-math.sin(0.8), math.cos(0.8), 0), atol=5e-3)


def test_move_about_a_point_follows_an_arc():
    move = ToolMove(turn=(0, 0, math.pi / 2), about=(1, 0, 0), opening=0)
    place, quat = moved(np.array([2.0, 0, 0]), np.array([1.0, 0, 0, 0]), move, 0.5)
    np.testing.assert_allclose(place, (1 + math.sqrt(0.5), math.sqrt(0.5), 0))
    np.testing.assert_allclose(quat, (math.cos(math.pi / 8), 0, 0, math.sin(math.pi / 8)))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"closing": (0, 0, 1)}, "nor parallel"),
        ({"approach": (0, 0, 0)}, "not be zero"),
        ({"opening": 0.5}, "0.12"),
        ({"position": (0, 0, 9)}, "less than or equal to 3"),
        ({"moves": ()}, "at least 1"),
        (
            {"moves": (ToolMove(turn=(0, 0, 2), opening=0), ToolMove(turn=(0, 0, 1), opening=0))},
            "2.9 rad",
        ),
        ({"moves": ({"opening": 0, "displacement": (math.nan, 0, 0)},)}, "finite"),
    ],
)
def test_plans_have_bounds(changes, message):
    with pytest.raises(ValidationError, match=message):
        plan(**changes)


def test_joint_fraction_requires_a_range():
    scene = scene_of("globe", put("desk_globe", fixed=True))
    goal = JointBetween(object="desk_globe", joint="spin", low=0, high=1, source="test")
    with pytest.raises(SpecError, match="desk_globe/spin has no range"):
        wait(scene, goal, 1.0)


def test_object_named_like_the_gripper_is_refused():
    scene = scene_of("cup", put("mug", name="end_effector"))
    with pytest.raises(SpecError, match="gripper's name"):
        World(scene, plan())


def test_there_are_84_tasks_of_eight_kinds():
    tasks = all_tasks()
    assert len({task.name for task in tasks}) == len(tasks) == 84
    assert len({task.kind for task in tasks}) == 8
    assert task_names() == tuple(task.name for task in tasks)
    assert len({task.instruction for task in tasks}) > 80
    with pytest.raises(ConfigError, match="cube_on_cube"):
        find_task("cube_on_cub")


def test_programs_of_tasks_pass_the_checks():
    for name, program in task_programs().items():
        for values in ({}, program.draw(0)):
            built = build(program.program(values))
            assert built.ok, (name, values, built.signals)


def test_summary_of_task_checks():
    row = TaskRow(
        task="a",
        kind="placement",
        reference=True,
        reason="",
        waiting=False,
        drift_mm=0.1,
        displaced=0,
        directions=4,
        lag_mm=1.0,
        simulated_s=1.0,
        wall_s=1.0,
    )
    assert summarised([row])["passed"]
    bad = row.model_copy(update={"reference": False, "reason": "fell"})
    assert not summarised([row, bad])["passed"]
    assert summarised([row, bad])["missed"] == ["a: fell"]
    assert not summarised([row.model_copy(update={"waiting": True})])["passed"]
    assert not summarised([row.model_copy(update={"displaced": 1})])["passed"]
    other = {"kind": "pushing", "displaced": 3, "drift_mm": 2.5, "reference": False}
    first, pushed, whole = summarised([row, row.model_copy(update=other)])["table"]
    assert (first["kind"], pushed["kind"], whole["kind"]) == ("placement", "pushing", "all")
    assert first["tasks"] == first["reference_succeeds"] == 1 and first["displaced_succeeds"] == 0
    assert pushed["reference_succeeds"] == 0 and pushed["largest_drift_mm"] == 2.5
    assert (whole["tasks"], whole["displaced_succeeds"], whole["displaced_runs"]) == (2, 3, 8)


def command(*arguments):
    with pytest.raises(SystemExit) as ended:
        cli.main(["bench", "run", "tasks", *arguments])
    return ended.value.code


def test_tasks_command_prints_one_json_object(capfd):
    assert command("--task", "cube_on_cube", "--directions", "1", "--json") == 0
    answer = json.loads(capfd.readouterr().out)
    assert answer["tasks"] == answer["reference_succeeds"] == answer["displaced_runs"] == 1
    assert answer["true_without_a_plan"] == answer["displaced_succeeds"] == 0
    assert command("--task", "cube_on_cub") == 2
    assert "cube_on_cube" in capfd.readouterr().err
    assert command("--directions", "-1") == 2


def test_the_page_lists_every_task():
    text = PAGE.read_text(encoding="utf-8")
    for task in all_tasks():
        assert f"| `{task.name}` | {task.instruction} |" in text


@pytest.mark.slow
def test_every_reference_plan_succeeds_and_waiting_fails():
    for task in all_tasks():
        outcome = execute(task.scene, task.plan, task.predicate)
        assert outcome.success, (task.name, outcome)
        assert not wait(task.scene, task.predicate).success, task.name


@pytest.mark.slow
def test_page_matches_the_generated_table():
    assert PAGE.read_text(encoding="utf-8") == page(PAGE.read_text(encoding="utf-8"))
