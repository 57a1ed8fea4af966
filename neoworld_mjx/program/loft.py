"""Solids between level cross sections that are superellipses: flattened bottles, pillows, soaps."""

from collections.abc import Sequence
from typing import no_type_check

import numpy as np
from numpy.typing import NDArray

from .. import spec as S
from ..spec.convex import volume_of_hull
from . import session as validate
from .part import Shape, Vec3
from .shape_functions import MAX_POINTS, make_shape

MAX_SQUARE = 20.0
CONVEX_EXCESS = 0.01
"""Largest volume that one hull may add to several bands, relative to their volume."""


@no_type_check
def loft(sections: Sequence[Vec3], square: float = 2.0, sectors: int = 16) -> Shape:
    """Make a solid through level sections (z, width along x, width along y), from bottom to top.

    The sections are centered on the z axis. Each is a superellipse: `square` is its exponent, 2 for
    an ellipse, 4 for a rectangle with round corners, up to 20.
    """
    rows = [
        validate.vector(section, f"loft sections[{i}]")
        for i, section in enumerate(validate.sequence(sections, "loft sections", 2, MAX_POINTS))
    ]
    for i, (_, x, y) in enumerate(rows):
        validate.length(x, f"loft sections[{i}] width along x")
        validate.length(y, f"loft sections[{i}] width along y")
        if i and rows[i][0] <= rows[i - 1][0]:
            raise ValueError(f"loft sections[{i}]: z must increase, got {rows[i][0]:g}")
    power = validate.number(square, "loft square", MAX_SQUARE)
    if power < 1:
        raise ValueError(f"loft square must lie between 1 and {MAX_SQUARE:g}, got {power:g}")
    count = validate.integer(sectors, "loft sectors", 8, 64)
    rings = _rings(np.array(rows), power, count)
    hulls = _hulls(rings)
    vertices, faces = _surface(rings)
    return make_shape(
        S.Mesh,
        len(hulls),
        vertices=tuple(map(tuple, vertices.tolist())),
        faces=tuple(map(tuple, faces.tolist())),
        hulls=tuple(tuple(map(tuple, hull.reshape(-1, 3).tolist())) for hull in hulls),
    )


def _rings(rows: NDArray, power: float, count: int) -> NDArray:
    """Return the corners of the sections [section, corner, 3]."""
    angle = 2 * np.pi * np.arange(count) / count
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    # Round the zeros of cosine and sine, of which a root would be large.
    circle = np.where(np.abs(circle) < 1e-12, 0.0, circle)
    flat = np.sign(circle) * np.abs(circle) ** (2 / power)
    level = np.broadcast_to(rows[:, None, :1], (len(rows), count, 1))
    return np.concatenate([flat * rows[:, None, 1:] / 2, level], axis=2)


def _hulls(rings: NDArray) -> list[NDArray]:
    """Return the corners of convex pieces; neighboring bands are joined where they are convex."""
    hulls, first = [], 0
    while first < len(rings) - 1:
        last = first + 1
        while last + 1 < len(rings) and _is_convex(rings[first : last + 2]):
            last += 1
        hulls.append(rings[first : last + 1])
        first = last
    return hulls


def _is_convex(rings: NDArray) -> bool:
    volume = lambda corners: volume_of_hull(corners.reshape(-1, 3))
    bands = sum(volume(rings[i : i + 2]) for i in range(len(rings) - 1))
    return bool(volume(rings) <= (1 + CONVEX_EXCESS) * bands)


def _surface(rings: NDArray) -> tuple[NDArray, NDArray]:
    """Return the vertices [v, 3] and triangles [f, 3] of the closed surface."""
    sections, count, _ = rings.shape
    vertices = np.vstack([rings.reshape(-1, 3), rings[0].mean(axis=0), rings[-1].mean(axis=0)])
    here = np.arange(count)
    there = (here + 1) % count
    faces = []
    for below in range(0, (sections - 1) * count, count):
        a, b, c, d = below + here, below + there, below + count + there, below + count + here
        faces += [np.column_stack([a, b, c]), np.column_stack([a, c, d])]
    bottom, top, last = sections * count, sections * count + 1, (sections - 1) * count
    faces.append(np.column_stack([np.full(count, bottom), there, here]))
    faces.append(np.column_stack([np.full(count, top), last + here, last + there]))
    return vertices, np.vstack(faces)
