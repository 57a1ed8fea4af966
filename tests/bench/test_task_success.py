"""Task success: plans from reconstructed scenes, rows and summaries."""

import math

import numpy as np
import pytest
from neoworld_bench.methods.method_runs import RunSettings
from neoworld_bench.methods.scene_methods import METHODS
from neoworld_bench.suites import MethodName
from neoworld_bench.tables.success_table import success_table
from neoworld_bench.tasks import all_tasks, find_task, success_runs
from neoworld_bench.tasks.plan_format import rotation
from neoworld_bench.tasks.reconstructed_plans import planned_there
from neoworld_bench.tasks.success_runs import SuccessRow, known_successes, run_successes
from neoworld_bench.tasks.success_summary import success_interval, success_summary
from neoworld_bench.tasks.task_photo import photographed_task

from neoworld_mjx.config import ComposeOptions, RefineOptions
from neoworld_mjx.errors import SpecError
from neoworld_mjx.spec import scale
from neoworld_mjx.spec.pose import from_yaw, pose, rotate
from neoworld_mjx.spec.scene import transformed_scene

ONE_OF_EACH = (
    *("cup_on_plate", "tight_peg", "third_cube", "push_block", "ball_through_gate", "tip_book"),
    *("dominoes_curved", "push_off_the_edge", "open_till", "close_laptop", "turn_faucet", "bridge"),
)


def _moved(task, names, by):
    objects = []
    for item in task.scene.objects:
        if item.name in names:
            xy = (item.xy[0] + by[0], item.xy[1] + by[1])
            item = item.model_copy(update={"xy": xy})
        objects.append(item)
    return task.scene.model_copy(update={"objects": tuple(objects)})


def _check_that_the_plan_moves_along(task):
    """Planned in the scene, moved as a whole, it is the reference plan, moved as a whole."""
    by = pose((0.4, -0.3, 0.0), from_yaw(0.9))
    plan, moved = task.plan, task.plan_in(transformed_scene(task.scene, by))
    near = {"atol": 3e-6}
    np.testing.assert_allclose(moved.position, by.apply(plan.position), **near)
    # Closed fingers that poke from above may close along any line.
    for name in ("approach", "closing") if plan.opening else ("approach",):
        a, b = getattr(moved, name), rotate(by.quat, getattr(plan, name))
        np.testing.assert_allclose(a, b, **near)
    assert len(moved.moves) == len(plan.moves)
    for a, b in zip(moved.moves, plan.moves, strict=True):
        np.testing.assert_allclose(a.displacement, rotate(by.quat, b.displacement), **near)
        np.testing.assert_allclose(a.turn, rotate(by.quat, b.turn), **near)
        assert (a.about is None) == (b.about is None)
        if b.about is not None:
            np.testing.assert_allclose(a.about, by.apply(b.about), **near)
        assert (a.opening, a.seconds) == (
            pytest.approx(b.opening, abs=1e-6),
            pytest.approx(b.seconds, abs=1e-4),
        )
    assert task.predicate_in(task.scene) == task.predicate or task.prepared.condition is not None


@pytest.mark.parametrize("name", ONE_OF_EACH)
def test_plans_transform_with_the_scene(name):
    _check_that_the_plan_moves_along(find_task(name))


@pytest.mark.slow
def test_every_plan_transforms_with_the_scene():
    for task in all_tasks():
        _check_that_the_plan_moves_along(task)


def test_targets_follow_the_layout():
    task = find_task("push_block")
    assert task.predicate_in(task.scene).target == pytest.approx(task.predicate.target)
    marks = _moved(task, ("mark", "mark_2"), (0.05, 0.0))
    x, y, z = task.predicate.target
    assert task.predicate_in(marks).target == pytest.approx((x + 0.05, y, z))
    (farther,) = (m for m in task.plan_in(marks).moves if m.displacement[0] > 0)
    assert farther.displacement[0] == pytest.approx(0.25 + 0.003 * 0.25 / math.hypot(0.25, 0.1))
    bridge = find_task("bridge")
    for a, b in zip(bridge.predicate_in(bridge.scene).of, bridge.predicate.of, strict=True):
        assert a.target == pytest.approx(b.target, abs=2e-4)


def test_grips_and_targets_scale_with_objects():
    task = find_task("cube_on_cube")
    objects = [
        item.model_copy(update={"spec": scale(item.spec, 1.2), "z": 1.2 * item.z})
        if item.name in ("upper", "lower")
        else item
        for item in task.scene.objects
    ]
    larger = task.scene.model_copy(update={"objects": tuple(objects)})
    plan = task.plan_in(larger)
    assert plan.opening == pytest.approx(task.plan.opening + 0.2 * 0.05)
    assert task.predicate_in(larger).target == pytest.approx((0.0, 0.0, 0.06))
    assert task.predicate_in(larger).radius == task.predicate.radius


def test_plan_from_a_wrong_layout_fails_in_the_ground_truth():
    task = find_task("cube_on_cube")
    there = planned_there(task, _moved(task, ("upper",), (0.03, -0.02)))
    assert there.in_scene.success and not there.on_truth.success
    assert "upper within" in there.on_truth.reason
    assert there.object_error_m == pytest.approx(math.hypot(0.03, 0.02))


def test_common_offset_of_all_objects_is_no_error():
    task = find_task("cube_on_cube")
    names = [item.name for item in task.scene.objects if not item.environment]
    there = planned_there(task, _moved(task, names, (0.04, 0.03)))
    assert there.shift_m == pytest.approx(0.05) and there.object_error_m == pytest.approx(0.0)
    assert there.on_truth.success and there.in_scene.success and not there.unaligned.success


def test_shifted_plans_shift_their_axes():
    plan = find_task("turn_faucet").plan
    there = plan.shifted((0.1, 0.2, 0.0))
    before, after = plan.moves[-1].about, there.moves[-1].about
    assert np.subtract(after, before) == pytest.approx((0.1, 0.2, 0.0))
    assert np.subtract(there.position, plan.position) == pytest.approx((0.1, 0.2, 0.0))
    np.testing.assert_allclose(rotation(plan.moves[-1].turn), rotation(there.moves[-1].turn))


def test_missing_object_means_no_plan():
    task = find_task("cube_on_cube")
    objects = [item for item in task.scene.objects if item.name != "lower"]
    there = planned_there(task, task.scene.model_copy(update={"objects": tuple(objects)}))
    assert not (there.on_truth.success or there.in_scene.success or there.unaligned.success)
    assert there.on_truth.reason.startswith("no plan: ")
    assert there.on_truth.reason.endswith("; the scene has no lower")


def test_task_photos_view_the_scene_from_a_side_without_occlusion():
    front = photographed_task(find_task("cube_on_cube").scene)
    for item in front.scene.objects[1:]:
        x0, y0, x1, y1 = item.box2d.as_tuple()
        assert x0 > 0 and y0 > 0 and x1 < 640 and y1 < 480 and (x1 - x0) * (y1 - y0) > 500
    back = front.back(front.scene).objects[0]
    assert (*back.xy, back.z, back.yaw) == pytest.approx((0, 0, -0.04, 0), abs=1e-12)
    # From the front the first domino hides behind the last.
    row = photographed_task(find_task("dominoes_straight").scene)
    assert abs(abs(math.degrees(row.scene.objects[0].yaw)) - 180.0) > 20.0


EXACT = RunSettings(0, RefineOptions(), ComposeOptions(), "exact")


def _run(out):
    tasks = [find_task("cube_on_cube")]
    return run_successes(tasks, ["open_loop"], EXACT, starts=1, out=out)


def test_rows_are_stored_and_exceptions_count_as_failures(tmp_path, monkeypatch):
    def raising(*_, **__):
        raise ValueError("broken")
        yield

    with monkeypatch.context() as patch:
        patch.setattr(success_runs, "outcomes_of", raising)
        (row,) = _run(tmp_path)
    assert not (row.on_truth or row.in_scene or row.unaligned or row.valid)
    assert row.reason == "no layout: ValueError: broken"
    assert known_successes(tmp_path) == [row] == _run(tmp_path)
    assert known_successes(tmp_path / "none") == []
    with pytest.raises(SpecError, match="method: got 'opn_loop'"):
        run_successes([], ["opn_loop"], EXACT, starts=1)


@pytest.mark.slow
def test_exact_response_leads_to_task_success(tmp_path):
    (row,) = _run(tmp_path)
    assert row.on_truth and row.in_scene and row.valid and row.missed == 0
    assert row.shift_m < 1e-3 and row.object_error_m < 1e-3 and row.reason == ""


def _row(task, kind, method, on_truth, start=0, **more):
    given = dict.fromkeys(SuccessRow.model_fields, 0) | {
        **{"task": task, "kind": kind, "method": method, "on_truth": on_truth, "start": start},
        **{"in_scene": True, "unaligned": False, "valid": True, "evaluation": start % 2 == 1},
        **{"noise": "layout", "injected": "", "reason": "", "scene_reason": "", "fingerprint": "x"},
    }
    return SuccessRow.model_validate(given | more)


def test_success_summary_by_method_and_kind():
    rows = [_row("a", "stacking", "ours", True), _row("a", "stacking", "ours", True, 1)]
    rows += [_row("b", "pushing", "ours", False), _row("b", "pushing", "ours", False, 1)]
    rows += [_row("b", "pushing", "gravity", False, reason="no plan: x")]
    summary = success_summary(rows)
    ours = summary["methods"]["ours"]
    assert (ours["n"], ours["success_on_truth"], ours["success_in_scene"]) == (4, 0.5, 1.0)
    assert ours["success_on_truth_interval"] == pytest.approx([0.0, 1.0])
    assert summary["evaluation"]["ours"]["n"] == 2
    assert summary["kinds"]["pushing"]["gravity"]["no_plan"] == 1
    assert summary["kinds"]["stacking"]["ours"]["success_on_truth"] == 1.0
    assert summary["paper"]["success"]["NeoWorld-Pro"] == 0.9285
    assert success_interval(rows[:2], "success_on_truth") == (1.0, None, None)


def test_success_table_has_intervals_and_marks_the_papers_rows():
    rows = [_row("a", "stacking", "ours", True), _row("b", "pushing", "ours", False, 1)]
    text = success_table(rows).markdown()
    # Clopper and Pearson's intervals of one and of two of two tasks, none of a single task.
    assert "| ours | all | 2 | 50.0 (1.3 to 98.7) | 100.0 (15.8 to 100.0) |" in text
    assert "| ours | evaluation | 1 | 0.0 |" in text
    assert "| NeoWorld-Pro* |  |  |  | 92.85 |  |  |" in text


def test_command_line_offers_all_methods():
    assert set(MethodName.__args__) == set(METHODS)
