"""Plans requested from a model, and feedback into the layout; the tapes are written by hand."""

import json

import numpy as np
import pytest
from neoworld_bench.tasks import execute, find_task
from neoworld_bench.tasks.model_plans import displaced_layout, plan_figures, plan_rows
from neoworld_bench.tasks.outcome_feedback import refine_by_outcome
from neoworld_bench.tasks.plan_asking import PlanAttempt, named_objects, plan_request

from neoworld_mjx import cli
from neoworld_mjx.config import CEMOptions, MLLMOptions
from neoworld_mjx.errors import MissingResponseError
from neoworld_mjx.mllm import Panel
from neoworld_mjx.mllm.replay import Replay, Tape

TASK = find_task("cube_on_cube")


def answer(plan):
    return json.dumps({"reasoning": "by hand", "plan": json.loads(plan.model_dump_json())})


def astray():
    """The reference plan, 6 cm beside the cube."""
    x, y, z = TASK.plan.position
    return TASK.plan.model_copy(update={"position": (x + 0.06, y + 0.06, z)})


@pytest.fixture
def tape():
    """A first plan that fails, and after its outcome the reference plan; by hand."""
    tape = Tape(made="written by hand: the reference plan, first displaced")
    first = plan_request(TASK, TASK.scene)
    tape.put(first, answer(astray()), "hand")
    outcome = execute(TASK.scene, astray(), TASK.predicate)
    second = plan_request(TASK, TASK.scene, [PlanAttempt(astray(), outcome)])
    tape.put(second, answer(TASK.plan), "hand")
    return tape


def rows_of(tape, **changes):
    given = {"rounds": 2, "offset_m": 0.0, "feedback": False, "seed": 0}
    with Panel(Replay(tape, "by hand"), MLLMOptions()) as models:
        return list(plan_rows(models, [TASK], **(given | changes)))


def test_failed_plan_is_revised_with_its_outcome(tape):
    (row,) = rows_of(tape)
    assert row.plans == 2 and row.in_scene and row.on_truth and row.reason == ""
    assert plan_figures([row]) == {"tasks": 1, "in_scene": 1, "after_feedback": 1, "on_truth": 1}


def test_no_rounds_means_no_revision(tape):
    (row,) = rows_of(tape, rounds=0)
    assert row.plans == 1 and not row.in_scene and "upper within" in row.reason


def test_missing_response_raises(tape):
    with pytest.raises(MissingResponseError):
        rows_of(tape, offset_m=0.02)


def test_request_describes_the_scene_but_not_the_success_condition():
    prompt = plan_request(TASK, TASK.scene).prompt
    assert TASK.instruction in prompt and "- upper (wooden block, carried by table)" in prompt
    assert "(-0.120, -0.100, 0.025)" in prompt  # the middle of the upper cube
    assert "within" not in prompt and "1 s" not in prompt
    drawer = find_task("close_cabinet_drawer")
    assert "joint drawer_2_slide (prismatic)" in plan_request(drawer, drawer.scene).prompt


@pytest.mark.slow
def test_feedback_moves_the_named_objects_until_the_plan_succeeds():
    lower = TASK.scene.object("lower")
    wrong = TASK.with_object("lower", xy=(lower.xy[0] + 0.015, lower.xy[1] - 0.015))
    assert not execute(wrong, TASK.plan, TASK.predicate).success
    options = CEMOptions(population=10, iterations=5, elite_ratio=0.25, smoothing=0.2)
    result = refine_by_outcome(wrong, TASK.plan, TASK.predicate, options=options)
    assert result.outcome.success and 1 < result.executions <= 72
    before = np.linalg.norm(np.subtract(wrong.object("lower").xy, lower.xy))
    after = np.linalg.norm(np.subtract(result.scene.object("lower").xy, lower.xy))
    assert after < before
    assert result.scene.object("peg").xy == pytest.approx(wrong.object("peg").xy)


def test_only_objects_of_the_predicate_are_displaced():
    assert named_objects(TASK.predicate) == {"upper", "lower"}
    scene = displaced_layout(TASK, 0.02, 0)
    moved = {
        item.name: float(np.linalg.norm(np.subtract(item.xy, TASK.scene.object(item.name).xy)))
        for item in scene.objects
    }
    assert moved == pytest.approx({"table": 0, "lower": 0.02, "upper": 0.02, "peg": 0})


def test_plans_command_requires_a_provider_with_responses(capfd, tmp_path):
    with pytest.raises(SystemExit) as ended:
        cli.main(["bench", "run", "plans", "--task", "bridge", "--provider", "mailbox"])
    assert ended.value.code == 2
    assert "mailbox" in capfd.readouterr().err
