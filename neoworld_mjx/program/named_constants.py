"""Named constants of a program, and edits of one number in the program's text.

A program assigns its dimensions to names at top level, as the guide for programmers asks. Examples
are `X, Y, Z = 0.60, 0.90, 0.45`, and `depth = 0.55  # 0.4 to 0.7 m` in a template. An edit replaces
only the literal.
"""

import ast
import math
import re
from collections import Counter
from typing import NamedTuple

RANGE = re.compile(r"#\s*(-?[\d.]+) to (-?[\d.]+)(?:\s+(m|deg|kg))?\s*$")
"""Comment after a parameter of a template, which states the parameter's range and unit."""


class NamedConstant(NamedTuple):
    """A positive float that a program assigns, exactly once, to a name at top level."""

    name: str
    value: float
    line: int
    """Line of the literal, counted from 0."""
    start: int
    """Column of the literal's first byte in UTF-8, counted from 0."""
    end: int
    """Column after the literal's last byte."""
    low: float = 0.0
    """Lower bound that the comment after a template's parameter states."""
    high: float = math.inf
    """Upper bound that the comment states."""

    def within(self, value: float) -> float:
        """Return the value, clipped to the range from `low` to `high`."""
        return min(max(value, self.low), self.high)


def named_constants(text: str) -> tuple[NamedConstant, ...]:
    """Return the named constants of a program, in the order of the text.

    Integers are omitted, because they are counts rather than lengths. Names that are assigned more
    than once, or in a loop or a function, are omitted, because they are not constant. If the text
    is not valid Python, return no constants.
    """
    if "\r" in text.replace("\r\n", "\n"):
        return ()  # Python ends a line at a bare "\r", so its line numbers would not fit `lines`.
    try:
        tree = ast.parse(text)
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return ()
    stored = Counter(
        node.id
        for node in ast.walk(tree)
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)
    )
    lines = text.split("\n")
    constants = []
    for node in tree.body:
        for target, value in _pairs(node):
            if stored[target] != 1 or value.end_col_offset is None:
                continue
            number = value.value
            if not isinstance(number, float) or not 0 < number < math.inf:
                continue
            line = value.lineno - 1
            comment = lines[line].encode()[value.end_col_offset :].decode().strip()
            match = RANGE.match(comment)
            limits = (0.0, math.inf) if match is None else (float(match[1]), float(match[2]))
            span = value.col_offset, value.end_col_offset
            constants.append(NamedConstant(target, number, line, *span, *limits))
    return tuple(constants)


def _pairs(node: ast.stmt) -> list[tuple[str, ast.Constant]]:
    """Return pairs of a name and the literal that an assignment statement assigns to it."""
    if isinstance(node, ast.AnnAssign):
        targets: list[ast.expr] = [node.target]
        values = [node.value]
    elif isinstance(node, ast.Assign) and len(node.targets) == 1:
        targets, values = [node.targets[0]], [node.value]
        if isinstance(node.targets[0], ast.Tuple) and isinstance(node.value, ast.Tuple):
            targets, values = node.targets[0].elts, list(node.value.elts)
    else:
        return []
    if len(targets) != len(values):
        return []
    return [
        (target.id, value)
        for target, value in zip(targets, values, strict=True)
        if isinstance(target, ast.Name) and isinstance(value, ast.Constant)
    ]


def with_value(text: str, constant: NamedConstant, value: float) -> str:
    """Return the text with the literal of a constant replaced by another number.

    The number is rounded to four significant digits. The rest of the text is unchanged.

    Raises:
        ValueError: the line does not contain the constant's literal, or the number is not positive
            and finite.
    """
    if not 0 < value < math.inf:
        raise ValueError(f"{constant.name} must be positive and finite, got {value!r}")
    lines = text.split("\n")
    line = lines[constant.line].encode() if constant.line < len(lines) else b""
    literal = line[constant.start : constant.end].decode("utf-8", "replace")
    try:
        matches = float(literal) == constant.value
    except ValueError:
        matches = False
    if not matches:
        raise ValueError(f"line {constant.line + 1} does not hold {constant.name} any more")
    number = repr(float(f"{value:.4g}"))
    lines[constant.line] = (
        line[: constant.start] + number.encode() + line[constant.end :]
    ).decode()
    return "\n".join(lines)
