"""Residuals of depth and overlaps of masks, of a desk that is right and of one with a moved can."""

import numpy as np
import pytest

from neoworld_mjx.evidence.depth_image import DepthImage
from neoworld_mjx.evidence.masks import Masks
from neoworld_mjx.view.evidence_pictures import (
    WIDTH_PX,
    depth_picture,
    depth_residuals,
    mask_overlaps,
)
from tests.estimate import desk

AWAY_MM = 30.0


@pytest.fixture(scope="module")
def measured(five):
    """Exact depths of the desk; none in the upper left corner."""
    depth = desk.drawn(five, WIDTH_PX).depth.copy()
    depth[~np.isfinite(depth)] = np.nan
    depth[:160, :120] = np.nan
    return DepthImage(depth)


@pytest.fixture(scope="module")
def moved(five):
    return desk.displaced(five, can=(AWAY_MM, 0, 0, 0))


def side_of(scene, name):
    """Pixels in the middle of an object."""
    rows, columns = np.nonzero(desk.drawn(scene, WIDTH_PX).owner == scene.index(name))
    row, column = int(np.median(rows)), int(np.median(columns))
    return np.s_[row - 3 : row + 4, column - 3 : column + 4]


def test_residual_is_rendered_minus_measured_distance_along_the_ray(five, measured, moved):
    drawn = desk.drawn(moved, WIDTH_PX)
    can = side_of(moved, "can")
    residual = depth_residuals(measured, drawn, moved)
    depth_off = (drawn.depth - measured.values)[can]
    assert (residual[can] > depth_off).all() and residual[can].mean() > 0.02
    box = depth_residuals(measured, desk.drawn(five, WIDTH_PX), five)[side_of(five, "box")]
    assert np.abs(box).max() < 1e-9
    inverse = DepthImage((1 / measured.values - 0.3) * 100, "disparity")
    affine = depth_residuals(inverse, drawn, moved)[can]
    assert affine.mean() == pytest.approx(residual[can].mean(), abs=0.002)


def test_picture_colors_what_is_farther_and_nearer_and_leaves_the_rest_gray(
    five, photo, measured, moved
):
    picture = depth_picture(moved, measured, photo).astype(int)
    red, _, blue = picture[side_of(moved, "can")].reshape(-1, 3).T
    assert (red > blue + 100).all()
    near = desk.displaced(five, can=(-AWAY_MM, 0, 0, 0))
    red, _, blue = depth_picture(near, measured, photo).astype(int)[side_of(near, "can")].T
    assert (blue > red + 100).all()
    assert picture[side_of(five, "box")].min() > 240
    corner = picture[:160, :120].reshape(-1, 3)
    assert np.ptp(corner, axis=1).max() == 0 and corner.max() < 180
    legend = picture[480:]
    assert len(legend) and (legend[:, 0, 2] > legend[:, 0, 0]).all()
    nothing = DepthImage(np.full((48, 64), np.nan), "affine")
    assert np.ptp(depth_picture(moved, nothing, photo)[:480].astype(int), axis=2).max() == 0


def test_overlap_of_a_mask_falls_with_the_displacement(five):
    owner = desk.drawn(five, WIDTH_PX).owner
    names = {"can": five.index("can"), "box": five.index("box")}
    masks = Masks(np.where(owner > 0, owner, 0), names)
    assert mask_overlaps(five, masks) == {"box": 1.0, "can": 1.0}
    aside = mask_overlaps(desk.displaced(five, can=(0, 40, 0, 0)), masks)
    assert aside["box"] > 0.99 and 0.2 < aside["can"] < 0.7
