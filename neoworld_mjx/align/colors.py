"""Colors of a photograph: CIE Lab values, their histogram bins, and histograms as color models."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from PIL import Image
from scipy.ndimage import distance_transform_edt, gaussian_filter

from ..render.appearance import linear
from .rasterize import window_of

BINS = 24
"""Number of bins of a histogram along each axis."""
LIGHTNESS = 0.5
"""Scale of the lightness axis relative to the two chromatic axes. It is less than 1 because shading
mostly changes the lightness."""
CHROMA = 80.0
"""Largest absolute value of a chromatic coordinate that the bins resolve."""
BLUR = 0.7
"""Standard deviation of the Gaussian that smooths histograms, in bins."""
OUTLIERS = 0.1
"""Share of pixels whose colors the color model does not contain, due to highlights, textures and
objects that are not modeled."""
LARGEST = 4.0
"""Bound on the absolute log likelihood ratio of a pixel [nats]."""
_UNIFORM = 1.0 / (BINS**3 * LIGHTNESS)
_TO_XYZ = np.array(
    [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
) / np.array([[0.9505], [1.0], [1.089]])
LEAST_PIXELS = 60
"""Least number of pixels for a color model; a margin that leaves fewer pixels is reduced."""
RING = 0.25
"""Width of the ring around an object, relative to the square root of its area."""
LEAST_RING_PX = 6
BAND = 6
"""Width of the band inside a contour whose colors are used, in multiples of the margin."""


def to_lab(rgb: np.ndarray) -> Float[np.ndarray, "*n 3"]:
    """Convert display colors (sRGB, 0 to 255) to CIE Lab, D65."""
    xyz = linear(rgb.astype(float) / 255.0) @ _TO_XYZ.T
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    return np.stack(
        [
            116 * f[..., 1] - 16,
            500 * (f[..., 0] - f[..., 1]),
            200 * (f[..., 1] - f[..., 2]),
        ],
        axis=-1,
    )


def bins_of(lab: Float[np.ndarray, "*n 3"]) -> Int[np.ndarray, "*n"]:
    """Return the index of the histogram bin of each color [CIE Lab]."""
    unit = np.stack(
        [
            lab[..., 0] / 100 * LIGHTNESS,
            (lab[..., 1] + CHROMA) / (2 * CHROMA),
            (lab[..., 2] + CHROMA) / (2 * CHROMA),
        ],
        axis=-1,
    )
    index = np.clip((unit * BINS).astype(int), 0, BINS - 1)
    return (index[..., 0] * BINS + index[..., 1]) * BINS + index[..., 2]


def color_model(bins: Int[np.ndarray, " n"]) -> Float[np.ndarray, " bin"]:
    """Return the smoothed and normalized histogram of pixels, given the bins of their colors."""
    counts = np.bincount(bins, minlength=BINS**3).reshape(BINS, BINS, BINS).astype(float)
    smooth = gaussian_filter(counts, BLUR, mode="constant")
    return (smooth / max(smooth.sum(), 1e-9)).ravel()


def log_likelihood_ratio(
    inside: Float[np.ndarray, "*n"], outside: Float[np.ndarray, "*n"]
) -> Float[np.ndarray, "*n"]:
    """Return log p(color | object) - log p(color | background), bounded by LARGEST.

    Both probabilities are mixtures with a uniform distribution of the weight OUTLIERS.
    """
    mix = lambda p: np.log((1 - OUTLIERS) * p + OUTLIERS * _UNIFORM)
    return np.clip(mix(inside) - mix(outside), -LARGEST, LARGEST)


class LabImage(NamedTuple):
    """The photograph in CIE Lab."""

    lab: Float[np.ndarray, "row column 3"]
    bins: Int[np.ndarray, "row column"]
    """Bin of each pixel's color."""

    @classmethod
    def of(cls, photo: UInt8[np.ndarray, "_ _ 3"], width: int, height: int) -> "LabImage":
        """Resize a photograph (sRGB) to `width` x `height` pixels, and convert it to CIE Lab."""
        if photo.shape[:2] != (height, width):
            size = (width, height)
            photo = np.asarray(Image.fromarray(photo).resize(size, Image.Resampling.LANCZOS))
        lab = to_lab(photo)
        return cls(lab, bins_of(lab))


class LocalColors(NamedTuple):
    """Probabilities of colors on the two sides of a contour, near each of its points.

    They refer to volumes of the size of a histogram bin, as those of `ColorModels` do.
    """

    inside: Float[np.ndarray, "n m"]
    outside: Float[np.ndarray, "n m"]
    known: Bool[np.ndarray, " n"]
    """True for points with enough samples on both sides."""


class ColorModels(NamedTuple):
    """Color models on the two sides of an object's contour in a layout."""

    inside: Float[np.ndarray, " bin"]
    """Colors of the object near its contour. The rest of the object is omitted, because it may look
    like the background."""
    around: Float[np.ndarray, " bin"]
    """Colors around the object, which include its shadow."""
    behind: dict[int, Float[np.ndarray, " bin"]]
    """Colors of each neighbor in the ring around the object, by index; neighbors with too few
    pixels in the ring are missing."""

    def background(self, neighbor: int) -> Float[np.ndarray, " bin"]:
        """Return the color model of the background where `neighbor` is behind the contour."""
        behind = self.behind.get(neighbor)
        return self.around if behind is None else 0.5 * (behind + self.around)

    def log_ratio(
        self,
        lab: Float[np.ndarray, "n m 3"],
        behind: Int[np.ndarray, " n"],
        local: LocalColors | None = None,
    ) -> Float[np.ndarray, "n m"]:
        """Return the log likelihood ratio of each color: the object versus the background.

        Args:
            lab: colors [CIE Lab].
            behind: index of the neighbor behind the contour, for each row of `lab`.
            local: probabilities of the colors near each point of the contour. Where they are known,
                they are averaged with the probabilities of these models.
        """
        bins = bins_of(lab)
        outside = np.empty(bins.shape)
        for neighbor in np.unique(behind).tolist():
            rows = behind == neighbor
            outside[rows] = self.background(neighbor)[bins[rows]]
        inside = self.inside[bins]
        if local is not None:
            share = np.where(local.known, 0.5, 0.0)[:, None]
            inside = (1 - share) * inside + share * local.inside
            outside = (1 - share) * outside + share * local.outside
        return log_likelihood_ratio(inside, outside)


def color_models(
    owner: Int[np.ndarray, "row column"], bins: Int[np.ndarray, "row column"], k: int, margin: int
) -> ColorModels | None:
    """Estimate the color models of an object from the pixels that show it in a layout.

    Args:
        owner: index of the object at each pixel; -1 for none.
        bins: bin of each pixel's color.
        k: index of the object, which must be visible.
        margin: width of the margin [px] along the contour that is omitted, because the position of
            the contour is uncertain.

    Returns:
        The color models, or None if there are too few pixels around the object.
    """
    mask = owner == k
    window = window_of(mask, margin + ring_width(int(mask.sum())) + 1)
    owner, bins = owner[window], bins[window]
    mask = owner == k
    ring = around(mask, margin)
    if ring.sum() < LEAST_PIXELS / 2:
        return None
    behind = {}
    for neighbor in np.unique(owner[ring]).tolist():
        near = ring & (owner == neighbor)
        if near.sum() >= LEAST_PIXELS:
            behind[neighbor] = color_model(bins[near])
    inner = _band(mask, margin)
    return ColorModels(color_model(bins[inner]), color_model(bins[ring]), behind)


def _band(mask: Bool[np.ndarray, "row column"], margin: int) -> Bool[np.ndarray, "row column"]:
    """Return the pixels of a mask near its contour, without the margin if enough pixels remain."""
    depth = np.asarray(distance_transform_edt(np.pad(mask, 1, mode="edge")))[1:-1, 1:-1]
    band = depth <= margin + BAND * margin
    for width in (margin, 1, 0):
        inner = mask & band & (depth > width)
        if inner.sum() >= LEAST_PIXELS:
            return inner
    return mask


def around(mask: Bool[np.ndarray, "row column"], margin: int) -> Bool[np.ndarray, "row column"]:
    """Return the ring around a mask, which starts `margin` pixels from the mask."""
    distance = np.asarray(distance_transform_edt(~mask))
    return (distance > margin) & (distance <= margin + ring_width(int(mask.sum())))


def ring_width(area: int) -> int:
    """Return the width [px] of the ring around an object of the given area [px^2]."""
    return max(LEAST_RING_PX, round(RING * area**0.5))
