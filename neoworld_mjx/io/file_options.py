"""Limits for untrusted files, and the limits that are active in the current context."""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from ..options import Options, option


class FileOptions(Options):
    """Options that limit input files. A file that exceeds a limit is rejected with an error."""

    max_text_mib: int = option(
        64,
        "Maximum size of a text file: JSON, tape, XML or program.",
        unit="MiB",
        ge=1,
        le=1024,
    )
    max_values: int = option(
        4_000_000, "Maximum number of values in a JSON file.", ge=1000, le=100_000_000
    )
    max_depth: int = option(100, "Maximum nesting depth of JSON, YAML and XML.", ge=10, le=180)
    max_yaml_kib: int = option(256, "Maximum size of a YAML file.", unit="KiB", ge=1, le=4096)
    max_array_mib: int = option(
        256,
        "Maximum memory of the arrays in an .npz file.",
        unit="MiB",
        ge=1,
        le=16384,
    )
    timeout_s: float = option(
        8.0,
        "Processor time limit of the worker process that reads an asset, a large image or a "
        "Parquet table.",
        unit="s",
        gt=0,
        le=86400,
    )
    memory_mib: int = option(
        500,
        "Memory limit of the worker process on Linux: the address space that it may allocate after "
        "it is forked.",
        unit="MiB",
        ge=64,
        le=65536,
    )
    decompose_s: float = option(
        120.0,
        "Time limit for decomposing all meshes of an asset into convex pieces, within "
        "`memory_mib`; the remaining meshes are replaced by their convex hulls.",
        unit="s",
        gt=0,
        le=86400,
    )
    max_mesh_mib: int = option(64, "Maximum size of a mesh file.", unit="MiB", ge=1, le=1024)
    max_picture_mib: int = option(256, "Maximum size of an image file.", unit="MiB", ge=1, le=4096)
    max_picture_mpx: int = option(
        134,
        "Maximum number of pixels of a photograph; common phone cameras reach 108 megapixels. "
        "A large photograph in a format other than JPEG reaches the limit `memory_mib` first.",
        unit="MP",
        ge=1,
        le=1000,
    )


_DEFAULTS = FileOptions()
_active: ContextVar[FileOptions] = ContextVar("file_bounds", default=_DEFAULTS)


def file_bounds() -> FileOptions:
    """Return the active limits: the limits of the current run, or the defaults."""
    return _active.get()


def set_file_bounds(options: FileOptions) -> None:
    """Activate limits in the current context, as the command line does."""
    _active.set(options)


@contextmanager
def bounded_by(options: FileOptions) -> Iterator[None]:
    """Activate limits for the duration of a `with` block."""
    token = _active.set(options)
    try:
        yield
    finally:
        _active.reset(token)
