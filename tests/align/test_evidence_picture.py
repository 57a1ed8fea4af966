"""The picture of the pixels' evidence, of a desk that is right and of one with a displaced can."""

import numpy as np
import pytest

from neoworld_mjx.align.outlines import WIDTH_PX, evidence_picture
from tests.align import desk


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


def test_a_displaced_object_is_green_only_where_it_is_in_the_photograph(photo):
    right = desk.five()
    can = right.index("can")
    moved = [
        o.model_copy(update={"xy": (o.xy[0], o.xy[1] + 0.04)}) if o.name == "can" else o
        for o in right.objects
    ]
    scene = right.model_copy(update={"objects": tuple(moved)})
    picture = evidence_picture(scene, photo)
    true, wrong = (desk.drawn(s, WIDTH_PX).owner == can for s in (right, scene))
    green, red, _ = np.array([shares(picture, m) for m in (true & wrong, wrong & ~true)]).T
    # The desk's colors are now among those of the can.
    assert 0.5 < green[0] < 0.9
    assert green[1] < 0.05
    assert red[0] < 0.05
    assert shares(picture, wrong)[0] < 0.6
