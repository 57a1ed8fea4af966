"""Colors near each point of a contour, and what they correct."""

import numpy as np
import pytest

from neoworld_mjx.estimate.image.colors import LabImage, color_models
from neoworld_mjx.estimate.rows.contours import contour, displacements
from neoworld_mjx.render.rasterize import DrawnObjects

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
