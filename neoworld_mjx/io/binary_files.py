"""Readers of untrusted arrays and images, which check format and size before they decode."""

import io
import warnings
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from math import prod
from pathlib import Path

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray
from PIL import Image

from ..errors import NeoWorldError
from .files import MIB, read_bytes
from .limited_worker import file_bounds

MAX_ARRAYS = 4096


def read_untrusted_bytes(path: Path, error: type[NeoWorldError]) -> bytes:
    """Read an untrusted file of at most `files.max_file_mib`.

    Raises:
        NeoWorldError: of the class `error`: the file cannot be read, or is too large.
    """
    try:
        return read_bytes(Path(path), file_bounds().max_file_mib * MIB)
    except OSError as problem:
        raise error(f"cannot read {path}: {problem.strerror}") from None


def read_arrays(path: Path, error: type[NeoWorldError]) -> dict[str, NDArray]:
    """Read the arrays of an .npz file by name, or of an .npy file, whose only array is named "".

    All declared sizes are checked before memory is allocated.

    Args:
        path: the file.
        error: class of the error to raise.

    Raises:
        NeoWorldError: of the class `error`: the file cannot be read, contains something other than
            plain arrays, or unpacks to more than `files.max_file_mib`.
    """
    limit = file_bounds().max_file_mib * MIB
    data = read_untrusted_bytes(path, error)
    try:
        if data.startswith(npy.MAGIC_PREFIX):
            return {"": _array(data, str(path))}
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = archive.infolist()
            declared = sum(member.file_size for member in members)
            if len(members) > MAX_ARRAYS or declared > limit:
                raise error(
                    f"{path} unpacks to {declared / MIB:.0f} MiB in {len(members)} arrays; the "
                    f"limit is {limit // MIB} MiB in {MAX_ARRAYS} arrays (files.max_file_mib)"
                )
            return {
                m.filename.removesuffix(".npy"): _array(archive.read(m), m.filename)
                for m in members
            }
    except (zipfile.BadZipFile, zlib.error, ValueError, EOFError, OSError, RuntimeError,
            SyntaxError, TypeError, OverflowError) as problem:  # fmt: skip
        raise error(f"{path} holds no readable arrays: {problem}") from None


def _array(data: bytes, name: str) -> NDArray:
    """Return the array of a file in the format .npy."""
    stream = io.BytesIO(data)
    version = npy.read_magic(stream)  # pyright: ignore[reportArgumentType]
    headers = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
    if version not in headers:
        raise ValueError(f"{name} has the unsupported version {version}")
    shape, fortran, dtype = headers[version](stream)  # pyright: ignore[reportArgumentType]
    if dtype.hasobject:
        raise ValueError(f"{name} holds Python objects")
    if len(shape) > 32 or any(n < 0 for n in shape):
        raise ValueError(f"{name} has the invalid shape {shape}")
    size, available = prod(shape) * dtype.itemsize, len(data) - stream.tell()
    if size > available:
        raise ValueError(f"{name} declares {size} bytes but has {available}")
    array = np.frombuffer(stream.read(size), dtype, prod(shape)).copy()
    return array.reshape(shape[::-1]).T if fortran else array.reshape(shape)


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
