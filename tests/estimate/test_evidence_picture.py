"""The picture of the pixels' evidence, of a desk that is right and of one with a displaced can."""

import numpy as np
import pytest

from neoworld_mjx.view.outline_pictures import WIDTH_PX, evidence_picture
from tests.estimate import desk


@pytest.fixture(scope="module")
def photo():
    return desk.photograph(desk.five(), WIDTH_PX)


def shares(picture, mask):
    """Shares of a mask's pixels that are green, red and blue."""
    red, green, blue = picture[mask].astype(int).T
    strong = 40
    return (
        np.mean(green > np.maximum(red, blue) + strong),
        np.mean(red > np.maximum(green, blue) + strong),
        np.mean(blue > np.maximum(red, green) + strong),
    )


def test_right_objects_are_green_and_the_desk_is_gray(photo):
    scene = desk.five()
    picture = evidence_picture(scene, photo)
    owner = desk.drawn(scene, WIDTH_PX).owner
    assert picture.shape == (WIDTH_PX * 3 // 4, WIDTH_PX, 3) and picture.dtype == np.uint8
    for name in ("box", "can", "brick", "ball", "tower"):
        green, red, _ = shares(picture, owner == scene.index(name))
        assert green > 0.9 and red < 0.05, name
    table = owner == scene.index("desk")
    assert max(shares(picture, table)) < 0.03
    flat = picture[table].astype(int)
    assert np.quantile(np.ptp(flat, axis=1), 0.9) <= 3
