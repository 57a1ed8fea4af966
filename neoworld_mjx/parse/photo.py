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
from ..io.binary_files import PLAIN_MPX
from ..io.files import MIB, read_bytes
from ..io.limited_worker import call_limited

MIN_SIDE_PX = 16
MODEL_MIN_SIDE_PX = 512
"""Minimum length of the longer side of a picture that models receive [px]."""
DRAFT_MPX = 40
"""Number of megapixels above which a JPEG is decoded at half its size."""


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
        # White is 65535 for integers, 1 for floats that do not exceed 1, and 255 for other floats.
        values = np.asarray(image, np.float32)
        values = np.nan_to_num(values, nan=0.0, posinf=0.0, neginf=0.0)
        white = 65535.0 if image.mode[0] == "I" else 1.0 if values.max() <= 1.0 else 255.0
        grey = np.clip(np.rint(values * (255.0 / white)), 0, 255).astype(np.uint8)
        return Image.fromarray(grey).convert("RGB")
    if image.has_transparency_data:
        image = image.convert("RGBA")
        white = Image.new("RGBA", image.size, "white")
        return Image.alpha_composite(white, image).convert("RGB")
    return image.convert("RGB")


def enlarged(rgb: UInt8[np.ndarray, "h w 3"], least: int, most: int = 8) -> np.ndarray:
    """Enlarge a picture by an integer factor until its longer side has at least `least` pixels.

    Interpolation is linear, so edges become smooth ramps without overshoot.

    Args:
        rgb: the picture [h, w, 3].
        least: minimum length of the longer side [px].
        most: maximum factor.

    Returns:
        The picture, uint8 of shape [k h, k w, 3] with an integer factor k. If the picture is large
        enough, k is 1.
    """
    factor = min(-(-least // max(rgb.shape[:2])), most)
    if factor <= 1:
        return rgb
    return _stretch(_stretch(rgb, factor, 0), factor, 1)


def _stretch(rgb: np.ndarray, factor: int, axis: int) -> np.ndarray:
    """Stretch one axis by linear interpolation between pixel centers, in integer arithmetic."""
    count = rgb.shape[axis]
    # Unit: 1 / (2 factor) pixels; origin: the center of the first pixel.
    position = 2 * np.arange(count * factor) + 1 - factor
    lower = position // (2 * factor)
    weight = position - 2 * factor * lower
    shape = [1, 1, 1]
    shape[axis] = -1
    first = np.take(rgb, np.clip(lower, 0, count - 1), axis).astype(np.int32)
    second = np.take(rgb, np.clip(lower + 1, 0, count - 1), axis).astype(np.int32)
    upper_weight = weight.reshape(shape)
    mixed = (first * (2 * factor - upper_weight) + second * upper_weight + factor) // (2 * factor)
    return mixed.astype(np.uint8)
