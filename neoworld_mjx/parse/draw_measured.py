"""Drawing of what is measured on the photograph: the grid of the ground, and depths.

The picture is part of the requests to the reasoner. Lines and labels are drawn as in `draw`.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8

from ..evidence.depth_image import DepthImage
from ..evidence.known_camera import KnownCamera
from ..mllm import Picture
from ..spec import Camera
from .draw import Region, name_tag, overlap, stamp
from .photo import Photo

TOLD_SD = 0.01
"""Largest standard deviation of a focal length, relative to it, of which models are told."""
STEP_M, BOLD = 0.1, 10
"""Distance between lines of the grid [m]; every BOLD-th line is bold."""
LEAST_PX = 10.0
"""Least distance between lines of the grid ahead of the camera [px]."""
FARTHEST_M, NEAR_M = 30.0, 0.05
"""Distance up to which the grid is drawn, and least depth of its points [m]."""
SAMPLES = 4001
"""Number of points of a line at which it is tested whether they are in the picture."""
LATTICE = 9
"""Number of depths along the longer side of the picture."""
GRID, X_INK, Y_INK, DEPTH_INK = (0, 225, 225), (255, 215, 60), (130, 255, 130), (255, 255, 255)
FINE, STRONG = 0.4, 0.9
"""Opacities of fine and of bold lines."""
LABELS_AT = (0.03, 0.5)
"""Positions of a line's labels, as shares of its visible length from its end at the border."""

Canvas = UInt8[np.ndarray, "h w 3"]


class MeasuredPicture(NamedTuple):
    """The photograph with measurements drawn on it."""

    picture: Picture
    grid: bool
    """True if it shows the grid of the ground."""
    depths: bool
    """True if it shows depths."""


def draw_measured(
    photo: Photo, known: KnownCamera | None, depth: DepthImage | None
) -> MeasuredPicture | None:
    """Draw the grid of the ground and a lattice of metric depths; None if neither is known.

    Args:
        photo: the photograph.
        known: what is known of the camera.
        depth: a depth image of the photograph's view.
    """
    camera = _ground_camera(known, photo.size)
    if depth is not None and depth.kind != "metric":
        depth = None
    if camera is None and depth is None:
        return None
    canvas, tags = np.array(photo.rgb), []
    if camera is not None:
        _draw_grid(canvas, camera, tags)
    if depth is not None:
        _draw_depths(canvas, depth, tags)
    return MeasuredPicture(
        Picture("measured", canvas), grid=camera is not None, depths=depth is not None
    )


def _ground_camera(known: KnownCamera | None, size: tuple[int, int]) -> Camera | None:
    """Return the camera of a picture if it determines the image of the ground, otherwise None."""
    if known is None or known.focal is None or known.focal_sd > TOLD_SD:
        return None
    if known.pitch is None or known.height is None or known.height <= 0:
        return None
    width, height = size
    guess = Camera(width=width, height_px=height, fovy=1.0, height=1.0, pitch=0.0)
    return known.camera(guess)


def _draw_grid(canvas: Canvas, camera: Camera, tags: list[Region]) -> None:
    """Draw lines of constant x and y on z = 0, and label them in meters.

    Fine and bold lines end where they would be less than LEAST_PX apart.
    """
    opacity = np.zeros(canvas.shape[:2])
    labels = []
    for axis, number, line in _lines(camera):
        bold = number % BOLD == 0
        _add_line(opacity, line, STRONG if bold else FINE)
        text = f"{'xy'[axis]} {STEP_M * number + 0.0:.1f}"
        labels += [
            (not bold, share > LABELS_AT[0], text, line[int(share * (len(line) - 1))], axis)
            for share in LABELS_AT
        ]
    blended = canvas + opacity[..., None] * (np.array(GRID) - canvas.astype(float))
    canvas[:] = np.floor(blended + 0.5).astype(np.uint8)
    # Labels of bold lines and those at the border come first; others fill the space that is left.
    for *_, text, pixel, axis in sorted(labels, key=lambda label: label[:2]):
        _label(canvas, text, pixel, (X_INK, Y_INK)[axis], tags, centered=True)


def _lines(camera: Camera) -> Iterator[tuple[int, int, Float[np.ndarray, "n 2"]]]:
    """Yield the axis, the number and the pixels of each visible line; its first pixel is near.

    Lines of axis 0 have constant x and run from right to left, those of axis 1 constant y.
    """
    spread = np.linspace(-1, 1, SAMPLES)
    for step in (BOLD, 1):
        reach = _reach(camera, step * STEP_M)
        along = reach * spread * np.abs(spread)
        most = round(reach / STEP_M)
        for axis in (0, 1):
            for number in range(-most, most + 1):
                if (number % BOLD == 0) != (step == BOLD):
                    continue
                points = np.zeros((SAMPLES, 3))
                points[:, axis], points[:, 1 - axis] = STEP_M * number, along
                pixels, depth = camera.project(points)
                inside = (depth > NEAR_M) & (pixels >= 0).all(axis=1)
                inside &= (pixels < (camera.width, camera.height_px)).all(axis=1)
                if inside.sum() > 1:
                    yield axis, number, pixels[inside]


def _reach(camera: Camera, step: float) -> float:
    """Return the distance up to which lines `step` [m] apart are LEAST_PX apart in the picture."""
    near = np.zeros((round(FARTHEST_M / 0.05), 3))
    near[:, 0] = 0.05 * np.arange(1, len(near) + 1)
    (first, depth), (second, _) = (camera.project(near + [x, 0, 0]) for x in (0.0, step))
    apart = np.linalg.norm(second - first, axis=1)
    wide = (depth > NEAR_M) & (apart >= LEAST_PX)
    return float(near[wide, 0].max(initial=0.0))


def _add_line(
    opacity: Float[np.ndarray, "h w"], line: Float[np.ndarray, "n 2"], strength: float
) -> None:
    """Draw a line between its ends, one pixel wide."""
    count = int(np.abs(line[-1] - line[0]).max()) + 2
    column, row = np.floor(np.linspace(line[0], line[-1], count)).astype(int).T
    opacity[row, column] = np.maximum(opacity[row, column], strength)


def _draw_depths(canvas: Canvas, depth: DepthImage, tags: list[Region]) -> None:
    """Draw dots on a lattice, and write the depth along the view to the right of each [m]."""
    height, width = canvas.shape[:2]
    values = depth.resized(height, width).values
    spacing = max(height, width) / LATTICE
    for row in np.arange(spacing / 2, height, spacing).astype(int).tolist():
        for column in np.arange(spacing / 2, width, spacing).astype(int).tolist():
            value = values[row, column]
            if np.isfinite(value):
                beside = np.array([column + 5.0, row])
                if _label(canvas, f"{value:.2f}", beside, DEPTH_INK, tags, centered=False):
                    canvas[row - 3 : row + 4, column - 3 : column + 4] = 0
                    canvas[row - 2 : row + 3, column - 2 : column + 3] = DEPTH_INK


def _label(
    canvas: Canvas,
    text: str,
    pixel: Float[np.ndarray, " 2"],
    ink: tuple[int, int, int],
    tags: list[Region],
    *,
    centered: bool,
) -> bool:
    """Write a label at a pixel, or to its right; return False if no space is left there."""
    height, width = canvas.shape[:2]
    tag = name_tag(text, 1 if max(width, height) < 900 else 2)
    rows, columns = tag.shape
    x = int(pixel[0]) - (columns // 2 if centered else 0)
    y = int(pixel[1]) - rows // 2
    x, y = min(max(x, 0), width - columns), min(max(y, 0), height - rows)
    region = (x, y, x + columns, y + rows)
    if min(x, y) < 0 or any(overlap(region, other) for other in tags):
        return False
    stamp(canvas, tag, (x, y), ink)
    tags.append(region)
    return True
