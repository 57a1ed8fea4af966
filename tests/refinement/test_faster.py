"""What makes refinement faster: exact pruning, descent before physics, credit by objects."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neoworld_mjx.bench.scenes import crowded, noisy_layouts
from neoworld_mjx.config import CEMOptions, DescentOptions, RefineOptions, RolloutOptions
from neoworld_mjx.errors import ConfigError
from neoworld_mjx.physics.model import compile_scene
from neoworld_mjx.physics.native import NativeEngine
from neoworld_mjx.refinement import open_cem, refine
from neoworld_mjx.refinement.credit import assigned_credit, contact_components
from neoworld_mjx.refinement.gradient import refine_by_gradient
from neoworld_mjx.refinement.objective import evaluate, open_objective, place
from neoworld_mjx.refinement.pruning import PRUNED, RolloutPlan
from neoworld_mjx.refinement.rewards import d_pen
from neoworld_mjx.refinement.semantic import reprojection_error
from tests.support import scenes


@pytest.fixture(scope="module")
def crowd():
    scene = compile_scene(crowded(3), samples=96)
    return scene, jax.tree.map(jnp.asarray, noisy_layouts(scene, 96, seed=4))


@pytest.mark.parametrize("elites", [1, 12])
def test_pruning_changes_no_elite(crowd, elites):
    scene, layouts = crowd
    objective = open_objective(RefineOptions())
    roll_out = lambda placed: NativeEngine().rollout(scene, placed.poses, duration=0.3)
    placement = place(scene, layouts, objective)
    every = evaluate(scene, layouts, placement, roll_out(placement), objective)
    plan = RolloutPlan(placement, batch=8, elites=elites)
    while (rows := plan.next()) is not None:
        some, placed = jax.tree.map(lambda x, rows=rows: x[rows], (layouts, placement))
        plan.add(evaluate(scene, some, placed, roll_out(placed), objective))
    found = plan.scores()
    assert plan.rolled_out == np.sum(np.asarray(found.status) != PRUNED)
    pruned = np.asarray(found.status) == PRUNED
    assert 0 < pruned.sum() < 96
    best = lambda s: np.argsort(-np.asarray(s.reward), kind="stable")[:elites]
    assert np.array_equal(best(found), best(every))
    assert np.allclose(found.reward[best(found)], every.reward[best(every)], atol=1e-5)
    assert not np.isfinite(np.asarray(found.reward)[pruned]).any()
    assert not np.asarray(found.valid)[pruned].any()
    assert np.asarray(every.reward)[pruned].max() <= np.asarray(every.reward)[best(every)].min()


def test_a_refinement_with_pruning_ends_where_one_without_does():
    noisy = compile_scene(crowded(3), samples=96)
    start = noisy.apply(noisy_layouts(noisy, 1, seed=2), 0)
    found = [
        refine(
            start,
            RefineOptions(
                cem=CEMOptions(population=48, iterations=3, prune=prune, batch=6),
                rollout=RolloutOptions(duration_s=0.3, samples_per_object=96),
            ),
            seed=3,
        )
        for prune in (True, False)
    ]
    assert found[0].pruned > 40 and found[1].pruned == 0
    assert found[0].rollouts + found[0].pruned == found[1].rollouts == 32 + 48 + 48
    for name in ("xy", "yaw", "log_scale"):
        with_, without = (f.history[name] for f in found)
        assert np.allclose(with_, without, atol=1e-5, equal_nan=True)


def test_descent_leaves_interpenetration_and_finds_the_boxes(crowd):
    scene, layouts = crowd
    sigma = open_cem(scene, CEMOptions()).params.sigma
    how = {"steps": 12, "rate": 0.2, "samples": 64}
    moved = refine_by_gradient(scene, layouts, sigma, photo=False, **how)
    before, after = d_pen(scene, layouts), d_pen(scene, moved)
    assert float(jnp.median(after)) < 0.3 * float(jnp.median(before))
    table = scene.names.index("table")
    assert np.array_equal(moved.xy[:, table], layouts.xy[:, table])
    # The composed scene is what its own boxes show.
    how["steps"] = 60
    seen = refine_by_gradient(scene, layouts[:4], sigma, photo=True, **how)
    far = lambda some: np.asarray(reprojection_error(scene, scene.place(some)))
    assert far(seen).max() < 0.2 * far(layouts[:4]).min()


def test_candidates_descend_each_by_itself(crowd):
    scene, layouts = crowd
    sigma = open_cem(scene, CEMOptions()).params.sigma
    how = {"steps": 3, "rate": 0.2, "samples": 32, "photo": True}
    several = refine_by_gradient(scene, layouts[:5], sigma, **how)
    one = refine_by_gradient(scene, layouts[3:4], sigma, **how)
    assert np.allclose(several.xy[3], one.xy[0], atol=1e-5)


def test_credit_goes_to_what_stands_on_each_other():
    scene = compile_scene(scenes.blocks())
    spec = scene.spec
    near = contact_components(scene, CEMOptions(credit="object"))
    assert np.array_equal(near, near.T) and np.all(np.diag(near) == 1)
    table = spec.index("table")
    for k, item in enumerate(spec.objects):
        if item.parent not in (None, "table"):
            assert near[k, spec.index(item.parent)] == 1
        assert near[k, table] == (k == table)
    wider = contact_components(scene, CEMOptions(credit="island"))
    assert np.all(wider >= near)
    apart = contact_components(scene, CEMOptions(credit="island", sigma_xy=0.0))
    assert apart.sum() <= wider.sum()


def test_each_object_takes_the_elites_that_are_best_for_it():
    scene = compile_scene(scenes.blocks())
    cem = open_cem(scene, CEMOptions(elite_ratio=0.1))
    state = cem.init()
    layouts = cem.ask(jax.random.key(0), state, 64)
    # The first object wants to go right and the second left; no candidate does both best.
    one, two = np.flatnonzero(np.asarray(scene.optimised))[:2]
    credit = jnp.zeros((64, len(scene.names)))
    credit = credit.at[:, one].set(layouts.xy[:, one, 0]).at[:, two].set(-layouts.xy[:, two, 0])
    fitted = cem.tell(state, layouts, jnp.zeros(64), credit=credit)
    best = np.sort(np.asarray(layouts.xy[:, one, 0]))[-6:]
    assert float(fitted.mean.xy[0, one, 0]) == pytest.approx(best.mean(), rel=1e-4)
    assert float(fitted.mean.xy[0, two, 0]) < 0 < float(fitted.mean.xy[0, one, 0])


def test_failed_candidates_get_no_credit():
    credit = jnp.array([[0.1, 0.2, 0.3], [-jnp.inf, 0.5, 0.5]])
    reward, every = jnp.array([0.7, -jnp.inf]), jnp.ones((3, 3))
    assigned = assigned_credit(credit, reward, every)
    assert np.allclose(assigned[0], 0.6) and np.all(assigned[1] == -np.inf)
    assert np.array_equal(assigned_credit(credit, reward, every, False)[:, 0], reward)


def test_credit_by_objects_excludes_terms_of_the_whole_scene():
    options = RefineOptions(cem=CEMOptions(credit="object"))
    bad = options.model_copy(
        update={"reward": options.reward.model_copy(update={"terms": {"math:sin": 1.0}})}
    )
    with pytest.raises(ConfigError, match=r"refine\.cem\.credit"):
        refine(scenes.blocks(), bad)


def test_candidates_are_projected_before_they_are_rolled_out(crowd):
    scene, layouts = crowd
    start = scene.apply(layouts, 0)
    options = RefineOptions(
        cem=CEMOptions(population=16, iterations=1, first=0),
        descent=DescentOptions(warm_steps=0, project="always"),
        rollout=RolloutOptions(duration_s=0.1, samples_per_object=64),
    )
    plain = options.model_copy(update={"descent": DescentOptions(warm_steps=0)})
    moved, drawn = (refine(start, o, seed=1) for o in (options, plain))
    assert moved.history["d_pen"].mean() < 0.7 * drawn.history["d_pen"].mean()
