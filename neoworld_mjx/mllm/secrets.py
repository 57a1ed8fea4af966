"""Keys of model servers, which are read only from the environment and removed from all output."""

import os
import re
from collections.abc import Iterable

_KEY_PATTERNS = re.compile(
    r"(?i)\bbearer\s+[^\s'\",;]+|\bsk-[A-Za-z0-9_-]{8,}|(?<=://)[^/@\s]+(?=@)"
)
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
