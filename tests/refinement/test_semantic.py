"""S_sem: the truth scores highest, and rotations of round objects count nothing."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.physics.model import compile_scene
from neoworld_mjx.physics.scene_arrays import pad_scene
from neoworld_mjx.physics.visibility import visibility
from neoworld_mjx.refinement.semantic import semantic_score
from neoworld_mjx.spec import Box2D
from tests.support.scenes import stored_scene

DRAWS = 64


@eqx.filter_jit
def scored(scene, layouts):
    apart = jnp.zeros((*layouts.yaw.shape, layouts.yaw.shape[1]))
    return semantic_score(scene, apart, visibility(scene, scene.place(layouts)))


def displaced(scene, draws, number, *, yaw=0.0):
    """Move one object of every candidate but the first by 1 to 5 cm."""
    rng = np.random.default_rng(number)
    objects = np.flatnonzero(np.asarray(scene.photo.judged))
    who = rng.choice(objects, draws)
    angle, far = rng.uniform(0, 2 * np.pi, draws), rng.uniform(0.01, 0.05, draws)
    xy, turn = np.zeros((draws, scene.count, 2)), np.zeros((draws, scene.count))
    rows = np.arange(1, draws)
    xy[rows, who[1:]] = np.column_stack([far * np.cos(angle), far * np.sin(angle)])[1:]
    upright = np.asarray(scene.arrangement.tilt)[:, 0] > 0.999
    turn[1:] = yaw * (np.asarray(scene.round) & upright)
    f32 = lambda x: jnp.asarray(x, jnp.float32)
    return Layout(f32(xy), f32(turn), jnp.zeros((draws, scene.count)))


@pytest.fixture(scope="module", params=["photo_1", "photo_12"])
def photographed(request):
    spec = stored_scene(request.param)
    return spec, pad_scene(compile_scene(spec, samples=64))


def test_the_ground_truth_scores_highest(photographed):
    spec, scene = photographed
    assert any(item.occluded for item in spec.objects)
    semantic = scored(scene, displaced(scene, DRAWS, 1))
    total, each = np.asarray(semantic.total), np.asarray(semantic.each)
    assert total[0] > 0.98
    assert np.mean(total[0] > total[1:]) > 0.98
    assert np.all((total >= 0) & (total <= 1)) and np.all((each >= 0) & (each <= 1 + 1e-6))
    # A piecewise constant score would give many ties.
    assert len(np.unique(total)) > 0.9 * DRAWS


def test_rotation_of_round_objects_does_not_change_the_score(photographed):
    _, scene = photographed
    layouts = displaced(scene, DRAWS, 2, yaw=0.7)
    layouts = eqx.tree_at(lambda z: z.xy, layouts, jnp.zeros_like(layouts.xy))
    assert np.asarray(scene.round).sum() >= 2
    semantic = scored(scene, layouts)
    # An object on a round one rotates with it, here about its axis.
    np.testing.assert_allclose(semantic.total[1:], semantic.total[0], atol=2e-3)


def test_a_box_at_the_image_border_is_cut():
    spec = stored_scene("photo_1")
    item = spec.objects[1]
    box = item.box2d.as_tuple()
    cut = item.model_copy(update={"box2d": Box2D(x0=0.0, y0=box[1], x1=box[2], y1=box[3])})
    objects = tuple(cut if o.name == item.name else o for o in spec.objects)
    scene = compile_scene(spec.model_copy(update={"objects": objects}), samples=16)
    assert not np.asarray(scene.photo.whole)[1]
