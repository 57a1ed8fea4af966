"""Errors a user can act on. Each message names what is wrong, where, and the valid choices."""


class NeoWorldError(Exception):
    """Base of every error the package raises on purpose; the command line turns it into exit 2."""


class ConfigError(NeoWorldError):
    """A configuration file or option is wrong."""


class PhotoError(NeoWorldError):
    """The photograph cannot be read or is not usable."""


class SpecError(NeoWorldError):
    """A scene tree, object or scene description is inconsistent."""


class ProgramError(NeoWorldError):
    """An object program could not be turned into an object within its rounds."""


class ModelError(NeoWorldError):
    """A multimodal model could not be asked, or gave no valid answer."""

    texts: tuple[str, ...] = ()
    """The answers that could not be used, as they came, without keys."""


class MissingResponseError(ModelError):
    """A tape holds no answer for a request."""


class BudgetError(ModelError):
    """The cost cap of a run is reached; the run can be resumed with a higher one."""


class EngineError(NeoWorldError):
    """A physics engine cannot run here or cannot carry this scene."""


class ExportError(NeoWorldError):
    """A file could not be written, or could not be read back."""


class RunError(NeoWorldError):
    """A run folder cannot be used: in use, foreign, incomplete or not writable."""


MAX_CHOICES = 40
"""Most names that an error message lists beside a near one."""


def choices(given: str, valid: object) -> str:
    """Phrase "got 'x', valid are a, b, c; did you mean 'b'?" for an error message.

    Of very many names only the nearest is told, if there is a near one.
    """
    import difflib

    names = [str(name) for name in valid]  # pyright: ignore[reportGeneralTypeIssues]
    near = difflib.get_close_matches(given, names, n=1)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    if near and len(names) > MAX_CHOICES:
        return f"got {given!r}, which is none of {len(names)} names{hint}"
    return f"got {given!r}, valid are: {', '.join(names) or 'none'}{hint}"
