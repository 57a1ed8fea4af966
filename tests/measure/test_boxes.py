"""Overlap of boxes and outlines, against areas and volumes known in closed form."""

import math

import numpy as np
import pytest

from neoworld_mjx.measure.boxes import (
    footprint,
    intersection_2d,
    intersection_3d,
    iou_2d,
    support_footprint,
    upright,
)
from neoworld_mjx.spec import Box2D, Box3D, TreeNode
from neoworld_mjx.spec.pose import from_axis_angle
from neoworld_mjx.spec.room import SupportOutline

PIXELS = Box2D(x0=1.0, y0=2.0, x1=4.0, y1=8.0)


def node(box, **fields):
    return TreeNode(name="desk", label="desk", environment=True, box2d=PIXELS, box3d=box, **fields)


@pytest.mark.parametrize(
    "a, b, shared",
    [
        ((0, 0, 2, 3), (1, 1, 5, 5), 2.0),
        ((0, 0, 2, 3), (1, -4, 5, 1), 1.0),
        ((0, 0, 2, 3), (2, 0, 3, 3), 0.0),
        ((0, 0, 2, 3), (3, 4, 5, 6), 0.0),
        ((0, 0, 2, 3), (3, 0, 5, 3), 0.0),
        ((0, 0, 4, 4), (1, 1, 2, 3), 2.0),
    ],
)
def test_the_shared_area_of_boxes_in_pixels(a, b, shared):
    area = lambda box: (box[2] - box[0]) * (box[3] - box[1])
    assert intersection_2d(a, b) == intersection_2d(b, a) == shared
    assert iou_2d(a, b) == pytest.approx(shared / (area(a) + area(b) - shared))


def test_a_supports_outline_is_scaled_and_turned_with_its_box():
    box = Box3D(position=(1.0, 2.0, 0.0), size=(0.4, 0.2, 1.0), yaw=math.pi / 2)
    np.testing.assert_allclose(support_footprint(node(box)), footprint(box))
    points = ((-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5))
    triangle = SupportOutline(shape="polygon", points=points)
    corners = support_footprint(node(box, outline=triangle))
    np.testing.assert_allclose(corners, [[1.1, 1.8], [1.1, 2.2], [0.9, 1.8]])
    round_top = support_footprint(node(box, outline=SupportOutline(shape="round")))
    ellipse = ((round_top - [1.0, 2.0]) / [0.1, 0.2]) ** 2
    np.testing.assert_allclose(ellipse.sum(axis=1), 1.0)
    lying = tuple(from_axis_angle([0, 1, 0], math.pi / 2).tolist())
    tilted = node(box, outline=triangle, base_tilt=lying)
    np.testing.assert_allclose(support_footprint(tilted), footprint(upright(tilted)))


def test_the_shared_volume_of_boxes():
    a = Box3D(position=(0.0, 0.0, 0.0), size=(2.0, 1.0, 3.0))
    above = a.model_copy(update={"position": (1.0, 0.5, 2.0)})
    assert intersection_3d(a, above) == intersection_3d(above, a) == pytest.approx(0.5)
    assert intersection_3d(a, a.model_copy(update={"position": (0.0, 0.0, 3.0)})) == 0.0
    across = a.model_copy(update={"yaw": math.pi / 2, "size": (2.0, 1.0, 1.0)})
    assert intersection_3d(a, across) == pytest.approx(1.0)
    # Two unit squares at 45 degrees share a regular octagon of area 2 (sqrt 2 - 1).
    cube = a.model_copy(update={"size": (1.0, 1.0, 1.0)})
    turned = cube.model_copy(update={"yaw": math.pi / 4})
    assert intersection_3d(cube, turned) == pytest.approx(2 * (math.sqrt(2) - 1))
