"""The five steps of the method, from a photograph to an exported scene.

Names are resolved on first use, so code that only reads or draws a run loads no simulator.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from ..run_folder import Result

if TYPE_CHECKING:
    from .reconstruction import reconstruct, refine_again


def __getattr__(name: str) -> object:
    if name not in ("reconstruct", "refine_again"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.reconstruction"), name)


__all__ = ["Result", "reconstruct", "refine_again"]
