"""Errors that invalid input causes; messages state the problem, its location and valid choices."""

import difflib
import errno
import os
from collections.abc import Iterable


class NeoWorldError(Exception):
    """Base class of the errors that invalid input causes. The command line exits with code 2."""


class ConfigError(NeoWorldError):
    """Raised if a configuration file or an option is invalid."""


class PhotoError(NeoWorldError):
    """Raised if a photograph cannot be read or used."""


class EvidenceError(NeoWorldError):
    """Raised if a known camera, a depth image or masks cannot be read, or contradict the photo."""


class SpecError(NeoWorldError):
    """Raised if a scene tree, an object or a scene description is inconsistent."""


class ProgramError(NeoWorldError):
    """Raised if an object program is still invalid after all revisions."""


class ModelError(NeoWorldError):
    """Raised if a request to a multimodal model fails or has no valid response."""


class MissingResponseError(ModelError):
    """Raised if the recorded responses (tape) contain no response to a request."""


class BudgetError(ModelError):
    """Raised if a run reaches its cost cap. The run can be resumed with a higher cap."""


class EngineError(NeoWorldError):
    """Raised if a physics engine is unavailable or cannot simulate the scene."""


class ExportError(NeoWorldError):
    """Raised if a file cannot be written, or cannot be read back after writing."""


class RunError(NeoWorldError):
    """Raised if a run folder is in use, incomplete, not writable, or from another program."""


def expected_message(error: BaseException) -> str | None:
    """Return the message of an error that the input or the system caused, otherwise None."""
    if isinstance(error, NeoWorldError):
        return str(error)
    if isinstance(error, MemoryError):
        return "not enough memory: use fewer candidates, a shorter duration or a smaller image"
    return system_refusal(error) or mujoco_refusal(error)


_OPEN_FILES = {errno.EMFILE, errno.ENFILE}
_REFUSALS = _OPEN_FILES | {
    *(errno.ENAMETOOLONG, errno.ELOOP, errno.EACCES, errno.EPERM, errno.EROFS),
    *(errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO),
}


_MESSAGES = {
    "environment variable MUJOCO_GL": "MuJoCo accepts no such value of MUJOCO_GL; unset it",
    "can't start new thread": "the system starts no more threads; raise the limit (ulimit -u, -v)",
    "failed to map segment": "not enough memory to load a library; raise the limit (ulimit -v)",
    "annot allocate memory": "not enough memory to load a library; raise the limit (ulimit -v)",
}
"""Messages for errors of libraries that the environment causes, by a part of their text."""


def system_refusal(error: BaseException) -> str | None:
    """Return a message if the system or its environment caused an error, otherwise None.

    Such errors are not bugs of the package. They are due to invalid file names, missing
    permissions, full or failing disks, limits of the system, and environment variables.
    """
    for text, refusal in _MESSAGES.items():
        if isinstance(error, RuntimeError | ImportError) and text in str(error):
            return refusal
    if open_files_exhausted(error):
        return f"{os.strerror(errno.EMFILE)}; raise the limit, such as with ulimit -n 4096"
    if isinstance(error, OSError) and error.errno == errno.ENOENT and error.filename is None:
        return f"{error.strerror}; free some space, or set TMPDIR"  # From `tempfile`.
    if not isinstance(error, OSError) or error.errno not in _REFUSALS:
        return None
    path = "" if error.filename is None else f"cannot use {error.filename}: "
    return f"{path}{error.strerror}"


def mujoco_refusal(error: BaseException) -> str | None:
    """Return a message if MuJoCo gave up on a model (`mujoco.FatalError`), otherwise None."""
    if (type(error).__module__.split(".")[0], type(error).__name__) != ("mujoco", "FatalError"):
        return None
    reason = str(error).partition("\n")[0]
    return f"MuJoCo cannot simulate this: {reason}; {CROWDED}"


CROWDED = "move overlapping objects apart, or use fewer or simpler ones"
"""Remedy for a scene with more contacts than MuJoCo's memory holds."""


def open_files_exhausted(error: BaseException | None) -> bool:
    """Return True if too many open files caused an error, including errors of Rust libraries."""
    number = getattr(error, "errno", None)
    return number in _OPEN_FILES or f"(os error {errno.EMFILE})" in str(error)


MAX_CHOICES = 40
"""Largest number of valid names that an error message lists if it suggests a similar name."""


def choices(value: str, valid: Iterable[object]) -> str:
    """Return "got 'x', valid are: a, b, c; did you mean 'b'?" for an error message.

    If there are more than `MAX_CHOICES` names and one of them is similar to `value`, only the
    similar name is given.
    """
    names = list(map(str, valid))
    # A name that lacks only its unit, as sigma_yaw for sigma_yaw_deg, is meant.
    near = [name for name in names if value and name.startswith(value)]
    near = near[:1] or difflib.get_close_matches(value, names, n=1)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    if near and len(names) > MAX_CHOICES:
        return f"got {value!r}, which is none of {len(names)} names{hint}"
    return f"got {value!r}, valid are: {', '.join(names) or 'none'}{hint}"
