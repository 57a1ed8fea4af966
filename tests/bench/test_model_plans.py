"""Plans requested from a model, and feedback into the layout; the tapes are written by hand."""

import io
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from neoworld_bench.methods.method_runs import RunSettings
from neoworld_bench.tasks import execute, find_task, model_plans
from neoworld_bench.tasks.model_plans import plan_figures, plan_rows, scene_rows
from neoworld_bench.tasks.outcome_feedback import FeedbackResult, refine_by_outcome
from neoworld_bench.tasks.plan_asking import PlanAttempt, plan_request
from neoworld_bench.tasks.planned_scenes import displaced_layout, reconstructed_scene, true_scene
from neoworld_bench.tasks.predicates import named_objects
from PIL import Image

from neoworld_mjx import cli
from neoworld_mjx.config import CEMOptions, ComposeOptions, MLLMOptions, RefineOptions
from neoworld_mjx.errors import MissingResponseError
from neoworld_mjx.mllm import Panel
from neoworld_mjx.mllm.replay import Replay, Tape
from neoworld_mjx.spec import world_poses
from tests.support.model_server import ModelServer, says

TASK = find_task("cube_on_cube")
SEEN = true_scene(TASK, 0.0, 0, "numbers")
EXACT = RunSettings(0, RefineOptions(), ComposeOptions(), "exact")


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
    first = plan_request(TASK, SEEN)
    tape.put(first, answer(astray()), "hand")
    outcome = execute(TASK.scene, astray(), TASK.predicate)
    second = plan_request(TASK, SEEN, [PlanAttempt(astray(), outcome)])
    tape.put(second, answer(TASK.plan), "hand")
    return tape


def rows_of(tape, **changes):
    given = {"rounds": 2, "offset_m": 0.0, "feedback": False, "seed": 0, "sees": "numbers"}
    with Panel(Replay(tape, "by hand"), MLLMOptions()) as models:
        return list(plan_rows(models, [TASK], **(given | changes)))


def test_failed_plan_is_revised_with_its_outcome(tape):
    (row,) = rows_of(tape)
    assert row.plans == 2 and row.in_scene and row.on_truth and row.reason == ""
    figures = plan_figures([row])["methods"]["truth"]
    assert (figures["n"], figures["no_plan"]) == (1, 0)
    assert figures["success_on_truth"] == figures["success_in_scene"] == 1.0


def test_no_rounds_means_no_revision(tape):
    (row,) = rows_of(tape, rounds=0)
    assert row.plans == 1 and not row.in_scene and "upper within" in row.reason


def test_missing_response_raises(tape):
    with pytest.raises(MissingResponseError):
        rows_of(tape, offset_m=0.02)


def test_request_describes_the_scene_but_not_the_success_condition():
    prompt = plan_request(TASK, SEEN).prompt
    assert TASK.instruction in prompt and "- upper (wooden block, carried by table)" in prompt
    assert "(-0.120, -0.100, 0.025)" in prompt  # the middle of the upper cube
    assert "within" not in prompt and "1 s" not in prompt
    drawer = find_task("close_cabinet_drawer")
    seen = true_scene(drawer, 0.0, 0, "numbers")
    assert "joint drawer_2_slide (prismatic)" in plan_request(drawer, seen).prompt


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


def test_picture_shows_the_scene_through_the_camera_that_the_prompt_tells():
    seen = true_scene(TASK, 0.0, 0, "both")
    request = plan_request(TASK, seen)
    (picture,) = request.pictures
    with Image.open(io.BytesIO(picture.data)) as image:
        pixels = np.asarray(image.convert("RGB")).astype(int)
    vectors = "".join(rf"{name} \((.*?)\)[,;] " for name in ("position", "right", "down", "ahead"))
    numbers = re.search(rf"{vectors}.* and (.*?) upright", request.prompt)
    eye, *axes = (np.array([float(v) for v in numbers[k].split(",")]) for k in range(1, 5))
    focal = pixels.shape[0] / 2 / np.tan(np.radians(float(numbers[5])) / 2)
    for name, channel in (("upper", 0), ("lower", 2)):  # The red and the blue cube.
        middle = world_poses(TASK.scene)[name].apply([0.0, 0.0, 0.05])
        x, y, z = np.stack(axes) @ (middle - eye)
        u = round(pixels.shape[1] / 2 + focal * x / z)
        v = round(pixels.shape[0] / 2 + focal * y / z)
        assert pixels[v, u].argmax() == channel, name
    assert "- upper (" in request.prompt
    alone = plan_request(TASK, true_scene(TASK, 0.0, 0, "picture"))
    assert (
        "- upper (" not in alone.prompt and "Its objects: table, lower, upper, peg" in alone.prompt
    )


def test_plans_of_a_served_model_in_a_reconstruction_have_both_columns(monkeypatch, capfd):
    """A fake server sees the picture of the reconstruction; its plan fails without feedback."""
    seen = reconstructed_scene(TASK, "open_loop", 0, EXACT, "both")
    plan = TASK.plan_in(seen.scene)
    monkeypatch.setenv("ANTHROPIC_API_KEY", "sk-test-0123456789-do-not-show")
    with ModelServer("anthropic", says(answer(plan))) as server:
        with pytest.raises(SystemExit, match="0"):
            cli.main(
                ["bench", "run", "plans", "--task", TASK.name, "--method", "open_loop"]
                + ["--noise", "exact", "--feedback", "--provider", "anthropic", "--json"]
                + ["--set", f"mllm.base_url={server.url}"]
            )
        (body,) = server.bodies
    assert '"type": "image"' in json.dumps(body) and TASK.instruction in json.dumps(body)
    result = json.loads(capfd.readouterr().out)
    assert set(result["methods"]) == {"open_loop", "open_loop+feedback"}
    for figures in result["methods"].values():
        assert figures["success_in_scene"] == figures["success_on_truth"] == 1.0
    assert [row["executions"] for row in result["rows"]] == [0, 0]


def test_feedback_is_a_row_of_its_own(monkeypatch):
    """The plan fails in the displaced scene, and succeeds in the layout that feedback finds."""
    tape = Tape(made="written by hand: the reference plan")
    wrong = true_scene(TASK, 0.03, 0, "numbers")
    tape.put(plan_request(TASK, wrong), answer(TASK.plan), "hand")
    outcome = execute(TASK.scene, TASK.plan, TASK.predicate)
    calls = []

    def refined(scene, plan, predicate, *, seed):
        calls.append((scene, plan, predicate, seed))
        return FeedbackResult(TASK.scene, outcome, 2, 40)

    monkeypatch.setattr(model_plans, "refine_by_outcome", refined)
    before, after = rows_of(tape, rounds=0, offset_m=0.03, feedback=True)
    assert calls == [(wrong.scene, TASK.plan, TASK.predicate, 0)]
    assert (before.method, after.method) == ("displaced", "displaced+feedback")
    assert not before.in_scene and before.executions == 0 and "upper" in before.scene_reason
    assert after.in_scene and after.on_truth and after.executions == 40
    shares = plan_figures([before, after])["methods"]
    assert [shares[name]["success_in_scene"] for name in shares] == [0.0, 1.0]


def test_scene_without_a_named_object_counts_as_a_failure_of_both_rows():
    objects = tuple(item for item in TASK.scene.objects if item.name != "lower")
    short = replace(SEEN, scene=TASK.scene.model_copy(update={"objects": objects}))
    with Panel(Replay(Tape(made="none"), "by hand"), MLLMOptions()) as models:
        rows = list(scene_rows(models, TASK, short, rounds=0, feedback=True, seed=0))
    assert [row.method for row in rows] == ["truth", "truth+feedback"]
    for row in rows:
        assert row.plans == 0 and not row.in_scene and not row.on_truth
        assert row.reason.startswith("no plan: ")
