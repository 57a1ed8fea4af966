"""Picture of the pixel evidence: where the photograph agrees with an object, and where not.

The colors of every object and of its surroundings are estimated as for contours. Every pixel near
an object is rated: does its color belong to the object or to the background?
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, UInt8
from PIL import Image

from ..physics.photo_view import see_through
from ..spec import SceneSpec
from .colors import LARGEST, LabImage, color_models, log_likelihood_ratio
from .linear_evidence import MARGIN_PX
from .rasterize import draw_scene, height_of, window_of

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
