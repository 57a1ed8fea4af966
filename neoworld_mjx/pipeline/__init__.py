"""The five steps of the method, from a photograph to an exported scene."""

from .reconstruction import Result, reconstruct, refine_again

__all__ = ["Result", "reconstruct", "refine_again"]
