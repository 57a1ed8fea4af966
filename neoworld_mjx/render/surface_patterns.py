"""Procedural surface patterns: grain, boards, tiles, bricks, veins, speckles, weave, brushed,
checker.

Each pattern is a function of points in the object's frame, so it moves with the object. Details
smaller than a pixel fade into their mean.
"""

import numpy as np
from numpy.typing import NDArray

from ..spec import SurfacePattern

DARKER = {"brushed": 0.9, "veins": 0.72, "weave": 0.75, "speckles": 0.7}
"""Ratio of the second to the first color, in linear light, for patterns without a second color."""
JOINT_DARKER = 0.4
GAPS = 0.075
"""Mean fraction of a surface that the gaps of a weave cover."""
MAX_DETAIL = 0.25
"""Size of a pixel, relative to the period of a pattern, at which the pattern fades to its mean."""


def patterned(
    pattern: SurfacePattern,
    colour: NDArray,
    second: NDArray | None,
    point: NDArray,
    normal: NDArray,
    pixel: NDArray,
) -> NDArray:
    """Return the linear color [n, 3] of points on a patterned surface.

    Args:
        pattern: the pattern.
        colour: linear color of the material [3].
        second: linear color [3] of mortar, veins, etc.; if None, a darker shade of `colour`.
        point: points in the object's frame [m], shape [n, 3].
        normal: normals at the points, shape [n, 3].
        pixel: size of a pixel at each point [m], shape [n].
    """
    if second is None:
        second = colour * DARKER.get(pattern.kind, JOINT_DARKER)
    step = pattern.length
    u, v = _on_face(point, normal, pattern.along)
    mix, light = np.zeros(len(point)), np.ones(len(point))
    if pattern.kind == "grain":
        light = wood(point)
    elif pattern.kind == "boards":
        mix, light = _boards(u, v, step, pixel)
    elif pattern.kind == "tiles":
        mix, light = _courses(u, v, (step, step), 0.0, 0.015 * step, pixel, 0.04)
    elif pattern.kind == "bricks":
        mix, light = _courses(u, v, (3 * step, step), 0.5, 0.12 * step, pixel, 0.12)
    elif pattern.kind == "veins":
        mix, light = _veins(point, step)
    elif pattern.kind == "speckles":
        rough = noise(point / step) + 0.5 * noise(point / (0.45 * step) + 7.0)
        mix = _faded(_ramp(rough, 0.35, 0.7), pixel, step, 0.2)
    elif pattern.kind == "weave":
        mix, light = _weave(u, v, step, pixel)
    elif pattern.kind == "checker":
        odd = (np.floor(u / step) + np.floor(v / step)) % 2
        mix = _faded(odd, pixel, step, 0.5)
    elif pattern.kind == "brushed":
        mix = _brushed(u, v, step, pixel)
    return (colour + mix[:, None] * (second - colour)) * light[:, None]


def _on_face(p: NDArray, normal: NDArray, along: str) -> tuple[NDArray, NDArray]:
    """Return coordinates (u, v) [m] in the coordinate plane most nearly parallel to the surface."""
    axis = np.argmax(np.abs(normal), axis=1)
    u = np.where(axis == 0, p[:, 1], p[:, 0])
    v = np.where(axis == 2, p[:, 1], p[:, 2])
    return (u, v) if along == "x" else (v, u)


def _boards(u: NDArray, v: NDArray, step: float, pixel: NDArray) -> tuple[NDArray, NDArray]:
    row = np.floor(v / step)
    length = 9.0 * step
    shift = 0.5 + 0.5 * _hashed(row, 0 * row)
    column = np.floor(u / length + shift)
    mix = _line(v - row * step, step, 0.02 * step, pixel)
    ends = _line((u / length + shift - column) * length, length, 0.015 * step, pixel)
    light = 1.0 + 0.11 * _hashed(row, column)
    fibre = noise(np.column_stack([u * 4.0, v * 160.0, row * 3.7]))
    broad = noise(np.column_stack([u * 1.5, v * 30.0, row * 1.9 + 5.0]))
    light = light * (1.0 + _faded(0.05 * fibre, pixel, 0.02, 0.0) + 0.05 * broad)
    return np.maximum(mix, ends), light


def _courses(
    u: NDArray,
    v: NDArray,
    size: tuple[float, float],
    offset: float,
    joint: float,
    pixel: NDArray,
    spread: float,
) -> tuple[NDArray, NDArray]:
    """Return mix and brightness of rows of rectangles, each row shifted by `offset` lengths."""
    row = np.floor(v / size[1])
    along = u / size[0] + offset * row
    column = np.floor(along)
    level = _line(v - row * size[1], size[1], joint, pixel)
    upright = _line((along - column) * size[0], size[0], joint, pixel)
    light = 1.0 + spread * _hashed(row, column)
    return np.maximum(level, upright), light


def _veins(p: NDArray, step: float) -> tuple[NDArray, NDArray]:
    q = p / step
    bent = q + 0.55 * np.column_stack([noise(1.3 * q + k * 11.3) for k in range(3)])
    bent = bent + 0.16 * np.column_stack([noise(6.0 * q + k * 5.1) for k in range(3)])
    ridge = np.abs(noise(0.9 * bent))
    fine = np.abs(noise(1.9 * bent + 3.0))
    # Veins fade in and out along their length.
    present = _ramp(noise(0.8 * q + 2.0), -0.25, 0.45)
    mix = (1.0 - _ramp(ridge, 0.0, 0.03)) * present
    mix = np.maximum(mix, 0.5 * (1.0 - _ramp(fine, 0.0, 0.02)) * (1.0 - present))
    mix = np.maximum(mix, 0.18 * (1.0 - _ramp(ridge, 0.0, 0.09)) * present)
    return mix, 1.0 + 0.02 * noise(2.0 * q + 9.0)


def _weave(u: NDArray, v: NDArray, step: float, pixel: NDArray) -> tuple[NDArray, NDArray]:
    """Return mix and brightness of a plain weave: threads that pass over and under in turn."""
    column, row = np.floor(u / step), np.floor(v / step)
    across, along = (2.0 * (w / step - k) - 1.0 for w, k in ((u, column), (v, row)))
    # In every second field the thread along v is above; it is round, and dives at its ends.
    above = (row + column) % 2 == 0
    side, end = np.where(above, across, along), np.where(above, along, across)
    mix = _faded(_ramp(np.abs(side), 0.85, 1.0), pixel, step, GAPS)
    uneven = 0.05 * _hashed(np.where(above, column, row), above.astype(float))
    rounded = np.where(above, 0.06, -0.06) - 0.1 * (end * end - 1 / 3)
    light = 1.0 + _faded(uneven + rounded, pixel, step, 0.0)
    return mix, light


def _brushed(u: NDArray, v: NDArray, step: float, pixel: NDArray) -> NDArray:
    """Return the mix of scratches along u, 10 steps long and an eighth of a step apart.

    Wider ones would draw rings around a pot.
    """
    fine = noise(np.column_stack([u / (10 * step), 8 * v / step, 0 * u]))
    return np.clip(_faded(0.5 + 0.6 * fine, pixel, step / 4, 0.5), 0.0, 1.0)


def _line(position: NDArray, period: float, width: float, pixel: NDArray) -> NDArray:
    """Return the fraction [n] of each pixel that a line covers, given positions in a period [m]."""
    away = np.minimum(position, period - position)
    wide = np.maximum(pixel, 1e-9)
    return np.clip((width / 2 - away) / wide + 0.5, 0.0, 1.0) * np.minimum(1.0, width / wide)


def _faded(value: NDArray, pixel: NDArray, step: float, mean: float) -> NDArray:
    """Blend values towards their mean where a pixel is not small compared with the period."""
    keep = np.clip(2.0 - 2.0 * pixel / (MAX_DETAIL * step), 0.0, 1.0)
    return mean + keep * (value - mean)


def _ramp(x: NDArray, low: float, high: float) -> NDArray:
    t = np.clip((x - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def _hashed(row: NDArray, column: NDArray) -> NDArray:
    """Return a pseudorandom number in [-1, 1] for each pair of integers [n]."""
    return _hash(np.column_stack([row, column, 0 * row]).astype(np.int64))


def wood(p: NDArray) -> NDArray:
    """Return the relative brightness of wood, cut lengthwise, at points [m] of shape [n, 3]."""
    x, y, z = p[:, 0], p[:, 1], p[:, 2]
    # The axis of the tree is parallel to x, slightly off the surface, and wanders slowly.
    wander = 0.010 * noise(np.column_stack([x * 3.0, y * 9.0, z * 9.0]))
    radius = np.hypot(y + 0.7 * wander + 0.013, 1.6 * (z + 0.06) + wander)
    rings = radius * 95.0 + 0.8 * noise(np.column_stack([x * 5.0, y * 40.0, z * 40.0]))
    wave = rings - np.floor(rings)
    # Earlywood darkens slowly into latewood, then the next ring begins.
    ring = np.where(wave < 0.8, wave / 0.8, (1.0 - wave) / 0.2)
    fibre = noise(np.column_stack([x * 30.0, y * 700.0, z * 700.0]))
    return 1.06 - 0.22 * ring * ring + 0.05 * fibre


def noise(p: NDArray) -> NDArray:
    """Return smooth value noise in [-1, 1] at points [n, 3], from integer hashes."""
    cell = np.floor(p)
    f = p - cell
    f = f * f * (3.0 - 2.0 * f)
    i = cell.astype(np.int64)
    total = np.zeros(len(p))
    for corner in range(8):
        bits = np.array([corner & 1, corner >> 1 & 1, corner >> 2])
        weight = np.prod(np.where(bits, f, 1.0 - f), axis=1)
        total += weight * _hash(i + bits)
    return total


def _hash(i: NDArray) -> NDArray:
    h = i[:, 0] * 73856093 ^ i[:, 1] * 19349663 ^ i[:, 2] * 83492791
    h = (h ^ (h >> 13)) * 1274126177 & 0xFFFFFFFF
    h = (h ^ (h >> 16)) & 0xFFFF
    return h / 32767.5 - 1.0
