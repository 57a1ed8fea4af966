"""Errors caused by the input; each message states the problem, its location and valid choices."""

import difflib
import errno
import os
from collections.abc import Iterable


class NeoWorldError(Exception):
    """Base of the errors that the package raises on invalid input, with exit code 2."""


class ConfigError(NeoWorldError):
    """Invalid configuration file or option."""


class PhotoError(NeoWorldError):
    """Unreadable or unusable photograph."""


class SpecError(NeoWorldError):
    """Inconsistent scene tree, object or scene description."""


class ProgramError(NeoWorldError):
    """Object program that is still invalid after all revisions."""


class ModelError(NeoWorldError):
    """Failed request to a multimodal model, or one without a valid response."""

    texts: tuple[str, ...] = ()
    """Invalid responses as received, without API keys."""


class MissingResponseError(ModelError):
    """Request without a response in the tape."""


class BudgetError(ModelError):
    """Reached cost cap of a run; the run can be resumed with a higher cap."""


class EngineError(NeoWorldError):
    """Physics engine that is unavailable or cannot simulate the scene."""


class ExportError(NeoWorldError):
    """File that cannot be written, or read back after writing."""


class RunError(NeoWorldError):
    """Run folder that cannot be used: in use, of another program, incomplete or not writable."""


_OPEN_FILES = {errno.EMFILE, errno.ENFILE}
_REFUSALS = _OPEN_FILES | {
    *(errno.ENAMETOOLONG, errno.ELOOP, errno.EACCES, errno.EPERM, errno.EROFS),
    *(errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO),
}


def system_refusal(error: BaseException) -> str | None:
    """Return the message of an error of the system that no code causes, otherwise None.

    These are refused names and permissions, full or failing disks, and limits.
    """
    if open_files_exhausted(error):
        return f"{os.strerror(errno.EMFILE)}; raise the limit, such as with ulimit -n 4096"
    if isinstance(error, OSError) and error.errno == errno.ENOENT and error.filename is None:
        return f"{error.strerror}; free some space, or set TMPDIR"  # Of `tempfile`.
    if not isinstance(error, OSError) or error.errno not in _REFUSALS:
        return None
    path = "" if error.filename is None else f"cannot use {error.filename}: "
    return f"{path}{error.strerror}"


def open_files_exhausted(error: BaseException | None) -> bool:
    """Return True if an error, also one of a library in Rust, is the limit of open files."""
    number = getattr(error, "errno", None)
    return number in _OPEN_FILES or f"(os error {errno.EMFILE})" in str(error)


MAX_CHOICES = 40
"""Maximum number of names that an error message lists next to a suggestion."""


def choices(value: str, valid: Iterable[object]) -> str:
    """Return "got 'x', valid are: a, b, c; did you mean 'b'?" for an error message.

    If there are more than `MAX_CHOICES` names and one is similar, only that one is listed.
    """
    names = list(map(str, valid))
    near = difflib.get_close_matches(value, names, n=1)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    if near and len(names) > MAX_CHOICES:
        return f"got {value!r}, which is none of {len(names)} names{hint}"
    return f"got {value!r}, valid are: {', '.join(names) or 'none'}{hint}"
