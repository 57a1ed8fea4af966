"""Keys of model servers, which are read only from the environment and removed from all output."""

import os
import re
from collections.abc import Iterable

from ..errors import ConfigError

_KEY_PATTERNS = re.compile(
    r"(?i)\bbearer\s+[^\s'\",;]+|\bsk-[A-Za-z0-9_-]{8,}|(?<=://)[^/@\s]+(?=@)"
)
_VARIABLE = re.compile(r"\$\{(\w+)\}")
_PLACEHOLDER = "[key]"


def environment_key(name: str) -> str | None:
    """Return the key in an environment variable; None if the variable is unset or blank."""
    return os.environ.get(name, "").strip() or None


def hide(text: str, secrets: Iterable[str]) -> str:
    """Replace the given secrets in a text by a placeholder."""
    for secret in sorted(secrets, key=len, reverse=True):
        if len(secret) >= 4:
            text = text.replace(secret, _PLACEHOLDER)
    return text


def scrub(text: str, secrets: Iterable[str]) -> str:
    """Replace the given secrets, and everything that looks like a key, by a placeholder."""
    return _KEY_PATTERNS.sub(_PLACEHOLDER, hide(text, secrets))


def expand(headers: dict[str, str]) -> tuple[dict[str, str], tuple[str, ...]]:
    """Replace ${NAME} in header values by environment variables.

    Returns:
        The headers to send, and the values of the variables, which must be kept secret.

    Raises:
        ConfigError: a variable is not set.
    """
    secrets: list[str] = []

    def fill(match: re.Match[str]) -> str:
        value = environment_key(match[1])
        if value is None:
            raise ConfigError(
                f"mllm.headers needs the environment variable {match[1]}, which is not set"
            )
        secrets.append(value)
        return value

    sent = {name: _VARIABLE.sub(fill, value) for name, value in headers.items()}
    return sent, tuple(secrets)
