"""Bounded readers of untrusted files, atomic writes, and names that are safe in paths and markup.

This package has one reader for each kind of file: text, JSON, YAML, arrays and images. The
readers of XML and meshes are in `export`. All readers open files with `files.read_bytes`, enforce
the limits of `FileOptions`, and report a file that they cannot read in a single message.
"""

from .binary_files import open_image, read_arrays, read_untrusted_bytes
from .limited_worker import bounded_by, file_bounds, set_file_bounds
from .text_files import read_json, read_model, read_object, read_untrusted_text

__all__ = [
    "bounded_by",
    "file_bounds",
    "open_image",
    "read_arrays",
    "read_json",
    "read_model",
    "read_object",
    "read_untrusted_bytes",
    "read_untrusted_text",
    "set_file_bounds",
]
