"""Options of requests to multimodal models."""

import re
from pathlib import Path
from typing import Literal

from pydantic import ConfigDict, field_validator

from ..options import Options, option

Role = Literal["reasoner", "programmer", "critic"]


class RoleOptions(Options):
    """Options of the model that plays one role (Section 3.2 of the paper)."""

    model: str = option("claude-sonnet-5-5", "Name of the model, as its provider calls it.")


class MLLMOptions(Options):
    """Options of multimodal models: reasoner (Step 1), programmer (Step 2), critic (all steps)."""

    model_config = ConfigDict(hide_input_in_errors=True)

    reasoner: RoleOptions = RoleOptions()
    programmer: RoleOptions = RoleOptions()
    critic: RoleOptions = RoleOptions()
    max_tokens: int = option(
        32768,
        "Maximum length of a response, including the reasoning that some models write first.",
        unit="token",
        ge=256,
    )
    base_url: str | None = option(
        None,
        "URL of a server that offers the provider's API, such as vLLM or Ollama. If null, the "
        "provider's own server is used.",
    )
    call_timeout_s: float = option(
        600.0,
        "Maximum time that the server may take for one request, including all retries. Transient "
        "errors are retried four times.",
        unit="s",
        gt=0,
        le=600,
    )
    concurrency: int = option(8, "Maximum number of concurrent requests.", ge=1)
    max_cost_usd: float | None = option(
        None,
        "Maximum cost of a run. The run stops before a call that would exceed this limit, and can "
        "be resumed with a higher limit. If null, the cost is not limited.",
        unit="USD",
        gt=0,
    )
    prices: Path | None = option(
        None,
        "YAML file of prices in USD per million tokens. If null, the built-in prices are used.",
    )

    @field_validator("base_url")
    @classmethod
    def _keep_keys_out(cls, value: str | None) -> str | None:
        """Reject keys, because the configuration is written into run.json."""
        if value is not None and re.search(r"://[^/]*@|[?&][^=]*(key|token)=", value, re.I):
            raise ValueError(
                "contains a key, which would be written into run.json: give keys as environment "
                "variables"
            )
        return value
