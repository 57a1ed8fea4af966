"""Loading of photographs: every format that Pillow decodes becomes upright 8-bit RGB.

The picture is rotated by its EXIF data, laid on white where it is transparent, converted to 8-bit
RGB, and shrunk to the size that models are shown. Pixel coordinates elsewhere are those of the
upright original; `Photo.scale` leads from them to the shown picture. Embedded colour profiles are
not applied, so that the same file gives the same pixels everywhere.

Files that could exhaust the memory are refused by their header, before a pixel is decoded.
"""

import hashlib
import io
import warnings
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image, ImageOps

from ..errors import PhotoError

MAX_PIXELS = 2**27
"""134 megapixels, 400 MB as RGB: above the largest common phone picture of 108 megapixels."""
MAX_BYTES = 2**29
MIN_SIDE_PX = 16

_REFUSED_FORMATS = frozenset({"EPS", "MPEG", "BUFR", "GRIB", "HDF5", "WMF"})
"""EPS would run Ghostscript on the file; of the others Pillow reads the header alone."""


@dataclass(frozen=True)
class Photo:
    """A photograph in the size that models are shown."""

    rgb: UInt8[np.ndarray, "height width 3"] = field(repr=False)
    """The shown picture, shape [height, width, 3]."""
    original_size: tuple[int, int]
    """Width and height of the upright original, in pixels."""
    sha256: str
    """Digest of the file."""
    path: Path

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the shown picture, in pixels."""
        return self.rgb.shape[1], self.rgb.shape[0]

    @property
    def scale(self) -> float:
        """Shown over original pixels, at most 1."""
        return max(self.size) / max(self.original_size)


def load_photo(path: Path, max_side_px: int = 1568) -> Photo:
    """Read a photograph; of an animation or a stack of pages the first.

    Args:
        path: the file, in any raster format that Pillow decodes itself.
        max_side_px: the shown picture's longer side is at most this, in pixels.

    Raises:
        PhotoError: the file is missing, no picture, damaged, too small (under 16 pixels a side),
            or too large (over 134 megapixels or 512 MiB).
    """
    path = Path(path)
    data = _read(path)
    image = _decode(path, data)
    original = image.size
    longest = max(original)
    if longest > max_side_px:
        shown = (
            max(1, round(original[0] * max_side_px / longest)),
            max(1, round(original[1] * max_side_px / longest)),
        )
        if min(shown) < MIN_SIDE_PX:
            raise PhotoError(
                f"{path}: {original[0]} x {original[1]} pixels is too long and narrow: shrunk to "
                f"{max_side_px} pixels its short side is under {MIN_SIDE_PX}; crop it"
            )
        image = image.resize(shown, Image.Resampling.LANCZOS)
    rgb = np.array(image)
    rgb.flags.writeable = False
    return Photo(rgb, original, hashlib.sha256(data).hexdigest(), path)


def _read(path: Path) -> bytes:
    try:
        if path.is_dir():
            raise PhotoError(f"{path} is a folder; give the file of one photograph")
        if not path.exists():
            raise PhotoError(f"{path}: no such file; check the path of the photograph")
        if not path.is_file():
            raise PhotoError(f"{path} is no regular file; give the file of one photograph")
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise PhotoError(
                f"{path} has {size / 2**20:.0f} MiB, at most {MAX_BYTES // 2**20} are read; "
                f"save a smaller copy"
            )
        return path.read_bytes()
    except OSError as error:
        raise PhotoError(f"cannot read {path}: {error.strerror}") from None


def _decode(path: Path, data: bytes) -> Image.Image:
    """Return the picture upright, in mode RGB, at full size."""
    Image.init()
    formats = sorted(set(Image.OPEN) - _REFUSED_FORMATS)
    try:
        with warnings.catch_warnings():
            # Pillow warns of large pictures, for which the limit below decides.
            warnings.simplefilter("ignore")
            with Image.open(io.BytesIO(data), formats=formats) as image:
                _check_size(path, image.size)
                image.load()
                return _to_rgb(_upright(image))
    except PhotoError:
        raise
    except Image.UnidentifiedImageError:
        raise PhotoError(
            f"{path} is no picture that can be read, whatever its name says; save it as PNG or JPEG"
        ) from None
    except Image.DecompressionBombError:
        raise PhotoError(_too_large(path, "over 179")) from None
    except MemoryError:
        raise PhotoError(f"{path} does not fit into memory; save a smaller copy") from None
    except Exception as error:
        # Decoders raise nearly anything on damaged data: OSError, SyntaxError, struct.error, ...
        raise PhotoError(
            f"{path} is damaged or cut off ({error}); get the file again, or save it anew as PNG"
        ) from None


def _check_size(path: Path, size: tuple[int, int]) -> None:
    width, height = size
    if width * height > MAX_PIXELS:
        raise PhotoError(_too_large(path, f"{width} x {height} pixels, {width * height / 1e6:.0f}"))
    if min(size) < MIN_SIDE_PX:
        raise PhotoError(
            f"{path}: {width} x {height} pixels is too small; "
            f"at least {MIN_SIDE_PX} pixels a side are needed"
        )


def _too_large(path: Path, megapixels: str) -> str:
    limit = MAX_PIXELS / 1e6
    return f"{path}: {megapixels} megapixels, at most {limit:.0f} are read; save a smaller copy"


def _upright(image: Image.Image) -> Image.Image:
    try:
        turned = ImageOps.exif_transpose(image)
    except Exception:
        return image  # EXIF data that cannot be read say nothing about the picture.
    return turned or image


def _to_rgb(image: Image.Image) -> Image.Image:
    if image.mode.startswith(("I", "F")):
        return Image.fromarray(_to_bytes(np.asarray(image))).convert("RGB")
    if image.has_transparency_data:
        image = image.convert("RGBA")
        white = Image.new("RGBA", image.size, "white")
        return Image.alpha_composite(white, image).convert("RGB")
    return image.convert("RGB")


def _to_bytes(values: np.ndarray) -> UInt8[np.ndarray, "height width"]:
    """Convert grey values of 16 or 32 bits, or of floats, to 8 bits.

    White is the full range of 16-bit integers, and 1 for floats that do not exceed it; of wider
    values, whose white is unknown, it is their maximum.
    """
    grey = np.nan_to_num(values.astype(np.float64), nan=0.0, posinf=0.0, neginf=0.0)
    top = float(grey.max())
    if np.issubdtype(values.dtype, np.floating):
        white = 1.0 if top <= 1.0 else max(255.0, top)
    else:
        white = max(65535.0, top)
    return np.clip(np.rint(grey * (255.0 / white)), 0, 255).astype(np.uint8)
