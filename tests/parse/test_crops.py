import io

import numpy as np
from PIL import Image

from neoworld_mjx.parse.crops import MARGIN, MARK, colour_in_box, crops
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
    image = np.array(Image.open(io.BytesIO(found["right"].picture.data)))
    margin, factor = round(MARGIN * 100), 4  # 124 pixels become at least 448.
    assert image.shape == (factor * (100 + 2 * margin), factor * (100 + 2 * margin), 3)
    assert found["right"].window == (400 - margin, 300 - margin, 500 + margin, 400 + margin)
    # The left box ends 20 pixels within the right one.
    left, grey = factor * (margin + 19), image[factor * (margin + 10)]
    assert grey[left : left + factor].min() <= MARK[0] + 8
    assert tuple(image[factor * (margin + 70), factor * (margin + 50)]) == (128, 128, 128)


def test_crops_describe_hidden_and_cut_parts():
    found = crops(answers.photo(), scene())
    assert found["right"].note == ""
    assert "partly hidden by right" in found["left"].note
    assert "lower right" in found["left"].note
    assert "cut off by the picture's left and right and bottom" in found["table"].note
    unsaid = answers.with_node(scene(), "right", occluded=True)
    assert crops(answers.photo(), unsaid)["right"].note == "partly hidden"


def test_colours_leave_out_other_objects():
    rgb = np.full((600, 800, 3), 128, np.uint8)
    rgb[250:350, 200:420] = (200, 20, 20)
    rgb[300:400, 400:500] = (20, 20, 200)
    photo = Photo(rgb, (800, 600), "0" * 64, answers.photo().path)
    tree = scene()
    tree = answers.with_node(tree, "can", box2d=tree.node("right").box2d)
    assert np.allclose(colour_in_box(photo, tree, tree.node("left")), np.array([200, 20, 20]) / 255)
