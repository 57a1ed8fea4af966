"""Untrusted strings as safe identifiers, file names and lines."""

import re
import unicodedata
from collections import Counter
from collections.abc import Iterable

MAX_NAME = 48
NAME_RULE = f"letters, digits and underscores, a letter first, at most {MAX_NAME}"
RESERVED = frozenset({"world"})
"""Names that MuJoCo reserves; an object cannot have one of them."""
UNIQUE = "names must be unique, ignoring case; repeated"
_NAME = re.compile(rf"[A-Za-z][A-Za-z0-9_]{{0,{MAX_NAME - 1}}}")
_HIDDEN = {"Cc", "Cf", "Co", "Cs"}
"""Unicode categories of control characters, formatting characters (for example, characters that
change the reading direction), private-use characters and surrogates."""


def is_name(text: str) -> bool:
    """Return True if a string is a valid identifier, file name and element name in all formats."""
    return _NAME.fullmatch(text) is not None


def identifier(text: str, kind: str, taken: Iterable[str] = ()) -> str:
    """Return a valid name (see `is_name`) that resembles a string.

    Args:
        text: any string.
        kind: kind of the named element. It replaces an empty string, and its first letter and "_"
            are prepended to a string that does not start with a letter.
        taken: names that must not be returned, in either case. If `kind` is "object", the names of
            `RESERVED` are not returned either.
    """
    plain = re.sub(r"[^A-Za-z0-9_]", "_", text[:MAX_NAME])[: MAX_NAME - 4] or kind
    if not plain[0].isalpha():
        plain = f"{kind[0]}_{plain}"[: MAX_NAME - 4]
    used = {*map(str.lower, taken), *(RESERVED if kind == "object" else ())}
    name, count = plain, 1
    while name.lower() in used:
        ending = f"_{count}"
        name, count = plain[: MAX_NAME - len(ending)] + ending, count + 1
    return name


def unused(name: str, taken: Iterable[str]) -> str:
    """Append underscores to a name until it is not taken, in either case."""
    used = {*map(str.lower, taken)}
    while name.lower() in used:
        name += "_"
    return name


def repeated(names: Iterable[str]) -> list[str]:
    """Return the names that occur more than once, sorted.

    Names that differ only in case are the same file on disks that ignore case.
    """
    names = list(names)
    counts = Counter(map(str.lower, names))
    return sorted({name for name in names if counts[name.lower()] > 1})


def file_name(text: str, length: int = 60) -> str:
    """Return a file name (may be empty) of at most `length` characters that resembles a string."""
    return re.sub(r"[^A-Za-z0-9._]+", "-", text[: 4 * length]).strip("-.")[:length].rstrip("-.")


def plain_text(text: str, length: int) -> str:
    """Return a string as one line of at most `length` characters, without hidden characters."""
    spaced = (" " if c.isspace() else c for c in text[: 4 * length])
    line = " ".join("".join(c for c in spaced if unicodedata.category(c) not in _HIDDEN).split())
    return line if len(line) <= length else line[: length - 1] + "…"


def printable(text: str) -> str:
    """Escape the hidden characters of a string, except line breaks and tabs, for a terminal."""
    if text.isprintable():
        return text
    return "".join(
        c
        if c in "\n\t" or unicodedata.category(c) not in _HIDDEN
        else c.encode("unicode_escape").decode("ascii")
        for c in text
    )
