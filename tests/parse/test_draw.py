import io

import numpy as np
from PIL import Image

from neoworld_mjx.parse.draw import COLOURS, GREY, draw_parse
from neoworld_mjx.spec import Box2D
from tests.support import answers


def pixels(picture):
    return np.array(Image.open(io.BytesIO(picture.data)))


def test_frames_lie_on_the_boxes_in_the_colour_of_the_support():
    tree = answers.exact()
    image = pixels(draw_parse(answers.photo(), tree))
    assert image.shape == (600, 800, 3)
    for name, colour in [("right", COLOURS[0]), ("can", COLOURS[1])]:
        box = np.rint(tree.node(name).box2d.as_tuple()).astype(int)
        side = image[(box[1] + box[3]) // 2, box[2] - 1]
        assert tuple(side) == colour
    assert tuple(image[300, 0]) == GREY
    # Nothing is drawn in the middle of a box but frames of others.
    assert tuple(image[590, 400]) == (128, 128, 128)


def test_the_name_of_a_low_object_at_the_edge_does_not_cover_it():
    tree = answers.exact()
    low = answers.with_node(tree, "can", box2d=Box2D(x0=300, y0=0, x1=400, y1=14))
    image = pixels(draw_parse(answers.photo(), low))
    assert (image[3:11, 303:397] == 128).all()
    assert (image[:40, 250:450] == COLOURS[1]).all(axis=-1).sum() > 300  # The tag is near it.
