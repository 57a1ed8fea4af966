"""Tiles of patterned materials: small pictures that repeat without a seam, for other programs.

A tile is the pattern that our pictures draw, on the plane z = 0 of an object's frame. Patterns in
courses repeat after whole ones; the others are folded, so that each tile meets its mirror image, or
blended at their edges.
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
"""Edge of a tile."""
COLOURS = 48
"""Of a tile; more cost bytes and are not seen."""
SAMPLES = 2
"""A pixel and axis, of patterns with edges."""
GRAIN_M = 0.32
_STEPS: dict[str, tuple[int, int]] = {
    # Steps along u and v; both make whole courses where they are not folded.
    "boards": (9, 8), "tiles": (4, 4), "bricks": (12, 12), "veins": (3, 3),
    "speckles": (24, 24), "weave": (16, 16), "brushed": (40, 40),
}  # fmt: skip
_FOLDED = {
    "grain": "uv", "boards": "u", "weave": "u", "brushed": "uv",
}  # fmt: skip
"""Along which axes a tile is its own mirror image."""
_BLENDED = ("veins", "speckles")
"""Patterns where a mirror image would show: their edges run over into what comes next."""
OVERLAP = 0.125
"""Share of a tile in which they do."""


def tile_size(pattern: SurfacePattern) -> tuple[float, float]:
    """Return the edges of a pattern's tile along the first and second axis of a face [m]."""
    if pattern.kind == "grain":
        return GRAIN_M, GRAIN_M
    u, v = (count * pattern.length for count in _STEPS[pattern.kind])
    return (u, v) if pattern.along == "x" else (v, u)


def tile_png(material: Material) -> bytes | None:
    """Return the tile of a patterned material as PNG, the same bytes every time; None if plain.

    Its first row is at the greatest v, as in all pictures. Of a material that bears a print of the
    photograph it is that, which does not repeat.
    """
    if material.photo is not None:
        return print_png(material)
    pattern = finish(material).pattern
    return None if pattern is None else _tile_png(pattern.model_dump_json(), material.rgba[:3])


@lru_cache(maxsize=256)
def _tile_png(described: str, rgb: tuple[float, float, float]) -> bytes:
    pattern, content = SurfacePattern.model_validate_json(described), BytesIO()
    picture = Image.fromarray(_tile(pattern, rgb)).quantize(
        COLOURS, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE
    )
    picture.save(content, format="PNG", optimize=True)
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
    at = (np.arange(n + round(OVERLAP * n) * blended) + 0.5) / n
    first = at[: n // 2] if "u" in folded else at
    second = at[: n // 2] if "v" in folded else at
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
    """Blend the rows beyond a tile's edge into its first ones."""
    more = len(rows) - PIXELS
    share = ((np.arange(more) + 0.5) / more)[:, None, None]
    first = share * rows[:more] + (1 - share) * rows[PIXELS:]
    return np.concatenate([first, rows[more:PIXELS]])
