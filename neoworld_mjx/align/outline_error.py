"""Distances of a scene's outlines from the photograph's, by the colors on their two sides."""

import numpy as np
from jaxtyping import UInt8

from ..physics.photo_view import see_through
from ..spec import SceneSpec
from .colors import LabImage, color_model, color_models
from .contours import contour, displacements
from .linear_evidence import CONTOUR_PX, LEAST_PRECISION, MARGIN_PX, REFERENCE_PX
from .rasterize import DrawnObjects, draw_scene, height_of

REACH_PX, STEP_PX = 24.0, 1.0
"""Largest distance that is recognized, and the distance of samples [px of REFERENCE_PX]."""
LEAST_INFORMED = 0.25
"""Share of an outline whose two sides differ in color, below which its error is unknown."""


def outline_errors(
    scene: SceneSpec,
    photo: UInt8[np.ndarray, "row column 3"],
    drawn: DrawnObjects | None = None,
) -> dict[str, float | None]:
    """Return the median distance of each object's visible outline from the photograph's.

    Along the outline's normals, the colors inside the object and behind it say where the edge is,
    as in the alignment. Distances are at most REACH_PX and rather too small from about 6 px on, as
    the colors are those that the scene shows; an object that is off by more than its own size may
    find another edge.

    Args:
        scene: the scene, with a camera.
        photo: the photograph (sRGB), at any size of the camera's aspect ratio.
        drawn: the scene as `draw_scene` draws it in REFERENCE_PX columns; None draws it.

    Returns:
        Pixels of an image 640 px wide, by object that is not a support; None where the object is
        not visible or see-through, or the colors do not tell it from what is behind it.
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
        # Of the whole object, as a wrong outline may have only background within.
        models = models._replace(inside=color_model(image.bins[drawn.owner == k]))
        moved = displacements(
            image.lab, points, models, reach=REACH_PX, step=STEP_PX, noise=CONTOUR_PX, unit=1.0
        )
        informed = moved.precision > LEAST_PRECISION
        if informed.mean() >= LEAST_INFORMED:
            errors[item.name] = float(np.median(np.abs(moved.value[informed])))
    return errors
