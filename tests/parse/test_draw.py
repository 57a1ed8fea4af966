import io

import numpy as np
from PIL import Image

from neoworld_mjx.parse.draw import COLOURS, GREY, draw_parse
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
