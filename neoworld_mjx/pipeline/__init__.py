"""The five steps of the method, from a photograph to an exported scene."""

from .edited import rebuild, search_again
from .reconstruction import Result, reconstruct, refine_again

__all__ = ["Result", "rebuild", "reconstruct", "refine_again", "search_again"]
