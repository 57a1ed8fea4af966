"""The picture of the outlines before and after."""

import numpy as np
import pytest
from scipy.ndimage import binary_dilation

from neoworld_mjx.render import render
from neoworld_mjx.view.evidence_pictures import AFTER, BEFORE, outline_picture
from neoworld_mjx.view.evidence_pictures import PICTURE_MARGIN_PX as MARGIN_PX
from tests.estimate import desk


def borders(scene, width):
    """Pixels whose right or lower neighbor shows another object."""
    owner = render(scene, scene.camera, width=width, supersample=1, floor=False).segmentation
    edge = np.zeros(owner.shape, bool)
    edge[:, :-1] |= owner[:, 1:] != owner[:, :-1]
    edge[:-1] |= owner[1:] != owner[:-1]
    return edge


@pytest.mark.parametrize("width", [320])
def test_outlines_are_at_the_borders_of_the_objects(width):
    before = desk.five()
    after = desk.displaced(before, box=(40, 0, 20, 0), ball=(-30, 20, 0, 10))
    photo = np.full((3 * width // 4, width, 3), 77, np.uint8)
    picture = outline_picture(photo, before, after)
    assert picture.shape == (3 * width // 4, 2 * width + MARGIN_PX, 3)
    assert picture.dtype == np.uint8
    assert (photo == 77).all()
    panels = picture[:, :width], picture[:, width + MARGIN_PX :]
    assert (picture[:, width : width + MARGIN_PX] == 255).all()
    wide = np.ones((3, 3), bool)
    masks = []
    for panel, scene, color in zip(panels, (before, after), (BEFORE, AFTER), strict=True):
        line, edge = (panel == color).all(axis=2), borders(scene, width)
        assert (line & ~binary_dilation(edge, wide)).sum() == 0
        assert (edge & ~binary_dilation(line, wide)).sum() == 0
        assert (panel[~line] == 77).all()
        # Pixels on both sides of a border.
        assert 1.6 * edge.sum() < line.sum() < 2.2 * edge.sum()
        masks.append(line)
    assert (masks[0] != masks[1]).sum() > 200
