"""Cells of tables: means with intervals as text, and tables as JSON."""

from neoworld_mjx.io.text_tables import TextTable
from neoworld_mjx.sweeps.intervals import Interval


def interval_text(estimate: Interval, factor: float, digits: int) -> str:
    """Return a mean and its interval, such as `50.0 (1.3 to 98.7)`; empty without a mean."""
    value, low, high = estimate
    if value is None:
        return ""
    text = f"{factor * value:.{digits}f}"
    if low is None or high is None:
        return text
    return f"{text} ({factor * low:.{digits}f} to {factor * high:.{digits}f})"


def records(table: TextTable) -> list[dict[str, str]]:
    """Return the rows of a table as JSON objects, by column."""
    return [dict(zip(table.head, row, strict=True)) for row in table.rows]
