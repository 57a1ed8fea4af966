"""Readers of depth images, and their registration with the photograph.

A depth image is a 16-bit PNG with a scale, or an .npy or .npz file. Its values are depths along the
view (not distances from the camera) unless `kind` says otherwise. 0, NaN and infinite values are
missing.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import NDArray

from ..errors import EvidenceError
from ..io import open_image, read_arrays, read_untrusted_bytes
from .depth_image import MONOCULAR, DepthImage, DepthKind
from .lens import Lens

PNG_SCALE = 0.001
"""Meters per unit of a 16-bit PNG, if no scale is given."""
ASPECT = 0.01
"""Largest relative difference between the aspect ratios of depth image and photograph."""
MIN_SIDE_PX, MAX_SIDE_PX = 16, 8192
FLYING = 0.03
"""Relative difference of depths within 3 x 3 pixels from which on there is an edge."""
PLANE = 0.75
"""A surface without an edge differs over 3 pixels by at most this share of what it does over 5."""
BETWEEN = 0.2
"""A flying pixel is farther than this share of the edge from both of its sides."""
HOLES = 0.8
"""Size of the pixels of a reprojected depth image, as a share of those of the sensor."""


def read_depth(
    path: Path,
    *,
    scale: float | None = None,
    kind: DepthKind = "metric",
    confidence: Path | None = None,
    smooth_sd: float | None = None,
) -> DepthImage:
    """Read a depth image, without its flying pixels.

    Args:
        path: a 16-bit PNG, .npy, or .npz with one array, or with one named depth.
        scale: meters per unit; by default `PNG_SCALE` for a PNG, else 1. Only of the kind metric.
        kind: how the values depend on the depth.
        confidence: image of the same size, from 0 to 1 or, as a PNG, to its largest value.
        smooth_sd: standard deviation of errors that neighbors share; by default that of a network
            if the kind is not metric, else 0.

    Raises:
        EvidenceError: a file cannot be read, or is no depth image.
    """
    values, image = _values(path, "depth")
    if image and np.dtype(values.dtype).itemsize < 2:
        raise EvidenceError(
            f"{path} has 8 bits, which are colors or steps of centimeters: give a 16-bit PNG or a "
            ".npy file"
        )
    if scale is not None and not (0 < scale < np.inf):
        raise EvidenceError(f"{path}: scale {scale:g} must be positive, in meters per unit")
    if scale is None:
        scale = PNG_SCALE if image and kind == "metric" else 1.0
    values = values.astype(float) * scale
    missing = ~np.isfinite(values)
    if kind != "affine":
        missing |= values <= 0
    values = np.where(missing, np.nan, values)
    if not np.isfinite(values).any():
        raise EvidenceError(f"{path} has no values: all of its pixels are 0 or not finite")
    trust = None
    if confidence is not None:
        trust = _confidence(confidence, values.shape)
    if smooth_sd is None:
        smooth_sd = 0.0 if kind == "metric" else MONOCULAR
    values = np.where(flying_pixels(values, kind), np.nan, values)
    return DepthImage(values, kind, trust, smooth_sd, path.name)


def _values(path: Path, name: str) -> tuple[NDArray, bool]:
    """Return the values of a file, and True if it is an image."""
    suffix = path.suffix.lower()
    if suffix in (".npy", ".npz"):
        arrays = read_arrays(path, EvidenceError)
        if name not in arrays and len(arrays) != 1:
            raise EvidenceError(
                f"{path} has the arrays {', '.join(sorted(arrays)[:8])}: name the one to use {name}"
            )
        array, image = arrays.get(name, next(iter(arrays.values()))), False
        if array.dtype.kind not in "fiu":
            raise EvidenceError(f"{path} holds {array.dtype}, and not numbers")
        array = array[..., 0] if array.ndim == 3 and array.shape[-1] == 1 else array
        array = array[0] if array.ndim == 3 and array.shape[0] == 1 else array
    elif suffix == ".exr":
        raise EvidenceError(
            f"{path}: EXR files are not read: save it as .npy, such as by numpy.save(name, "
            "imageio.v3.imread(path))"
        )
    else:
        array, image = read_gray(path), True
    if array.ndim != 2:
        raise EvidenceError(f"{path} has the shape {array.shape}; a {name} image has two axes")
    check_side(array, path)
    return array, image


def check_side(values: NDArray, path: Path) -> None:
    """Raise an EvidenceError if an image [row, column] is too small or too large."""
    if not all(MIN_SIDE_PX <= side <= MAX_SIDE_PX for side in values.shape):
        raise EvidenceError(
            f"{path} has {values.shape[1]} x {values.shape[0]} pixels; valid are {MIN_SIDE_PX} to "
            f"{MAX_SIDE_PX} a side"
        )


def read_gray(path: Path) -> NDArray:
    """Return the values of an image with one channel, or the indices of one with a palette.

    Raises:
        EvidenceError: the file cannot be read, or has colors.
    """
    data = read_untrusted_bytes(path, EvidenceError)
    with open_image(data, str(path), EvidenceError, ("PNG", "TIFF", "PPM")) as image:
        if image.mode not in ("I;16", "I;16B", "I;16L", "I", "L", "P", "F", "1"):
            raise EvidenceError(
                f"{path} has colors ({image.mode}), of which no values can be read: give the values"
            )
        return np.asarray(image).copy()


def _confidence(path: Path, shape: tuple[int, ...]) -> Float[np.ndarray, "row column"]:
    values, image = _values(path, "confidence")
    if values.shape != shape:
        own, other = (f"{s[1]} x {s[0]}" for s in (values.shape, shape))
        raise EvidenceError(f"{path} has {own} pixels, and the depth image {other}")
    most = 1.0
    if image or values.dtype.kind in "iu":
        # Levels such as ARKit's 0, 1 and 2 become 0, .5 and 1.
        most = float(values.max()) or 1.0
    result = np.nan_to_num(values.astype(float) / most)
    if result.min() < 0 or result.max() > 1:
        raise EvidenceError(
            f"{path} has values from {result.min():.3g} to {result.max():.3g}; a confidence is "
            "from 0 to 1"
        )
    return result


def flying_pixels(
    values: Float[np.ndarray, "row column"], kind: DepthKind = "metric"
) -> Bool[np.ndarray, "row column"]:
    """Return the pixels between the two sides of an edge, at depths at which nothing is.

    Planes, however steep, have no flying pixels: the inverse depth of a plane is linear in the
    image.
    """
    from scipy.ndimage import maximum_filter, minimum_filter

    known = np.isfinite(values)
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1 / values if kind == "metric" else values
    scale = np.abs(inverse[known])
    unit = np.where(known, np.abs(inverse), 1.0) if kind == "metric" else np.median(scale)
    high, low = (
        [filtered(np.where(known, inverse, fill), size) for size in (3, 5)]
        for filtered, fill in ((maximum_filter, -np.inf), (minimum_filter, np.inf))
    )
    near, far = high[0] - low[0], high[1] - low[1]
    with np.errstate(invalid="ignore"):
        edge = (near > FLYING * unit) & (near > PLANE * far)
        lone = np.minimum(high[0] - inverse, inverse - low[0]) > BETWEEN * near
    return known & edge & lone


def registered(
    depth: DepthImage, sensor: Lens, to_photo: Float[np.ndarray, "4 4"], photo: Lens
) -> DepthImage:
    """Return the depths of a sensor next to the camera as depths in the photograph's image.

    Every pixel covers as many pixels of the result as it would at its depth; the nearest depth
    wins.

    Args:
        depth: the depth image, of the kind metric.
        sensor: the sensor's lens, for an image of the depth image's size.
        to_photo: transform from the sensor's frame to that of the photograph's camera (OpenCV).
        photo: the lens of the photograph, at any size.
    """
    if depth.kind != "metric":
        raise EvidenceError(
            f"{depth.source}: a sensor next to the camera needs metric depth, not {depth.kind}"
        )
    rows, columns = np.nonzero(np.isfinite(depth.values))
    pixels = np.column_stack([columns + 0.5, rows + 0.5])
    z = depth.values[rows, columns]
    flat = sensor.slopes(pixels)
    points = np.column_stack([flat * z[:, None], z]) @ to_photo[:3, :3].T + to_photo[:3, 3]
    share = min(HOLES * sensor.focal[0] / photo.focal[0], 1.0)
    width, height = (max(round(share * side), MIN_SIDE_PX) for side in photo.size)
    ahead = points[:, 2] > 1e-3
    points, rows, columns = points[ahead], rows[ahead], columns[ahead]
    at = photo.project(points) * [width / photo.size[0], height / photo.size[1]]
    u, v = np.floor(at).astype(int).T
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    order = np.flatnonzero(inside)
    order = order[np.argsort(-points[order, 2], kind="stable")]  # The nearest is written last.
    result = np.full((height, width), np.nan)
    result[v[order], u[order]] = points[order, 2]
    trust = None
    if depth.confidence is not None:
        trust = np.zeros((height, width))
        trust[v[order], u[order]] = depth.confidence[rows[order], columns[order]]
    seen_through = _hidden(result)
    return replace(depth, values=np.where(seen_through, np.nan, result), confidence=trust)


def _hidden(values: Float[np.ndarray, "row column"]) -> Bool[np.ndarray, "row column"]:
    """Return pixels that show the background through gaps of a nearer surface."""
    from scipy.ndimage import median_filter

    filled = np.where(np.isfinite(values), values, np.inf)
    median = median_filter(filled, size=3, mode="nearest")
    return np.isfinite(values) & (values > (1 + FLYING) * median)


def check_aspect(shape: tuple[int, ...], size: tuple[int, int], source: str) -> None:
    """Refuse an image that has another aspect ratio than the photograph.

    Args:
        shape: shape of the image.
        size: width and height of the photograph [px].
        source: name of the image.

    Raises:
        EvidenceError: the aspect ratios differ.
    """
    height, width = shape[:2]
    ratio, own = width / height, size[0] / size[1]
    if abs(ratio / own - 1) <= max(ASPECT, 1.0 / min(height, width)):
        return
    cause = "it is of another view, or cropped"
    if abs(ratio * own - 1) <= ASPECT:
        cause = "it is turned by 90 degrees"
    raise EvidenceError(
        f"{source} has {width} x {height} pixels and the photograph {size[0]} x {size[1]}: {cause}"
    )
