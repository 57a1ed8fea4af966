"""Text of a file from outside."""

from pathlib import Path

from ..errors import NeoWorldError
from .bounds import bounds_of_files
from .files import MIB, read_text


def read_outside_text(path: Path, error: type[NeoWorldError], kind: str = "") -> str:
    """Read a text file.

    Args:
        path: the file.
        error: class of the error to raise.
        kind: of the file, for the message, such as "tape".

    Raises:
        NeoWorldError: of the class `error`: it is missing, no regular file, too large or no text.
    """
    try:
        return read_text(Path(path), bounds_of_files().max_text_mib * MIB)
    except OSError as problem:
        raise error(f"cannot read {kind}{' ' * bool(kind)}{path}: {problem.strerror}") from None
