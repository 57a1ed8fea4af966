"""Distances between a scene's outlines and the photograph's, from the colors on their two sides."""

import numpy as np
from jaxtyping import UInt8

from ..physics.photo_view import see_through
from ..spec import SceneSpec
from .colors import LabImage, color_model, color_models
from .contours import contour, displacements
from .linear_evidence import CONTOUR_PX, LEAST_PRECISION, MARGIN_PX, REFERENCE_PX
from .rasterize import DrawnObjects, draw_scene, height_of

REACH_PX, STEP_PX = 24.0, 1.0
"""Largest distance that is recognized, and distance between samples, in pixels of an image
REFERENCE_PX wide."""
LEAST_INFORMED = 0.25
"""Share of an outline with different colors on its two sides below which the error is unknown."""


def outline_errors(
    scene: SceneSpec,
    photo: UInt8[np.ndarray, "row column 3"],
    drawn: DrawnObjects | None = None,
) -> dict[str, float | None]:
    """Return the median distance between each object's visible outline and the photograph's.

    As in the alignment, the colors inside the object and behind it determine where the edge is
    along each normal of the outline. Distances are at most REACH_PX. Distances above about 6 px are
    underestimated, because the color models come from the pixels that show the object in the scene.
    An object that is off by more than its size may match another edge.

    Args:
        scene: the scene, with a camera.
        photo: the photograph (sRGB), at any size of the camera's aspect ratio.
        drawn: the scene rendered by `draw_scene` at a width of REFERENCE_PX; if None, it is
            rendered.

    Returns:
        The distance of each object except environment supports, in pixels of an image 640 px wide,
        by name. It is None if the object is invisible or see-through, or if its colors do not
        distinguish it from the background.
    """
    assert scene.camera is not None
    width = round(REFERENCE_PX)
    drawn = drawn or draw_scene(scene, scene.camera, width)
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
