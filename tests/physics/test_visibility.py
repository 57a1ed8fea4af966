"""What the camera sees of a population, against ray-cast pictures."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from neoworld_kernels.first_hits import Rays, first_hits

from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.physics.sampling import is_round
from neoworld_mjx.physics.scene_arrays import pad_scene
from neoworld_mjx.physics.visibility import (
    WINDOW_TILE,
    _in_camera_frame,
    _rows_in_window,
    visibility,
)
from neoworld_mjx.render import render
from neoworld_mjx.spec import Box, Cylinder, Material, SceneObject
from tests.support import scenes
from tests.support.scenes import compile_scene

see = eqx.filter_jit(lambda scene, layouts: visibility(scene, scene.place(layouts)))
CELLS = {"columns": 64, "rows": 48}


@pytest.fixture(scope="module", params=["photo_0", "photo_5"])
def photographed(request):
    spec = scenes.stored_scene(request.param)
    return spec, pad_scene(compile_scene(spec, samples=64))


@pytest.fixture(scope="module")
def picture(photographed):
    spec, _ = photographed
    return render(spec, spec.camera, width=640, supersample=1, floor=False)


def raster(scene, poses, columns, rows):
    """Return the object that is visible in each cell of the image, and its depth [m].

    The whole image is a single window. Environment supports count as objects. If a cell shows no
    object, the object is -1 and the depth is inf. `columns` and `rows` must be multiples of
    WINDOW_TILE.
    """
    camera_scene = _in_camera_frame(scene, poses)
    half = scene.photo.half_size / scene.photo.focal
    pop = poses.scale.shape[0]
    row, column = np.mgrid[:rows, :columns]

    def slopes(index, number, axis):
        """Return the slopes of the rays through the cells, ordered by tiles."""
        tiles = index.reshape(rows // WINDOW_TILE, WINDOW_TILE, -1, WINDOW_TILE).swapaxes(1, 2)
        middle = (tiles.reshape(-1, WINDOW_TILE**2) + 0.5) / number * 2 - 1
        return jnp.repeat(middle[..., None] * half[axis], pop, axis=-1)

    window = jnp.repeat(jnp.concatenate([-half, half])[:, None], pop, axis=1)
    rays = Rays(slopes(column, columns, 0), slopes(row, rows, 1))
    near = _rows_in_window(camera_scene, window, 0.0)
    layer = jnp.arange(scene.count, dtype=jnp.int32)
    hits = first_hits(camera_scene.placed, camera_scene.families, near, rays, layer, scene.count)
    nearest = jnp.max(hits, axis=0)
    owner = jnp.where(nearest > 0, jnp.argmax(hits, axis=0).astype(jnp.int32), -1)
    unfold = lambda v: (
        jnp.moveaxis(v, -1, 0)
        .reshape(pop, rows // WINDOW_TILE, columns // WINDOW_TILE, WINDOW_TILE, WINDOW_TILE)
        .swapaxes(2, 3)
        .reshape(pop, rows, columns)
    )
    depth = jnp.where(owner >= 0, 1.0 / jnp.maximum(nearest, 1e-9), jnp.inf)
    return unfold(owner), unfold(depth)


def test_ids_and_depths_agree_with_the_ray_caster(photographed, picture):
    spec, scene = photographed
    ids, depth = eqx.filter_jit(lambda s, z: raster(s, s.place(z), **CELLS))(
        scene, Layout.zero(1, scene.count)
    )
    order = [spec.index(name) for name in picture.names] + [-1]
    true = np.array(order)[picture.segmentation[5::10, 5::10]]
    # Away from edges: cells all of whose neighbours in the picture show the same object.
    fine = np.array(order)[picture.segmentation]
    block = fine.reshape(48, 10, 64, 10)
    inner = (block == block[:, :1, :, :1]).all(axis=(1, 3))
    same = np.asarray(ids[0]) == true
    assert same[inner].mean() > 0.99
    assert same.mean() > 0.97
    shown = same & inner & (true >= 0)
    assert len(np.unique(true[shown])) >= 5
    near = np.asarray(depth[0])[shown] / picture.depth[5::10, 5::10][shown]
    assert np.percentile(np.abs(near - 1), 95) < 0.01


def test_boxes_and_shares_match_a_rendered_image(photographed, picture):
    spec, scene = photographed
    seen = see(scene, Layout.zero(1, scene.count))
    parsed, judged = np.asarray(scene.photo.boxes), np.asarray(scene.photo.scored)
    size = parsed[:, 2:] - parsed[:, :2]
    share = np.asarray(seen.visible_fraction[0])
    shown = judged & (share > 0.05)
    assert shown.sum() >= 5
    error = np.abs(np.asarray(seen.boxes[0]) - parsed) / np.tile(size, 2)
    # Slivers may lie between the 24 cells along a window.
    assert np.max(error[shown]) < 2 / 24
    assert np.mean(error[shown]) < 0.01
    pixels = [np.sum(picture.segmentation == picture.names.index(o.name)) for o in spec.objects]
    assert share[: len(pixels)][np.array(pixels) == 0].max(initial=0.0) < 0.05
    assert share[np.flatnonzero(~judged)].max() == 0.0
    assert share[shown].min() < 0.8 and share[shown].max() > 0.99


def test_an_occluder_reduces_the_share_and_cuts_the_box():
    far = scenes.single("far", (Box(size=(0.1, 0.2, 0.1)), (0, 0, 0)))
    # Its top is below the camera, not in the camera's plane.
    near = scenes.single("near", (Box(size=(0.02, 0.2, 0.39)), (0, 0, 0)))
    spec = scenes.on_table((far, (0, 0), 0.0, {}), (near, (-0.2, 0), 0.0, {}))
    scene = compile_scene(spec, samples=64)
    xy = np.zeros((3, 3, 2), np.float32)
    xy[1, 2, 1], xy[2, 2, 1] = 0.08, 5.0
    seen = see(scene, Layout(jnp.asarray(xy), jnp.zeros((3, 3)), jnp.zeros((3, 3))))
    share, sides = np.asarray(seen.visible_fraction[:, 1]), np.asarray(seen.unoccluded_sides[:, 1])
    assert share[0] < 0.1 < share[1] < 0.9
    assert share[2] == pytest.approx(1.0, abs=0.01)
    assert sides[2].all() and not sides[1, 0] and sides[1, 2]
    full, half = np.asarray(seen.boxes[2, 1]), np.asarray(seen.boxes[1, 1])
    assert half[0] > full[0] + 0.3 * (full[2] - full[0])
    assert half[2] == pytest.approx(full[2], abs=0.5)
    np.testing.assert_allclose(half[1::2], full[1::2], atol=0.03 * (full[3] - full[1]))


def test_round_objects_are_detected():
    item = lambda *shapes: SceneObject(name="it", spec=scenes.single("it", *shapes))
    can = (Cylinder(radius=0.03, height=0.1), (0, 0, 0))
    assert is_round(item(can))
    assert not is_round(item(can, (Box(size=(0.03, 0.01, 0.04)), (0.04, 0, 0.05))))
    assert not is_round(item((Box(size=(0.05, 0.05, 0.05)), (0, 0, 0))))


def test_a_pane_of_glass_is_visible_but_occludes_nothing():
    clear = Material(name="pane", density=2500, rgba=(0.8, 0.9, 0.9, 0.3))
    shown = {}
    for kind, material in (("clear", clear), ("opaque", scenes.CERAMIC)):
        far = scenes.single("far", (Box(size=(0.1, 0.2, 0.1)), (0, 0, 0)))
        near = scenes.single("near", (Box(size=(0.02, 0.2, 0.4)), (0, 0, 0)), material=material)
        spec = scenes.on_table((far, (0, 0), 0.0, {}), (near, (-0.2, 0), 0.0, {}))
        scene = pad_scene(compile_scene(spec, samples=64))
        seen = see(scene, Layout.zero(1, scene.count))
        shown[kind] = (
            np.asarray(seen.visible_fraction[0])[1:3],
            np.asarray(seen.unoccluded_sides[0])[1],
        )
    (far_share, near_share), sides = shown["clear"]
    assert far_share > 0.99 and near_share > 0.5 and sides.all()
    (far_share, near_share), sides = shown["opaque"]
    assert far_share < 0.5 and near_share > 0.5 and not sides.all()
