"""Step 2: object programs, the SDK that they call, the sandbox that runs them, and their checks.

`build` is resolved on first use, so that a program that imports `neoworld_mjx.program.sdk` under
plain Python loads no sandbox.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..checks.signals import Signal
    from .make import build
    from .sandbox import Built

_HOMES = {"build": "make", "Built": "sandbox", "Signal": "signals"}


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)


__all__ = ["Built", "Signal", "build"]
