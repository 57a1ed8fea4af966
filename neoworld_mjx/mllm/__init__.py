"""Multimodal models: requests, validated answers, and the loop that revises them.

    panel = open_panel(config.mllm, "auto", photo=photo.sha256)
    answer = panel.ask_sync(Request("reasoner", "parse", system, prompt, MySchema, pictures))
    answer.value        # a MySchema

The steps of the pipeline take a `Model` and use `Request`, `Picture` and `Answer`, and `revise` for
their rounds of criticism; the pipeline opens the `Panel`.
"""

from .ledger import Ledger, Price, load_prices
from .panel import Panel
from .provider import PROVIDERS, bundled_tapes, open_panel
from .replay import Tape, find_tape
from .requests import Answer, Model, Picture, Request, Usage, package_text
from .revision import ask_or_record, revise

__all__ = [
    "PROVIDERS",
    "Answer",
    "Ledger",
    "Model",
    "Panel",
    "Picture",
    "Price",
    "Request",
    "Tape",
    "Usage",
    "ask_or_record",
    "bundled_tapes",
    "find_tape",
    "load_prices",
    "open_panel",
    "package_text",
    "revise",
]
