"""Options of the requests to multimodal models."""

import re
from pathlib import Path
from typing import Any, Literal

from pydantic import ConfigDict, field_validator

from ..options import Options, option

Role = Literal["reasoner", "programmer", "critic"]

_KEY_HEADER = re.compile(r"authorization|key|token|secret|cookie", re.IGNORECASE)


class RoleOptions(Options):
    """The model that plays a role of the paper's Section 3.2."""

    model: str = option("claude-sonnet-5-5", "Name of the model, as its provider calls it.")
    max_tokens: int = option(
        16384,
        "Longest answer; with models that think first, their thinking is part of it.",
        unit="token",
        ge=256,
    )


class MLLMOptions(Options):
    """Requests to multimodal models: reasoner (Step 1), programmer (Step 2), critic (all steps)."""

    model_config = ConfigDict(hide_input_in_errors=True)

    reasoner: RoleOptions = RoleOptions()
    programmer: RoleOptions = RoleOptions(max_tokens=32768)
    critic: RoleOptions = RoleOptions()
    base_url: str | None = option(
        None,
        "Server that speaks the provider's API, such as vLLM or Ollama; null is the provider's.",
    )
    headers: dict[str, str] = option(
        {},
        "Headers sent with every request. Keys are named, not written: "
        '`{"x-api-key": "${MY_KEY}"}`.',
    )
    timeout_s: float = option(
        120.0,
        "Longest silence of a server; a request as a whole may take ten times as long.",
        unit="s",
        gt=0,
    )
    retries: int = option(
        4,
        "Repetitions of a request that may succeed later: too many requests, overload, a lost "
        "connection.",
        ge=0,
    )
    concurrency: int = option(8, "Requests in flight at once.", ge=1)
    validation_rounds: int = option(
        3, "Times that an answer that breaks the schema is sent back with its error.", ge=1
    )
    max_cost_usd: float | None = option(
        None, "Stop, resumably, before the run would cost more; null is no limit.", unit="USD", gt=0
    )
    prices: Path | None = option(
        None, "YAML of prices in USD per million tokens; null takes the table of the package."
    )

    @field_validator("headers", "base_url")
    @classmethod
    def _keep_keys_out(cls, value: Any) -> Any:
        """Refuse keys, as a configuration is written into every run."""
        for name, text in value.items() if isinstance(value, dict) else ():
            if _KEY_HEADER.search(name) and "${" not in text:
                raise ValueError(f"{name} would be written into run.json: give it as ${{VARIABLE}}")
        if isinstance(value, str) and re.search(r"://[^/]*@|[?&][^=]*(key|token)=", value, re.I):
            raise ValueError("holds a key, which would be written into run.json: use headers")
        return value
