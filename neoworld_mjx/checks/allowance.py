"""Overlaps of parts that a program declares as intended."""

from typing import NamedTuple


class Allowance(NamedTuple):
    """An overlap of two parts that a program declares as intended, with a reason."""

    first: str
    second: str
    depth: float
    """Largest allowed depth [m]."""
    reason: str
