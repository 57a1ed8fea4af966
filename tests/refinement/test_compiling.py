"""Which scenes share a compiled one, and which need the photograph."""

import numpy as np
import pytest

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.errors import ConfigError
from neoworld_mjx.refinement.compiling import (
    LEAST_REACH,
    S_PHOTO,
    compile_for_search,
    reach_of,
    with_evidence,
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


def test_the_photograph_is_read_only_by_a_search_that_rates_its_pixels():
    model = compile_for_search(scenes.stored_scene("photo_1"), options())
    photo = np.random.default_rng(0).integers(0, 255, (60, 80, 3), dtype=np.uint8)
    plain, rated = options(), options(reward={"terms": {S_PHOTO: 1.0}})
    assert with_evidence(model, plain, photo) is model
    assert with_evidence(model, plain, None) is model
    with pytest.raises(ConfigError, match="s_photo needs the photograph; pass it as photo"):
        with_evidence(model, rated, None)
    evident = with_evidence(model, rated, photo)
    assert evident is not model and np.any(evident.photo.evidence)
    assert with_evidence(evident, rated, None) is evident, "it has the evidence already"
    other = with_evidence(evident, rated, np.flip(photo, 0))
    assert not np.array_equal(other.photo.evidence, evident.photo.evidence)
