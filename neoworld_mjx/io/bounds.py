"""The bounds of files that hold in this context."""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from .file_options import FileOptions

_DEFAULTS = FileOptions()
_bounds: ContextVar[FileOptions | None] = ContextVar("bounds_of_files", default=None)


def bounds_of_files() -> FileOptions:
    """Return the bounds that hold: those of the run, or the defaults."""
    return _bounds.get() or _DEFAULTS


@contextmanager
def bounded_by(options: FileOptions) -> Iterator[None]:
    """Let other bounds hold."""
    token = _bounds.set(options)
    try:
        yield
    finally:
        _bounds.reset(token)


def keep_bounds(options: FileOptions) -> None:
    """Let other bounds hold from now on in this context, as the command line does."""
    _bounds.set(options)
