"""Pitch and roll of a camera from the vertical edges in its photograph.

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
from jaxtyping import Float, UInt8
from PIL import Image

from ..spec import Box2D, Camera
from .line_segments import Segments, line_segments

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
    x, y = np.moveaxis(pixels - np.array([camera.width, camera.height_px]) / 2, -1, 0)
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
