"""Signals: findings about a program, each with a code, a place, a number and a hint.

Failures of a program cross its border as these, never as exceptions.
"""

from collections.abc import Iterable
from typing import Literal

from pydantic import BaseModel, ConfigDict

Severity = Literal["error", "warning"]


class Signal(BaseModel):
    """One finding about a program or the object it makes."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    severity: Severity
    """An error leaves no usable object; a warning is worth a look."""
    code: str
    """Stable and short, such as "parts_overlap"."""
    message: str
    part: str | None = None
    joint: str | None = None
    line: int | None = None
    """Line of the program, counted from 1."""
    column: int | None = None
    value: float | None = None
    """What was measured, in SI units."""
    threshold: float | None = None
    """What it was held against."""
    hint: str = ""
    """What to do about it."""

    @property
    def identity(self) -> tuple[str, str | None, str | None, int | None, str]:
        """What makes two signals the same finding, whatever their numbers."""
        anchored = self.part is not None or self.joint is not None
        line = None if anchored else self.line
        return self.code, self.part, self.joint, line, "" if anchored else self.message

    def phrase(self) -> str:
        """Say it in one line, for a person or a model."""
        place = "" if self.line is None else f"line {self.line}: "
        measured = ""
        if self.value is not None and self.threshold is not None:
            measured = f" [{self.value:.4g} against {self.threshold:.4g}]"
        hint = f" -> {self.hint}" if self.hint else ""
        return f"{self.severity} {self.code}: {place}{self.message}{measured}{hint}"


def deduplicated(signals: Iterable[Signal]) -> tuple[Signal, ...]:
    """Keep the worst of each finding: errors first, then in the order they came."""
    kept: dict[tuple[object, ...], Signal] = {}
    for signal in signals:
        other = kept.get(signal.identity)
        if other is None or (signal.severity == "error", abs(signal.value or 0)) > (
            other.severity == "error",
            abs(other.value or 0),
        ):
            kept[signal.identity] = signal
    return tuple(sorted(kept.values(), key=lambda signal: signal.severity != "error"))


def has_errors(signals: Iterable[Signal]) -> bool:
    """Tell whether any signal is an error."""
    return any(signal.severity == "error" for signal in signals)
