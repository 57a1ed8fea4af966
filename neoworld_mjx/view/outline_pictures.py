"""Outlines of a scene in its photograph: their distances, and pictures of them.

The distances come from the colors on the two sides of an outline. One picture has the outlines
before and after the alignment over the photograph, another one shows where the photograph agrees
with an object. The colors of every object and of its surroundings are estimated as for contours.
Every pixel near an object is rated: does its color belong to the object or to the background?
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, UInt8
from PIL import Image

from ..estimate.image.colors import (
    LARGEST,
    LabImage,
    color_model,
    color_models,
    log_likelihood_ratio,
)
from ..estimate.image.rasterize import DrawnObjects, draw_scene, height_of, window_of
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


WIDTH_PX = 640
"""Width of the image in which pixels are rated [px]."""
MARGIN = 0.5
"""Width of the margin between an object's 2D box and its window, relative to the longer side of the
box."""
AGREES, CONTRADICTS, UNCLAIMED = (0.0, 200.0, 80.0), (255.0, 0.0, 60.0), (60.0, 90.0, 255.0)
"""Colors (sRGB) of three kinds of pixels: pixels of an object that look like the object, pixels of
an object that look like the background, and pixels around an object that look like the object."""
GRAY = 0.35
"""Share of the gray photograph in the picture; the rest is white."""


def evidence_picture(
    scene: SceneSpec, photo: UInt8[np.ndarray, "row column 3"]
) -> UInt8[np.ndarray, "_ _ 3"]:
    """Draw the log likelihood ratio of every pixel near an object over a gray photograph.

    The stronger the color, the larger the absolute ratio. All other pixels are gray.

    Args:
        scene: the scene, with a camera.
        photo: the photograph (sRGB), at any size of the camera's aspect ratio.
    """
    assert scene.camera is not None
    height = height_of(scene.camera, WIDTH_PX)
    gray = Image.fromarray(photo).convert("L").resize((WIDTH_PX, height))
    picture = np.repeat((255 * (1 - GRAY) + GRAY * np.asarray(gray, float))[..., None], 3, axis=2)
    covered = np.zeros((height, WIDTH_PX), bool)
    rated = list(rated_pixels(scene, photo))
    for _, window, _, inside in rated:
        covered[window] |= inside
    for _, window, ratio, inside in rated:
        around = ~covered[window] & (ratio > 0)
        for pixels, color in (
            (around, UNCLAIMED),
            (inside & (ratio > 0), AGREES),
            (inside & (ratio < 0), CONTRADICTS),
        ):
            share: Float[np.ndarray, " n 1"] = np.abs(ratio[pixels])[:, None] / LARGEST
            part = picture[window]
            part[pixels] = (1 - share) * part[pixels] + share * np.array(color)
    return np.clip(picture + 0.5, 0, 255).astype(np.uint8)


class RatedPixels(NamedTuple):
    """Log likelihood ratios of the pixels near an object: the object versus the background."""

    k: int
    """Index of the object."""
    window: tuple[slice, slice]
    """Rows and columns in an image WIDTH_PX wide."""
    ratio: Float[np.ndarray, "row column"]
    """[nats]"""
    inside: Bool[np.ndarray, "row column"]
    """Pixels that show the object in the given scene."""


def rated_pixels(
    scene: SceneSpec, photo: UInt8[np.ndarray, "row column 3"]
) -> Iterator[RatedPixels]:
    """Yield the log likelihood ratios of the pixels near each visible, opaque object.

    Environment supports are omitted, as are objects with too few pixels around them.

    Args:
        scene: the scene, with a camera.
        photo: the photograph (sRGB), at any size of the camera's aspect ratio.
    """
    assert scene.camera is not None
    owner = draw_scene(scene, scene.camera, WIDTH_PX).owner
    bins = LabImage.of(photo, WIDTH_PX, height_of(scene.camera, WIDTH_PX)).bins
    for k, item in enumerate(scene.objects):
        mask = owner == k
        if item.environment or see_through(item.spec) or not mask.any():
            continue
        models = color_models(owner, bins, k, round(MARGIN_PX))
        if models is None:
            continue
        tight = window_of(mask)
        margin = round(MARGIN * max(span.stop - span.start for span in tight)) + 2
        rows, columns = (
            slice(max(s.start - margin, 0), min(s.stop + margin, n))
            for s, n in zip(tight, owner.shape, strict=True)
        )
        near = rows, columns
        colors = bins[near]
        outside = np.empty(colors.shape)
        for behind in np.unique(owner[near]).tolist():
            pixels = owner[near] == behind
            background = models.around if behind == k else models.background(behind)
            outside[pixels] = background[colors[pixels]]
        ratio = log_likelihood_ratio(models.inside[colors], outside)
        yield RatedPixels(k, near, ratio, mask[near])
