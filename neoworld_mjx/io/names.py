"""Names and texts from models and strangers, before they become paths, markup or identifiers."""

import re
import unicodedata
from collections.abc import Container

MAX_NAME = 48
NAME_RULE = f"letters, digits and underscores, a letter first, at most {MAX_NAME}"
_NAME = re.compile(rf"[A-Za-z][A-Za-z0-9_]{{0,{MAX_NAME - 1}}}")
_HIDDEN = {"Cc", "Cf", "Co", "Cs"}
"""Categories of control and formatting characters, such as those that turn the reading direction,
of private ones and of halves of characters."""


def is_name(text: str) -> bool:
    """Tell whether a text can stand as an identifier, a file and an element of every format."""
    return _NAME.fullmatch(text) is not None


def identifier(text: str, kind: str, taken: Container[str] = ()) -> str:
    """Return a name, see `is_name`, that resembles a text.

    Args:
        text: any text.
        kind: a name that stands for an empty one; its first letter is put before digits.
        taken: names that others have.
    """
    plain = re.sub(r"[^A-Za-z0-9_]", "_", text[:MAX_NAME])[: MAX_NAME - 4] or kind
    if not plain[0].isalpha():
        plain = f"{kind[0]}_{plain}"[: MAX_NAME - 4]
    name, count = plain, 1
    while name in taken:
        ending = f"_{count}"
        name, count = plain[: MAX_NAME - len(ending)] + ending, count + 1
    return name


def file_name(text: str, most: int = 60) -> str:
    """Return a file's name that resembles a text; empty if nothing of it can stay."""
    return re.sub(r"[^A-Za-z0-9._]+", "-", text[: 4 * most]).strip("-.")[:most].rstrip("-.")


def plain_text(text: str, most: int) -> str:
    """Return a text in one line of at most `most` characters, without hidden characters."""
    kept = (" " if c.isspace() else c for c in text[: 4 * most])
    shown = "".join(c for c in kept if unicodedata.category(c) not in _HIDDEN)
    line = " ".join(shown.split())
    return line if len(line) <= most else line[: most - 1] + "…"


def printable(text: str) -> str:
    """Return a text for a terminal: hidden characters but line breaks and tabs as escapes."""
    if text.isprintable():
        return text
    return "".join(
        c
        if c in "\n\t" or unicodedata.category(c) not in _HIDDEN
        else c.encode("unicode_escape").decode("ascii")
        for c in text
    )
