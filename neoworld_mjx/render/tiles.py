"""Tiles of patterned materials: small images that repeat seamlessly, for use in other programs.

A tile shows the same pattern as rendered images, on the plane z = 0 of an object's frame. Patterns
of courses repeat after a whole number of courses. Other tiles are mirrored or blended at the edges.
"""

from functools import lru_cache
from io import BytesIO

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ..spec import Material, SurfacePattern
from ..spec.finish import finish
from .appearance import displayed, linear
from .prints import print_png
from .surface_patterns import patterned

PIXELS = 256
"""Edge length of a tile [px]."""
COLOURS = 48
"""Number of colors of a tile; a larger number makes no visible difference."""
SAMPLES = 2
"""Samples per pixel and axis of patterns with edges."""
GRAIN_M = 0.32
_STEPS: dict[str, tuple[int, int]] = {
    # Size along u and v in steps of the pattern: a whole number of courses if not mirrored.
    "boards": (9, 8), "tiles": (4, 4), "bricks": (12, 12), "veins": (3, 3),
    "speckles": (24, 24), "weave": (16, 16), "brushed": (40, 40),
}  # fmt: skip
_FOLDED = {
    "grain": "uv", "boards": "u", "weave": "u", "brushed": "uv",
}  # fmt: skip
"""Axes along which a tile is mirrored."""
_BLENDED = ("veins", "speckles")
"""Patterns whose tiles are blended at the edges, because mirroring would be visible."""
OVERLAP = 0.125
"""Width of the blended edge, relative to the width of the tile."""


def tile_size(pattern: SurfacePattern) -> tuple[float, float]:
    """Return the width and height of a pattern's tile [m]."""
    if pattern.kind == "grain":
        return GRAIN_M, GRAIN_M
    u, v = (count * pattern.length for count in _STEPS[pattern.kind])
    return (u, v) if pattern.along == "x" else (v, u)


def tile_png(material: Material) -> bytes | None:
    """Return the tile of a patterned material, or the texture of a printed one, as PNG.

    The first row of pixels is at the largest v. If the material is plain, return None.
    """
    if material.photo is not None:
        return print_png(material)
    pattern = finish(material).pattern
    return None if pattern is None else _tile_png(pattern.model_dump_json(), material.rgba[:3])


@lru_cache(maxsize=256)
def _tile_png(described: str, rgb: tuple[float, float, float]) -> bytes:
    pattern, content = SurfacePattern.model_validate_json(described), BytesIO()
    image = Image.fromarray(_tile(pattern, rgb)).quantize(
        COLOURS, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE
    )
    image.save(content, format="PNG", optimize=True)
    return content.getvalue()


def _tile(pattern: SurfacePattern, rgb: tuple[float, float, float]) -> NDArray:
    """Return the tile, uint8 [PIXELS, PIXELS, 3]."""
    wide, tall = tile_size(pattern)
    folded = _FOLDED.get(pattern.kind, "")
    if pattern.along == "y":
        folded = folded.translate(str.maketrans("uv", "vu"))
    blended = pattern.kind in _BLENDED
    samples = 1 if blended else SAMPLES
    n = PIXELS * samples
    grid = (np.arange(n + round(OVERLAP * n) * blended) + 0.5) / n
    first = grid[: n // 2] if "u" in folded else grid
    second = grid[: n // 2] if "v" in folded else grid
    u, v = np.meshgrid(first * wide, second * tall)
    point = np.stack([u.ravel(), v.ravel(), np.zeros(u.size)], axis=1)
    up = np.broadcast_to([0.0, 0.0, 1.0], point.shape)
    pixel = np.full(u.size, max(wide, tall) / PIXELS)
    other = None if pattern.rgb is None else linear(np.array(pattern.rgb))
    light = patterned(pattern, linear(np.array(rgb)), other, point, up, pixel)
    rows, columns = len(second) // samples, len(first) // samples
    fine = light.reshape(rows, samples, columns, samples, 3).mean(axis=(1, 3))
    if blended:
        fine = _wrapped(np.swapaxes(_wrapped(np.swapaxes(fine, 0, 1)), 0, 1))
    if "u" in folded:
        fine = np.concatenate([fine, fine[:, ::-1]], axis=1)
    if "v" in folded:
        fine = np.concatenate([fine, fine[::-1]], axis=0)
    return np.round(255 * displayed(fine[::-1])).astype(np.uint8)


def _wrapped(rows: NDArray) -> NDArray:
    """Blend the rows beyond the edge of a tile into its first rows."""
    overlap = len(rows) - PIXELS
    weight = ((np.arange(overlap) + 0.5) / overlap)[:, None, None]
    first = weight * rows[:overlap] + (1 - weight) * rows[PIXELS:]
    return np.concatenate([first, rows[overlap:PIXELS]])
