"""Log likelihood ratios of the photograph's pixels, as evidence for whole populations of layouts.

The colors of every object and of its surroundings are estimated once for a photograph and a
composed scene, as for contours. Every pixel near an object is rated: does its color belong to the
object or to the background? The score of a candidate is then the sum of the ratings of the pixels
at which the candidate shows the object (`physics.visibility`).
"""

import dataclasses
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, UInt8
from PIL import Image

from ..physics.model import SceneModel
from ..physics.photo_view import see_through
from ..physics.scene_arrays import on_device
from ..spec import SceneSpec
from .colors import LabImage, color_models, log_likelihood_ratio
from .linear_evidence import MARGIN_PX
from .rasterize import draw_scene, height_of, window_of

EVIDENCE_CELLS = 48
"""Number of cells of an object's evidence along each axis of its window."""
WIDTH_PX = 640
"""Width of the image in which pixels are rated [px]."""
MARGIN = 0.5
"""Width of the margin between an object's 2D box and its window, relative to the longer side of the
box."""
LEAST_RATIO = 0.5
"""Mean log likelihood ratio within an object [nats] below which the object has no evidence, because
its colors do not distinguish it from its surroundings."""


def with_photo(model: SceneModel, photo: UInt8[np.ndarray, "row column 3"]) -> SceneModel:
    """Return a compiled scene with the evidence of its photograph, which `s_photo` uses.

    Args:
        model: the compiled scene; its camera and layout must be nearly right.
        photo: the photograph (sRGB), at any size of the camera's aspect ratio.
    """
    evidence, window = photo_evidence(model.spec, photo)
    view = model.photo._replace(**on_device({"evidence": evidence, "window": window}))
    return dataclasses.replace(model, photo=view)


def photo_evidence(
    scene: SceneSpec, photo: UInt8[np.ndarray, "row column 3"]
) -> tuple[Float[np.ndarray, "object cell cell"], Float[np.ndarray, "object 4"]]:
    """Return the scaled log likelihood ratios of the pixels near each object.

    Returns:
        The scaled ratios, and the windows that they cover. Ratios [1/px^2] are divided by the sum
        of their absolute values within the object in the given scene, so that the sum over the
        pixels of an object is at most about 1. Windows are left, top, right and bottom, relative to
        the middle of the image [px]. The ratios are zero for environment supports, for see-through
        or invisible objects, and for objects whose colors do not distinguish them from their
        surroundings.
    """
    camera = scene.camera
    evidence = np.zeros((len(scene.objects), EVIDENCE_CELLS, EVIDENCE_CELLS))
    window = np.tile([0.0, 0.0, 1.0, 1.0], (len(scene.objects), 1))
    if camera is None:
        return evidence, window
    unit = camera.width / WIDTH_PX
    height = height_of(camera, WIDTH_PX)
    for k, near, ratio, inside in rated_pixels(scene, photo):
        if ratio[inside].mean() < LEAST_RATIO:
            continue
        total = np.abs(ratio[inside]).sum() * unit**2
        size = (EVIDENCE_CELLS, EVIDENCE_CELLS)
        image = Image.fromarray((ratio / total).astype(np.float32))
        evidence[k] = np.asarray(image.resize(size, Image.Resampling.BOX))
        rows, columns = near
        corners = np.array([columns.start, rows.start, columns.stop, rows.stop], float)
        middle = np.array([WIDTH_PX, height, WIDTH_PX, height]) / 2
        window[k] = (corners - middle) * unit
    return evidence, window


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
