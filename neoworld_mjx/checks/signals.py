"""Signals: findings about a program, each with a code, a location, a value and a hint.

Running a program that fails returns signals instead of raising an exception. An allowance is an
overlap of parts that a program declares as intended.
"""

import math
from collections.abc import Iterable
from typing import Any, Literal, NamedTuple

from pydantic import BaseModel, ConfigDict

Severity = Literal["error", "warning"]


class Signal(BaseModel):
    """One finding about a program or the object that it builds."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    severity: Severity
    """Severity of the finding. An error makes the object unusable; a warning does not."""
    code: str
    """Short, stable name of the kind of finding, such as "overlap_at_rest"."""
    message: str
    part: str | None = None
    joint: str | None = None
    line: int | None = None
    """Line of the program, counted from 1."""
    column: int | None = None
    value: float | None = None
    """Measured value in SI units."""
    threshold: float | None = None
    """Limit with which the value is compared."""
    hint: str = ""
    """Hint that says how to correct the program."""

    @property
    def identity(self) -> tuple[str, str | None, str | None, int | None, str]:
        """Key that is equal for two signals of the same finding, regardless of their values."""
        anchored = self.part is not None or self.joint is not None
        line = None if anchored else self.line
        return self.code, self.part, self.joint, line, "" if anchored else self.message

    def phrase(self) -> str:
        """Return the finding in one line."""
        place = "" if self.line is None else f"line {self.line}: "
        hint = f" -> {self.hint}" if self.hint else ""
        return f"{self.severity} {self.code}: {place}{self.message}{self._measured()}{hint}"

    def listing(self, file: str, text: str = "") -> str:
        """Format the finding for a terminal: place (file:line:column), source line and hint.

        Args:
            file: name of the program's file.
            text: the program; if empty, the source line is omitted.
        """
        place = ":".join(str(part) for part in (file, self.line, self.column) if part is not None)
        rows = [f"{place}: {self.severity} {self.code}: {self.message}{self._measured()}"]
        source = text.splitlines()
        if self.line is not None and 0 < self.line <= len(source):
            rows.append(f"    {source[self.line - 1].strip()[:160]}")
        if self.hint:
            rows.append(f"    hint: {self.hint}")
        return "\n".join(rows)

    def _measured(self) -> str:
        if self.value is None or self.threshold is None:
            return ""
        return f" [{self.value:.4g} against {self.threshold:.4g}]"


def error_signal(code: str, message: str, **details: Any) -> Signal:
    """Return a signal with severity "error"; `details` are other fields of `Signal`."""
    return Signal(severity="error", code=code, message=message, **details)


def deduplicated(signals: Iterable[Signal]) -> tuple[Signal, ...]:
    """Return the worst signal of each identity, errors first, and otherwise in the given order."""
    worst: dict[tuple[object, ...], Signal] = {}

    def rank(signal: Signal) -> tuple[bool, float]:
        return signal.severity == "error", abs(signal.value or 0)

    for signal in signals:
        previous = worst.setdefault(signal.identity, signal)
        if rank(signal) > rank(previous):
            worst[signal.identity] = signal
    return tuple(sorted(worst.values(), key=lambda signal: signal.severity != "error"))


def has_errors(signals: Iterable[Signal]) -> bool:
    """Return True if any signal is an error."""
    return any(signal.severity == "error" for signal in signals)


def radians_hint(degrees: float) -> str:
    """Return the hint that angles are in radians, with the value that was probably intended."""
    return (
        f"angles are in radians: {degrees:g} degrees are {math.radians(degrees):.4g}, "
        f"math.radians({degrees:g})"
    )


class Allowance(NamedTuple):
    """An overlap of two parts that a program declares as intended, with a reason."""

    first: str
    second: str
    depth: float
    """Largest allowed depth [m]."""
    reason: str
