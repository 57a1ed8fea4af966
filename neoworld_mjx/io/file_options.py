"""Limits for untrusted files, and the limits that are active in the current context."""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from ..options import Options, option


class FileOptions(Options):
    """Options that limit input files. A file that exceeds a limit is rejected with an error."""

    max_file_mib: int = option(
        256,
        "Maximum size of a file, and of the arrays in an .npz file after unpacking.",
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
