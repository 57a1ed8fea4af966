"""Camera pose and field of view from the vanishing points of two perpendicular ground directions.

Pixels are homogeneous coordinates relative to the principal point, the center of the picture. The
line through two points and the intersection of two lines are cross products, also at infinity. A
direction with vanishing point (x, y, w) is (x, y, w f) in the camera frame.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import SpecError
from ..spec import Camera

MIN_FOVY, MAX_FOVY = math.radians(10), math.radians(120)
"""Smallest and largest plausible vertical field of view [rad]."""
MIN_LENGTH_PX = 10.0
"""Minimum length of a line [px]."""
MIN_ANGLE = math.radians(4)
"""Minimum angle between the two estimated directions [rad]."""


class CameraOfLines(NamedTuple):
    """A camera estimated from lines."""

    camera: Camera
    has_fovy: bool
    """True if the lines also determine the camera's field of view."""


def camera_of_lines(camera: Camera, along: ArrayLike, across: ArrayLike) -> CameraOfLines:
    """Estimate a camera's rotation, and its field of view, from lines on the ground.

    Args:
        camera: the initial camera, which gives picture size, height and field of view.
        along: ends of two parallel horizontal lines [px], shape [2, 2, 2].
        across: ends of two horizontal lines perpendicular to `along` [px], shape [2, 2, 2].

    Returns:
        The camera with new pitch and roll. It also has a new field of view if both pairs of lines
        converge and the estimate is plausible.

    Raises:
        SpecError: a line is too short, or both pairs have the same direction.
    """
    points = [_vanishing_point(camera, lines) for lines in (along, across)]
    focal = _focal(camera, *points)
    has_fovy = focal is not None
    focal = camera.focal if focal is None else focal
    directions = [np.array([x, y, w * focal]) for x, y, w in points]
    directions = [direction / np.linalg.norm(direction) for direction in directions]
    up = np.cross(directions[0], directions[1])
    if np.linalg.norm(up) < math.sin(MIN_ANGLE):
        raise SpecError("both pairs of lines have one direction: give the second across the first")
    up /= np.linalg.norm(up)
    up *= -1 if up[1] > 0 else 1  # The y axis of the picture points down.
    change = {
        "pitch": math.asin(float(np.clip(-up[2], -1, 1))),
        "roll": math.atan2(-float(up[0]), -float(up[1])),
        "fovy": 2 * math.atan(camera.height_px / 2 / focal),
    }
    return CameraOfLines(camera.model_copy(update=change), has_fovy)


def _vanishing_point(camera: Camera, lines: ArrayLike) -> NDArray:
    """Return the unit homogeneous intersection (x, y, w) of two lines."""
    ends = np.asarray(lines, float) - np.array([camera.width, camera.height_px]) / 2
    if (np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) < MIN_LENGTH_PX).any():
        raise SpecError("a line is too short: choose its ends farther apart")
    size = camera.height_px
    homogeneous = np.concatenate([ends / size, np.ones((2, 2, 1))], axis=2)
    first, second = (np.cross(line[0], line[1]) for line in homogeneous)
    intersection = np.cross(first / np.linalg.norm(first), second / np.linalg.norm(second))
    if np.linalg.norm(intersection) < 1e-6:
        raise SpecError("two lines lie on each other: choose lines that are apart")
    intersection = intersection * [size, size, 1.0]
    return intersection / np.linalg.norm(intersection)


def _focal(camera: Camera, first: NDArray, second: NDArray) -> float | None:
    """Return the focal length [px] that makes two directions perpendicular, or None."""
    weight = float(first[2] * second[2])
    if abs(weight) < 1e-12:
        return None
    squared = -float(first[:2] @ second[:2]) / weight
    if squared <= 0:
        return None
    fovy = 2 * math.atan(camera.height_px / 2 / math.sqrt(squared))
    return math.sqrt(squared) if MIN_FOVY <= fovy <= MAX_FOVY else None
