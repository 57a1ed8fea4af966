"""Pruning skips rollouts without changing the elites."""

import equinox as eqx
import jax
import numpy as np
import pytest

from neoworld_mjx.config import CEMOptions, RefineOptions, RolloutOptions
from neoworld_mjx.physics.engine import unmoved
from neoworld_mjx.physics.model import compile_scene
from neoworld_mjx.physics.native import NativeEngine
from neoworld_mjx.refinement import refine
from neoworld_mjx.refinement.objective import evaluate, open_objective, place
from neoworld_mjx.refinement.pruning import PRUNED, RolloutPlan
from tests.support.scenes import noisy_layouts, stored_scene


@pytest.mark.parametrize("elites", [1, 12])
def test_pruning_does_not_change_the_elites(crowd, elites):
    scene, layouts = crowd
    objective = open_objective(RefineOptions())
    roll_out = lambda placed: NativeEngine().rollout(scene, placed.poses, duration=0.3)
    placement = place(scene, layouts, objective)
    complete = evaluate(scene, layouts, placement, roll_out(placement), objective)
    plan = RolloutPlan(placement, batch=8, elites=elites)
    while (rows := plan.next()) is not None:
        some, placed = jax.tree.map(lambda x, rows=rows: x[rows], (layouts, placement))
        plan.add(evaluate(scene, some, placed, roll_out(placed), objective))
    scores = plan.scores()
    assert plan.rolled_out == np.sum(np.asarray(scores.status) != PRUNED)
    pruned = np.asarray(scores.status) == PRUNED
    assert 0 < pruned.sum() < 96
    best = lambda s: np.argsort(-np.asarray(s.reward), kind="stable")[:elites]
    assert np.array_equal(best(scores), best(complete))
    assert np.allclose(scores.reward[best(scores)], complete.reward[best(complete)], atol=1e-5)
    assert not np.isfinite(np.asarray(scores.reward)[pruned]).any()
    assert not np.asarray(scores.valid)[pruned].any()
    assert (
        np.asarray(complete.reward)[pruned].max()
        <= np.asarray(complete.reward)[best(complete)].min()
    )


def test_batches_settle_until_one_candidate_is_valid(crowd):
    scene, layouts = crowd
    objective = open_objective(RefineOptions())
    placement = place(scene, layouts, objective)
    still = evaluate(scene, layouts, placement, unmoved(scene, placement.poses), objective)
    order = np.argsort(-np.asarray(placement.bound), kind="stable")
    plan = RolloutPlan(placement, batch=8, elites=4, until_valid=True, rests=16)
    rolled = []
    for valid in (False, True):
        assert plan.next() is None
        waiting = plan.waiting()
        assert waiting.tolist() == sorted(order[len(rolled) : len(rolled) + 16])
        plan.placed_at_rest(placement)
        while (rows := plan.next()) is not None:
            scores = jax.tree.map(lambda x, rows=rows: np.asarray(x)[rows], still)
            plan.add(eqx.tree_at(lambda s: s.valid, scores, np.full(8, valid)))
            rolled += rows.tolist()
    assert plan.waiting() is None and plan.next() is None
    # Candidates after a valid one may be pruned, but none before it.
    assert rolled == order[: len(rolled)].tolist() and 16 < len(rolled) <= 32
    assert plan.rolled_out == len(rolled)


def test_refinements_with_and_without_pruning_are_equal():
    noisy = compile_scene(stored_scene("crowded_3"), samples=64)
    start = noisy.apply(noisy_layouts(noisy, 1, seed=2), 0)
    results = [
        refine(
            start,
            RefineOptions(
                cem=CEMOptions(population=48, iterations=3, prune=prune, batch=8),
                rollout=RolloutOptions(duration_s=0.3, samples_per_object=64),
            ),
            seed=3,
        )
        for prune in (True, False)
    ]
    assert results[0].pruned > 40 and results[1].pruned == 0
    assert results[0].rollouts + results[0].pruned == results[1].rollouts == 32 + 48 + 48
    for name in ("xy", "yaw", "log_scale"):
        pruned, complete = (result.history[name] for result in results)
        assert np.allclose(pruned, complete, atol=1e-5, equal_nan=True)
