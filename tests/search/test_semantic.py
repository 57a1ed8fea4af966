"""S_sem: the truth scores highest, and rotations of round objects count nothing."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.physics.scene_arrays import pad_scene
from neoworld_mjx.physics.visibility import visibility
from neoworld_mjx.search.semantic import semantic_score
from tests.support import scenes
from tests.support.scenes import compile_scene, stored_scene
from tests.support.visible import as_parsed

DRAWS = 64


@eqx.filter_jit
def scored(scene, layouts):
    apart = jnp.zeros((*layouts.yaw.shape, layouts.yaw.shape[1]))
    return semantic_score(scene, apart, visibility(scene, scene.place(layouts)))


def displaced(scene, draws, number, *, yaw=0.0):
    """Move one object of every candidate but the first by 1 to 5 cm."""
    rng = np.random.default_rng(number)
    objects = np.flatnonzero(np.asarray(scene.photo.scored))
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
    total = np.asarray(semantic)
    assert total[0] > 0.98
    assert np.mean(total[0] > total[1:]) > 0.98
    assert np.all((total >= 0) & (total <= 1))
    # A piecewise constant score would give many ties.
    assert len(np.unique(total)) > 0.9 * DRAWS


LEFT, RIGHT = (-50.0, -10.0, -30.0, 10.0), (20.0, -10.0, 60.0, 30.0)
"""Boxes [px] of 20 x 20 around (-40, 0) and 40 x 40 around (40, 10)."""


@pytest.fixture(scope="module")
def two_blocks():
    rows = [
        (scenes.block(name, (0.1, 0.1, 0.1)), (x, 0.0), 0.0, {})
        for name, x in (("left", -0.1), ("right", 0.1))
    ]
    return compile_scene(scenes.on_table(*rows), samples=16)


def semantic_of(
    scene,
    *,
    boxes=(LEFT, RIGHT),
    seen=None,
    depth=(2.0, 3.0),
    far=None,
    overlap=0.0,
    cut=(0.0, 0.0),
    judged=(False, True, True),
):
    """Score two blocks with parsed boxes and depths that are seen otherwise.

    `cut` is what the picture's border or others hide of the left side of each [px].
    """
    f32 = lambda *rows: jnp.asarray(rows, jnp.float32)
    ground = (-300.0, -200.0, 300.0, 200.0)
    photo = scene.photo._replace(
        boxes=f32(ground, *boxes),
        depth=f32(9.0, *depth),
        parsed=np.ones(3, bool),
        fully_visible=np.ones(3, bool),
        scored=np.array(judged),
    )
    seen_photo = photo._replace(
        boxes=f32(ground, *(seen or boxes)), depth=f32(9.0, *(far or depth))
    )
    scene = eqx.tree_at(lambda s: s.photo, scene, photo)
    penetration = jnp.zeros((1, 3, 3)).at[0, 1, 2].set(overlap)
    visible = as_parsed(seen_photo, 1)
    whole = visible.outlines.boxes - f32((0.0, 0.0, 0.0, 0.0), *((c, 0.0, 0.0, 0.0) for c in cut))
    visible = eqx.tree_at(lambda v: v.outlines.boxes, visible, whole)
    return semantic_score(scene, penetration, visible)


def total_of(scene, **given):
    return float(semantic_of(scene, **given)[0])


def score(error, tolerance):
    return 1 - (np.hypot(error, 0.02) - 0.02) / (np.hypot(tolerance, 0.02) - 0.02)


@pytest.mark.parametrize(("overlap", "lost"), [(0.0, 0.0), (0.004, 0.4), (0.01, 1.0), (0.5, 1.0)])
def test_a_centimetre_of_overlap_costs_a_quarter(two_blocks, overlap, lost):
    assert total_of(two_blocks, overlap=overlap) == pytest.approx(1 - lost / 4, abs=1e-5)


@pytest.mark.parametrize(
    ("depth", "far", "order"),
    [
        # The noise is 2 % of 2.5 m; an order that is wrong by twice that is worth nothing.
        ((2.0, 3.0), (2.0, 3.0), 1.0),
        ((2.0, 3.0), (2.0, 2.0), 1.0),
        ((2.0, 3.0), (2.0, 1.99), 0.9),
        ((2.0, 3.0), (2.0, 1.95), 0.5),
        ((2.0, 3.0), (2.0, 1.85), 0.0),
        ((3.0, 2.0), (2.0, 3.0), 0.0),
        # Parsed depths that are closer than the noise have no order.
        ((2.0, 2.03), (3.0, 2.0), 1.0),
    ],
)
def test_depth_order_counts_an_eighth_outside_the_noise(two_blocks, depth, far, order):
    expected = 1 - (1 - order) / 8
    assert total_of(two_blocks, depth=depth, far=far) == pytest.approx(expected, abs=1e-4)


def test_an_object_that_is_hidden_where_the_photograph_shows_it_whole_loses_an_eighth(two_blocks):
    found = semantic_of(two_blocks, cut=(0.0, 8.0))
    # A side that is 8 px off is 2 px on average, of 40.
    lost = (1 - score(2 / 40, 0.25)) / 2 / 4
    assert lost > 0.01
    assert found[0] == pytest.approx(1.0 - lost / 2, abs=1e-5)


def test_pairs_and_single_objects_are_scored(two_blocks):
    found = semantic_of(two_blocks, overlap=0.004, seen=(LEFT, (18.0, -12.0, 62.0, 32.0)))
    relative, box = score(np.log(44 / 40), 0.4), score(2 / 40, 0.25)
    pair = (0.5 + relative + 0.5 + 0.6) / 4
    expected = pair + (1 + (box + 1) / 2) / 2 / 4
    assert found[0] == pytest.approx(expected, abs=1e-5)


def test_offsets_of_concentric_objects_are_compared_with_their_sizes(two_blocks):
    around = lambda x, side: (x - side / 2, -side / 2, x + side / 2, side / 2)
    boxes, seen = (around(0, 20), around(0, 40)), (around(4, 20), around(0, 40))
    # The larger one is 40 px wide, so 4 px are a fifth of its half; 45 degrees count nothing.
    turn = score(2 * np.arcsin(4 / 20 / 2), np.pi / 4)
    box = score(4 / 2 / 20, 0.25)
    expected = (0.5 + 1 + turn / 2 + 1) / 4 + ((box + 1) / 2 + 1) / 2 / 4
    assert total_of(two_blocks, boxes=boxes, seen=seen) == pytest.approx(expected, abs=1e-5)
