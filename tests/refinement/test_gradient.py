"""Gradient refinement of layouts, before the search and of its candidates."""

import jax.numpy as jnp
import numpy as np

from neoworld_mjx.config import CEMOptions, DescentOptions, RefineOptions, RolloutOptions
from neoworld_mjx.refinement import open_cem, refine
from neoworld_mjx.refinement.gradient import refine_by_gradient
from neoworld_mjx.refinement.rewards import d_pen
from neoworld_mjx.refinement.semantic import reprojection_error

FITTING = {"steps": 60, "rate": 0.2, "samples": 64}


def test_gradient_refinement_removes_overlaps_and_fits_the_boxes(crowd):
    scene, layouts = crowd
    sigma = open_cem(scene, CEMOptions()).params.sigma
    settings = {"steps": 12, "rate": 0.2, "samples": 64}
    moved = refine_by_gradient(scene, layouts, sigma, photo=False, **settings)
    before, after = d_pen(scene, layouts), d_pen(scene, moved)
    assert float(jnp.median(after)) < 0.3 * float(jnp.median(before))
    table = scene.names.index("table")
    assert np.array_equal(moved.xy[:, table], layouts.xy[:, table])
    # The layout of the composed scene has the boxes of its photo.
    fitted = refine_by_gradient(scene, layouts[:4], sigma, photo=True, **FITTING)
    error = lambda some: np.asarray(reprojection_error(scene, scene.place(some)))
    assert error(fitted).max() < 0.2 * error(layouts[:4]).min()


def test_candidates_are_refined_independently(crowd):
    scene, layouts = crowd
    sigma = open_cem(scene, CEMOptions()).params.sigma
    first, second = (
        refine_by_gradient(scene, layouts[rows], sigma, photo=True, **FITTING)
        for rows in (np.arange(4), np.array([3, 7, 8, 9]))
    )
    assert np.allclose(first.xy[3], second.xy[0], atol=1e-5)
    assert not np.allclose(first.xy[1], second.xy[1], atol=1e-3)


def test_candidates_are_refined_before_their_rollout(crowd):
    scene, layouts = crowd
    start = scene.apply(layouts, 0)
    options = RefineOptions(
        cem=CEMOptions(population=32, iterations=1, first=0, keep_sound=False),
        descent=DescentOptions(warm_steps=0, project="always"),
        rollout=RolloutOptions(duration_s=0.1, samples_per_object=64),
    )
    without = options.model_copy(update={"descent": DescentOptions(warm_steps=0)})
    refined, sampled = (refine(start, o, seed=1) for o in (options, without))
    assert refined.history["d_pen"].mean() < 0.7 * sampled.history["d_pen"].mean()
