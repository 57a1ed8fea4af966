"""Picture of the objects' outlines over the photograph, before and after the alignment."""

import numpy as np
from jaxtyping import UInt8

from ..spec import SceneSpec
from .rasterize import draw_scene

BEFORE, AFTER = (255, 120, 0), (0, 255, 90)
"""Colors of the outlines of the composed and of the aligned scene (sRGB)."""
MARGIN_PX = 8


def outline_picture(
    photo: UInt8[np.ndarray, "row column 3"], before: SceneSpec, after: SceneSpec
) -> UInt8[np.ndarray, "_ _ 3"]:
    """Draw the outlines of each scene over a copy of the photograph; return both side by side.

    Args:
        photo: the photograph.
        before: the composed scene, with a camera.
        after: the aligned scene, with a camera.
    """
    panels = []
    for scene, color in ((before, BEFORE), (after, AFTER)):
        assert scene.camera is not None
        owner = draw_scene(scene, scene.camera, photo.shape[1]).owner
        rows, columns = (min(a, b) for a, b in zip(owner.shape, photo.shape, strict=False))
        owner, panel = owner[:rows, :columns], np.array(photo[:rows, :columns])
        edge = np.zeros(owner.shape, bool)
        across, down = owner[:, 1:] != owner[:, :-1], owner[1:] != owner[:-1]
        for side in (slice(1, None), slice(None, -1)):
            edge[:, side] |= across
            edge[side] |= down
        panel[edge] = color
        panels.append(panel)
    gap = np.full((panels[0].shape[0], MARGIN_PX, 3), 255, np.uint8)
    return np.concatenate([panels[0], gap, panels[1]], axis=1)
