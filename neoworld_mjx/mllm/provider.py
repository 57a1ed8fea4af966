"""Providers of responses, and the function that opens a panel with one of them."""

from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import get_args

from ..config import MLLMOptions, Role
from ..errors import ConfigError, MissingResponseError, ModelError, choices
from .mailbox import Mailbox
from .panel import Panel, environment_key
from .replay import SUFFIX, Replay, find_tape
from .requests import Provider

PROVIDERS = ("auto", "anthropic", "openai", "replay", "mailbox")
"""Names of the providers of responses."""


def open_panel(
    options: MLLMOptions,
    provider: str = "auto",
    *,
    photo: str | None = None,
    tapes: Sequence[Path] = (),
    mailbox: Path | None = None,
    record: Path | None = None,
    made: str = "",
) -> Panel:
    """Open the panel of models for a run.

    `auto` uses a key from the environment. If there is no key, it replays the recorded responses (a
    tape) of this photo. OPENAI_API_KEY is used only if no role uses a model of Anthropic.

    Args:
        options: models, limits and cap.
        provider: a name from `PROVIDERS`.
        photo: sha256 of the photo's file, by which its tape is found.
        tapes: tapes and folders of tapes, searched before the tapes of the package.
        mailbox: folder of the mailbox; required for the provider `mailbox`.
        record: tape file. New responses are written to it, and recorded responses are reused.
        made: origin of the responses, written to the recorded tape.

    Raises:
        ConfigError: the provider is unknown, or lacks a required argument.
        MissingResponseError: the provider is `replay`, and there is no tape for this photo.
        ModelError: there is neither a key nor a tape, or the chosen provider cannot be used.
    """
    if provider not in PROVIDERS:
        raise ConfigError(f"provider: {choices(provider, PROVIDERS)}")
    client: Provider
    if provider == "mailbox":
        if mailbox is None:
            raise ConfigError("provider mailbox needs a folder for its requests")
        client = Mailbox(mailbox)
    else:
        name = _from_environment(options) if provider == "auto" else provider
        client = _server(name, options) or _replay(provider, photo, tapes)
    return Panel(client, options, record=record, photo=photo, made=made)


def bundled_tapes() -> Path:
    """Return the folder of the tapes that belong to the package."""
    return Path(str(resources.files("neoworld_mjx") / "data" / "tapes"))


def _from_environment(options: MLLMOptions) -> str:
    if environment_key("ANTHROPIC_API_KEY"):
        return "anthropic"
    models = [getattr(options, role).model for role in get_args(Role)]
    others = not any(model.startswith("claude") for model in models)
    return "openai" if others and environment_key("OPENAI_API_KEY") else "replay"


def _server(name: str, options: MLLMOptions) -> Provider | None:
    # Imported on demand: an SDK takes a second to load, and other providers do not need it.
    if name == "anthropic":
        from .anthropic import Anthropic

        return Anthropic(options)
    if name == "openai":
        from .openai import OpenAI

        return OpenAI(options)
    return None


def _replay(provider: str, photo: str | None, tapes: Sequence[Path]) -> Replay:
    searched = (*map(Path, tapes), bundled_tapes())
    tape = find_tape(photo, searched)
    if tape is not None:
        return Replay(*tape)
    if provider == "auto":
        raise ModelError(_REMEDIES)
    raise MissingResponseError(
        f"no tape was recorded for this photo (sha256 {(photo or 'unknown')[:16]}); searched "
        f"{', '.join(map(str, searched))}. Use the exact file that a tape was recorded for, name "
        f"a tape, or choose another provider: {', '.join(PROVIDERS)}"
    )


_REMEDIES = f"""no key in the environment and no tape for this photo. Options:
  - set ANTHROPIC_API_KEY
  - set OPENAI_API_KEY, install the extra (uv sync --inexact --extra openai) and name OpenAI's \
models in the config (mllm.reasoner.model, mllm.programmer.model, mllm.critic.model)
  - run a local model: --provider anthropic or openai with mllm.base_url in the config
  - answer yourself: --provider mailbox
  - give a tape (*{SUFFIX}) that was recorded for this exact file: --provider replay"""
