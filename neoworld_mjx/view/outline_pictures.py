"""Outlines of a scene in its photograph: their distances, and pictures of them.

The distances come from the colors on the two sides of an outline, as in the alignment.
"""

import numpy as np
from jaxtyping import UInt8

from ..estimate.image.colors import LabImage, color_model, color_models
from ..estimate.image.rasterize import draw_scene, height_of
from ..estimate.rows.contours import CONTOUR_PX, LEAST_PRECISION, MARGIN_PX, contour, displacements
from ..estimate.rows.linear import REFERENCE_PX
from ..physics.photo_view import see_through
from ..spec import SceneSpec

REACH_PX, STEP_PX = 24.0, 1.0
"""Largest distance that is recognized, and distance between samples, in pixels of an image
REFERENCE_PX wide."""
LEAST_INFORMED = 0.25
"""Share of an outline with different colors on its two sides below which the error is unknown."""


def outline_errors(
    scene: SceneSpec, photo: UInt8[np.ndarray, "row column 3"]
) -> dict[str, float | None]:
    """Return the median distance between each object's visible outline and the photograph's.

    As in the alignment, the colors inside the object and behind it determine where the edge is
    along each normal of the outline. Distances are at most REACH_PX. Distances above about 6 px are
    underestimated, because the color models come from the pixels that show the object in the scene.
    An object that is off by more than its size may match another edge.

    Args:
        scene: the scene, with a camera.
        photo: the photograph (sRGB), at any size of the camera's aspect ratio.

    Returns:
        The distance of each object except environment supports, in pixels of an image 640 px wide,
        by name. It is None if the object is invisible or see-through, or if its colors do not
        distinguish it from the background.
    """
    assert scene.camera is not None
    width = round(REFERENCE_PX)
    drawn = draw_scene(scene, scene.camera, width)
    image = LabImage.of(photo, width, height_of(scene.camera, width))
    errors: dict[str, float | None] = {}
    for k, item in enumerate(scene.objects):
        if item.environment:
            continue
        errors[item.name] = None
        points = None if see_through(item.spec) else contour(drawn, k)
        models = None
        if points is not None:
            models = color_models(drawn.owner, image.bins, k, round(MARGIN_PX))
        if points is None or models is None:
            continue
        # Use the whole object: near a wrong outline, there may be only background.
        models = models._replace(inside=color_model(image.bins[drawn.owner == k]))
        moved = displacements(
            image.lab, points, models, reach=REACH_PX, step=STEP_PX, noise=CONTOUR_PX, unit=1.0
        )
        informed = moved.precision > LEAST_PRECISION
        if informed.mean() >= LEAST_INFORMED:
            errors[item.name] = float(np.median(np.abs(moved.value[informed])))
    return errors


BEFORE, AFTER = (255, 120, 0), (0, 255, 90)
"""Colors of the outlines of the composed and of the aligned scene (sRGB)."""
PICTURE_MARGIN_PX = 8


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
    gap = np.full((panels[0].shape[0], PICTURE_MARGIN_PX, 3), 255, np.uint8)
    return np.concatenate([panels[0], gap, panels[1]], axis=1)
