"""Templates: object programs whose parameters have ranges.

A template is a complete object program. Its parameters are constants that are assigned at the top
level of the program and followed by a comment with their range or choices:

    depth = 0.55  # 0.4 to 0.7 m
    drawers = 3  # 1 to 5
    pull = "bar"  # one of bar, knob, cup

An instance of a template differs from it only in these constants. Every template has the parameters
`depth`, `width` and `height`: the edges of the object's bounding box along x, y and z with all
joints at zero. A label and a measured box therefore determine a program.
"""

import ast
import functools
import io
import re
import tokenize
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import SpecError, choices

PROGRAMS = Path(__file__).parent / "programs"
BOX = ("depth", "width", "height")
"""Parameters that every template has: edges of the bounding box along x, y and z [m]."""

RANGE = re.compile(r"#\s*(-?[\d.]+) to (-?[\d.]+)(?:\s+(m|deg|kg))?\s*$")
"""Comment after a parameter, which states its range and unit."""
_CHOICES = re.compile(r"#\s*one of (\w+(?:, \w+)*)\s*$")
_HEADER = re.compile(r"# ([A-Z][\w-]*): (.+)")

Value = float | int | str


@dataclass(frozen=True)
class Parameter:
    """A constant of a template with a range or choices."""

    name: str
    default: Value
    low: float = 0.0
    high: float = 0.0
    """Minimum and maximum of a number; both are 0 if the parameter has choices."""
    choices: tuple[str, ...] = ()
    unit: str = ""

    def checked(self, value: Value) -> Value:
        """Validate a value and convert it to the parameter's type.

        Raises:
            SpecError: the value is outside the range, or is not one of the choices.
        """
        if self.choices:
            if value not in self.choices:
                raise SpecError(f"{self.name}: {choices(str(value), self.choices)}")
            return value
        if isinstance(value, str) or not self.low <= value <= self.high:
            unit = f" {self.unit}" if self.unit else ""
            raise SpecError(
                f"{self.name}: {value!r} is outside {self.low:g} to {self.high:g}{unit}"
            )
        return round(value) if isinstance(self.default, int) else float(value)

    def draw(self, random: np.random.Generator) -> Value:
        """Sample a value uniformly from the range or the choices."""
        if self.choices:
            return self.choices[int(random.integers(len(self.choices)))]
        if isinstance(self.default, int):
            return int(random.integers(int(self.low), int(self.high) + 1))
        # Round to four digits, so that the text remains readable.
        return float(f"{random.uniform(self.low, self.high):.4g}")


@dataclass(frozen=True)
class Template:
    """A program with parameters."""

    name: str
    label: str
    """Common name of the object."""
    partnet: str
    """Category of the object in PartNet-Mobility; empty if there is none."""
    text: str
    parameters: Mapping[str, Parameter]
    lines: Mapping[str, int]
    """Line of each parameter in the text, counted from 0."""

    def program(self, values: Mapping[str, Value] | None = None) -> str:
        """Return the program's text with the given values of parameters.

        Raises:
            SpecError: a parameter is unknown, or its value is outside its range.
        """
        text = self.text.splitlines(keepends=True)
        for name, value in (values or {}).items():
            if name not in self.parameters:
                raise SpecError(
                    f"template {self.name}, parameter: {choices(name, self.parameters)}"
                )
            value = self.parameters[name].checked(value)
            k = self.lines[name]
            literal = f'"{value}"' if isinstance(value, str) else repr(value)
            text[k] = f"{name} = {literal}  {text[k][text[k].index('#') :]}"
        return "".join(text)

    def draw(self, seed: int) -> dict[str, Value]:
        """Sample the values of all parameters; the same seed gives the same values."""
        random = np.random.default_rng([seed, *self.name.encode()])
        return {name: p.draw(random) for name, p in self.parameters.items()}

    def of_box(self, size: tuple[float, float, float]) -> dict[str, Value]:
        """Return `depth`, `width` and `height` for a measured box [m], clipped to their ranges."""
        return {
            name: min(max(value, self.parameters[name].low), self.parameters[name].high)
            for name, value in zip(BOX, size, strict=True)
        }


def read_template(path: Path) -> Template:
    """Read a template's file.

    Raises:
        SpecError: a header line, a range or a parameter in BOX is missing, or a default is out of
            range.
    """
    text = path.read_text(encoding="utf-8")
    header = dict(_HEADER.findall(text.split("\nfrom ", 1)[0]))
    if "Label" not in header:
        raise SpecError(f"{path.name}: the first lines must contain '# Label: ...'")
    comments = {
        token.start[0]: token.string
        for token in tokenize.generate_tokens(io.StringIO(text).readline)
        if token.type == tokenize.COMMENT
    }
    parameters, lines = {}, {}
    for node in ast.parse(text).body:
        if not (isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant)):
            continue
        (target,), comment = node.targets, comments.get(node.lineno, "")
        if not comment or not isinstance(target, ast.Name):
            continue
        parameters[target.id] = _parameter(path.name, target.id, node.value.value, comment)
        lines[target.id] = node.lineno - 1
    if missing := [name for name in BOX if name not in parameters]:
        raise SpecError(f"{path.name}: no parameter {', '.join(missing)} with a range")
    partnet = header.get("PartNet-Mobility", "")
    return Template(path.stem, header["Label"], partnet, text, parameters, lines)


def _parameter(file: str, name: str, default: object, comment: str) -> Parameter:
    if isinstance(default, str) and (match := _CHOICES.match(comment)):
        parameter = Parameter(name, default, choices=tuple(match[1].split(", ")))
    elif isinstance(default, int | float) and (match := RANGE.match(comment)):
        parameter = Parameter(name, default, float(match[1]), float(match[2]), unit=match[3] or "")
    else:
        raise SpecError(
            f"{file}: {name} needs '# LOW to HIGH [m|deg|kg]' or '# one of a, b' after it, "
            f"got {comment!r}"
        )
    try:
        parameter.checked(default)
    except SpecError as error:
        raise SpecError(f"{file}: the default of {error}") from None
    return parameter


@functools.cache
def templates() -> dict[str, Template]:
    """Return all bundled templates by name."""
    return {path.stem: read_template(path) for path in sorted(PROGRAMS.glob("*.py"))}


def template(name: str) -> Template:
    """Return a bundled template.

    Raises:
        SpecError: no template has this name.
    """
    bundled = templates()
    if name not in bundled:
        raise SpecError(f"template: {choices(name, bundled)}")
    return bundled[name]
