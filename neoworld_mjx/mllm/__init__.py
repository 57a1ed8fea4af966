"""Asking multimodal models: requests in, validated answers out, whoever answers.

    panel = open_panel(config.mllm, "auto", photo=photo.sha256)
    answer = panel.ask_sync(Request("reasoner", "parse", system, prompt, MySchema, pictures))
    answer.value        # a MySchema

Rooms take a `Model` and need `Request`, `Picture` and `Answer`; a pipeline opens the `Panel`.
"""

from .ledger import Ledger, Price, load_prices
from .model import Answer, Model, Picture, Request, Usage
from .panel import Panel
from .provider import PROVIDERS, bundled_tapes, open_panel
from .replay import Tape, find_tape

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
    "bundled_tapes",
    "find_tape",
    "load_prices",
    "open_panel",
]
