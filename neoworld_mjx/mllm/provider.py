"""Table of all providers of responses, and the function that opens one of them.

To add a provider, write a module for it and add an entry to `PROVIDERS`.
"""

from collections.abc import Callable, Sequence
from importlib import resources
from pathlib import Path
from typing import NamedTuple, get_args

from ..config import MLLMOptions, Role
from ..errors import ConfigError, MissingResponseError, ModelError, choices
from .mailbox import Mailbox
from .panel import Panel
from .replay import SUFFIX, Replay, find_tape
from .requests import Provider
from .secrets import environment_key


class ProviderInputs(NamedTuple):
    """Inputs of the functions in `PROVIDERS`."""

    options: MLLMOptions
    photo: str | None = None
    """sha256 of the photo's file."""
    tapes: Sequence[Path] = ()
    """Files of recorded responses (tapes), and folders of tapes, in search order."""
    mailbox: Path | None = None
    mailbox_timeout_s: float | None = None


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
        mailbox_timeout_s: maximum time that a request waits in the mailbox [s]. If None, there is
            no limit.
        record: tape file. New responses are written to it, and recorded responses are reused.
        made: origin of the responses, written to the recorded tape.

    Raises:
        ConfigError: the provider is unknown, or lacks a required argument.
        MissingResponseError: the provider is `replay`, and there is no tape for this photo.
        ModelError: there is neither a key nor a tape, or the chosen provider cannot be used.
    """
    if provider not in PROVIDERS:
        raise ConfigError(f"provider: {choices(provider, PROVIDERS)}")
    searched = (*map(Path, tapes), bundled_tapes())
    inputs = ProviderInputs(options, photo, searched, mailbox, mailbox_timeout_s)
    client = PROVIDERS[provider](inputs)
    return Panel(client, options, record=record, photo=photo, made=made)


def bundled_tapes() -> Path:
    """Return the folder of the tapes that belong to the package."""
    return Path(str(resources.files("neoworld_mjx") / "data" / "tapes"))


def _auto(inputs: ProviderInputs) -> Provider:
    if environment_key("ANTHROPIC_API_KEY"):
        return _anthropic(inputs)
    models = [getattr(inputs.options, role).model for role in get_args(Role)]
    if environment_key("OPENAI_API_KEY") and not any(m.startswith("claude") for m in models):
        return _openai(inputs)
    tape = find_tape(inputs.photo, inputs.tapes)
    if tape is not None:
        return Replay(*tape)
    raise ModelError(_REMEDIES)


def _anthropic(inputs: ProviderInputs) -> Provider:
    # Imported on demand: an SDK takes a second to load, and other providers do not need it.
    from .anthropic import Anthropic

    return Anthropic(inputs.options)


def _openai(inputs: ProviderInputs) -> Provider:
    from .openai import OpenAI

    return OpenAI(inputs.options)


def _replay(inputs: ProviderInputs) -> Provider:
    tape = find_tape(inputs.photo, inputs.tapes)
    if tape is None:
        searched = ", ".join(map(str, inputs.tapes))
        raise MissingResponseError(
            f"no tape was recorded for this photo (sha256 {(inputs.photo or 'unknown')[:16]}); "
            f"searched {searched}. Use the exact file that a tape was recorded for, name a tape, "
            f"or choose another provider: {', '.join(PROVIDERS)}"
        )
    return Replay(*tape)


def _mailbox(inputs: ProviderInputs) -> Provider:
    if inputs.mailbox is None:
        raise ConfigError("provider mailbox needs a folder for its requests")
    return Mailbox(inputs.mailbox, timeout_s=inputs.mailbox_timeout_s)


PROVIDERS: dict[str, Callable[[ProviderInputs], Provider]] = {
    "auto": _auto,
    "anthropic": _anthropic,
    "openai": _openai,
    "replay": _replay,
    "mailbox": _mailbox,
}
"""Functions that open a provider, by the provider's name."""

_REMEDIES = f"""no key in the environment and no tape for this photo. Options:
  - set ANTHROPIC_API_KEY
  - set OPENAI_API_KEY, install the extra (uv sync --inexact --extra openai) and name OpenAI's \
models in the config (mllm.reasoner.model, mllm.programmer.model, mllm.critic.model)
  - run a local model: --provider anthropic or openai with mllm.base_url in the config
  - answer yourself: --provider mailbox
  - give a tape (*{SUFFIX}) that was recorded for this exact file: --provider replay"""
