"""What the camera sees of a population, against ray-cast pictures."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.physics.scene_arrays import pad_scene
from neoworld_mjx.physics.visibility import visibility
from neoworld_mjx.render import render
from neoworld_mjx.spec import Box, Material
from tests.support import scenes
from tests.support.scenes import compile_scene

see = eqx.filter_jit(lambda scene, layouts: visibility(scene, scene.place(layouts)))


@pytest.fixture(scope="module", params=["photo_0", "photo_5"])
def photographed(request):
    spec = scenes.stored_scene(request.param)
    return spec, pad_scene(compile_scene(spec, samples=64))


@pytest.fixture(scope="module")
def picture(photographed):
    spec, _ = photographed
    return render(spec, spec.camera, width=640, supersample=1, floor=False)


def test_boxes_match_a_rendered_image(photographed, picture):
    spec, scene = photographed
    seen = see(scene, Layout.zero(1, scene.count))
    parsed, boxes = np.asarray(scene.photo.boxes), np.asarray(seen.boxes[0])
    size = parsed[:, 2:] - parsed[:, :2]
    names = picture.names
    pixels = np.array([np.sum(picture.segmentation == names.index(o.name)) for o in spec.objects])
    scored = np.asarray(scene.photo.scored)[: len(pixels)]
    shown = np.flatnonzero(scored & (pixels > 100))
    assert len(shown) >= 5
    error = (np.abs(boxes - parsed) / np.tile(size, 2))[shown]
    # Slivers may lie between the 24 cells along a window.
    assert np.max(error) < 2 / 24 and np.mean(error) < 0.01
    area = np.prod(boxes[:, 2:] - boxes[:, :2], axis=1)
    assert area[: len(pixels)][scored & (pixels == 0)].max(initial=0.0) == 0.0
    assert not area[len(pixels) :].any(), "padding is not seen"


def test_an_occluder_cuts_the_box():
    far = scenes.block("far", (0.1, 0.2, 0.1))
    # Its top is below the camera, not in the camera's plane.
    near = scenes.block("near", (0.02, 0.2, 0.39))
    spec = scenes.on_table((far, (0, 0), 0.0, {}), (near, (-0.2, 0), 0.0, {}))
    scene = compile_scene(spec, samples=64)
    xy = np.zeros((3, 3, 2), np.float32)
    xy[1, 2, 1], xy[2, 2, 1] = 0.08, 5.0
    seen = see(scene, Layout(jnp.asarray(xy), jnp.zeros((3, 3)), jnp.zeros((3, 3))))
    full, half = np.asarray(seen.boxes[2, 1]), np.asarray(seen.boxes[1, 1])
    assert half[0] > full[0] + 0.3 * (full[2] - full[0])
    assert half[2] == pytest.approx(full[2], abs=0.5)
    np.testing.assert_allclose(half[1::2], full[1::2], atol=0.03 * (full[3] - full[1]))


def test_a_pane_of_glass_is_visible_but_occludes_nothing():
    clear = Material(name="pane", density=2500, rgba=(0.8, 0.9, 0.9, 0.3))
    shown = {}
    for kind, material in (("clear", clear), ("opaque", scenes.CERAMIC)):
        far = scenes.block("far", (0.1, 0.2, 0.1))
        near = scenes.single("near", (Box(size=(0.02, 0.2, 0.4)), (0, 0, 0)), material=material)
        spec = scenes.on_table((far, (0, 0), 0.0, {}), (near, (-0.2, 0), 0.0, {}))
        scene = pad_scene(compile_scene(spec, samples=64))
        seen = see(scene, Layout.zero(1, scene.count))
        far_box, near_box = np.asarray(seen.boxes[0])[1:3]
        assert np.prod(near_box[2:] - near_box[:2]) > 1000
        shown[kind] = far_box
        whole = np.asarray(seen.outlines.boxes[0])[1]
    np.testing.assert_allclose(shown["clear"], whole, atol=1e-3)
    height = lambda box: box[3] - box[1]
    assert height(shown["opaque"]) < 0.9 * height(whole)
