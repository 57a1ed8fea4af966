"""Conversion of exceptions and type errors of programs into error signals with hints."""

import difflib
import inspect
import re
from collections.abc import Mapping, Sequence
from functools import cache
from importlib import import_module
from typing import Any

from ..checks.signals import Signal, error_signal
from .part import Geom, Joint, Part
from .placing import Shape
from .sdk_object import Object
from .session import LimitExceeded, Session

MODULE = "neoworld_mjx.program.sdk"
"""The only module of the package that a program may import."""

IMPORT_HINT = (
    f"import only from {MODULE}, math, random, itertools, functools, dataclasses and typing"
)
ENDLESS_HINT = "the program must end by itself; look for an endless loop"
_CLOSED_HINT = "programs have no files, network or processes"
_CODES: dict[type[BaseException], tuple[str, str]] = {
    TimeoutError: ("timeout", ENDLESS_HINT),
    MemoryError: ("memory", "the program holds too much at once"),
    RecursionError: ("recursion", "write a loop instead"),
    NotImplementedError: (
        "unsupported",
        "the sandbox knows a part of Python: no inheritance, no yield, no del, no properties, "
        "no import *",
    ),
    ImportError: ("import", IMPORT_HINT),
    OSError: ("forbidden", _CLOSED_HINT),
    ValueError: ("value", ""),
    TypeError: ("value", ""),
}


def exception_signal(
    error: BaseException, line: int | None = None, column: int | None = None
) -> Signal:
    """Return the error signal of an exception that a program raised."""
    code, hint = next(
        (entry for kind, entry in _CODES.items() if isinstance(error, kind)), ("runtime", "")
    )
    message = f"{type(error).__name__}: {error}"[:600]
    return error_signal(code, message, line=line, column=column, hint=hint)


def limit_signal(exceeded: LimitExceeded, session: Session) -> Signal:
    """Return the error signal of an exceeded limit."""
    hint = "use fewer or simpler shapes"
    return error_signal(exceeded.code, str(exceeded), line=session.line, hint=hint)


MAX_TYPE_SIGNALS = 20
_CLASSES = {kind.__name__: kind for kind in (Object, Part, Geom, Joint, Shape)}
_TUPLE = re.compile(r"Expected `tuple\[((?:float, )*float)\]")
_NUMBER = r"(?:float|int|Literal\[[-\d, ]+\])\*?"
_UNKNOWN_LENGTH = re.compile(rf"found `tuple\[{_NUMBER}(?: \| {_NUMBER})*, \.\.\.\]`")
"""Type of a tuple of numbers of unknown length, such as tuple(... for ...).

The SDK counts the entries of such a tuple at run time.
"""
_OWN_MODULES = ("neoworld_mjx", "sdk")
_FOREIGN_NAMES = {
    **dict.fromkeys(("hinge", "rotate_joint"), "Object.revolute"),
    **dict.fromkeys(("slide", "slider"), "Object.prismatic"),
    **dict.fromkeys(("link", "body"), "Object.part"),
    **dict.fromkeys(("weld", "attach"), "Object.fixed"),
    **dict.fromkeys(("translate", "rotate", "transform"), "Shape.moved"),
}
"""Names in other tools, and the members of the SDK that correspond to them."""
_NUMERALS = {2: "two", 3: "three"}


def type_signals(findings: Sequence[Mapping[str, Any]]) -> list[Signal]:
    """Convert the findings of the type check that the sandbox reports into signals.

    Some findings are dropped:

    - If the text does not parse, only syntax errors are returned, because the check then also
      reports every import of the SDK.
    - Numbers that are passed instead of a tuple cause two findings, and only the finding that
      mentions the tuple is returned.
    - Tuples of unknown length are not errors.
    """
    broken = [finding for finding in findings if finding["code"] == "invalid-syntax"]
    tuples = {_line(finding) for finding in findings if _TUPLE.search(finding["message"])}
    relevant = [
        finding
        for finding in broken or findings
        if not (finding["code"] == "too-many-positional-arguments" and _line(finding) in tuples)
        and not (_TUPLE.search(message := finding["message"]) and _UNKNOWN_LENGTH.search(message))
    ]
    return [
        error_signal(
            "syntax" if broken else "type",
            finding["message"][:400],
            line=_line(finding),
            column=finding["location"]["column"],
            hint=_syntax_hint(finding["message"])
            if broken
            else _hint(finding["code"], finding["message"]),
        )
        for finding in relevant[:MAX_TYPE_SIGNALS]
    ]


def _syntax_hint(message: str) -> str:
    return "a bracket or a quote above is not closed" if "unexpected EOF" in message else ""


def _line(finding: Mapping[str, Any]) -> int:
    return finding["location"]["row"]


def _hint(code: str, message: str) -> str:
    names = re.findall(r"`([^`]*)`", message)
    if code == "unresolved-import" and names:
        return _import_hint(names)
    if code == "unresolved-attribute" and len(names) > 1:
        return _nearest_member(names[-1], names[0])
    if code == "unknown-argument" and len(names) > 1:
        arguments = _arguments(names[-1])
        valid = f"; it takes {', '.join(arguments)}" if arguments else ""
        return (
            _nearest(names[0], arguments) or "the SDK has only the arguments that the guide lists"
        ) + valid
    if code == "too-many-positional-arguments" and names:
        arguments = _arguments(names[0])
        return f"it takes {', '.join(arguments)}" if arguments else ""
    numbers = _TUPLE.search(message)
    if numbers is not None:
        count = numbers.group(1).count("float")
        example = "(x, y, z)" if count == 3 else "(low, high)"
        return f"give {_NUMERALS.get(count, count)} numbers in one tuple: {example}"
    return ""


def _import_hint(names: Sequence[str]) -> str:
    """Return a hint for a failed import."""
    sdk_names = import_module(MODULE).__all__
    module, name = names[0], names[-1] if len(names) > 1 else ""
    if module == MODULE:
        return _nearest(name, sdk_names) or "the SDK has only what the guide lists"
    if module.split(".")[0] in _OWN_MODULES:
        return f"write: from {MODULE} import {name if name in sdk_names else 'Object, box'}"
    return IMPORT_HINT


def _nearest_member(name: str, kind: str) -> str:
    if name in _FOREIGN_NAMES:
        return f"a {name} is {_FOREIGN_NAMES[name]}"
    return _nearest(name, _members(kind)) or _owner(name)


def _owner(name: str) -> str:
    """Return a hint that states which class of the SDK has a member with a similar name."""
    for kind in _CLASSES:
        matches = difflib.get_close_matches(name, _members(kind), n=1, cutoff=0.8)
        if matches:
            return f"{matches[0]} belongs to {kind}"
    return "the SDK has only what the guide lists"


def _nearest(name: str, valid: Sequence[str]) -> str:
    matches = difflib.get_close_matches(name, valid, n=1, cutoff=0.5)
    return f"did you mean {matches[0]}?" if matches else ""


def _members(kind: str) -> list[str]:
    """Return the public members of a class of the SDK."""
    sdk_class = _CLASSES.get(kind, object)
    names = {*dir(sdk_class), *inspect.get_annotations(sdk_class)}
    return sorted(name for name in names if not name.startswith("_"))


@cache
def _arguments(function: str) -> tuple[str, ...]:
    """Return the argument names of an SDK function, or of a method given as "Class.method"."""
    owner, _, name = function.rpartition(".")
    member = getattr(_CLASSES.get(owner) if owner else import_module(MODULE), name, None)
    if not callable(member):
        return ()
    return tuple(key for key in inspect.signature(member).parameters if key != "self")
