"""What makes refinement faster: exact pruning, descent before physics, credit by objects."""

import equinox as eqx
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
from neoworld_mjx.refinement.credit import partners, shared
from neoworld_mjx.refinement.descent import descend
from neoworld_mjx.refinement.prune import PRUNED, score_elites
from neoworld_mjx.refinement.rewards import d_pen, placed, score, weights
from neoworld_mjx.refinement.semantic import misfit
from tests.support import scenes


@pytest.fixture(scope="module")
def crowd():
    scene = compile_scene(crowded(3), samples=96)
    return scene, jax.tree.map(jnp.asarray, noisy_layouts(scene, 96, seed=4))


@pytest.mark.parametrize("elites", [1, 12])
def test_pruning_changes_no_elite(crowd, elites):
    scene, layouts = crowd
    w = weights(RefineOptions())
    engine = NativeEngine()
    rollout = lambda poses: engine.rollout(scene, poses, duration=0.3)
    every = score(scene, layouts, rollout(scene.place(layouts)), w)
    before = placed(scene, layouts, w)
    found = score_elites(scene, layouts, before, rollout, w, elites=elites, batch=8)
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
    _, params = open_cem(scene, CEMOptions())
    how = {"steps": 12, "rate": 0.2, "samples": 64}
    moved = descend(scene, layouts, params.sigma, photo=False, **how)
    before, after = d_pen(scene, layouts), d_pen(scene, moved)
    assert float(jnp.median(after)) < 0.3 * float(jnp.median(before))
    table = scene.names.index("table")
    assert np.array_equal(moved.xy[:, table], layouts.xy[:, table])
    # The composed scene is what its own boxes show.
    how["steps"] = 60
    seen = descend(scene, layouts[:4], params.sigma, photo=True, **how)
    far = lambda some: np.asarray(misfit(scene, scene.place(some)))
    assert far(seen).max() < 0.2 * far(layouts[:4]).min()


def test_candidates_descend_each_by_itself(crowd):
    scene, layouts = crowd
    _, params = open_cem(scene, CEMOptions())
    how = {"steps": 3, "rate": 0.2, "samples": 32, "photo": True}
    several = descend(scene, layouts[:5], params.sigma, **how)
    one = descend(scene, layouts[3:4], params.sigma, **how)
    assert np.allclose(several.xy[3], one.xy[0], atol=1e-5)


def test_credit_goes_to_what_stands_on_each_other():
    scene = compile_scene(scenes.blocks())
    spec = scene.spec
    mine = partners(scene, CEMOptions(credit="object"))
    assert np.array_equal(mine, mine.T) and np.all(np.diag(mine) == 1)
    table = spec.index("table")
    for k, item in enumerate(spec.objects):
        if item.parent not in (None, "table"):
            assert mine[k, spec.index(item.parent)] == 1
        assert mine[k, table] == (k == table)
    wider = partners(scene, CEMOptions(credit="island"))
    assert np.all(wider >= mine)
    apart = partners(scene, CEMOptions(credit="island", sigma_xy=0.0))
    assert apart.sum() <= wider.sum()


def test_each_object_takes_the_elites_that_are_best_for_it():
    scene = compile_scene(scenes.blocks())
    cem, params = open_cem(scene, CEMOptions(population=64, elite_ratio=0.1))
    state = cem.init(scene, params)
    layouts = cem.ask(jax.random.key(0), state, params)
    # The first object wants to go right and the second left; no candidate does both best.
    one, two = np.flatnonzero(np.asarray(scene.optimised))[:2]
    credit = jnp.zeros((64, len(scene.names)))
    credit = credit.at[:, one].set(layouts.xy[:, one, 0]).at[:, two].set(-layouts.xy[:, two, 0])
    told = cem.tell(state, layouts, jnp.zeros(64), jnp.zeros(64), params, credit)
    best = np.sort(np.asarray(layouts.xy[:, one, 0]))[-6:]
    assert float(told.mean.xy[0, one, 0]) == pytest.approx(best.mean(), rel=1e-4)
    assert float(told.mean.xy[0, two, 0]) < 0 < float(told.mean.xy[0, one, 0])


def test_failed_candidates_get_no_credit(crowd):
    scene, layouts = crowd
    found = score(
        scene,
        layouts[:2],
        NativeEngine().rollout(scene, scene.place(layouts[:2])),
        weights(RefineOptions()),
    )
    bad = found.credit.at[1, 0].set(-jnp.inf)
    found = eqx.tree_at(lambda s: s.credit, found, bad)
    every = np.ones((len(scene.names),) * 2, np.float32)
    credit = shared(found, every)
    assert np.allclose(credit[0], np.sum(found.credit[0])) and np.all(credit[1] == -np.inf)
    assert np.array_equal(shared(found, every, False)[:, 0], found.reward)


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
