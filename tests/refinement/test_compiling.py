"""Which scenes share a compiled one, and which need the photograph."""

import pytest

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.refinement.compiling import (
    LEAST_REACH,
    compile_for_search,
    reach_of,
)
from tests.support import scenes


def options(sigma_xy=0.05, samples=16, **given):
    return RefineOptions.model_validate(
        {"cem": {"sigma_xy": sigma_xy}, "rollout": {"samples_per_object": samples}, **given}
    )


@pytest.mark.parametrize(
    "sigma_xy, factor", [(0.001, 1), (0.05, 1), (0.0501, 2), (0.1, 2), (0.11, 4), (0.2, 4)]
)
def test_the_reach_doubles_until_it_covers_the_draws(sigma_xy, factor):
    reach = reach_of(options(sigma_xy))
    assert reach == factor * LEAST_REACH
    assert reach >= 0.999 * 6.7 * sigma_xy
    assert factor == 1 or reach / 2 < 6.7 * sigma_xy
    assert pytest.approx(6.7 * RefineOptions().cem.sigma_xy) == LEAST_REACH


def test_a_scene_is_compiled_once_for_all_draws_of_a_reach():
    scene = scenes.blocks()
    model = compile_for_search(scene, options())
    assert compile_for_search(scenes.blocks(), options(0.02)) is model
    assert model.samples.shape[1] == 16 and model.static.mjm.opt.timestep == 0.004
    for other in (options(0.1), options(samples=17)):
        assert compile_for_search(scene, other) is not model
    finer = options(rollout={"samples_per_object": 16, "timestep_s": 0.002})
    assert compile_for_search(scene, finer).static.mjm.opt.timestep == 0.002
