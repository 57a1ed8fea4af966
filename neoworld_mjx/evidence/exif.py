"""Focal length of a photograph from its EXIF data."""

import math
from pathlib import Path

from PIL import Image

from ..errors import EvidenceError, PhotoError
from ..io import open_image, read_untrusted_bytes
from .known_camera import KnownCamera

EXIF_SD = 0.03
"""Standard deviation of the logarithm of a focal length from EXIF: crops, zoom and rounding."""
EXIF_FOLDER, FOCAL_35MM, WIDTH, HEIGHT = 0x8769, 0xA405, 0xA002, 0xA003
FILM_MM = math.hypot(36, 24)
"""Diagonal of 35 mm film [mm]."""
VALID_MM = (8.0, 800.0)
"""Valid equivalent focal lengths [mm]."""
CROPPED = 0.02
"""Difference of the aspect ratio from that in the EXIF data above which a photograph is cropped."""


def exif_camera(photo: Path, size: tuple[int, int]) -> KnownCamera | None:
    """Return the camera that the EXIF data of a photograph state; None if they state none.

    The focal length in pixels is f35 * diagonal / 43.27, where f35 is FocalLengthIn35mmFilm.

    Args:
        photo: the image file.
        size: width and height of the upright photograph [px].

    Raises:
        PhotoError: the file cannot be read.
        EvidenceError: the photograph is a crop of the one that the EXIF data describe.
    """
    data = read_untrusted_bytes(photo, PhotoError)
    with open_image(data, str(photo), PhotoError, large=True) as image:
        tags = _tags(image)
    focal, width, height = (tags.get(tag, math.nan) for tag in (FOCAL_35MM, WIDTH, HEIGHT))
    if not VALID_MM[0] <= focal <= VALID_MM[1]:
        return None
    if width > 0 and height > 0:
        taken, shown = max(width, height) / min(width, height), max(size) / min(size)
        if abs(taken / shown - 1) > CROPPED:
            raise EvidenceError(
                f"the EXIF data of {photo.name} are for {width:.0f} x {height:.0f} pixels: it is "
                f"cropped to {size[0]} x {size[1]}"
            )
    pixels = focal * math.hypot(*size) / FILM_MM
    return KnownCamera(
        size, focal=pixels, focal_sd=EXIF_SD, source=f"EXIF of {photo.name} ({focal:g} mm)"
    )


def _tags(image: Image.Image) -> dict[int, float]:
    """Return the numbers of the tags that this module reads."""
    tags: dict[int, float] = {}
    try:
        folder = image.getexif().get_ifd(EXIF_FOLDER)
        for tag in (FOCAL_35MM, WIDTH, HEIGHT):
            if tag in folder and math.isfinite(float(folder[tag])):
                tags[tag] = float(folder[tag])
    except Exception:
        return {}  # Unreadable EXIF data state nothing.
    return tags
