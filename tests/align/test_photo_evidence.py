"""S_photo: the pixels' evidence for populations of layouts, and its place in the search."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from neoworld_mjx.align.photo_evidence import photo_evidence, with_photo
from neoworld_mjx.config import CEMOptions, RefineOptions, RewardOptions, RolloutOptions
from neoworld_mjx.errors import ConfigError
from neoworld_mjx.mllm import Picture
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.refinement import refine
from neoworld_mjx.refinement.rewards import photo_agreement, s_photo
from tests.align import desk
from tests.support.scenes import compile_scene

SHIFTS = (0.0, 0.006, 0.012, 0.024)
SMALL = RefineOptions(
    cem=CEMOptions(population=8, iterations=1),
    reward=RewardOptions(terms={"s_photo": 1.0}),
    rollout=RolloutOptions(samples_per_object=32),
)


@pytest.fixture(scope="module")
def model(five, photo):
    return with_photo(compile_scene(five), photo)


def shifted(scene, axis):
    """Candidates with all objects shifted along an axis by SHIFTS."""
    zero = Layout.zero(len(SHIFTS), len(scene.objects))
    xy = np.zeros(zero.xy.shape, np.float32)
    xy[:, 1:, axis] = np.array(SHIFTS)[:, None]
    return Layout(jnp.asarray(xy), zero.yaw, zero.log_scale)


by_object = eqx.filter_jit(lambda scene, layouts: photo_agreement(scene, layouts).by_object)


def test_without_a_photograph_it_is_zero(five):
    model = compile_scene(five)
    assert np.asarray(s_photo(model, shifted(five, 0))) == pytest.approx(0.0)


@pytest.mark.parametrize("axis", [0, 1])
def test_it_falls_as_objects_leave_their_pixels(five, model, axis):
    value = np.asarray(s_photo(model, shifted(five, axis)))
    assert value[0] > 0.85
    assert (np.diff(value) < 0).all()
    assert value[0] - value[-1] > 0.15


def test_only_the_moved_object_loses(five, model):
    zero = Layout.zero(2, len(five.objects))
    xy = np.zeros(zero.xy.shape, np.float32)
    xy[1, five.index("can"), 1] = 0.03
    layouts = Layout(jnp.asarray(xy), zero.yaw, zero.log_scale)
    each = by_object(model, layouts)
    lost = np.asarray(each[0] - each[1])
    assert lost[five.index("can")] > 0.05
    assert np.delete(lost, five.index("can")) == pytest.approx(0.0, abs=0.01)


def test_the_sum_over_cells_is_that_over_pixels(five, photo, model):
    """The cells of a candidate at the composed scene add up to the pixels' mean sign."""
    evidence, window = photo_evidence(five, photo)
    owner = desk.drawn(five, 640).owner
    zero = Layout.zero(1, len(five.objects))
    each = np.asarray(by_object(model, zero))[0] * (len(five.objects) - 1)
    for k in range(1, len(five.objects)):
        rows, columns = np.nonzero(owner == k)
        low, high = window[k, :2], window[k, 2:]
        at = np.stack([columns + 0.5, rows + 0.5], axis=1) - [320, 240]
        cell = ((at - low) / (high - low) * evidence.shape[1]).astype(int)
        # 24 rays along an object sample its pixels.
        assert each[k] == pytest.approx(evidence[k][cell[:, 1], cell[:, 0]].sum(), abs=0.05)


def test_silent_pixels_are_zero(five):
    clear = desk.on_desk(
        (desk.block("glass", 0.1, 0.08, 0.09, "clear"), (-0.05, 0.18), 0.3, {}),
        (desk.block("same", 0.1, 0.08, 0.09, "gray"), (-0.05, -0.1), 0.3, {}),
        (desk.block("box", 0.1, 0.08, 0.09, "red"), (0.1, 0.0), 0.3, {}),
    )
    gray = np.full((480, 640, 3), 128, np.uint8)
    red = desk.drawn(clear, 640).owner == clear.index("box")
    gray[red] = (200, 20, 20)
    evidence, _ = photo_evidence(clear, gray)
    assert [bool(e.any()) for e in evidence] == [False, False, False, True]


def test_the_search_needs_the_photograph(five):
    with pytest.raises(ConfigError, match=r"s_photo needs the photograph"):
        refine(five, SMALL)


def test_the_search_records_it(five, photo):
    result = refine(five, SMALL, photo=Picture.of("photo", photo))
    initial, drawn = np.asarray(result.history["s_photo"])
    assert initial[0] > 0.85
    assert np.isfinite(drawn).all()
    assert (drawn < initial[0]).all()
