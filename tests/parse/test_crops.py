import io

import numpy as np
from PIL import Image

from neoworld_mjx.parse import crops
from neoworld_mjx.parse.crops import MARGIN, MARK
from neoworld_mjx.parse.photo import Photo
from neoworld_mjx.spec import Box2D
from tests.support import answers


def scene():
    """Two boxes in the picture that overlap, the first one behind."""
    tree = answers.exact()
    tree = answers.with_node(tree, "right", box2d=Box2D(x0=400, y0=300, x1=500, y1=400))
    return answers.with_node(
        tree,
        "left",
        box2d=Box2D(x0=200, y0=250, x1=420, y1=350),
        occluded=True,
        occluded_by=("right",),
    )


def test_crops_have_a_margin_and_mark_neighbours():
    found = crops(answers.photo(), scene())
    assert set(found) == {"table", "left", "right", "can"}
    image = np.array(Image.open(io.BytesIO(found["right"].data)))
    margin = round(MARGIN * 100)
    assert image.shape == (100 + 2 * margin, 100 + 2 * margin, 3)
    # The left box ends 20 pixels within the right one.
    assert tuple(image[margin + 10, margin + 19]) == MARK
    assert tuple(image[margin + 70, margin + 50]) == (128, 128, 128)


def test_what_a_crop_does_not_show_is_said():
    found = crops(answers.photo(), scene())
    assert found["right"].note == ""
    assert "partly hidden by right" in found["left"].note
    assert "lower right" in found["left"].note
    assert "cut off by the picture's left and right and bottom" in found["table"].note
    unsaid = answers.with_node(scene(), "right", occluded=True)
    assert crops(answers.photo(), unsaid)["right"].note == "partly hidden"


def test_colours_are_those_of_the_thing_alone():
    rgb = np.full((600, 800, 3), 128, np.uint8)
    rgb[250:350, 200:420] = (200, 20, 20)
    rgb[300:400, 400:500] = (20, 20, 200)
    photo = Photo(rgb, (800, 600), "0" * 64, answers.photo().path)
    tree = scene()
    found = crops(photo, answers.with_node(tree, "can", box2d=tree.node("right").box2d))
    assert np.allclose(found["left"].colour, np.array([200, 20, 20]) / 255)


def test_crops_of_a_shrunk_photo_are_cut_from_what_is_shown():
    small = answers.photo((400, 300), original=(800, 600))
    image = np.array(Image.open(io.BytesIO(crops(small, scene())["right"].data)))
    assert image.shape[:2] == (50 + 2 * 8, 50 + 2 * 8)
