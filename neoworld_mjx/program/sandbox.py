"""The Monty sandbox, in which programs run.

The program is first type-checked against the stubs of the SDK, and then interpreted by a separate
process. This process has no access to files or the network, and can import only the
SDK, `math` and similar modules. Memory, recursion, output and calls are limited. The SDK's objects
remain in the calling process, which is itself a worker with limited time and memory; the program
has only handles of them. The SDK validates every value that a program passes.

Exceptions and type errors of programs become error signals with hints.
"""

import contextlib
import difflib
import inspect
import json
import re
import signal
from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from functools import cache
from importlib import import_module, resources
from typing import Any

import pydantic_monty as monty

from ..checks.signals import Signal, error_signal
from ..config import ProgramOptions
from .part import Geom, Joint, Part, Shape
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
_ERROR_CLASSES = {kind.__name__: kind for kind in (Object, Part, Geom, Joint, Shape)}
_TUPLE = re.compile(r"Expected `tuple\[((?:float, )*float)\]")
_NUMBER = r"(?:float|int|Literal\[[-\d, ]+\])\*?"
_UNKNOWN_LENGTH = re.compile(rf"found `tuple\[{_NUMBER}(?: \| {_NUMBER})*, \.\.\.\]`")
"""Type of a tuple of numbers of unknown length, such as tuple(... for ...).

The SDK counts the entries of such a tuple at run time.
"""
_FOUND = re.compile(r"found `([^`]*)`")
_BRACKETED = re.compile(r"\[[^\[\]]*\]")
_OWN_MODULES = ("neoworld_mjx", "sdk")
_LISTED = "the SDK has only what the guide lists"


def type_signals(findings: Sequence[Mapping[str, Any]]) -> list[Signal]:
    """Convert the findings of the type check that the sandbox reports into signals.

    Some findings are dropped:

    - If the text does not parse, only syntax errors are returned, because the check then also
      reports every import of the SDK.
    - Numbers that are passed instead of a tuple cause two findings, and only the finding that
      mentions the tuple is returned.
    - Tuples of unknown length are not errors.
    - Nor are names of several types, such as an outline that has the name of a loop's variable
      above: the SDK checks every value that it gets at run time.
    """
    broken = [finding for finding in findings if finding["code"] == "invalid-syntax"]
    tuples = {_line(finding) for finding in findings if _TUPLE.search(finding["message"])}
    relevant = [
        finding
        for finding in broken or findings
        if not (finding["code"] == "too-many-positional-arguments" and _line(finding) in tuples)
        and not (_TUPLE.search(message := finding["message"]) and _UNKNOWN_LENGTH.search(message))
        and not (finding["code"] == "invalid-argument-type" and _is_union(message))
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


def _is_union(message: str) -> bool:
    """Return whether the type that a message reports as found is one of several."""
    found = _FOUND.search(message)
    if found is None:
        return False
    kind, inner = found[1], ""
    while kind != inner:
        kind, inner = _BRACKETED.sub("", kind), kind
    return " | " in kind


def _syntax_hint(message: str) -> str:
    return "a bracket or a quote above is not closed" if "unexpected EOF" in message else ""


def _line(finding: Mapping[str, Any]) -> int:
    return finding["location"]["row"]


def _hint(code: str, message: str) -> str:
    names = re.findall(r"`([^`]*)`", message)
    if code == "unresolved-import" and names:
        return _import_hint(names)
    if code == "unresolved-attribute" and len(names) > 1:
        return _nearest(names[-1], _members(names[0])) or _LISTED
    if code == "unknown-argument" and len(names) > 1:
        arguments = _arguments(names[-1])
        valid = f"; it takes {', '.join(arguments)}" if arguments else ""
        return (_nearest(names[0], arguments) or _LISTED) + valid
    if code == "too-many-positional-arguments" and names:
        arguments = _arguments(names[0])
        return f"it takes {', '.join(arguments)}" if arguments else ""
    return "give the numbers in one tuple" if _TUPLE.search(message) else ""


def _import_hint(names: Sequence[str]) -> str:
    """Return a hint for a failed import."""
    sdk_names = import_module(MODULE).__all__
    module, name = names[0], names[-1] if len(names) > 1 else ""
    if module == MODULE:
        return _nearest(name, sdk_names) or _LISTED
    if module.split(".")[0] in _OWN_MODULES:
        return f"write: from {MODULE} import {name if name in sdk_names else 'Object, box'}"
    return IMPORT_HINT


def _nearest(name: str, valid: Sequence[str]) -> str:
    matches = difflib.get_close_matches(name, valid, n=1, cutoff=0.5)
    return f"did you mean {matches[0]}?" if matches else ""


def _members(kind: str) -> list[str]:
    """Return the public members of a class of the SDK."""
    sdk_class = _ERROR_CLASSES.get(kind, object)
    names = {*dir(sdk_class), *inspect.get_annotations(sdk_class)}
    return sorted(name for name in names if not name.startswith("_"))


@cache
def _arguments(function: str) -> tuple[str, ...]:
    """Return the argument names of an SDK function, or of a method given as "Class.method"."""
    owner, _, name = function.rpartition(".")
    member = getattr(_ERROR_CLASSES.get(owner) if owner else import_module(MODULE), name, None)
    if not callable(member):
        return ()
    return tuple(key for key in inspect.signature(member).parameters if key != "self")


def public_members(kind: type, select: Callable[[object], bool]) -> tuple[str, ...]:
    """Return the names of the public members of a class that `select` accepts."""
    members = inspect.getmembers_static(kind, select)
    return tuple(name for name, _ in members if not name.startswith("_"))


WALL_FACTOR = 30.0
"""Ratio of the wall time limit, which ends programs that wait, to the processor time limit."""
MAX_RECURSION, MAX_CALLS = 200, 5000
"""Limits on the recursion depth of a program, and on its calls of the SDK."""
CLOCK = datetime(2000, 1, 1, tzinfo=UTC)
"""Time at which every program runs, so that equal texts build equal objects."""
MAX_PRINTED_BYTES = 20_000
"""Limit on the text that a program prints."""
_START_S = 30.0
"""Time limit for starting the interpreter [s]."""
_CLASSES = (Object, Part, Geom, Joint, Shape)
_METHODS = {kind: frozenset(public_members(kind, inspect.isfunction)) for kind in _CLASSES}
_PROPERTIES = {
    kind: public_members(kind, lambda value: isinstance(value, property)) for kind in _CLASSES
}
_FIELDS = {
    kind: tuple(name for name in inspect.get_annotations(kind) if not name.startswith("_"))
    for kind in _CLASSES
}


class _Handle(monty.ClassInstance):
    """Handle of an SDK object, which exposes only public fields, properties and methods."""

    session: Session

    def call_method(self, name: str, args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
        with self.session.call():
            return super().call_method(name, args, kwargs)

    def lookup_lazy_attrs(self, name: str) -> Any:
        with self.session.call():
            return super().lookup_lazy_attrs(name)

    def convert_value(self, /, name: str, value: Any) -> Any:
        return _exposed(value, self.session)


def _exposed(value: Any, session: Session) -> Any:
    """Return a handle if the value is an SDK object; return any other value unchanged."""
    kind = type(value)
    if kind not in _METHODS:
        return value
    handle = _Handle(
        value,
        eager_attrs=_FIELDS[kind],
        lazy_attrs=_PROPERTIES[kind] or None,
        allowed_methods=_METHODS[kind],
    )
    handle.session = session
    return handle


def _module(session: Session) -> dict[str, monty.ExternalModule]:
    """Return the SDK as a module for the worker; the functions are bound to the session."""

    def bind(function: Any) -> Any:
        def call(*args: Any, **kwargs: Any) -> Any:
            with session.call():
                return _exposed(function(*args, **kwargs), session)

        return call

    exposed: dict[str, Any] = {}
    sdk = import_module(MODULE)
    for name in sdk.__all__:
        value = getattr(sdk, name)
        # Programs may use these classes in annotations, but may call only `Object`.
        class_only = inspect.isclass(value) and value is not Object
        exposed[name] = monty.ClassType(value) if class_only else bind(value)
    module = monty.ExternalModule(exposed, stubs=stubs())
    *packages, last = MODULE.split(".")
    for inner in (last, *reversed(packages[1:])):
        module = monty.ExternalModule({inner: module}, stubs="")
    return {packages[0]: module}


def run_sandboxed(text: str, session: Session, options: ProgramOptions) -> tuple[str, list[Signal]]:
    """Run a program in the sandbox, and return its printed text and its errors.

    The interpreter inherits the limit on processor time of this process.

    Args:
        text: the program.
        session: collects the program's objects and counts the resources that the program uses.
        options: the limits.
    """
    printed = monty.CollectString(max_bytes=MAX_PRINTED_BYTES)
    limits: monty.ResourceLimits = {
        "max_feed_duration_secs": WALL_FACTOR * options.timeout_s,
        "max_memory": options.memory_mib << 20,
        "max_recursion_depth": MAX_RECURSION,
        "max_suspensions": MAX_CALLS,
    }
    policy: monty.OSPolicy = {
        "datetime": CLOCK,
        "sleep": "zero",
        "random_start": {"seed": 0},
    }
    errors: list[Signal] = []
    starts = [0, *(match.end() for match in re.finditer(rb"\n", text.encode()))]
    try:
        with (
            monty.Monty(max_processes=1, checkout_timeout=_START_S) as interpreter,
            interpreter.checkout(
                script_name="program.py",
                limits=limits,
                type_check=options.type_check,
                type_check_format="json",
                os_policy=policy,
                external_modules=_module(session),
            ) as worker,
        ):
            progress = worker.feed_start(text, print_callback=printed)
            while not isinstance(progress, monty.MontyComplete):
                if progress.position.filename.startswith("<python-input"):
                    session.line = bisect_right(starts, progress.position.start)
                progress = progress.resume_auto()
                if session.exceeded is not None:
                    raise session.exceeded
    except monty.MontyTypingError as error:
        errors = type_signals(json.loads(error.display()))
        if not errors:
            unchecked = options.model_copy(update={"type_check": False})
            return run_sandboxed(text, session, unchecked)
    except LimitExceeded:
        pass  # Reported below, even if the program caught the exception.
    except monty.MontyError as error:
        errors = [_monty_signal(error, options)]
    if session.exceeded is not None:
        errors = [limit_signal(session.exceeded, session)]
    return printed.output, errors


@contextlib.contextmanager
def limited_calls(session: Session, timeout_s: float) -> Iterator[None]:
    """Raise LimitExceeded in SDK calls of the block when this worker's processor time runs out."""
    message = f"building the shapes took over {timeout_s:g} s; use fewer"
    previous = signal.signal(signal.SIGXCPU, lambda *_: session.stop("timeout", message))
    try:
        yield
    finally:
        signal.signal(signal.SIGXCPU, previous)


def stubs() -> str:
    """Return the type stubs that programs are checked against."""
    return resources.files("neoworld_mjx.program").joinpath("sdk.pyi").read_text(encoding="utf-8")


def _monty_signal(error: monty.MontyError, options: ProgramOptions) -> Signal:
    if isinstance(error, monty.MontyCrashedError):
        if error.timed_out or "SIGXCPU" in str(error):
            message = f"the program took over {options.timeout_s:g} s"
            return error_signal("timeout", message, hint=ENDLESS_HINT)
        message = f"the sandbox had to be stopped: {error}"[:400]
        return error_signal("crashed", message, hint=ENDLESS_HINT)
    located = isinstance(error, monty.MontySyntaxError | monty.MontyRuntimeError)
    frames = error.traceback() if located else []
    frames = [frame for frame in frames if frame.filename.startswith("<python-input")]
    inner = error.exception()
    position = (frames[-1].line, frames[-1].column) if frames else (None, None)
    found = exception_signal(inner, *position)
    update: dict[str, str] = {}
    if isinstance(error, monty.MontySyntaxError):
        update = {"code": "syntax", "hint": ""}
    elif found.code == "memory" and f"> {MAX_PRINTED_BYTES} bytes" in found.message:
        update = {"code": "output", "hint": f"print at most {MAX_PRINTED_BYTES} bytes"}
    elif isinstance(inner, RuntimeError) and "suspension" in found.message:
        hint = f"make at most {MAX_CALLS} calls of the SDK"
        update = {"code": "too_many_calls", "hint": hint}
    return found.model_copy(update=update)
