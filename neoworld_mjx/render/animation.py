"""Encode frames as an animation for people: GIF or WebP."""

import io
from collections.abc import Iterable

from numpy.typing import NDArray
from PIL import Image

FORMATS = {".gif": "GIF", ".webp": "WEBP"}
"""Formats of animations by suffix."""


def encode_animation(frames: Iterable[NDArray], pause_ms: int, suffix: str = ".gif") -> bytes:
    """Encode frames, which repeat without end.

    Args:
        frames: uint8 [h, w, 3] each, at least one.
        pause_ms: time that each frame is shown [ms].
        suffix: ".gif" or ".webp".
    """
    first, *rest = (Image.fromarray(frame) for frame in frames)
    buffer = io.BytesIO()
    first.save(
        buffer, FORMATS[suffix], save_all=True, append_images=rest, duration=pause_ms, loop=0
    )
    return buffer.getvalue()
