"""Reader of untrusted image files that checks format and size before it decodes pixels."""

import io
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

from PIL import Image

from ..errors import NeoWorldError
from .file_options import file_bounds

IMAGE_FORMATS = (
    *("PNG", "JPEG", "MPO", "WEBP", "TIFF", "BMP", "GIF"),
    *("AVIF", "JPEG2000", "PPM", "TGA", "ICO"),
)
"""Accepted formats. Pillow decodes each of them without an external program, unlike EPS."""

PLAIN_MPX = 16
"""Maximum size of an image that is decoded without a limited worker [megapixels]."""


@contextmanager
def open_image(
    data: bytes,
    name: str,
    error: type[NeoWorldError],
    formats: tuple[str, ...] = IMAGE_FORMATS,
    *,
    large: bool = False,
) -> Iterator[Image.Image]:
    """Open an image, or the first frame of an animation or multi-page file.

    Args:
        data: contents of the file.
        name: name of the file for messages.
        error: class of the error to raise.
        formats: formats to try.
        large: if True, allow `files.max_picture_mpx` megapixels instead of `PLAIN_MPX`; for callers
            that decode the image in a limited worker.

    Yields:
        The image, before its pixels are decoded.

    Raises:
        NeoWorldError: of the class `error`: the data is not an image in these formats, has too
            many pixels, or is damaged. Damage may be detected only when the pixels are decoded.
    """
    limit = file_bounds().max_picture_mpx
    limit = limit if large else min(limit, PLAIN_MPX)
    try:
        with warnings.catch_warnings():
            # Pillow warns about large images; the limit below replaces its warning.
            warnings.simplefilter("ignore")
            with _identified(data, formats) as image:
                width, height = image.size
                if width * height > limit * 1_000_000:
                    size = f"{width} x {height} pixels, {width * height / 1e6:.0f}"
                    raise error(_too_large(name, size, limit))
                yield image
    except NeoWorldError:
        raise
    except Image.UnidentifiedImageError:
        raise error(
            f"{name} is not an image in a supported format; save it as PNG or JPEG"
        ) from None
    except Image.DecompressionBombError:
        raise error(_too_large(name, "over 179", limit)) from None
    except MemoryError:
        raise error(f"{name} does not fit into memory; save a smaller copy") from None
    except Exception as problem:
        # Decoders raise nearly anything on damaged data: OSError, SyntaxError, struct.error, ...
        raise error(
            f"{name} is damaged or truncated ({problem}); get the file again, or save it as PNG"
        ) from None


def _identified(data: bytes, formats: tuple[str, ...]) -> Image.Image:
    """Open an image, loading the plug-ins of rare formats only if no common format matches."""
    for load in (Image.preinit, Image.init):
        load()
        known = [name for name in formats if name in Image.OPEN]
        try:
            return Image.open(io.BytesIO(data), formats=known)
        except Image.UnidentifiedImageError:
            continue
    raise Image.UnidentifiedImageError


def _too_large(name: str, megapixels: str, limit: int) -> str:
    return f"{name}: {megapixels} megapixels; the limit is {limit}; save a smaller copy"
