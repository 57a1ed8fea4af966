"""Overlaps that a program declares by name."""

from typing import NamedTuple


class Allowance(NamedTuple):
    """An overlap of two parts that a program asks for, and answers for by a reason."""

    first: str
    second: str
    depth: float
    """[m]"""
    reason: str
