import math

import numpy as np
import pytest
from PIL import Image, ImageDraw

from neoworld_mjx.estimate.image.lines import line_segments

SIZE = (240, 320)


def drawn(*lines, noise=0.0, finer=8, ink=(200, 60, 50)):
    """Fill half planes' borders: bands 20 px wide between two points each."""
    image = Image.new("RGB", (SIZE[1] * finer, SIZE[0] * finer), (90, 90, 90))
    draw = ImageDraw.Draw(image)
    for (x0, y0), (x1, y1) in lines:
        corners = [(x0, y0), (x1, y1), (x1 + 20, y1), (x0 + 20, y0)]
        draw.polygon([(finer * x, finer * y) for x, y in corners], fill=ink)
    pixels = np.array(image.resize((SIZE[1], SIZE[0]), Image.Resampling.BOX), float)
    pixels += noise * np.random.default_rng(0).normal(size=pixels.shape)
    return np.clip(np.rint(pixels), 0, 255).astype(np.uint8)


def upright(reach=15.0):
    return np.broadcast_to([0.0, 1.0], (*SIZE, 2)).copy(), math.radians(reach)


def degrees(segments):
    return np.degrees(np.arctan2(segments.direction[:, 0], segments.direction[:, 1]))


@pytest.mark.parametrize("noise", [0.0, 10.0])
def test_both_edges_of_a_band_are_found_where_they_are(noise):
    found = line_segments(drawn(((100, 40), (112, 200)), noise=noise), *upright())
    assert len(found.length) == 2
    slope = math.degrees(math.atan2(12, 160))
    assert degrees(found) == pytest.approx([slope] * 2, abs=0.3)
    # Of each edge by the row of its middle, as its ends are not sharp.
    right = found.middle[:, 0] - (found.middle[:, 1] - 40) * 12 / 160
    assert sorted(right) == pytest.approx([100, 120], abs=0.15)
    assert found.length == pytest.approx([160] * 2, rel=0.06)
    assert (np.abs(np.radians(degrees(found) - slope)) < 4 * found.sd + 1e-4).all()


def test_edges_that_point_elsewhere_are_not_found():
    rgb = drawn(((60, 120), (160, 60)))
    assert len(line_segments(rgb, *upright()).length) == 0
    along = np.broadcast_to([100.0, -60.0], (*SIZE, 2)).copy()
    assert len(line_segments(rgb, along, math.radians(15)).length) == 2


def test_pieces_of_one_line_are_joined_across_a_gap():
    whole = drawn(((100, 30), (110, 130)), ((112, 150), (118, 210)))
    found = line_segments(whole, *upright())
    assert len(found.length) == 2
    assert found.length == pytest.approx([180] * 2, rel=0.05)
    far = drawn(((100, 10), (101, 30)), ((111, 200), (112, 220)))
    assert len(line_segments(far, *upright()).length) == 4


def test_noise_alone_has_no_lines():
    noise = np.random.default_rng(0).normal(128, 20, (*SIZE, 3))
    found = line_segments(np.clip(noise, 0, 255).astype(np.uint8), *upright())
    assert len(found.length) == 0
    assert found.middle.shape == (0, 2)
