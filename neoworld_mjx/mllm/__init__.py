"""Multimodal models: requests, validated responses, recorded responses, and costs.

    panel = open_panel(config.mllm, "auto", photo=photo.sha256)
    response = panel.ask_sync(Request("reasoner", "parse", system, prompt, MySchema, pictures))
    response.value      # a MySchema

Steps of the pipeline send a `Request` with its `Picture`s to a `Model` and receive a `Response`.
The pipeline opens a `Panel`, which implements `Model`.
"""

from .ledger import Ledger, Price, load_prices
from .panel import Panel
from .provider import PROVIDERS, bundled_tapes, open_panel
from .replay import Tape, find_tape
from .requests import (
    Fallback,
    Model,
    Picture,
    Request,
    Response,
    Usage,
    ask_or_record,
    package_text,
)

__all__ = [
    "PROVIDERS",
    "Fallback",
    "Ledger",
    "Model",
    "Panel",
    "Picture",
    "Price",
    "Request",
    "Response",
    "Tape",
    "Usage",
    "ask_or_record",
    "bundled_tapes",
    "find_tape",
    "load_prices",
    "open_panel",
    "package_text",
]
