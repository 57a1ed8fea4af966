"""Colors near each point of a contour, and what they correct."""

import numpy as np
import pytest

from neoworld_mjx.align.colors import LabImage, color_models, local_colors, to_lab
from neoworld_mjx.align.contours import contour, displacements
from neoworld_mjx.align.rasterize import DrawnObjects

SHAPE = (200, 320)
LID_TOP, LID_BOTTOM, FOOT = 60, 78, 150
CANS = ((30, 85), (120, 175), (210, 265))
"""Columns of three cans; the second one is measured."""
WALL, SILVER, GREEN = ((200.0, 204.0, 194.0), (184.0, 188.0, 200.0), (45.0, 110.0, 60.0))


def photo_of_cans():
    """Green cans with silver lids before a wall of almost the same color, with noise."""
    image = np.tile(WALL, (*SHAPE, 1))
    for start, stop in CANS:
        image[LID_TOP:LID_BOTTOM, start:stop] = SILVER
        image[LID_BOTTOM:FOOT, start:stop] = GREEN
    image += np.random.default_rng(0).normal(0, 2, image.shape)
    return np.clip(image + 0.5, 0, 255).astype(np.uint8)


def drawn_can(lower=0):
    """The second can, drawn `lower` by a number of pixels; the layout lacks the other two."""
    mask = np.zeros(SHAPE, bool)
    start, stop = CANS[1]
    mask[LID_TOP + lower : FOOT + lower, start:stop] = True
    return DrawnObjects(np.where(mask, 0, -1), np.where(mask, 1.0, np.inf))


def displaced(drawn, *, local):
    image = LabImage.of(photo_of_cans(), SHAPE[1], SHAPE[0])
    models = color_models(drawn.owner, image.bins, 0, 3)
    points = contour(drawn, 0)
    moved = displacements(
        image.lab,
        points,
        models,
        reach=6.0,
        step=0.5,
        noise=0.7,
        unit=1.0,
        mask=drawn.owner == 0 if local else None,
    )
    return points, moved


def top_edge(points):
    return points.normal[:, 1] < -0.99


@pytest.mark.parametrize("lower", [0, 2, -2])
def test_local_colors_find_the_edge_of_a_lid_that_looks_like_its_surroundings(lower):
    points, moved = displaced(drawn_can(lower), local=True)
    at_top = top_edge(points)
    assert at_top.sum() > 20
    assert np.abs(moved.value[at_top] - lower).mean() < 0.3
    plain = displaced(drawn_can(lower), local=False)[1]
    assert np.abs(plain.value[at_top] - lower).mean() > 1.0


def test_elsewhere_local_colors_agree_with_those_of_the_whole_object():
    points, moved = displaced(drawn_can(2), local=True)
    plain = displaced(drawn_can(2), local=False)[1]
    sides = (np.abs(points.normal[:, 0]) > 0.99) & (points.pixel[:, 1] > LID_BOTTOM + 12)
    assert sides.sum() > 50
    assert moved.value[sides] == pytest.approx(plain.value[sides], abs=0.3)


def local_at(points, lab, mask, colors):
    return local_colors(lab, mask, points.pixel, points.normal, colors, 1.0)


def test_colors_are_probable_on_the_side_that_shows_them():
    drawn = drawn_can()
    lab = to_lab(photo_of_cans())
    points = contour(drawn, 0)
    colors = np.tile(to_lab(np.array([WALL, SILVER, GREEN])), (len(points.pixel), 1, 1))
    near = local_at(points, lab, drawn.owner == 0, colors)
    top = top_edge(points)
    wall, silver, green = near.inside[top].mean(axis=0)
    assert silver > 10 * max(wall, green)
    wall, silver, green = near.outside[top].mean(axis=0)
    assert wall > 10 * max(silver, green)
    assert near.known.all()


def test_densities_integrate_to_one():
    """Samples of one color: the probability is that of a Gaussian around it."""
    drawn = drawn_can()
    lab = np.tile([50.0, 0.0, 0.0], (*SHAPE, 1))
    points = contour(drawn, 0)
    rng = np.random.default_rng(1)
    half = 15.0
    colors = np.array([50.0, 0.0, 0.0]) + rng.uniform(-half, half, (len(points.pixel), 400, 3))
    near = local_at(points, lab, drawn.owner == 0, colors)
    bin_volume = 100 / 12 * (160 / 24) ** 2
    assert near.inside.mean() * (2 * half) ** 3 / bin_volume == pytest.approx(1.0, rel=0.05)


def test_local_colors_are_unknown_where_an_object_is_thin():
    mask = np.zeros(SHAPE, bool)
    mask[100:103, 60:260] = True
    drawn = DrawnObjects(np.where(mask, 0, -1), np.where(mask, 1.0, np.inf))
    points = contour(drawn, 0)
    near = local_at(points, to_lab(photo_of_cans()), mask, np.zeros((len(points.pixel), 1, 3)))
    between_ends = (points.pixel[:, 0] > 80) & (points.pixel[:, 0] < 240)
    assert not near.known[between_ends].any()


def test_samples_beyond_the_picture_are_not_used():
    """The contour follows the border of the picture at a distance of 2 px."""
    mask = np.zeros(SHAPE, bool)
    mask[:, 2:200] = True
    pixel = np.column_stack([np.full(40, 2.0), np.linspace(50, 90, 40)])
    normal = np.tile([-1.0, 0.0], (40, 1))
    colors = np.zeros((40, 1, 3))
    near = local_colors(to_lab(photo_of_cans()), mask, pixel, normal, colors, 1.0)
    assert not near.known.any()
    # On the right side there is room for samples.
    pixel[:, 0] = 200.0
    near = local_colors(to_lab(photo_of_cans()), mask, pixel, -normal, colors, 1.0)
    assert near.known.all()
