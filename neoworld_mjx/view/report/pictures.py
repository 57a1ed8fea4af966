"""Pictures of a report, embedded as data URIs."""

import base64
import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from markupsafe import Markup
from numpy.typing import NDArray
from PIL import Image

from ...errors import RunError
from ...io import file_bounds, open_image
from ...io.files import MIB, read_bytes
from .page import elements

_MAX_PX = 1280
_SMALL_BYTES = 300_000
"""Largest PNG file that is embedded unchanged [bytes]."""


def picture(path: Path, caption: str) -> Markup:
    """Embed a picture file, reduced if it is large; embed a note if it is missing or damaged."""
    if not path.is_file():
        return elements.missing_figure("not there yet", caption)
    try:
        with _open(path) as (raw, image):
            if image.format == "PNG" and len(raw) <= _SMALL_BYTES:
                return elements.figure(_data_uri(raw, "png"), caption)
            image.thumbnail((_MAX_PX, _MAX_PX), Image.Resampling.LANCZOS)
            return _figure(image.convert("RGB"), caption, quality=88)
    except (OSError, RunError):
        return elements.missing_figure(f"{path.name} cannot be read", caption)


def cropped_picture(
    path: Path, window: tuple[float, float, float, float], caption: str, height: int = 150
) -> Markup:
    """Embed a crop of a picture file; return empty markup if the file is missing or damaged.

    Args:
        path: the picture file.
        window: left, top, right and bottom, as fractions of the picture.
        caption: caption of the crop.
        height: maximum height [pixels].
    """
    try:
        with _open(path) as (_, image):
            x0, y0, x1, y1 = (
                round(min(max(fraction, 0.0), 1.0) * size)
                for fraction, size in zip(window, (*image.size, *image.size), strict=True)
            )
            crop = image.convert("RGB").crop((x0, y0, max(x1, x0 + 1), max(y1, y0 + 1)))
    except (OSError, RunError):
        return Markup()
    crop.thumbnail((2 * height, height), Image.Resampling.LANCZOS)
    return _figure(crop, caption)


def embed_pixels(pixels: NDArray, caption: str) -> Markup:
    """Embed a picture, uint8 [h, w, 3]."""
    return _figure(Image.fromarray(pixels), caption)


@contextmanager
def _open(path: Path) -> Iterator[tuple[bytes, Image.Image]]:
    raw = read_bytes(path, file_bounds().max_file_mib * MIB)
    with open_image(raw, path.name, RunError) as image:
        image.load()
        yield raw, image


def _figure(image: Image.Image, caption: str, quality: int = 85) -> Markup:
    buffer = io.BytesIO()
    image.save(buffer, "JPEG", quality=quality)
    return elements.figure(_data_uri(buffer.getvalue(), "jpeg"), caption)


def _data_uri(raw: bytes, kind: str) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(raw).decode('ascii')}"
