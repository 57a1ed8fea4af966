"""Bounds of the files that come from outside."""

from ..options import Options, option


class FileOptions(Options):
    """Bounds of the files that are read: a file beyond them is refused by one message."""

    max_text_mib: int = option(
        64, "Largest file of text: JSON, tapes, XML, programs.", unit="MiB", ge=1, le=1024
    )
    max_values: int = option(4_000_000, "Most values in a JSON file.", ge=1000, le=100_000_000)
    max_depth: int = option(100, "Deepest nesting of JSON, YAML and XML.", ge=10, le=180)
    max_yaml_kib: int = option(256, "Largest YAML file.", unit="KiB", ge=1, le=4096)
    max_array_mib: int = option(
        256, "Most memory of the arrays in an .npz file.", unit="MiB", ge=1, le=16384
    )
    timeout_s: float = option(
        8.0,
        "Time for another library to read a file that could make it work for hours.",
        unit="s",
        gt=0,
    )
    max_mesh_mib: int = option(64, "Largest mesh file.", unit="MiB", ge=1, le=1024)
    max_picture_mib: int = option(512, "Largest picture file.", unit="MiB", ge=1, le=4096)
    max_picture_mpx: int = option(
        134,
        "Most pixels of a picture; the largest common phone pictures have 108 megapixels.",
        unit="MP",
        ge=1,
        le=1000,
    )
