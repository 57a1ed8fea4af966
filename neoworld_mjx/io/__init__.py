"""Readers of files from outside: regular files within bounds, one message if they do not fit.

There is one for each kind: JSON, text, arrays and pictures here, YAML in `config`, XML and meshes
in `export`; all open files by `neoworld_mjx.io.files.read_bytes`.
"""

from .array_files import read_arrays
from .bounds import bounded_by, bounds_of_files, keep_bounds
from .json_files import read_json, read_model, read_object
from .picture_files import PICTURE_FORMATS, open_picture
from .text_files import read_outside_text

__all__ = [
    "PICTURE_FORMATS",
    "bounded_by",
    "bounds_of_files",
    "keep_bounds",
    "open_picture",
    "read_arrays",
    "read_json",
    "read_model",
    "read_object",
    "read_outside_text",
]
