"""Camera pose and lens from the vanishing points of two perpendicular directions on the ground.

Pixels are counted from the middle of the picture, where the pinhole camera looks. A line through
two of them is their cross product, two lines meet in theirs, and points at infinity are as good as
others. A direction with vanishing point (x, y, w) is (x, y, w f) in the camera's frame.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import SpecError
from ..spec import Camera

NARROWEST, WIDEST = math.radians(10), math.radians(120)
"""Vertical fields of view that a photograph may have [rad]."""
LEAST_LENGTH_PX = 10.0
LEAST_ANGLE = math.radians(4)
"""Smallest angle between two directions on the ground, as the camera sees them."""


class CameraOfLines(NamedTuple):
    """A camera; `finds_lens` is True if the lines also gave its field of view."""

    camera: Camera
    finds_lens: bool


def camera_of_lines(camera: Camera, along: ArrayLike, across: ArrayLike) -> CameraOfLines:
    """Rotate a camera, and find its field of view, so that lines of the picture lie on the ground.

    Args:
        camera: the picture's size, and the height and field of view to begin with.
        along: ends of two lines that are parallel on the ground, or to it, [2, 2, 2] pixels.
        across: ends of two lines at right angles to those, on the ground or parallel to it.

    Returns:
        The camera with new pitch and roll. The field of view is new, too, where both pairs of
        lines converge and agree on one of a real lens; else it stays.

    Raises:
        SpecError: a line is too short, or the pairs have one direction.
    """
    points = [_vanishing_point(camera, lines) for lines in (along, across)]
    focal = _focal(camera, *points)
    finds_lens = focal is not None
    focal = camera.focal if focal is None else focal
    ways = [np.array([x, y, w * focal]) for x, y, w in points]
    ways = [way / np.linalg.norm(way) for way in ways]
    up = np.cross(ways[0], ways[1])
    if np.linalg.norm(up) < math.sin(LEAST_ANGLE):
        raise SpecError("both pairs of lines have one direction: give the second across the first")
    up /= np.linalg.norm(up)
    up *= -1 if up[1] > 0 else 1  # Up in the world is up in the picture: its y goes down.
    change = {
        "pitch": math.asin(float(np.clip(-up[2], -1, 1))),
        "roll": math.atan2(-float(up[0]), -float(up[1])),
        "fovy": 2 * math.atan(camera.height_px / 2 / focal),
    }
    return CameraOfLines(camera.model_copy(update=change), finds_lens)


def _vanishing_point(camera: Camera, lines: ArrayLike) -> NDArray:
    """Return the point in which two lines meet, (x, y, w) about the middle, of unit length."""
    ends = np.asarray(lines, float) - np.array([camera.width, camera.height_px]) / 2
    if (np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) < LEAST_LENGTH_PX).any():
        raise SpecError("a line is too short: choose its ends farther apart")
    size = camera.height_px
    homogeneous = np.concatenate([ends / size, np.ones((2, 2, 1))], axis=2)
    first, second = (np.cross(line[0], line[1]) for line in homogeneous)
    meet = np.cross(first / np.linalg.norm(first), second / np.linalg.norm(second))
    if np.linalg.norm(meet) < 1e-6:
        raise SpecError("two lines lie on each other: choose lines that are apart")
    meet = meet * [size, size, 1.0]
    return meet / np.linalg.norm(meet)


def _focal(camera: Camera, one: NDArray, other: NDArray) -> float | None:
    """Return the focal length [px] that makes two directions perpendicular; None without one."""
    weight = float(one[2] * other[2])
    if abs(weight) < 1e-12:
        return None
    squared = -float(one[:2] @ other[:2]) / weight
    if squared <= 0:
        return None
    fovy = 2 * math.atan(camera.height_px / 2 / math.sqrt(squared))
    return math.sqrt(squared) if NARROWEST <= fovy <= WIDEST else None
