"""Pictures from outside: formats by name, and bounds before a pixel is decoded."""

import io
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

from PIL import Image

from ..errors import NeoWorldError
from .bounds import bounds_of_files

PICTURE_FORMATS = (
    *("PNG", "JPEG", "MPO", "WEBP", "TIFF", "BMP", "GIF"),
    *("AVIF", "JPEG2000", "PPM", "TGA", "ICO"),
)
"""Formats that are read, all decoded by Pillow itself: EPS, for one, would start Ghostscript."""


@contextmanager
def open_picture(
    data: bytes, name: str, error: type[NeoWorldError], formats: tuple[str, ...] = PICTURE_FORMATS
) -> Iterator[Image.Image]:
    """Open a picture, of an animation or several pages the first image.

    Args:
        data: the file.
        name: of the file, for messages.
        error: class of the error to raise.
        formats: those to try.

    Yields:
        The picture, its pixels not yet decoded.

    Raises:
        NeoWorldError: of the class `error`: it is no picture of these formats, has too many pixels,
            or is damaged, which may show while it is used.
    """
    most = bounds_of_files().max_picture_mpx
    try:
        with warnings.catch_warnings():
            # Pillow warns of large pictures, for which the bound below decides.
            warnings.simplefilter("ignore")
            with _identified(data, formats) as image:
                width, height = image.size
                if width * height > most * 1_000_000:
                    size = f"{width} x {height} pixels, {width * height / 1e6:.0f}"
                    raise error(_too_large(name, size, most))
                yield image
    except NeoWorldError:
        raise
    except Image.UnidentifiedImageError:
        raise error(
            f"{name} is no picture that can be read, whatever its name says; save it as PNG or JPEG"
        ) from None
    except Image.DecompressionBombError:
        raise error(_too_large(name, "over 179", most)) from None
    except MemoryError:
        raise error(f"{name} does not fit into memory; save a smaller copy") from None
    except Exception as problem:
        # Decoders raise nearly anything on damaged data: OSError, SyntaxError, struct.error, ...
        raise error(
            f"{name} is damaged or cut off ({problem}); get the file again, or save it anew as PNG"
        ) from None


def _identified(data: bytes, formats: tuple[str, ...]) -> Image.Image:
    """Open a picture; the plug-ins of rare formats are loaded only if no common one fits."""
    for load in (Image.preinit, Image.init):
        load()
        known = [each for each in formats if each in Image.OPEN]
        try:
            return Image.open(io.BytesIO(data), formats=known)
        except Image.UnidentifiedImageError:
            continue
    raise Image.UnidentifiedImageError


def _too_large(name: str, megapixels: str, most: int) -> str:
    return f"{name}: {megapixels} megapixels, at most {most} are read; save a smaller copy"
