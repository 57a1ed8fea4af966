"""Step 1: a photograph becomes a scene tree."""

from .crops import Crop, crops
from .parse import Parsed, parse
from .photo import Photo, load_photo
from .support_colours import SupportColour, support_colours

__all__ = [
    "Crop",
    "Parsed",
    "Photo",
    "SupportColour",
    "crops",
    "load_photo",
    "parse",
    "support_colours",
]
