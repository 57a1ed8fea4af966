"""Manipulation tasks: plans and their execution, success in reconstructions, plans of a model."""

import dataclasses
import json
import math
from functools import partial

import numpy as np
import pytest
from neoworld_bench.dataset.settle_scene import failures
from neoworld_bench.methods.method_runs import MethodJob, RunSettings
from neoworld_bench.tables.task_figures import success_interval, task_summary
from neoworld_bench.tasks import (
    TaskPlan,
    ToolMove,
    all_tasks,
    execute,
    find_task,
    model_plans,
    success_runs,
)
from neoworld_bench.tasks.execution import judge
from neoworld_bench.tasks.model_plans import (
    FeedbackResult,
    plan_figures,
    plan_request,
    plan_rows,
    scene_of_method,
)
from neoworld_bench.tasks.plan_reliability import sampled_plans
from neoworld_bench.tasks.success_runs import SuccessRow, success_rows
from neoworld_bench.tasks.task_scenes import photographed_task, put, scene_of, task_programs
from neoworld_bench.tasks.world import World

from neoworld_mjx import cli
from neoworld_mjx.config import ComposeOptions, MLLMOptions, RefineOptions
from neoworld_mjx.environments.predicates import Leaning
from neoworld_mjx.errors import ConfigError, MissingResponseError
from neoworld_mjx.mllm import Panel
from neoworld_mjx.mllm.replay import Replay, Tape
from neoworld_mjx.program import build
from neoworld_mjx.spec.pose import from_yaw, pose, rotate
from neoworld_mjx.spec.scene import transformed_scene

TASK = find_task("cube_on_cube")
EXACT = RunSettings(0, RefineOptions(), ComposeOptions(), "exact")
ONE_OF_EACH = (
    *("cup_on_plate", "tight_peg", "third_cube", "push_block", "ball_through_gate", "tip_book"),
    *("dominoes_curved", "push_off_the_edge", "open_till", "close_laptop", "turn_faucet", "bridge"),
)
EVERY = [
    pytest.param(task.name, marks=() if task.name in ONE_OF_EACH else pytest.mark.slow)
    for task in all_tasks()
]


def plan(**changes):
    stay = ToolMove(opening=0.05, seconds=0.2)
    return TaskPlan(**({"position": (0, 0, 0.5), "opening": 0.05, "moves": (stay,)} | changes))


def with_moved(task, names, by):
    objects = []
    for item in task.scene.objects:
        if item.name in names:
            item = item.model_copy(update={"xy": (item.xy[0] + by[0], item.xy[1] + by[1])})
        objects.append(item)
    return task.scene.model_copy(update={"objects": tuple(objects)})


def test_there_are_84_tasks_of_eight_kinds():
    tasks = all_tasks()
    assert len({task.name for task in tasks}) == len(tasks) == 84
    assert len({task.kind for task in tasks}) == 8
    with pytest.raises(ConfigError, match="cube_on_cube"):
        find_task("cube_on_cub")


def wait(scene, predicate):
    """Simulate a scene without a gripper; return the outcome, and how far an object moved [m]."""
    world, moved = World(scene, None), []
    start = {item.name: world.pose(item.name).pos for item in scene.objects}

    def watch(now, _):
        moved.extend(np.linalg.norm(now.pose(name).pos - at) for name, at in start.items())

    return judge(world, predicate, watch=watch), max(moved)


def test_programs_of_tasks_pass_the_checks():
    for name, program in task_programs().items():
        built = build(program.program({}))
        assert built.ok, (name, built.signals)


def test_reference_plan_succeeds_and_fails_for_a_displaced_object():
    outcome = execute(TASK.scene, TASK.plan, TASK.predicate)
    assert outcome.success and outcome.held == 1 and outcome.progress == 1
    waiting, drift = wait(TASK.scene, TASK.predicate)
    assert not waiting.success and drift < 0.001
    beside = with_moved(TASK, ("upper",), (0.02, 0.03))
    outcome = execute(beside, TASK.plan, TASK.predicate)
    assert not outcome.success and outcome.held == 0 and "upper within" in outcome.reason
    held = TASK.plan.model_copy(update={"moves": TASK.plan.moves[:5]})
    outcome = execute(TASK.scene, held, TASK.predicate)
    assert not outcome.success and outcome.progress == 1, "what is held is not placed"
    inside = plan(position=(0.15, 0.05, 0.03), opening=0.0)
    outcome = execute(TASK.scene, inside, TASK.predicate)
    assert not outcome.success and "deep in lower" in outcome.reason


@pytest.mark.slow
@pytest.mark.parametrize("name", [task.name for task in all_tasks()])
def test_every_task_on_its_ground_truth(name):
    task = find_task(name)
    assert failures(task.scene) == []
    outcome = execute(task.scene, task.plan, task.predicate)
    assert outcome.success, outcome
    assert not wait(task.scene, task.predicate)[0].success


def test_gripper_tracks_opening_and_pose():
    way = ToolMove(displacement=(0.1, -0.05, 0.05), turn=(0, 0, 0.8), opening=0.03, seconds=1)
    seen = {}

    def watch(world, _):
        sides = [world.data.joint(f"end_effector-{side}").qpos[0] for side in ("left", "right")]
        seen["opening"], seen["tool"] = sum(sides), world.tool()

    given = plan(position=(0.3, 0.3, 0.4), moves=(way,))
    goal = Leaning(object="mug", tilt=(0, 1), source="test")
    execute(scene_of("cup", put("mug")), given, goal, watch=watch)
    assert seen["opening"] == pytest.approx(0.03, abs=1e-3)
    np.testing.assert_allclose(seen["tool"].pos, (0.4, 0.25, 0.45), atol=1e-3)
    closing = seen["tool"].apply((0, 1, 0)) - seen["tool"].pos
    np.testing.assert_allclose(closing, (-math.sin(0.8), math.cos(0.8), 0), atol=5e-3)


@pytest.mark.parametrize("name", EVERY)
def test_plans_transform_with_the_scene(name):
    """Planned in the scene, moved as a whole, it is the reference plan, moved as a whole."""
    task, by = find_task(name), pose((0.4, -0.3, 0.0), from_yaw(0.9))
    plan, there = task.plan, task.plan_in(transformed_scene(task.scene, by))
    near = {"atol": 3e-6}
    np.testing.assert_allclose(there.position, by.apply(plan.position), **near)
    # Closed fingers that poke from above may close along any line.
    for field in ("approach", "closing") if plan.opening else ("approach",):
        a, b = getattr(there, field), rotate(by.quat, getattr(plan, field))
        np.testing.assert_allclose(a, b, **near)
    for a, b in zip(there.moves, plan.moves, strict=True):
        np.testing.assert_allclose(a.displacement, rotate(by.quat, b.displacement), **near)
        np.testing.assert_allclose(a.turn, rotate(by.quat, b.turn), **near)
        if b.about is not None:
            np.testing.assert_allclose(a.about, by.apply(b.about), **near)
    assert task.predicate_in(task.scene) == task.predicate or task.prepared.condition is not None


@pytest.mark.slow
def test_exact_response_leads_to_task_success():
    (row,) = success_rows(MethodJob(TASK.name, 0, ("open_loop",), EXACT, 1))
    assert row.on_truth and row.in_scene and row.valid and row.missed == 0
    assert row.shift_m < 1e-3 and row.object_error_m < 1e-3 and row.reason == ""


@pytest.mark.parametrize("part", ["sample", "planned_there"])
def test_an_error_after_the_layout_is_a_row_and_ends_no_run(monkeypatch, part):
    def fail(*_args, **_options):
        raise ValueError("broken")

    monkeypatch.setattr(success_runs, part, fail)
    settings = dataclasses.replace(EXACT, samples=2)
    (row,) = success_rows(MethodJob(TASK.name, 0, ("open_loop",), settings, 1))
    assert not row.on_truth and row.reason == "no result: ValueError: broken"


def _row(task, kind, method, on_truth, start=0, **more):
    given = dict.fromkeys(SuccessRow.model_fields, 0) | {
        **{"task": task, "kind": kind, "method": method, "on_truth": on_truth, "start": start},
        **{"in_scene": True, "unaligned": False, "valid": True, "evaluation": start % 2 == 1},
        **{"noise": "layout", "injected": "", "evidence": "none", "reason": "", "scene_reason": ""},
    }
    return SuccessRow.model_validate(given | more)


def test_success_summary_by_method_and_kind():
    rows = [_row("a", "stacking", "ours", True), _row("b", "pushing", "ours", False, 1)]
    rows += [_row("b", "pushing", "gravity", False, reason="no plan: x")]
    summary = task_summary(rows)
    ours = summary["methods"]["ours"]
    assert (ours["n"], ours["success_on_truth"], ours["success_in_scene"]) == (2, 0.5, 1.0)
    assert summary["kinds"]["pushing"]["gravity"]["no_plan"] == 1
    assert summary["failures"][-1] == "b start 0 gravity: no plan: x"
    assert success_interval(rows[:1], "success_on_truth") == (1.0, None, None)
    # Clopper and Pearson's interval of one of two tasks.
    assert ours["success_on_truth_interval"] == pytest.approx([0.0126, 0.9874], abs=1e-4)


def test_reliability_compares_success_in_draws_with_success_in_the_truth():
    def row(task, on_truth, predicted, on_truths, chosen_predicted=None, chosen_on_truth=None):
        drawn = {"predicted": predicted, "on_truths": on_truths, "draws": 8}
        chosen = {"chosen_predicted": chosen_predicted, "chosen_on_truth": chosen_on_truth}
        return _row(task, "stacking", "ours", on_truth, **drawn, **chosen)

    rows = [
        row("a", True, 0.9, 0.5, 0.9, True),
        row("b", False, 1.0, 0.25, 1.0, True),
        row("c", False, 0.1, 0.0, 0.5, False),
        row("d", True, None, None),
    ]
    figures = task_summary(rows)["methods"]["ours"]
    assert [(b["n"], b["success"]) for b in figures["reliability"]] == [(1, 0.0), (2, 0.375)]
    assert figures["reliability_error"] == pytest.approx((0.1 + 2 * 0.575) / 3)
    assert figures["success_of_chosen"] == pytest.approx(2 / 3)
    assert figures["attempted"] == pytest.approx(2 / 3) and figures["success_of_attempted"] == 1.0
    assert "reliability" not in task_summary(rows[3:])["methods"]["ours"]


def test_the_plan_that_succeeds_in_the_most_draws_is_chosen():
    """Offsets that all objects share are no failure; a block that is elsewhere is one."""
    scene, away = TASK.scene, with_moved(TASK, [TASK.object], (0.06, 0.05, 0.0))
    every = [item.name for item in scene.objects if not item.environment]
    shared = with_moved(TASK, every, (0.02, 0.01, 0.0))
    zero = np.zeros(2)
    found = sampled_plans(TASK, scene, TASK.plan, [scene, shared, away], [scene, away], zero)
    assert found.predicted == found.chosen_predicted == pytest.approx(2 / 3)
    assert found.on_truths == 0.5 and found.chosen_on_truth.success
    wrong = TASK.plan.shifted((0.06, 0.05, 0.0))
    found = sampled_plans(TASK, scene, wrong, [scene, shared], [scene], zero)
    assert (found.predicted, found.on_truths, found.chosen_predicted) == (0.0, 0.0, 1.0)
    assert found.chosen_on_truth.success
    assert sampled_plans(TASK, scene, None, [], [], zero) is None


def answer(plan):
    return json.dumps({"reasoning": "by hand", "plan": json.loads(plan.model_dump_json())})


def planned(tape, method="truth"):
    with Panel(Replay(tape, "by hand"), MLLMOptions()) as models:
        return list(plan_rows(models, TASK, methods=[method], starts=1, settings=EXACT))


def test_a_models_plan_is_executed_and_its_failure_refines_the_layout(monkeypatch):
    seen = photographed_task(TASK.scene)
    monkeypatch.setattr(model_plans, "photographed_task", lambda scene: seen)
    # Nobody looks at the pictures, whose shadows take most of the time.
    monkeypatch.setattr(model_plans, "render", partial(model_plans.render, shadows=False))
    request = plan_request(TASK, scene_of_method(TASK, seen, "truth", 0, EXACT), seen)
    assert TASK.instruction in request.prompt and len(request.pictures) == 1
    assert "- upper (wooden block, carried by table)" in request.prompt
    assert "(-0.120, -0.100, 0.025)" in request.prompt  # the middle of the upper cube
    assert "within" not in request.prompt, "the condition of success is not told"
    tape = Tape(made="written by hand: the reference plan")
    tape.put(request, answer(TASK.plan), "hand")
    (row,) = planned(tape)
    assert row.planned and row.in_scene and row.on_truth and row.executions == 0
    # A plan that fails; the refinement finds a layout in which it succeeds.
    x, y, z = TASK.plan.position
    astray = TASK.plan.model_copy(update={"position": (x + 0.06, y + 0.06, z)})
    tape = Tape(made="written by hand: the reference plan, displaced")
    tape.put(request, answer(astray), "hand")
    outcome = execute(TASK.scene, TASK.plan, TASK.predicate)
    refined = lambda *_, **__: FeedbackResult(TASK.scene, outcome, 40)
    monkeypatch.setattr(model_plans, "refine_by_outcome", refined)
    (row,) = planned(tape)
    assert not row.in_scene and "upper within" in row.reason and row.executions == 40
    figures = plan_figures([row])["methods"]["truth"]
    assert (figures["n"], figures["no_plan"], figures["success_on_truth"]) == (1, 0, 0.0)
    with pytest.raises(MissingResponseError):
        planned(Tape(made="none"))


def test_plans_are_asked_of_a_model_that_answers_at_once(capfd):
    with pytest.raises(SystemExit, match="2"):
        cli.main(["bench", "run", "plans", "--task", "bridge", "--provider", "mailbox"])
    assert "mailbox" in capfd.readouterr().err
