"""Colors of a photograph: CIE Lab values, their histogram bins, and histograms as color models.

The color of a can's lid may be rare on the can, and common around it because other cans have such
lids, too. Near the lid, it is nevertheless the color inside the contour. Models of local colors
resolve such cases (Tjaden et al., "A Region-based Gauss-Newton Approach to Real-Time Monocular
Multiple Object Tracking", 2018). They assume that the contour is right to a few pixels.

Two poses of an object are compared by the pixels in which they differ.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from PIL import Image
from scipy.ndimage import binary_erosion, distance_transform_edt, gaussian_filter
from scipy.spatial import KDTree

from ...render.appearance import to_lab
from ...render.rasterize import window_of

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
LEAST_PIXELS = 60
"""Least number of pixels for a color model; a margin that leaves fewer pixels is reduced."""
RING = 0.25
"""Width of the ring around an object, relative to the square root of its area."""
LEAST_RING_PX = 6
BAND = 6
"""Width of the band inside a contour whose colors are used, in multiples of the margin."""


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


NEAREST_PX, FARTHEST_PX = 3.0, 8.0
"""Smallest and largest distance of a sample from the contour along the normal [px]. Closer pixels
may be on the other side of the contour."""
SAMPLES = 6
"""Number of samples of a point on each side of the contour."""
POINTS = 7
"""Number of adjacent points of a contour that share their samples."""
LEAST_SAMPLES = 8
"""Least number of samples on a side; with fewer samples, the local colors are unknown."""
SPREAD = np.array([4.0, 3.0, 3.0])
"""Standard deviations of the Gaussian kernel around each sample [CIE Lab]."""
BIN_VOLUME = 100 / (BINS * LIGHTNESS) * (2 * CHROMA / BINS) ** 2
"""Volume of a histogram bin [CIE Lab^3]."""


def local_colors(
    lab: Float[np.ndarray, "row column 3"],
    mask: Bool[np.ndarray, "row column"],
    pixel: Float[np.ndarray, "n 2"],
    normal: Float[np.ndarray, "n 2"],
    colors: Float[np.ndarray, "n m 3"],
    unit: float,
) -> LocalColors:
    """Return the probabilities of colors at each point of a contour, by kernel density estimation.

    Args:
        lab: the photograph [CIE Lab].
        mask: pixels that show the object.
        pixel: points of its contour.
        normal: outward unit normals in the image.
        colors: colors whose probabilities are computed, a row for each point [CIE Lab].
        unit: number of pixels to which the constants in pixels refer.
    """
    count = min(POINTS, len(pixel))
    adjacent = KDTree(pixel).query(pixel, k=count)[1].reshape(-1, count)
    distance = np.linspace(NEAREST_PX, FARTHEST_PX, SAMPLES) * unit
    sides = []
    for sign in (-1, 1):
        spot = pixel[:, None] + sign * distance[:, None] * normal[:, None]
        sides.append(_density(lab, mask == (sign < 0), spot, adjacent, colors))
    (inside, enough_inside), (outside, enough_outside) = sides
    return LocalColors(inside, outside, enough_inside & enough_outside)


def _density(
    lab: Float[np.ndarray, "row column 3"],
    mask: Bool[np.ndarray, "row column"],
    pixel: Float[np.ndarray, "n s 2"],
    adjacent: Int[np.ndarray, "n p"],
    colors: Float[np.ndarray, "n m 3"],
) -> tuple[Float[np.ndarray, "n m"], Bool[np.ndarray, " n"]]:
    """Return the probabilities of `colors`, and whether there are enough samples in the mask."""
    column, row = np.moveaxis(np.floor(pixel).astype(int), -1, 0)
    height, width = mask.shape
    there = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    row, column = row.clip(0, height - 1), column.clip(0, width - 1)
    used = (there & mask[row, column])[adjacent].reshape(len(pixel), -1)
    samples = (lab[row, column] / SPREAD)[adjacent].reshape(len(pixel), -1, 3)
    asked = colors / SPREAD
    dot = asked @ samples.swapaxes(1, 2)
    squares = np.sum(asked**2, axis=2)[:, :, None] + np.sum(samples**2, axis=2)[:, None]
    kernel = np.exp(np.minimum(dot - squares / 2, 0.0)) * used[:, None]
    number = used.sum(axis=1)
    volume = (2 * np.pi) ** 1.5 * np.prod(SPREAD) / BIN_VOLUME
    return kernel.sum(axis=2) / (np.maximum(number, 1)[:, None] * volume), number >= LEAST_SAMPLES


SAME_PX = 0.5
"""Distance between two outlines [px] up to which they count as equal."""
LEAST_GAIN = 0.02
"""Least mean log likelihood ratio of the pixels in only one of two masks [nats] that counts as
evidence for a mask. The colors of neighboring pixels are correlated, so a large sum of small ratios
is no evidence."""


def is_supported(
    now: Bool[np.ndarray, "row column"],
    other: Bool[np.ndarray, "row column"],
    bins: Int[np.ndarray, "row column"],
) -> bool:
    """Return whether the photograph's colors support a mask of an object, versus another mask.

    A mask that is almost equal to the other one is supported. Arguments are as for `gain`.
    """
    ratio = gain(now, other, bins)
    return ratio is None or ratio >= LEAST_GAIN * int((now != other).sum())


def overlap(a: Bool[np.ndarray, "row column"], b: Bool[np.ndarray, "row column"]) -> float:
    """Return the intersection over union of two masks; 0 if both are empty."""
    return float((a & b).sum()) / max(int((a | b).sum()), 1)


def gain(
    now: Bool[np.ndarray, "row column"],
    other: Bool[np.ndarray, "row column"],
    bins: Int[np.ndarray, "row column"],
) -> float | None:
    """Return the log likelihood ratio of two masks of an object, given the photograph's colors.

    The object's colors are estimated from the pixels in both masks, the background's colors from
    the pixels around both masks. The pixels in only one mask are evidence for or against that mask.

    Args:
        now: the mask to be judged.
        other: the alternative mask.
        bins: index of the histogram bin of each pixel's color in the photograph.

    Returns:
        The ratio [nats], assuming independent pixels; positive if `now` explains the photograph
        better than `other`. It is None if the masks are almost equal, and minus infinity if too few
        pixels are in both masks or around them.
    """
    union = now | other
    if not union.any():
        return None
    window = window_of(union, ring_width(int(union.sum())) + 2)
    now, other, union, bins = now[window], other[window], union[window], bins[window]
    outline = now & ~np.asarray(binary_erosion(now, border_value=1), bool)
    if (now != other).sum() <= SAME_PX * max(outline.sum(), 1):
        return None
    common, ring = now & other, around(union, 1)
    if min(common.sum(), ring.sum()) < LEAST_PIXELS / 2:
        return -np.inf
    ratio: Float[np.ndarray, "row column"] = log_likelihood_ratio(
        color_model(bins[common])[bins], color_model(bins[ring])[bins]
    )
    return float(ratio[now & ~other].sum() - ratio[other & ~now].sum())
