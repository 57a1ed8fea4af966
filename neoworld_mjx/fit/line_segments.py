"""Straight line segments of a picture whose direction is close to an expected direction.

Pixels at which the gradient has a maximum across an edge are linked to chains. Chains are split
where they bend, and the pieces are fitted by lines. Pieces of one line are joined across gaps.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, UInt8
from scipy import ndimage

BLUR_PX = 1.3
"""Standard deviation of the Gaussian filter that smooths the picture for derivatives [px]."""
LEAST_GRADIENT, TIMES_MEDIAN = 3.0, 2.0
"""Minimum gradient at an edge: in levels (of 255) per pixel, and as a multiple of the picture's
median gradient, which is mostly noise."""
LEAST_LENGTH = 0.035
"""Minimum length of a segment, as a fraction of the picture's longer side."""
LEAST_FILLED = 0.5
"""Minimum number of edge pixels per pixel of a segment's length."""
STRAIGHT_PX, BEND_PX = 0.6, 0.5
"""Maximum root mean square distance of a segment's pixels from its line, and maximum height of its
arc [px]."""
JOIN_PX, JOIN_GAP = 0.5, 0.6
"""Two pieces belong to one line if the mean offset of each piece from their common line is at most
JOIN_PX [px], and if the gap is at most JOIN_GAP times their total length."""
NOISE_PX = 0.2
"""Minimum standard deviation of the position of an edge pixel across its edge [px]."""

Points = Float[np.ndarray, "_ 2"]


class Segments(NamedTuple):
    """Line segments, from the longest to the shortest."""

    middle: Float[np.ndarray, "n 2"]
    """Midpoints of the segments; x points right and y down [px]."""
    direction: Float[np.ndarray, "n 2"]
    """Unit vectors along the segments, pointing downwards."""
    length: Float[np.ndarray, " n"]
    """Lengths of the segments [px]."""
    sd: Float[np.ndarray, " n"]
    """Standard deviations of the segments' angles [rad]."""


def line_segments(
    rgb: UInt8[np.ndarray, "h w 3"],
    expected: Float[np.ndarray, "h w 2"],
    reach: float,
) -> Segments:
    """Return the straight edges of a picture that are close to the expected directions.

    Args:
        rgb: the picture.
        expected: vector, of any length, along the expected edge at each pixel.
        reach: maximum angle between an edge and the expected direction [rad].
    """
    across, strength = _gradient(rgb)
    along = np.stack([-across[..., 1], across[..., 0]], axis=-1)
    dot = np.abs(np.sum(along * expected, axis=-1))
    close = dot > np.cos(reach) * np.linalg.norm(expected, axis=-1)
    edge = strength > max(LEAST_GRADIENT, TIMES_MEDIAN * float(np.median(strength)))
    rows, columns, points = _ridge(across, strength, close & edge)
    linked = np.zeros(strength.shape, bool)
    linked[rows, columns] = True
    labels, _ = ndimage.label(linked, np.ones((3, 3)))  # pyright: ignore[reportGeneralTypeIssues]
    least = LEAST_LENGTH * max(strength.shape)
    pieces: list[Points] = []
    for chain in _grouped(points, labels[rows, columns]):
        _split(chain, least, pieces)
    lines = [_line(piece) for piece in _joined(pieces)]
    lines.sort(key=lambda line: -line[2])
    middle, direction, length, sd = (
        np.array([line[k] for line in lines]).reshape(-1, *shape)
        for k, shape in enumerate(((2,), (2,), (), ()))
    )
    return Segments(middle, direction, length, sd)


def _gradient(
    rgb: UInt8[np.ndarray, "h w 3"],
) -> tuple[Float[np.ndarray, "h w 2"], Float[np.ndarray, "h w"]]:
    """Return unit gradient and magnitude at each pixel, of the color channel that changes most."""
    values = rgb.astype(float)
    gradient = np.stack(
        [
            ndimage.gaussian_filter1d(
                ndimage.gaussian_filter1d(values, BLUR_PX, axis=other), BLUR_PX, axis=axis, order=1
            )
            for axis, other in ((1, 0), (0, 1))
        ],
        axis=-1,
    )
    size = np.linalg.norm(gradient, axis=-1)
    channel = size.argmax(axis=-1)[..., None]
    strength = np.take_along_axis(size, channel, axis=-1)[..., 0]
    across = np.take_along_axis(gradient, channel[..., None], axis=2)[:, :, 0]
    return across / np.maximum(strength, 1e-9)[..., None], strength


def _ridge(
    across: Float[np.ndarray, "h w 2"],
    strength: Float[np.ndarray, "h w"],
    wanted: np.ndarray,
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"], Points]:
    """Return rows, columns and subpixel positions of the wanted pixels with maximum gradient."""
    rows, columns = np.nonzero(wanted)
    right, down = across[rows, columns].T
    here = strength[rows, columns]
    after, before = (
        ndimage.map_coordinates(strength, [rows + s * down, columns + s * right], order=1)
        for s in (1, -1)
    )
    top = (here >= after) & (here > before)
    curvature = np.maximum(2 * here - after - before, 1e-9)
    shift = np.clip((after - before) / 2 / curvature, -0.5, 0.5)
    # The center of the first pixel is at 0.5.
    points = np.column_stack([columns + 0.5 + shift * right, rows + 0.5 + shift * down])
    return rows[top], columns[top], points[top]


def _grouped(points: Points, labels: Int[np.ndarray, " n"]) -> list[Points]:
    order = np.argsort(labels, kind="stable")
    return np.split(points[order], np.flatnonzero(np.diff(labels[order])) + 1)


def _split(points: Points, least: float, pieces: list[Points]) -> None:
    """Add to `pieces` the straight pieces of a chain that are at least `least` pixels long."""
    if len(points) < LEAST_FILLED * least:
        return
    along, off, _ = _coordinates(points)
    length = float(np.ptp(along))
    if length < least:
        return
    rough = float(np.sqrt(np.mean(off**2))) > STRAIGHT_PX
    bend = abs(float(np.polyfit(along / length, off, 2)[0])) / 4
    if not rough and bend <= BEND_PX:
        if len(points) >= LEAST_FILLED * length:
            pieces.append(points)
        return
    split_at = along[np.argmax(np.abs(off))] if rough else 0.0
    split_at = np.clip(split_at, along.min() + length / 4, along.max() - length / 4)
    _split(points[along < split_at], least, pieces)
    _split(points[along >= split_at], least, pieces)


def _joined(pieces: list[Points]) -> list[Points]:
    """Join pieces that belong to one line, starting with the longest piece."""
    remaining = sorted(pieces, key=lambda piece: -float(np.ptp(_coordinates(piece)[0])))
    joined = []
    while remaining:
        whole = remaining.pop(0)
        for other in list(remaining):
            if _on_one_line(whole, other):
                whole = np.concatenate([whole, other])
                remaining = [piece for piece in remaining if piece is not other]
        joined.append(whole)
    return joined


def _on_one_line(one: Points, other: Points) -> bool:
    along, off, _ = _coordinates(np.concatenate([one, other]))
    filled = sum(float(np.ptp(_coordinates(piece)[0])) for piece in (one, other))
    if float(np.ptp(along)) > (1 + JOIN_GAP) * filled:
        return False
    sides = max(abs(float(np.mean(part))) for part in (off[: len(one)], off[len(one) :]))
    return sides <= JOIN_PX and float(np.sqrt(np.mean(off**2))) <= STRAIGHT_PX


def _coordinates(
    points: Points,
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, "2"]]:
    """Fit a line to points; return their coordinates along and across it, and its direction."""
    offset = points - points.mean(axis=0)
    _, axes = np.linalg.eigh(offset.T @ offset)
    direction = axes[:, 1] * (1 if axes[1, 1] >= 0 else -1)
    return offset @ direction, offset @ axes[:, 0], direction


def _line(
    points: Points,
) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"], float, float]:
    """Return the line's midpoint, direction, length [px] and standard deviation of angle [rad]."""
    along, off, direction = _coordinates(points)
    noise = max(float(np.sqrt(np.mean(off**2))), NOISE_PX)
    # Errors of neighboring pixels are correlated, because the picture is smoothed.
    spread = float(np.sqrt(np.sum(along**2) / (2 * BLUR_PX)))
    return points.mean(axis=0), direction, float(np.ptp(along)), noise / spread
