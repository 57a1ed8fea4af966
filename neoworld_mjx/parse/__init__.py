"""Step 1: a photograph becomes a scene tree."""

from .crops import Crop, crops
from .parse import Parsed, parse
from .photo import Photo, load_photo

__all__ = ["Crop", "Parsed", "Photo", "crops", "load_photo", "parse"]
