"""Plain pictures show the same objects in the same places as the full ones."""

import numpy as np

from neoworld_mjx.render import render_plain, render_scene
from tests.support import scenes


def test_flat_rendering_shows_the_objects_of_full_rendering():
    scene = scenes.furnished()
    plain = render_plain(scene, scene.camera, width=120)
    full = render_scene(scene, width=120, supersample=1)
    assert plain.shape == full.color.shape == (80, 120, 3)
    assert plain.dtype == np.uint8
    edge = np.zeros((80, 120), bool)
    edge[:, :-1] |= full.segmentation[:, :-1] != full.segmentation[:, 1:]
    edge[:-1] |= full.segmentation[:-1] != full.segmentation[1:]
    assert edge.sum() > 100
    # Outlines are where objects end, and nowhere else does a flat side change by as much.
    dark = plain.astype(int).sum(axis=2)
    for k in np.unique(full.segmentation):
        own = full.segmentation == k
        assert np.median(dark[own & edge]) < 0.8 * np.median(dark[own & ~edge])


def test_the_same_scene_gives_the_same_bytes():
    scene = scenes.coffee()
    first, second = (render_plain(scene, scene.camera, width=90) for _ in range(2))
    np.testing.assert_array_equal(first, second)
    moved = scene.objects[2].model_copy(update={"xy": (0.03, 0.01)})
    other = scene.model_copy(update={"objects": (*scene.objects[:2], moved, *scene.objects[3:])})
    assert not np.array_equal(first, render_plain(other, scene.camera, width=90))
