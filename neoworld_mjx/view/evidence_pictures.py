"""A scene compared with its evidence: outlines, depths and masks, as pictures and as numbers.

Distances of outlines come from the colors on their two sides, as in the alignment.
"""

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image, ImageDraw, ImageFont

from ..estimate.image.colors import LabImage, color_model, color_models, overlap
from ..estimate.rows.contours import CONTOUR_PX, LEAST_PRECISION, MARGIN_PX, contour, displacements
from ..estimate.rows.depth import LEAST_PIXELS, measured_depth, pixel_rays
from ..estimate.rows.linear import REFERENCE_PX
from ..evidence.depth_image import DepthImage
from ..evidence.masks import Masks
from ..physics.photo_view import see_through
from ..render.rasterize import DrawnObjects, draw_scene, height_of
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


WIDTH_PX = 640
"""Width of the image in which residuals are drawn [px]."""
FARTHER, NEARER, ZERO = (200.0, 30.0, 30.0), (30.0, 70.0, 210.0), (250.0, 250.0, 250.0)
"""Colors (sRGB) of surfaces rendered farther than measured, rendered nearer, and of no residual."""
SCALES_MM = (10, 20, 50, 100, 200, 500)
"""Residuals at which a color is saturated [mm]; the first that exceeds most residuals is used."""
MOST = 0.9
"""Share of the residuals that the scale covers."""
LEGEND_PX, FONT_PX = 30, 13
GRAY, DARK = 0.25, 100.0
"""Share of the photograph's brightness where nothing is measured, and its darkest value."""


def depth_residuals(
    depth: DepthImage, drawn: DrawnObjects, scene: SceneSpec
) -> Float[np.ndarray, "row column"]:
    """Return rendered minus measured distance along each pixel's ray [m]; NaN where unknown.

    Scale and shift of a monocular depth image are fitted to the rendering.

    Args:
        depth: the depth image.
        drawn: the rendered scene.
        scene: the scene, with a camera.
    """
    assert scene.camera is not None
    height, width = drawn.owner.shape
    image = depth.resized(height, width)
    rendered = np.where(np.isfinite(drawn.depth), drawn.depth, np.nan)
    if np.isfinite(rendered + image.values).sum() < LEAST_PIXELS:
        return np.full((height, width), np.nan)
    stretch = np.linalg.norm(pixel_rays(scene.camera, width, height), axis=-1)
    return (rendered - measured_depth(image, drawn).depth) * stretch


def depth_picture(
    scene: SceneSpec, depth: DepthImage, photo: UInt8[np.ndarray, "row column 3"]
) -> UInt8[np.ndarray, "_ _ 3"]:
    """Draw the residual of every measured pixel in diverging colors, with their scale in mm.

    Surfaces rendered farther than measured are red, nearer ones blue. Pixels without a measured or
    a rendered depth are gray. Dark lines are the outlines of the rendered objects.

    Args:
        scene: the scene, with a camera.
        depth: the depth image.
        photo: the photograph (sRGB), at any size of the camera's aspect ratio.
    """
    assert scene.camera is not None
    drawn = draw_scene(scene, scene.camera, WIDTH_PX)
    residual = 1000 * depth_residuals(depth, drawn, scene)
    known = np.isfinite(residual)
    typical = float(np.quantile(np.abs(residual[known]), MOST)) if known.any() else 0.0
    scale = next((mm for mm in SCALES_MM if mm >= typical), SCALES_MM[-1])
    height, width = residual.shape
    gray = Image.fromarray(photo).convert("L").resize((width, height))
    picture = np.repeat((DARK + GRAY * np.asarray(gray, float))[..., None], 3, axis=2)
    picture[known] = _diverging(residual[known] / scale)
    edge = np.zeros(drawn.owner.shape, bool)
    edge[:, 1:] |= drawn.owner[:, 1:] != drawn.owner[:, :-1]
    edge[1:] |= drawn.owner[1:] != drawn.owner[:-1]
    picture[edge] *= 0.5
    joined = np.concatenate([picture, _legend(scale, width)])
    return np.clip(joined + 0.5, 0, 255).astype(np.uint8)


def _diverging(share: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n 3"]:
    """Return the colors of residuals relative to the scale, clipped to -1 .. 1."""
    strength = np.clip(np.abs(share), 0, 1)[..., None]
    end = np.where(share[..., None] > 0, np.array(FARTHER), np.array(NEARER))
    return strength * end + (1 - strength) * np.array(ZERO)


def _legend(scale_mm: int, width: int) -> Float[np.ndarray, "row column 3"]:
    """Return a bar with the colors between the two ends of the scale, which are written on it."""
    bar = np.repeat(_diverging(np.linspace(-1, 1, width))[None], LEGEND_PX, axis=0)
    image = Image.fromarray(bar.astype(np.uint8))
    draw, font = ImageDraw.Draw(image), ImageFont.load_default(FONT_PX)
    ends = {"lm": (6, f"-{scale_mm} mm: rendered nearer than measured"), "mm": (width / 2, "0")}
    ends["rm"] = (width - 6, f"+{scale_mm} mm: rendered farther")
    for anchor, (x, text) in ends.items():
        ink = (0, 0, 0) if anchor == "mm" else (255, 255, 255)
        draw.text((x, LEGEND_PX / 2), text, ink, font, anchor=anchor)
    return np.asarray(image, float)


def mask_overlaps(scene: SceneSpec, masks: Masks) -> dict[str, float]:
    """Return the IoU of each object's visible pixels with its mask; without masks, none.

    Args:
        scene: the scene, with a camera.
        masks: the masks, by the names of the objects.
    """
    assert scene.camera is not None
    owner = draw_scene(scene, scene.camera, WIDTH_PX).owner
    names = [item.name for item in scene.objects]
    return {
        names[k]: overlap(mask, owner == k) for k, mask in masks.at(names, *owner.shape).items()
    }
