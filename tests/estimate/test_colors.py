"""Color space, color models, and the comparison of two masks by colors."""

import numpy as np
import pytest

from neoworld_mjx.estimate.image.colors import (
    LARGEST,
    LabImage,
    bins_of,
    color_model,
    color_models,
    gain,
    is_supported,
    log_likelihood_ratio,
)
from neoworld_mjx.render.appearance import to_lab

RED, GRAY, BLUE = (200, 30, 30), (128, 128, 128), (30, 40, 200)


def disc(shape, middle, radius):
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    return np.hypot(columns + 0.5 - middle[0], rows + 0.5 - middle[1]) <= radius


def picture(shape, ground, *areas):
    image = np.full((*shape, 3), ground, np.uint8)
    for mask, color in areas:
        image[mask] = color
    return image


def bin_of(color):
    return int(bins_of(to_lab(np.array([[color]], np.uint8)))[0, 0])


@pytest.mark.parametrize(
    ("rgb", "lab"),
    [
        ((255, 255, 255), (100.0, 0.0, 0.0)),
        ((0, 0, 0), (0.0, 0.0, 0.0)),
        ((255, 0, 0), (53.24, 80.09, 67.20)),
        ((0, 0, 255), (32.30, 79.19, -107.86)),
        ((119, 119, 119), (50.03, 0.0, 0.0)),
    ],
)
def test_known_colors(rgb, lab):
    assert to_lab(np.array([[rgb]], np.uint8))[0, 0] == pytest.approx(lab, abs=0.1)


def test_each_neighbor_has_the_colors_of_its_own_part_of_the_ring():
    owner = np.full((120, 160), 1)
    owner[:, 80:] = 2
    bins = np.where(owner == 1, bin_of(GRAY), bin_of(BLUE))
    owner[disc(owner.shape, (80, 60), 20)] = 0
    behind = color_models(owner, bins, 0, 2).behind
    assert behind[1].argmax() == bin_of(GRAY) and behind[2].argmax() == bin_of(BLUE)


def test_the_inside_model_is_that_of_the_band_near_the_contour():
    """A plate whose middle looks like the table."""
    shape, middle, margin = (240, 320), (160, 120), 3
    plate, inner = disc(shape, middle, 70), disc(shape, middle, 45)
    image = LabImage.of(picture(shape, GRAY, (plate, RED), (inner, GRAY)), 320, 240)
    models = color_models(np.where(plate, 0, -1), image.bins, 0, margin)
    gray, red = bin_of(GRAY), bin_of(RED)
    assert color_model(image.bins[plate])[gray] > 0.05
    assert models.inside[gray] < 1e-6 < 0.15 < models.inside[red]
    assert models.around[red] < 1e-6 < 0.15 < models.around[gray]
    assert log_likelihood_ratio(models.inside, models.background(-1))[red] == LARGEST


def test_gain_prefers_the_mask_that_the_colors_show():
    shape = (240, 320)
    right, wrong = disc(shape, (160, 120), 40), disc(shape, (168, 120), 40)
    bins = LabImage.of(picture(shape, GRAY, (right, RED)), 320, 240).bins
    better = gain(right, wrong, bins)
    # Every pixel that differs counts by at most LARGEST, and its colors are entirely distinct.
    differ = (right != wrong).sum()
    assert 0.9 * LARGEST * differ < better <= LARGEST * differ
    assert gain(wrong, right, bins) == pytest.approx(-better)
    assert gain(right, right, bins) is None


def test_gain_without_evidence():
    shape = (240, 320)
    mask, apart = disc(shape, (100, 120), 30), disc(shape, (220, 120), 30)
    bins = LabImage.of(picture(shape, GRAY, (mask, RED)), 320, 240).bins
    assert gain(mask, apart, bins) == -np.inf
    assert gain(apart, mask, bins) == -np.inf
    none = np.zeros(shape, bool)
    assert gain(none, none, bins) is None
    nearly = mask.copy()
    nearly[110:130, 75] = False
    # Less than half a pixel along the outline is no difference.
    assert 0 < (nearly != mask).sum() < 0.5 * 2 * 30
    assert gain(nearly, mask, bins) is None
    # The same pixels count if there are more.
    nearly[90:150, 70:80] = False
    assert gain(nearly, mask, bins) < -100
    # One color on all sides.
    plain = np.full(shape, bin_of(GRAY))
    assert gain(mask, disc(shape, (110, 120), 30), plain) == pytest.approx(0.0, abs=1e-6)
    assert not is_supported(mask, disc(shape, (110, 120), 30), plain)
