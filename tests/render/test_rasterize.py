"""Drawn triangles against the ray caster of `render`."""

import numpy as np
import pytest

from neoworld_mjx.render import render
from neoworld_mjx.render.rasterize import WorldMesh, draw_objects, pixels_of
from tests.estimate import desk

ROLLED = desk.CAMERA.model_copy(update={"roll": 0.15})


def overlapping():
    """Three boxes of which each hides a part of the one behind it, and a can between them."""
    return desk.on_desk(
        (desk.block("near", 0.1, 0.2, 0.12, "red"), (-0.25, 0.0), 0.3, {}),
        (desk.can("can", 0.05, 0.2, "blue"), (-0.1, -0.1), 0.0, {}),
        (desk.block("middle", 0.1, 0.2, 0.2, "green"), (-0.05, 0.06), -0.2, {}),
        (desk.block("far", 0.2, 0.5, 0.2, "purple"), (0.2, 0.0), 0.1, {}),
        camera=ROLLED,
    )


@pytest.mark.parametrize("width", [320, 200])
def test_owners_and_depths_are_those_of_the_ray_caster(width):
    scene = overlapping()
    image = render(scene, scene.camera, width=width, supersample=1, floor=False)
    mine = desk.drawn(scene, width)
    assert mine.owner.shape == image.segmentation.shape == (round(0.75 * width), width)
    assert image.names == tuple(item.name for item in scene.objects)
    assert set(np.unique(mine.owner)) == {-1, 0, 1, 2, 3, 4}
    assert np.mean(mine.owner != image.segmentation) < 2e-4
    same = (mine.owner == image.segmentation) & (mine.owner >= 0)
    flat = same & (mine.owner != scene.index("can"))
    assert np.abs(mine.depth[flat] - image.depth[flat]).max() < 1e-5
    # A can is drawn with facets.
    assert np.abs(mine.depth[same] - image.depth[same]).max() < 5e-3
    assert np.isinf(mine.depth[mine.owner < 0]).all()


def triangle(*corners):
    return WorldMesh(np.array(corners, float), np.array([[0, 1, 2]]))


def test_both_sides_of_a_triangle_are_visible_and_none_behind_the_camera():
    camera = desk.CAMERA.model_copy(update={"pitch": 0.0, "height": 0.0})
    ahead = triangle((1, -0.2, -0.2), (1, 0.2, -0.2), (1, 0, 0.2))
    turned = triangle((1, 0, 0.2), (1, 0.2, -0.2), (1, -0.2, -0.2))
    behind = triangle((-1, -0.2, -0.2), (-1, 0.2, -0.2), (-1, 0, 0.2))
    through = triangle((1, -0.2, -0.2), (1, 0.2, -0.2), (-1, 0, 0.2))
    first, second = (draw_objects([mesh], camera, 64) for mesh in (ahead, turned))
    # Its share of the image is half of its bounding box's.
    pixels, depth = pixels_of(camera, ahead.vertices, 64)
    area = 0.5 * np.prod(np.ptp(pixels, axis=0))
    assert (first.owner == 0).sum() == pytest.approx(area, rel=0.05)
    assert np.array_equal(first.owner, second.owner)
    assert depth == pytest.approx(1.0) and first.depth[24, 32] == pytest.approx(1.0)
    for hidden in (behind, through):
        assert (draw_objects([hidden], camera, 64).owner == -1).all()
    both = draw_objects([behind, ahead], camera, 64)
    assert np.array_equal(both.owner == 1, first.owner == 0)
