"""Policies of reconstructions in the ground truth."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from neoworld_bench.methods.method_runs import MethodJob, RunSettings, run_jobs
from neoworld_bench.noise.parse_noise import NoiseLog
from neoworld_bench.rows import RowStore
from neoworld_bench.tables.policy_figures import mean_maximum_rank_violation, policy_summary
from neoworld_bench.tasks.catalogue import find_task
from neoworld_bench.tasks.policy_runs import (
    KINDS,
    PolicyResult,
    PolicyRow,
    PolicyTraining,
    drawn_tasks,
    policy_rows,
)
from neoworld_bench.tasks.policy_tasks import Effector, contact, policy_task, with_start_noise

from neoworld_mjx.config import Config, load_config
from neoworld_mjx.environments.policy import Setting
from neoworld_mjx.environments.policy_environment import policy_observation
from neoworld_mjx.environments.randomization import variants_of
from neoworld_mjx.environments.samples import sample
from neoworld_mjx.environments.training import Training
from neoworld_mjx.spec.pose import pose
from neoworld_mjx.spec.scene import transformed_scene


def test_tasks_are_drawn_by_kind_and_the_first_stay():
    names = drawn_tasks(2)
    assert [find_task(name).kind for name in names] == [kind for kind in KINDS for _ in range(2)]
    assert set(names) < set(drawn_tasks(3)) and drawn_tasks(2, seed=1) != names


def test_a_plan_tells_where_the_gripper_works_and_whether_it_closes():
    grip = find_task("cube_on_cube").plan
    at, closes = contact(grip)
    assert closes and np.allclose(at, np.array(grip.position) - [0, 0, 0.05])
    poke = find_task("close_laptop").plan
    assert not contact(poke)[1] and np.allclose(contact(poke)[0], poke.position)
    push = find_task("push_block").plan
    assert not contact(push)[1] and np.allclose(contact(push)[0], push.position)


def test_a_policy_observes_the_same_wherever_the_scene_is():
    task = find_task("push_block")

    def observed(by):
        scene = transformed_scene(task.scene, pose((*by, 0.0), (1.0, 0, 0, 0)))
        plan = task.plan_in(scene)
        own = policy_task(task, scene, plan, task.predicate_in(scene))
        flying = Effector.of(own, plan, None).on(own)
        return policy_observation(flying, flying.initial_state, np)

    assert np.allclose(observed((0.0, 0.0)), observed((0.3, -0.1)), atol=1e-5)


def result(share, predicted, truth):
    return PolicyResult(share=share, steps=1, predicted=predicted, predicted_n=10, on_truth=truth,
                        unaligned=0, truth_n=10)  # fmt: skip


def test_agreement_is_that_of_simpler():
    truth, predicted = np.array([0.1, 0.5, 0.9]), np.array([0.2, 0.8, 0.6])
    # The last two are ordered otherwise: each of them has the violation 0.4.
    assert mean_maximum_rank_violation(truth, predicted) == pytest.approx(0.8 / 3)
    assert mean_maximum_rank_violation(truth, truth**2) == 0
    columns = {"noise": "parse", "injected": "", "start": 0, "seed": 0, "evaluation": False,
               "evidence": "", "rollouts": 0, "kind": "opening"}  # fmt: skip
    rows = [
        PolicyRow(**columns, task="a", method="scene",
                  results=(result(0.1, 2, 1), result(0.3, 8, 5), result(1.0, 6, 9))),
        PolicyRow(**columns, task="b", method="scene", reason="no start"),
    ]  # fmt: skip
    figures = policy_summary(rows)
    agreement = figures["agreement"]["scene"]
    assert agreement["n"] == 3 and agreement["mmrv"] == pytest.approx(0.8 / 3)
    assert agreement["pearson"] == pytest.approx(np.corrcoef(truth, predicted)[0, 1])
    assert agreement["calibration"] == pytest.approx(0.1 / 3)
    # A task without a policy is a failure of the method.
    assert figures["methods"]["scene"]["on_truth"] == pytest.approx(0.45)


def test_policies_are_trained_in_the_reconstruction_and_run_in_the_truth(tmp_path):
    quick = {"cem": {"population": 4, "iterations": 1}, "rollout": {"duration_s": 0.1}}
    config = load_config(None, {"refine": quick, "compose": {"align": {"enabled": False}}})
    settings = RunSettings(0, config.refine, config.compose, "layout")
    training = Training(steps=64, samples=2, engine="native", snapshots=(0.1, 0.3, 1.0))
    o = PolicyTraining(training, 2, 2, Setting(task=".", horizon=3), tmp_path)
    job = MethodJob("push_block", 0, ("plan", "scene"), settings, 1)
    plan, scene = policy_rows(o, job)
    assert not plan.reason and not scene.reason
    assert [r.share for r in scene.results] == [0.1, 0.3, 1.0]
    assert scene.results[-1].truth_n == 2 and scene.results[-1].on_truth == 0
    assert (tmp_path / "push_block-0-scene-photo" / "policy-1.npz").exists()
    store = RowStore(tmp_path / "rows.jsonl")
    store.put("a", [scene])
    assert RowStore(tmp_path / "rows.jsonl").of(PolicyRow) == [scene]
    # Another method makes another reconstruction.
    other = replace(o, method="open_loop", reconstructions={})
    (row,) = policy_rows(other, MethodJob("push_block", 0, ("plan",), settings, 1))
    assert not row.reason
    ends = [next(iter(each.reconstructions.values()))[0] for each in (o, other)]
    assert ends[0].object("toy_block") != ends[1].object("toy_block")
    job = MethodJob("push_block", 0, ("truth",), settings, 1)
    broken = replace(o, samples=0, robot="none.xml", reconstructions={})
    (row,) = policy_rows(broken, job)
    assert "none.xml" in row.reason and not row.results
    # Nothing is reconstructed for a training in the ground truth.
    assert row.shift_m == 0 and not broken.reconstructions


def test_a_robot_takes_the_place_of_the_gripper():
    arm = Path(__file__).parents[2] / "examples" / "arm" / "arm.xml"
    task = find_task("push_block")
    own = policy_task(task, task.scene, task.plan, task.predicate)
    effector = Effector.of(own, task.plan, str(arm))
    robot = effector.on(own)
    variants = with_start_noise(
        robot, variants_of(robot.controlled, sample(task.scene, 2, sizes=False)), 0
    )
    root = robot.controlled.arm.root
    apart = variants.fields["body_pos"][:, root] - robot.controlled.model.body_pos[root]
    assert (np.abs(apart).max(axis=1) > 0).all() and np.abs(apart).max() < 0.2
    there = effector.moved(np.array([0.1, -0.2])).on(own).controlled
    shift = there.model.body_pos[root] - robot.controlled.model.body_pos[root]
    assert np.allclose(shift, [0.1, -0.2, 0.0], atol=1e-6)


def test_trainings_go_method_by_method_and_resume(tmp_path):
    order = []

    def work(job):
        order.append((job.subject, *job.methods))
        columns = job.columns(job.methods[0], NoiseLog())
        yield PolicyRow(**columns, task=job.subject, kind="pushing", rollouts=0)

    config = Config()
    settings = RunSettings(0, config.refine, config.compose, "layout")
    run = lambda store: run_jobs(
        work, PolicyRow, starts={"a": [0], "b": [0]}, methods=("truth", "mean"),
        settings=settings, store=store, in_turn=True,
    )  # fmt: skip
    store = RowStore(tmp_path / "rows.jsonl")
    rows = run(store)
    assert order == [("a", "truth"), ("b", "truth"), ("a", "mean"), ("b", "mean")]
    assert [(row.task, row.method) for row in rows] == [
        ("a", "truth"), ("a", "mean"), ("b", "truth"), ("b", "mean"),
    ]  # fmt: skip
    lines = (tmp_path / "rows.jsonl").read_text().splitlines(keepends=True)
    (tmp_path / "rows.jsonl").write_text("".join(lines[:3]))
    assert run(RowStore(tmp_path / "rows.jsonl")) == rows and order[4:] == [("b", "mean")]
