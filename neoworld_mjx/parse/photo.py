"""Photographs as upright 8-bit RGB, from every format that Pillow decodes.

`load_photo` rotates a picture by its EXIF data, blends transparent pixels with white, converts it
to 8-bit RGB, and resizes it for the models. After Step 1, pixel coordinates refer to the upright
original; `Photo.scale` converts them to the resized picture. Embedded color profiles are ignored,
so a file gives the same pixels on every machine.

The header of a file is read first, and a file that could exhaust the memory is rejected before any
pixel is decoded. A large picture is decoded in a worker process with limited memory.
"""

import hashlib
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image, ImageOps

from ..errors import PhotoError
from ..io import file_bounds, open_image
from ..io.files import MIB, read_bytes
from ..io.image_files import PLAIN_MPX
from ..io.limited_worker import call_limited
from .enlarge import enlarged

MIN_SIDE_PX = 16
DRAFT_MPX = 40
"""Number of megapixels above which a JPEG is decoded at half its size."""
_ROWS = 256
"""Number of rows that are converted to 8 bits at once."""


@dataclass(frozen=True)
class Photo:
    """A photograph in the size that models receive."""

    rgb: UInt8[np.ndarray, "height width 3"] = field(repr=False)
    """The resized picture, shape [height, width, 3]."""
    original_size: tuple[int, int]
    """Width and height of the upright original, in pixels."""
    sha256: str
    """sha256 of the file."""
    path: Path

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the resized picture, in pixels."""
        return self.rgb.shape[1], self.rgb.shape[0]

    @property
    def scale(self) -> float:
        """Longer side of the resized picture divided by that of the original."""
        return max(self.size) / max(self.original_size)


def load_photo(path: Path, max_side_px: int = 1568, min_side_px: int = 1) -> Photo:
    """Read a photograph; if a file has several images (frames or pages), read the first one.

    Args:
        path: the image file.
        max_side_px: maximum length of the resized picture's longer side [px].
        min_side_px: minimum length of the longer side [px]. A smaller picture is enlarged by an
            integer factor, as far as `max_side_px` permits.

    Raises:
        PhotoError: the file is missing, not a picture, damaged, too small (under 16 pixels a side),
            or larger than `files` of the configuration allows.
    """
    path = Path(path)
    data = _read(path)
    with open_image(data, str(path), PhotoError, large=True) as image:
        width, height = image.size
    digest = hashlib.sha256(data).hexdigest()
    if width * height <= PLAIN_MPX * 1_000_000:
        rgb, original = _resized(path, max_side_px)
    else:
        del data
        rgb, original = call_limited(_resized, path, max_side_px, error=PhotoError)
    factor = max(1, max_side_px // max(rgb.shape[:2]))
    rgb = enlarged(rgb, min_side_px, factor)
    rgb.flags.writeable = False
    return Photo(rgb, original, digest, path)


def _resized(path: Path, max_side_px: int) -> tuple[UInt8[np.ndarray, "h w 3"], tuple[int, int]]:
    """Return the pixels of a photograph, at most `max_side_px` long, and the original size."""
    image, original = _decode(path, _read(path))
    longest = max(original)
    if longest > max_side_px:
        size = (
            max(1, round(original[0] * max_side_px / longest)),
            max(1, round(original[1] * max_side_px / longest)),
        )
        if min(size) < MIN_SIDE_PX:
            raise PhotoError(
                f"{path}: {original[0]} x {original[1]} pixels is too long and narrow: shrunk to "
                f"{max_side_px} pixels its short side is under {MIN_SIDE_PX}; crop it"
            )
        image = image.resize(size, Image.Resampling.LANCZOS)
    return np.array(image), original


def _read(path: Path) -> bytes:
    try:
        if path.is_dir():
            raise PhotoError(f"{path} is a folder; give the file of one photograph")
        if not path.exists():
            raise PhotoError(f"{path}: no such file; check the path of the photograph")
        return read_bytes(path, file_bounds().max_file_mib * MIB)
    except OSError as error:
        raise PhotoError(
            f"cannot read {path}: {error.strerror}; give the file of one photograph"
        ) from None


def _decode(path: Path, data: bytes) -> tuple[Image.Image, tuple[int, int]]:
    """Return the upright picture in mode RGB, and the size of the upright original."""
    with open_image(data, str(path), PhotoError, large=True) as image:
        width, height = image.size
        if min(image.size) < MIN_SIDE_PX:
            raise PhotoError(
                f"{path}: {width} x {height} pixels is too small; "
                f"at least {MIN_SIDE_PX} pixels a side are needed"
            )
        if width * height > DRAFT_MPX * 1_000_000:
            # The JPEG decoder can halve the size of a picture while decoding.
            image.draft("RGB", (width // 2, height // 2))
        image.load()
        upright = _upright(image)
        transposed = (upright.size[0] > upright.size[1]) != (image.size[0] > image.size[1])
        return _to_rgb(upright), (height, width) if transposed else (width, height)


def _upright(image: Image.Image) -> Image.Image:
    try:
        transposed = ImageOps.exif_transpose(image)
    except Exception:
        return image  # Ignore unreadable EXIF data.
    return transposed or image


def _to_rgb(image: Image.Image) -> Image.Image:
    if image.mode.startswith(("I", "F")):
        return Image.fromarray(_to_bytes(np.asarray(image))).convert("RGB")
    if image.has_transparency_data:
        image = image.convert("RGBA")
        white = Image.new("RGBA", image.size, "white")
        return Image.alpha_composite(white, image).convert("RGB")
    return image.convert("RGB")


def _to_bytes(values: np.ndarray) -> UInt8[np.ndarray, "height width"]:
    """Convert gray values of 16 or 32 bits, or floats, to 8 bits.

    The value of white is 65535 for integers, 1 for floats that do not exceed 1, and 255 for other
    floats. If the maximum of the picture is larger than 65535 or 255, the maximum is white.
    """
    blocks = range(0, len(values), _ROWS)
    top = max(float(_grey(values[row : row + _ROWS]).max()) for row in blocks)
    if np.issubdtype(values.dtype, np.floating):
        white = 1.0 if top <= 1.0 else max(255.0, top)
    else:
        white = max(65535.0, top)
    result = np.empty(values.shape, np.uint8)
    for row in blocks:
        grey = _grey(values[row : row + _ROWS]) * (255.0 / white)
        result[row : row + _ROWS] = np.clip(np.rint(grey), 0, 255)
    return result


def _grey(values: np.ndarray) -> np.ndarray:
    return np.nan_to_num(values.astype(np.float64), nan=0.0, posinf=0.0, neginf=0.0)
