"""Contours, and their displacements in photographs of shifted discs."""

import numpy as np
import pytest

from neoworld_mjx.estimate.image.colors import LabImage, color_models
from neoworld_mjx.estimate.rows.contours import BORDER_PX, contour, displacements
from neoworld_mjx.render.rasterize import DrawnObjects

SHAPE, MIDDLE, RADIUS = (240, 320), np.array([160.0, 120.0]), 50.0
RED, GRAY, BLUE = ((200.0, 30.0, 30.0), (128.0, 128.0, 128.0), (30.0, 40.0, 200.0))


def drawn_disc(middle=MIDDLE, radius=RADIUS):
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]] + 0.5
    mask = np.hypot(columns - middle[0], rows - middle[1]) <= radius
    return DrawnObjects(np.where(mask, 0, -1), np.where(mask, 1.0, np.inf))


def photographed(middle, radius=RADIUS, inner=RED, outer=GRAY):
    """A disc with smooth edges, and noise with a deviation of two levels."""
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]] + 0.5
    share = np.clip(radius - np.hypot(columns - middle[0], rows - middle[1]) + 0.5, 0, 1)
    color = share[..., None] * np.array(inner) + (1 - share[..., None]) * np.array(outer)
    color = color + np.random.default_rng(0).normal(0, 2, color.shape)
    return np.clip(color + 0.5, 0, 255).astype(np.uint8)


def measured(drawn, photo, *, reach=12.0, k=0):
    image = LabImage.of(photo, SHAPE[1], SHAPE[0])
    models = color_models(drawn.owner, image.bins, k, 3)
    points = contour(drawn, k)
    return points, displacements(
        image.lab, points, models, reach=reach, step=0.5, noise=0.7, unit=1.0
    )


def to_circle(points, middle, radius):
    """Distance along the normals to a circle."""
    offset = points.pixel - middle
    along = np.sum(offset * points.normal, axis=1)
    return -along + np.sqrt(along**2 - np.sum(offset**2, axis=1) + radius**2)


def test_the_contour_of_a_disc():
    points = contour(drawn_disc(), 0)
    offset = points.pixel - MIDDLE
    assert np.linalg.norm(offset, axis=1) == pytest.approx(RADIUS, abs=0.8)
    assert np.sum(offset * points.normal, axis=1) / RADIUS == pytest.approx(1.0, abs=0.02)
    assert points.length.sum() == pytest.approx(2 * np.pi * RADIUS, rel=0.02)
    assert (points.behind == -1).all() and (points.depth == 1.0).all()


@pytest.mark.parametrize("shift", [(1, 0), (-3, 0), (0, 3), (3.6, -4.8)])
def test_a_shift_is_found_along_every_normal(shift):
    """By 1, 3 and 6 px."""
    middle = MIDDLE + shift
    points, moved = measured(drawn_disc(), photographed(middle))
    expected = to_circle(points, middle, RADIUS)
    assert np.abs(expected).max() == pytest.approx(np.hypot(*shift), abs=0.8)
    error = moved.value - expected
    assert np.mean(np.abs(error)) < 0.2
    assert np.quantile(np.abs(error), 0.95) < 0.3
    # The shift that fits best, as the normal equations would find it.
    fitted = np.linalg.lstsq(points.normal, moved.value, rcond=None)[0]
    assert fitted == pytest.approx(shift, abs=0.3)
    assert moved.precision.min() > 0.5


@pytest.mark.parametrize("grown", [-6.0, -3.0, 3.0, 6.0])
def test_a_disc_of_another_size_displaces_every_point(grown):
    _, moved = measured(drawn_disc(), photographed(MIDDLE, RADIUS + grown))
    assert np.sign(moved.value) == pytest.approx(np.sign(grown))
    # Color models of a mask that is wrong all around contain the other side's color.
    assert 0.85 * abs(grown) < np.abs(moved.value).mean() < abs(grown) + 0.1


@pytest.mark.parametrize("shift", [3.0, 6.0])
def test_weak_contrast_does_not_pull_to_no_displacement(shift):
    """Two grays of which the camera's noise hides the edge: less precise, but no smaller."""
    strong, weak = (
        measured(drawn_disc(), photographed(MIDDLE + [shift, 0], inner=inner))
        for inner in (RED, (150.0, 150.0, 150.0))
    )
    assert weak[1].precision.mean() < 0.5 * strong[1].precision.mean()
    fitted = np.linalg.lstsq(weak[0].normal, weak[1].value, rcond=None)[0]
    assert 0.98 * shift < fitted[0] < 1.06 * shift


def two(front):
    """A rectangle at columns 100 to 200 whose right part another one, from 160 on, overlaps."""
    owner, depth = np.full(SHAPE, -1), np.full(SHAPE, np.inf)
    owner[60:180, 100:200], depth[60:180, 100:200] = 0, 1.0
    over = np.zeros(SHAPE, bool)
    over[40:200, 160:260] = True
    if not front:
        over &= owner < 0
    owner[over], depth[over] = 1, 0.5 if front else 2.0
    return DrawnObjects(owner, depth)


def test_an_edge_belongs_to_the_object_in_front():
    drawn = two(front=True)
    back, front = contour(drawn, 0), contour(drawn, 1)
    assert back.pixel[:, 0].max() <= 160
    inner = (back.pixel[:, 1] > 65) & (back.pixel[:, 1] < 175)
    assert back.pixel[inner, 0] == pytest.approx(100)
    assert (back.behind == -1).all()
    shared = (front.pixel[:, 0] == 160) & (front.pixel[:, 1] > 62) & (front.pixel[:, 1] < 178)
    assert shared.sum() > 30 and (front.behind[shared] == 0).all()
    assert (front.normal[shared] @ [-1.0, 0.0] > 0.95).all()
    # With the order reversed, the edge at column 200 is that of the first.
    behind = two(front=False)
    edge = contour(behind, 0)
    right = (edge.pixel[:, 0] == 200) & (np.abs(edge.pixel[:, 1] - 120) < 50)
    assert right.sum() > 30 and (edge.behind[right] == 1).all()
    other = contour(behind, 1)
    assert not ((other.pixel[:, 0] < 205) & (np.abs(other.pixel[:, 1] - 120) < 50)).any()


def test_contours_at_the_border_of_the_image_do_not_count():
    cut = contour(drawn_disc(middle=(10.0, 120.0)), 0)
    assert cut.pixel[:, 0].min() > BORDER_PX
    assert cut.length.sum() < 0.7 * 2 * np.pi * RADIUS
    owner = np.zeros(SHAPE, int)
    assert contour(DrawnObjects(owner, np.ones(SHAPE)), 0) is None
