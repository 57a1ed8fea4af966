"""Color space, color models, and the comparison of two masks by colors."""

import numpy as np
import pytest

from neoworld_mjx.align.colors import (
    BINS,
    LARGEST,
    LabImage,
    around,
    bins_of,
    color_model,
    color_models,
    gain,
    is_supported,
    log_likelihood_ratio,
    shown_at,
    to_lab,
)
from neoworld_mjx.align.rasterize import draw_objects
from tests.align import desk

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


def test_bins_are_valid_and_of_similar_colors():
    rng = np.random.default_rng(0)
    colors = rng.integers(0, 256, (50, 50, 3), dtype=np.uint8)
    bins = bins_of(to_lab(colors))
    assert bins.min() >= 0 and bins.max() < BINS**3
    assert len({bin_of(c) for c in (RED, GRAY, BLUE)}) == 3
    # Lightness counts half, so shading changes a bin less than hue does.
    lighter, darker = (bins_of(np.array([[[value, 0.0, 0.0]]])) for value in (51.0, 57.0))
    assert lighter == darker != bins_of(np.array([[[51.0, 8.0, 0.0]]]))


def test_a_photograph_is_resized():
    left = np.zeros((120, 160), bool)
    left[:, :80] = True
    image = LabImage.of(picture((120, 160), GRAY, (left, RED)), 80, 60)
    assert image.lab.shape == (60, 80, 3)
    assert (image.bins[:, :36] == bin_of(RED)).all() and (image.bins[:, 44:] == bin_of(GRAY)).all()


def test_a_color_model_is_a_smoothed_distribution():
    model = color_model(np.array([bin_of(RED)] * 30 + [bin_of(GRAY)] * 10))
    assert model.sum() == pytest.approx(1.0)
    assert model[bin_of(RED)] == pytest.approx(3 * model[bin_of(GRAY)], rel=1e-6)
    assert model.argmax() == bin_of(RED) and model[bin_of(RED)] < 0.75


def test_the_log_likelihood_ratio_is_bounded_and_antisymmetric():
    rng = np.random.default_rng(1)
    a, b = 10.0 ** rng.uniform(-12, 0, (2, 1000))
    ratio = log_likelihood_ratio(a, b)
    assert np.abs(ratio).max() <= LARGEST and (np.abs(ratio) == LARGEST).any()
    assert ratio == pytest.approx(-log_likelihood_ratio(b, a))
    assert log_likelihood_ratio(a, a) == pytest.approx(0.0)
    free = np.abs(ratio) > 0.1
    assert (np.sign(ratio) == np.sign(a - b))[free].all()


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


def test_the_margin_along_the_contour_is_left_out():
    shape, middle = (240, 320), (160, 120)
    mask = disc(shape, middle, 50)
    rim = disc(shape, middle, 52) & ~disc(shape, middle, 48)
    image = LabImage.of(picture(shape, GRAY, (mask, RED), (rim, BLUE)), 320, 240)
    models = color_models(np.where(mask, 0, -1), image.bins, 0, 3)
    assert models.inside[bin_of(BLUE)] < 1e-6 and models.around[bin_of(BLUE)] < 1e-6
    bare = color_models(np.where(mask, 0, -1), image.bins, 0, 1)
    assert bare.inside[bin_of(BLUE)] > 0.01 and bare.around[bin_of(BLUE)] > 0.005


def test_the_background_depends_on_what_is_behind():
    shape = (240, 320)
    mask = disc(shape, (160, 120), 40)
    owner = np.where(np.arange(320) < 160, 1, -1) * np.ones((240, 1), int)
    image = LabImage.of(picture(shape, GRAY, (owner == 1, BLUE), (mask, RED)), 320, 240)
    models = color_models(np.where(mask, 0, owner), image.bins, 0, 3)
    assert set(models.behind) == {-1, 1}
    blue = bin_of(BLUE)
    assert models.background(1)[blue] == pytest.approx(
        0.5 * (models.behind[1][blue] + models.around[blue])
    )
    assert models.background(1)[blue] > 2.5 * models.background(-1)[blue] > 0
    assert np.array_equal(models.background(7), models.around)


def test_an_object_that_fills_the_picture_has_no_models():
    assert color_models(np.zeros((60, 80), int), np.zeros((60, 80), int), 0, 3) is None


def test_the_ring_around_a_mask():
    mask = disc((200, 200), (100, 100), 40)
    ring = around(mask, 3)
    distance = np.hypot(*(np.mgrid[:200, :200] + 0.5 - 100))[ring]
    assert not (ring & mask).any()
    assert 42.5 < distance.min() < 44.5
    width = 0.25 * np.sqrt(mask.sum())
    assert distance.max() == pytest.approx(43 + width, abs=1.5)


def test_gain_prefers_the_mask_that_the_colors_show():
    shape = (240, 320)
    right, wrong = disc(shape, (160, 120), 40), disc(shape, (168, 120), 40)
    bins = LabImage.of(picture(shape, GRAY, (right, RED)), 320, 240).bins
    better = gain(right, wrong, bins)
    # Every pixel that differs counts by at most LARGEST, and its colors are entirely distinct.
    differ = (right != wrong).sum()
    assert 0.9 * LARGEST * differ < better <= LARGEST * differ
    assert gain(wrong, right, bins) == pytest.approx(-better)
    assert gain(right, right, bins) == 0.0


def test_gain_without_evidence():
    shape = (240, 320)
    mask, apart = disc(shape, (100, 120), 30), disc(shape, (220, 120), 30)
    bins = LabImage.of(picture(shape, GRAY, (mask, RED)), 320, 240).bins
    assert gain(mask, apart, bins) == -np.inf
    assert gain(apart, mask, bins) == -np.inf
    none = np.zeros(shape, bool)
    assert gain(none, none, bins) == 0.0
    nearly = mask.copy()
    nearly[110:130, 75] = False
    # Less than half a pixel along the outline is no difference.
    assert 0 < (nearly != mask).sum() < 0.5 * 2 * 30
    assert gain(nearly, mask, bins) == 0.0
    # The same pixels count if there are more.
    nearly[90:150, 70:80] = False
    assert gain(nearly, mask, bins) < -100
    # One color on all sides.
    plain = np.full(shape, bin_of(GRAY))
    assert gain(mask, disc(shape, (110, 120), 30), plain) == pytest.approx(0.0, abs=1e-6)
    assert not is_supported(mask, disc(shape, (110, 120), 30), plain)


def test_the_colors_support_the_mask_that_they_show():
    shape = (240, 320)
    right, wrong = disc(shape, (160, 120), 40), disc(shape, (168, 120), 40)
    bins = LabImage.of(picture(shape, GRAY, (right, RED)), 320, 240).bins
    assert is_supported(right, wrong, bins) and not is_supported(wrong, right, bins)
    assert is_supported(wrong, wrong, bins)


def test_many_pixels_with_little_evidence_support_no_mask():
    """Masks differ in two halves; the colors of one are only slightly more those of the object."""
    shape = (240, 320)
    common, ours, other = (np.zeros(shape, bool) for _ in range(3))
    common[100:140, 100:200] = ours[60:100, 100:200] = other[140:180, 100:200] = True
    rng = np.random.default_rng(0)
    bins = np.full(shape, bin_of(GRAY))
    for mask, share in ((common, 1.0), (ours, 0.501), (other, 0.5)):
        count = round(share * mask.sum())
        shown = np.zeros(mask.sum(), bool)
        shown[rng.permutation(mask.sum())[:count]] = True
        bins[mask] = np.where(shown, bin_of(RED), bin_of(GRAY))
    assert gain(common | ours, common | other, bins) > 10
    assert not is_supported(common | ours, common | other, bins)
    bins[ours] = bin_of(RED)
    assert is_supported(common | ours, common | other, bins)


def test_a_mask_at_another_place_is_hidden_by_what_is_in_front():
    scene = desk.on_desk(
        (desk.block("front", 0.1, 0.1, 0.1, "red"), (-0.2, 0.0), 0.0, {}),
        (desk.block("back", 0.1, 0.1, 0.1, "blue"), (0.1, 0.2), 0.0, {}),
    )
    unknowns = desk.unknowns_of(scene)
    now = unknowns.place(np.zeros((1, unknowns.size)))[0]
    meshes = [unknowns.mesh(now, k) for k in range(3)]
    drawn = draw_objects(meshes, now.camera, 320)
    assert np.array_equal(shown_at(unknowns, now, drawn, 2), drawn.owner == 2)
    x = np.zeros(unknowns.size)
    x[unknowns.columns(2)] = (-0.14, -0.2, 0.0, 0.0)
    there = unknowns.place(x[None])[0]
    mask = shown_at(unknowns, there, drawn, 2)
    alone = draw_objects([unknowns.mesh(there, 2)], now.camera, 320).owner == 0
    assert (mask & (drawn.owner == 1)).sum() == 0 < (alone & (drawn.owner == 1)).sum()
    assert np.array_equal(mask, alone & (drawn.owner != 1))
