"""Encode frames as an animated GIF or WebP."""

import io
from collections.abc import Iterable

from numpy.typing import NDArray
from PIL import Image

FORMATS = {".gif": "GIF", ".webp": "WEBP"}
"""Names of Pillow's formats, by file suffix."""


def encode_animation(frames: Iterable[NDArray], pause_ms: int, suffix: str = ".gif") -> bytes:
    """Encode frames as an animation that repeats forever.

    Args:
        frames: at least one image, each uint8 [h, w, 3].
        pause_ms: duration of each frame [ms].
        suffix: ".gif" or ".webp".
    """
    first, *rest = (Image.fromarray(frame) for frame in frames)
    buffer = io.BytesIO()
    first.save(
        buffer, FORMATS[suffix], save_all=True, append_images=rest, duration=pause_ms, loop=0
    )
    return buffer.getvalue()
