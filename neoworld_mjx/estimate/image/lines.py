"""Vertical edges in a photograph, and the pitch and roll of the camera that they determine.

Pixels at which the gradient has a maximum across an edge are linked to chains. Chains are split
where they bend, and the pieces are fitted by lines. Pieces of one line are joined across gaps.

The images of vertical edges meet at one point, which pitch, roll and field of view determine. The
straight edges near the expected direction vote for pitch and roll, while the field of view keeps
its value. An edge is assumed to be vertical with a probability of one half; otherwise its direction
is uniform within REACH of the expected direction. Edges that are not vertical do not agree on
another point, so a few of them do no harm. An error of the field of view appears as an error of the
pitch, because the point lies f / tan(pitch) below the middle of the picture.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, UInt8
from PIL import Image
from scipy import ndimage

from ...spec import Box2D, Camera

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


LONGER_PX = 960
"""Maximum length of the longer side [px]; edges are found in a picture reduced to it."""
REACH = math.radians(15.0)
"""Maximum angle between an edge and the expected direction [rad]."""
ANGLE = math.radians(0.4)
"""Standard deviation of the angle of a vertical edge in the picture [rad], in addition to the error
of its measurement. Reasons are that sides of objects bulge, and that lenses bend lines."""
VERTICAL = 0.5
"""Probability that an edge near the expected direction is vertical."""
PITCH_RANGE, ROLL_RANGE, GRID = math.radians(16.0), math.radians(8.0), math.radians(0.25)
"""Maximum deviations of pitch and roll from the given camera, and step of the grid [rad]."""
MAX_VOTES_PER_OBJECT = 6.0
"""Maximum total vote of the edges of one object, because these tend to be wrong together. It also
limits the vote of each of STRIPS vertical strips of the background."""
STRIPS = 8
MOST_SEGMENTS = 150
"""Maximum number of segments; the longest ones are used."""


class EdgeRegion(NamedTuple):
    """A part of the picture in which edges may be vertical."""

    box: Box2D
    """[px], as in the camera's picture."""
    vertical: bool
    """True if the object has vertical edges; other edges in the box do not vote."""
    background: bool = False
    """True for supports of the environment, which can fill the picture."""


@dataclass(frozen=True)
class VerticalEdges:
    """Pitch and roll estimated from vertical edges, with the given field of view."""

    pitch: float
    """Mean of the distribution of the pitch [rad]."""
    pitch_sd: float
    """Standard deviation of the pitch [rad]."""
    roll: float
    """Mean of the distribution of the roll [rad]."""
    roll_sd: float
    """Standard deviation of the roll [rad]."""
    count: float
    """Expected number of vertical edges at the estimate, each weighted by its vote."""
    sigma: float
    """Significance with which the edges exclude the given camera, in standard deviations."""
    camera: Camera
    """The given camera."""


def vertical_edges(
    rgb: UInt8[np.ndarray, "h w 3"], camera: Camera, regions: Sequence[EdgeRegion]
) -> VerticalEdges | None:
    """Estimate pitch and roll from the vertical edges of a photograph.

    An edge belongs to the smallest region that contains its midpoint, or else to the background,
    where edges may be vertical.

    Args:
        rgb: the photograph, of any size with the camera's aspect ratio.
        camera: the camera with a pitch and a roll from which the estimate starts.
        regions: boxes of the objects.

    Returns:
        The estimate; None if no two edges vote.
    """
    factor = -(-max(rgb.shape[:2]) // LONGER_PX)
    cropped_size = [side // factor * factor for side in rgb.shape[1::-1]]
    small = np.asarray(Image.fromarray(rgb).reduce(factor, (0, 0, *cropped_size)))
    height, width = small.shape[:2]
    per_pixel = np.array([camera.width / width, camera.height_px / height])
    columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    pixels = np.stack([columns, rows], axis=-1) * per_pixel
    expected = _towards_ground(camera, pixels, np.array(camera.pitch), np.array(camera.roll))
    all_segments = line_segments(small, expected / per_pixel, REACH)
    segments = Segments(*(values[:MOST_SEGMENTS] for values in all_segments))
    middle = segments.middle * per_pixel
    weights = _weights(camera, regions, middle)
    votes = weights > 0
    if votes.sum() < 2:
        return None
    segments = Segments(*(values[votes] for values in segments))
    return _estimate(camera, middle[votes], segments, weights[votes])


def _estimate(
    camera: Camera,
    middle: Float[np.ndarray, "n 2"],
    segments: Segments,
    weights: Float[np.ndarray, " n"],
) -> VerticalEdges:
    """Return the mean of the likelihood over a grid around the parsed pitch and roll."""
    steps = [np.arange(-round(r / GRID), round(r / GRID) + 1) for r in (PITCH_RANGE, ROLL_RANGE)]
    off = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1) * GRID
    pitch, roll = camera.pitch + off[..., 0], camera.roll + off[..., 1]
    expected = _towards_ground(camera, middle, pitch[..., None], roll[..., None])
    right, down = segments.direction.T
    angle = np.arctan2(
        expected[..., 0] * down - expected[..., 1] * right,
        expected[..., 0] * right + expected[..., 1] * down,
    )
    angle -= np.pi * np.round(angle / np.pi)
    sd = np.hypot(segments.sd, ANGLE)
    vertical = VERTICAL * np.exp(-((angle / sd) ** 2) / 2) / (sd * math.sqrt(2 * math.pi))
    other = (1 - VERTICAL) / (2 * REACH)
    log_likelihood = np.log(vertical + other) @ weights
    best = np.unravel_index(int(log_likelihood.argmax()), log_likelihood.shape)
    gain = log_likelihood[best] - log_likelihood[len(steps[0]) // 2, len(steps[1]) // 2]
    share = np.exp(log_likelihood - log_likelihood[best])
    share /= share.sum()
    at_best = vertical[best] / (vertical[best] + other)
    return VerticalEdges(
        *_mean_and_sd(pitch, share),
        *_mean_and_sd(roll, share),
        count=float(at_best @ weights),
        sigma=math.sqrt(2 * max(float(gain), 0.0)),
        camera=camera,
    )


def _mean_and_sd(
    values: Float[np.ndarray, "p r"], share: Float[np.ndarray, "p r"]
) -> tuple[float, float]:
    mean = float(np.sum(share * values))
    return mean, math.sqrt(float(np.sum(share * (values - mean) ** 2)) + GRID**2 / 12)


def _towards_ground(
    camera: Camera,
    pixels: Float[np.ndarray, "*n 2"],
    pitch: Float[np.ndarray, "*m"],
    roll: Float[np.ndarray, "*m"],
) -> Float[np.ndarray, "*k 2"]:
    """Return the image direction of a vertical line, downwards, at each pixel; shape [..., 2]."""
    right, down = np.sin(roll) * np.cos(pitch), np.cos(roll) * np.cos(pitch)
    ahead = np.sin(pitch)
    x, y = np.moveaxis(pixels - camera.center, -1, 0)
    return np.stack([camera.focal * right - x * ahead, camera.focal * down - y * ahead], axis=-1)


def _weights(
    camera: Camera, regions: Sequence[EdgeRegion], middle: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, " n"]:
    """Return the weight of each edge's vote, from the smallest region that contains its middle."""
    boxes = np.array([region.box.as_tuple() for region in regions]).reshape(-1, 4)
    area = np.append(np.prod(boxes[:, 2:] - boxes[:, :2], axis=1), np.inf)
    pad = 0.006 * max(camera.width, camera.height_px)
    x = middle[:, None]
    within = np.all((x > boxes[:, :2] - pad) & (x < boxes[:, 2:] + pad), axis=2)
    within = np.pad(within, ((0, 0), (0, 1)))
    owner = np.where(within.any(axis=1), np.where(within, area, np.inf).argmin(axis=1), len(boxes))
    may_vote = np.array([*(region.vertical for region in regions), True])
    background = np.array([*(region.background for region in regions), True])
    strip = (middle[:, 0] / camera.width * STRIPS).astype(int)
    group = np.where(background[owner], -1 - strip, owner)
    votes = may_vote[owner].astype(float)
    alike = (group[:, None] == group) @ votes
    return votes * np.minimum(1.0, MAX_VOTES_PER_OBJECT / np.maximum(alike, 1.0))
