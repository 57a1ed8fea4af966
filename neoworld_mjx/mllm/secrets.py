"""Keys stay where they are: they are taken from the environment and never shown."""

import os
import re
from collections.abc import Iterable

from ..errors import ConfigError

_SHAPES = re.compile(r"(?i)\bbearer\s+[^\s'\",;]+|\bsk-[A-Za-z0-9_-]{8,}|(?<=://)[^/@\s]+(?=@)")
_VARIABLE = re.compile(r"\$\{(\w+)\}")
_SHOWN = "[key]"


def environment_key(name: str) -> str | None:
    """Return the key in an environment variable; empty and blank count as absent."""
    return os.environ.get(name, "").strip() or None


def hide(text: str, secrets: Iterable[str]) -> str:
    """Replace given secrets by a placeholder and leave everything else as it is."""
    for secret in sorted(secrets, key=len, reverse=True):
        if len(secret) >= 4:
            text = text.replace(secret, _SHOWN)
    return text


def scrub(text: str, secrets: Iterable[str]) -> str:
    """Replace given secrets, and whatever looks like a key, by a placeholder; for messages."""
    return _SHAPES.sub(_SHOWN, hide(text, secrets))


def expand(headers: dict[str, str]) -> tuple[dict[str, str], tuple[str, ...]]:
    """Fill ${NAME} in header values from the environment.

    Returns:
        The headers to send, and the filled-in texts, which must not be shown.

    Raises:
        ConfigError: a variable is not set.
    """
    filled: list[str] = []

    def fill(match: re.Match[str]) -> str:
        value = environment_key(match[1])
        if value is None:
            raise ConfigError(
                f"mllm.headers needs the environment variable {match[1]}, which is not set"
            )
        filled.append(value)
        return value

    sent = {name: _VARIABLE.sub(fill, value) for name, value in headers.items()}
    return sent, tuple(filled)
