"""Points at which a program repeats a shape: grids, rings and mirror images."""

import math
from collections.abc import Sequence
from typing import Literal, no_type_check

from . import validate
from .sdk_types import Point2, Vec3

Point3 = tuple[float, float, float]
MAX_COUNT = 1000


@no_type_check
def grid(
    counts: tuple[int, int], steps: Point2, centre: Vec3 = (0.0, 0.0, 0.0)
) -> list[tuple[float, float, float]]:
    """Return the points of a grid in x and y around a center; x varies fastest."""
    columns, rows = (
        validate.integer(v, "grid counts", 1, MAX_COUNT)
        for v in validate.sequence(counts, "grid counts", 2, 2)
    )
    if columns * rows > MAX_COUNT:
        raise ValueError(f"grid makes at most {MAX_COUNT} points, got {columns} x {rows}")
    dx, dy = validate.pair(steps, "grid steps")
    x, y, z = validate.vector(centre, "grid centre")
    return [
        (x + dx * (i - (columns - 1) / 2), y + dy * (j - (rows - 1) / 2), z)
        for j in range(rows)
        for i in range(columns)
    ]


@no_type_check
def ring(
    count: int, radius: float, centre: Vec3 = (0.0, 0.0, 0.0), start: float = 0.0
) -> list[tuple[float, float, float]]:
    """Return points on a horizontal circle; point k lies at the angle start + 2 pi k / count."""
    total = validate.integer(count, "ring count", 1, MAX_COUNT)
    r = validate.length(radius, "ring radius")
    x, y, z = validate.vector(centre, "ring centre")
    first = validate.number(start, "ring start", 200.0)
    angles = [first + 2 * math.pi * k / total for k in range(total)]
    return [(x + r * math.cos(a), y + r * math.sin(a), z) for a in angles]


@no_type_check
def mirror(
    points: Vec3 | Sequence[Vec3], across: Literal["x", "y", "z"] = "y", at: float = 0.0
) -> list[tuple[float, float, float]]:
    """Return each point, followed by its mirror image across a plane.

    A point on the plane has no image.

    Args:
        points: one point (x, y, z) or a list of points.
        across: normal of the plane: "x" (exchanges front and back), "y" (exchanges left and right)
            or "z" (exchanges top and bottom).
        at: position of the plane along the normal [m].
    """
    if across not in ("x", "y", "z"):
        raise ValueError(f"mirror across is 'x', 'y' or 'z', got {validate.formatted(across)}")
    k, plane = "xyz".index(across), validate.number(at, "mirror at", validate.MAX_COORDINATE_M)
    originals = validate.sequence(points, "mirror points", 1, MAX_COUNT)
    if not isinstance(originals[0], list | tuple):
        originals = [originals]
    mirrored: list[Point3] = []
    for i, original in enumerate(originals):
        point = validate.vector(original, f"mirror points[{i}]")
        image = list(point)
        image[k] = 2 * plane - image[k]
        mirrored.append(point)
        if image[k] != point[k]:
            x, y, z = image
            mirrored.append((x, y, z))
    return mirrored
