"""Quantities and counts as text, the same in the terminal, in reports and on pages."""

import math
from collections.abc import Sized

_UNITS = {"m": (1000.0, "mm"), "rad": (180 / math.pi, "degrees"), "deg": (1.0, "degrees")}


def format_quantity(value: float, unit: str) -> str:
    """Format a value with its unit: lengths in mm, angles in degrees, fractions in percent.

    Args:
        value: the value, in `unit`.
        unit: a unit, or "of ..." for a fraction of something.
    """
    if not math.isfinite(value):
        return "not finite"
    if unit.startswith("of "):
        percent = 100 * value
        return f"{percent:.0f} % {unit}" if abs(percent) >= 100 else f"{percent:.3g} % {unit}"
    factor, unit_name = _UNITS.get(unit, (1.0, unit))
    value *= factor
    size = abs(value)
    digits = f"{value:.1f}" if 0.1 <= size < 1000 else f"{value:.1g}" if size >= 1e-3 else "0"
    if size >= 1000:
        digits = f"{value:.0f}"
    return f"{digits} {unit_name}".strip()


def count(items: int | Sized, noun: str) -> str:
    """Format a number with its noun, such as "3 objects"."""
    number = items if isinstance(items, int) else len(items)
    return f"{number} {noun}" + ("" if number == 1 else "s")
