"""Choosing who answers: a server's API, a tape, or a mailbox."""

import importlib.util
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import get_args

from ..config import MLLMOptions, Role
from ..errors import ConfigError, MissingAnswerError, ModelError, choices
from .ledger import Ledger
from .mailbox import Mailbox
from .model import Provider
from .panel import Panel
from .replay import SUFFIX, Replay, find_tape
from .secrets import environment_key

PROVIDERS = ("auto", "anthropic", "openai", "replay", "mailbox")


def bundled_tapes() -> Path:
    """Return the folder of the tapes that ship with the package."""
    return Path(str(resources.files("neoworld_mjx") / "data" / "tapes"))


def open_panel(
    options: MLLMOptions,
    provider: str = "auto",
    *,
    photo: str | None = None,
    tapes: Sequence[Path] = (),
    mailbox: Path | None = None,
    mailbox_timeout_s: float | None = None,
    record: Path | None = None,
    made: str = "",
    ledger: Ledger | None = None,
) -> Panel:
    """Open the panel of models for a run.

    `auto` takes a key from the environment, else a tape for this very photo. OPENAI_API_KEY counts
    as a key when the extra `openai` is installed and no role's model is one of Anthropic's.

    Args:
        options: models, limits and cap.
        provider: auto, anthropic, openai, replay or mailbox.
        photo: sha256 of the photo's file, by which tapes are found.
        tapes: folders of tapes, or tapes, searched before those that ship with the package.
        mailbox: folder of the mailbox; needed for `mailbox`.
        mailbox_timeout_s: how long a request waits in the mailbox, in seconds; None: for ever.
        record: tape file to record on and to take earlier answers from.
        made: how the answers come about, for the recorded tape.
        ledger: the books of the run, such as those of the run that is resumed.

    Raises:
        ConfigError: the provider is unknown, or needs something that is not given.
        MissingAnswerError: `replay` finds no tape for this photo.
        ModelError: there is no key and no tape, or the chosen provider cannot be used.
    """
    if provider not in PROVIDERS:
        raise ConfigError(f"provider: {choices(provider, PROVIDERS)}")
    places = [*map(Path, tapes), bundled_tapes()]
    if provider == "auto":
        chosen = _automatic(options, photo, places)
    elif provider == "replay":
        chosen = _replay(photo, places)
    elif provider == "mailbox":
        if mailbox is None:
            raise ConfigError("provider mailbox needs a folder for its requests")
        chosen = Mailbox(mailbox, timeout_s=mailbox_timeout_s)
    else:
        chosen = _server(provider, options)
    return Panel(chosen, options, ledger=ledger, record=record, photo=photo, made=made)


def _automatic(options: MLLMOptions, photo: str | None, places: list[Path]) -> Provider:
    if environment_key("ANTHROPIC_API_KEY"):
        return _server("anthropic", options)
    openai_key = environment_key("OPENAI_API_KEY") is not None
    if openai_key and _has_openai() and not _claude_models(options):
        return _server("openai", options)
    found = find_tape(photo, places)
    if found is not None:
        return Replay(*found)
    raise ModelError(_ways_on(openai_key, options))


def _ways_on(openai_key: bool, options: MLLMOptions) -> str:
    lines = [
        "no key in the environment and no tape for this photo. Ways to go on:",
        "  - set ANTHROPIC_API_KEY",
        "  - set OPENAI_API_KEY, install the extra (pip install 'neoworld-mjx[openai]') and name "
        "its models in the config (mllm.reasoner.model, ...)",
        "  - run a local model: --provider anthropic or openai with mllm.base_url in the config",
        "  - answer yourself: --provider mailbox",
        f"  - give a tape (*{SUFFIX}) that was recorded for this very file: --provider replay",
    ]
    if openai_key:
        lacking = [] if _has_openai() else ["the extra 'openai' is not installed"]
        if _claude_models(options):
            lacking.append("roles still name models of Anthropic")
        lines[0] = (
            f"OPENAI_API_KEY is set, but {' and '.join(lacking)}; no other key and no tape for "
            f"this photo. Ways to go on:"
        )
    return "\n".join(lines)


def _replay(photo: str | None, places: list[Path]) -> Provider:
    found = find_tape(photo, places)
    if found is None:
        searched = ", ".join(str(place) for place in places)
        raise MissingAnswerError(
            f"no tape was recorded for this photo (sha256 {(photo or 'unknown')[:16]}); searched "
            f"{searched}. Use the very file that the tape was made for, name a tape, or choose "
            f"another provider: {', '.join(PROVIDERS)}"
        )
    return Replay(*found)


def _server(provider: str, options: MLLMOptions) -> Provider:
    # Imported late: the SDKs take a second to load and a tape needs neither.
    if provider == "anthropic":
        from .anthropic import Anthropic

        return Anthropic(options)
    from .openai import OpenAI

    return OpenAI(options)


def _has_openai() -> bool:
    return importlib.util.find_spec("openai") is not None


def _claude_models(options: MLLMOptions) -> bool:
    return any(getattr(options, role).model.startswith("claude") for role in get_args(Role))
