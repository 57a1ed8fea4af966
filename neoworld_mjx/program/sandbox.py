"""Run a program's text and hand back an object or signals, never an exception.

`monty` is the default: the text is type-checked against the SDK's stubs, then interpreted by a worker
process that knows no files, network or imports besides `math` and its like, under limits of time,
memory, recursion, output and calls. The worker holds handles only; the SDK's objects live here, and
every value that crosses is checked by the SDK. `cpython` runs the same text in this process without
any wall, for programs one trusts.
"""

import atexit
import contextlib
import inspect
import io
import json
import os
import re
import time
import traceback
from bisect import bisect_right
from dataclasses import dataclass, field
from functools import lru_cache
from importlib import import_module, resources
from typing import Any

import pydantic_monty as monty

from ..config import ProgramOptions
from ..spec import ObjectSpec
from . import object as made
from .assemble import assemble
from .placing import Shape
from .session import Session, Spent, entered
from .signals import Signal, deduplicated, has_errors

MODULE = "neoworld_mjx.program.sdk"
_SCRIPT = "program.py"
_START_S, _GRACE_S = 10.0, 0.5
_MAX_TYPE_SIGNALS = 20
_METHODS: dict[type, frozenset[str]] = {
    made.Object: frozenset(
        {"material", "part", "fixed", "revolute", "continuous", "prismatic", "site"}
    ),
    made.Part: frozenset({"add", "anchor"}),
    made.Geom: frozenset({"anchor"}),
    made.Joint: frozenset(),
    Shape: frozenset(),
}
_FIELDS: dict[type, tuple[str, ...]] = {
    made.Object: ("name", "label"),
    made.Part: ("name",),
    made.Geom: ("name",),
    made.Joint: ("name",),
    Shape: (),
}


@dataclass(frozen=True)
class Built:
    """What became of a program."""

    spec: ObjectSpec | None
    """The object; None when any signal is an error of the program itself."""
    signals: tuple[Signal, ...] = ()
    printed: str = ""
    lines: dict[str, int] = field(default_factory=dict)
    """Where parts and joints were made: "part:door" or "joint:hinge" to a line."""
    seconds: float = 0.0

    @property
    def ok(self) -> bool:
        """Whether there is an object and no error was found."""
        return self.spec is not None and not has_errors(self.signals)


def run(text: str, options: ProgramOptions | None = None) -> Built:
    """Run a program and assemble its object.

    Args:
        text: the program.
        options: which sandbox, and its limits.
    """
    options = options or ProgramOptions()
    start = time.monotonic()
    session = Session(
        max_seconds=options.timeout_s,
        max_parts=options.max_parts,
        max_geoms=options.max_geoms,
        max_pieces=options.max_pieces,
    )
    printed, problems = "", _unfit(text, options)
    spec: ObjectSpec | None = None
    if not problems:
        try:
            runner = _run_monty if options.sandbox == "monty" else _run_cpython
            printed, problems = runner(text, session, options)
            if not problems:
                spec, problems = assemble(session.objects)
        except Exception as error:  # the border: whatever went wrong is a signal from here on
            problems = [
                Signal(
                    severity="error",
                    code="internal",
                    message=f"{type(error).__name__}: {error}"[:500],
                    hint="this is a fault of the SDK, not of the program",
                )
            ]
    lines: dict[str, int] = {}
    for item in session.objects[:1]:
        lines |= {f"part:{part.name}": part._line for part in item._parts if part._line}
        lines |= {f"joint:{joint.name}": joint._line for joint in item._joints if joint._line}
    return Built(
        None if has_errors(problems) else spec,
        deduplicated(problems),
        printed,
        lines,
        time.monotonic() - start,
    )


def stubs() -> str:
    """Return the SDK's type stubs, as programs are checked against."""
    return resources.files("neoworld_mjx.program").joinpath("sdk.pyi").read_text(encoding="utf-8")


def _unfit(text: str, options: ProgramOptions) -> list[Signal]:
    size = len(text.encode("utf-8", "replace"))
    if size > options.max_text_bytes:
        return [
            Signal(
                severity="error",
                code="too_long",
                message="the program's text is too long",
                value=size,
                threshold=options.max_text_bytes,
            )
        ]
    for bad, what in (("\0", "a NUL character"), ("\r", None)):
        if what is not None and bad in text:
            return [Signal(severity="error", code="syntax", message=f"the text holds {what}")]
    try:
        text.encode()
    except UnicodeEncodeError:
        return [Signal(severity="error", code="syntax", message="the text is not valid Unicode")]
    return []


class _Handle(monty.ClassInstance):
    """Shows the sandbox an SDK object: its name and its methods, nothing else."""

    session: Session

    def call_method(self, name: str, args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
        with self.session.call():
            return super().call_method(name, args, kwargs)

    def lookup_lazy_attrs(self, name: str) -> Any:
        with self.session.call():
            return super().lookup_lazy_attrs(name)

    def convert_value(self, /, name: str, value: Any) -> Any:
        return _handed(value, self.session)


def _handed(value: Any, session: Session) -> Any:
    kind = type(value)
    if kind not in _METHODS:
        return value
    handle = _Handle(
        value,
        eager_attrs=_FIELDS[kind],
        lazy_attrs=("size",) if kind is Shape else None,
        allowed_methods=_METHODS[kind],
    )
    handle.session = session
    return handle


def _module(session: Session) -> dict[str, monty.ExternalModule]:
    """Build the one module that a program may import, bound to its session."""

    def bound(make: Any) -> Any:
        def call(*args: Any, **kwargs: Any) -> Any:
            with session.call():
                return _handed(make(*args, **kwargs), session)

        return call

    exposed: dict[str, Any] = {}
    sdk = import_module(MODULE)
    for name in sdk.__all__:
        value = getattr(sdk, name)
        # Classes that are only named in annotations cannot be called.
        made_here = inspect.isclass(value) and value is not made.Object
        exposed[name] = monty.ClassType(value) if made_here else bound(value)
    module = monty.ExternalModule(exposed, stubs=stubs())
    *packages, last = MODULE.split(".")
    for inner in (last, *reversed(packages[1:])):
        module = monty.ExternalModule({inner: module}, stubs="")
    return {packages[0]: module}


def _run_monty(text: str, session: Session, options: ProgramOptions) -> tuple[str, list[Signal]]:
    printed = monty.CollectString(max_bytes=options.max_output_bytes)
    limits: monty.ResourceLimits = {
        "max_feed_duration_secs": options.timeout_s,
        "max_memory": options.memory_mib << 20,
        "max_recursion_depth": options.max_recursion,
        "max_suspensions": options.max_calls,
    }
    policy: monty.OSPolicy = {"sleep": "zero", "random_start": {"seed": 0}}
    problems: list[Signal] = []
    starts = [0, *(match.end() for match in re.finditer(rb"\n", text.encode()))]
    try:
        with _pool(options.workers, os.getpid()).checkout(
            script_name=_SCRIPT,
            limits=limits,
            type_check=options.type_check,
            type_check_format="json",
            os_policy=policy,
            external_modules=_module(session),
        ) as worker:
            at = worker.feed_start(text, print_callback=printed)
            while not isinstance(at, monty.MontyComplete):
                if at.position.filename.startswith("<python-input"):
                    session.line = bisect_right(starts, at.position.start)
                at = at.resume_auto()
                if session.spent is not None:
                    raise session.spent
    except monty.MontyTypingError as error:
        problems = _typing_signals(error)
    except Spent:
        pass  # told below, where it is told too when the program has caught it
    except monty.MontyError as error:
        problems = [_monty_signal(error, options)]
    except TimeoutError:
        message = "all sandbox workers are busy"
        hint = "raise program.workers, or run fewer programs at once"
        problems = [Signal(severity="error", code="busy", message=message, hint=hint)]
    if session.spent is not None:
        problems = [_spent_signal(session.spent, session)]
    return printed.output, problems


@lru_cache(maxsize=4)
def _pool(workers: int, pid: int) -> monty.Monty:
    """Start a pool of warm workers once; `pid` gives a forked process its own."""
    pool = monty.Monty(
        min_processes=1,
        max_processes=workers,
        checkout_timeout=_START_S,
        request_timeout=_START_S,
        feed_duration_limit_grace=_GRACE_S,
    )
    pool.__enter__()
    atexit.register(pool.__exit__, None, None, None)
    return pool


def _typing_signals(error: monty.MontyTypingError) -> list[Signal]:
    found = []
    for item in json.loads(error.display())[:_MAX_TYPE_SIGNALS]:
        syntax = item["code"] == "invalid-syntax"
        found.append(
            Signal(
                severity="error",
                code="syntax" if syntax else "type",
                message=item["message"][:400],
                line=item["location"]["row"],
                column=item["location"]["column"],
                hint="" if syntax else _TYPE_HINTS.get(item["code"], ""),
            )
        )
    return found


_TYPE_HINTS = {
    "unresolved-import": f"import only from {MODULE}, math, random, itertools, functools, "
    "dataclasses and typing",
    "unresolved-attribute": "the SDK has only what the guide lists",
    "unknown-argument": "the SDK has only the arguments that the guide lists",
}
_CODES: dict[type[BaseException], tuple[str, str]] = {
    TimeoutError: ("timeout", "the program must end by itself; look for an endless loop"),
    MemoryError: ("memory", "the program holds too much at once"),
    RecursionError: ("recursion", "write a loop instead"),
    NotImplementedError: (
        "unsupported",
        "the sandbox knows a part of Python: no inheritance, "
        "no yield, no del, no properties, no import *",
    ),
    ImportError: ("import", _TYPE_HINTS["unresolved-import"]),
    PermissionError: ("forbidden", "programs have no files, network or processes"),
    OSError: ("forbidden", "programs have no files, network or processes"),
}


def _monty_signal(error: monty.MontyError, options: ProgramOptions) -> Signal:
    if isinstance(error, monty.MontyCrashedError):
        code = "timeout" if error.timed_out else "crashed"
        message = f"the sandbox had to be stopped: {error}"[:400]
        return Signal(severity="error", code=code, message=message, hint=_CODES[TimeoutError][1])
    shows = isinstance(error, monty.MontySyntaxError | monty.MontyRuntimeError)
    frames = error.traceback() if shows else []
    own = [frame for frame in frames if frame.filename.startswith("<python-input")]
    inner = error.exception()
    code, hint = next(
        (entry for kind, entry in _CODES.items() if isinstance(inner, kind)), ("runtime", "")
    )
    message = f"{type(inner).__name__}: {inner}"
    if isinstance(error, monty.MontySyntaxError):
        code = "syntax"
    elif code == "memory" and "print" in message:
        code, hint = "output", f"print at most {options.max_output_bytes} bytes"
    elif isinstance(inner, RuntimeError) and "suspension" in message:
        code, hint = "too_many_calls", f"make at most {options.max_calls} calls of the SDK"
    elif isinstance(inner, ValueError | TypeError):
        code = "value"
    return Signal(
        severity="error",
        code=code,
        message=message[:600],
        line=own[-1].line if own else None,
        column=own[-1].column if own else None,
        hint=hint,
    )


def _spent_signal(spent: Spent, session: Session) -> Signal:
    hint = "use fewer or simpler shapes"
    return Signal(
        severity="error", code=spent.code, message=str(spent), line=session.line, hint=hint
    )


def _run_cpython(text: str, session: Session, options: ProgramOptions) -> tuple[str, list[Signal]]:
    session.filename = f"<{_SCRIPT}>"
    printed = io.StringIO()
    try:
        code = compile(text, session.filename, "exec", dont_inherit=True)
        with contextlib.redirect_stdout(printed), entered(session):
            exec(code, {"__name__": "__main__", "__file__": _SCRIPT})
    except SyntaxError as error:
        problem = Signal(
            severity="error",
            code="syntax",
            message=str(error.msg),
            line=error.lineno,
            column=error.offset,
        )
        return printed.getvalue(), [problem]
    except (Exception, SystemExit) as error:
        return printed.getvalue(), [_python_signal(error, session)]
    if session.spent is not None:
        return printed.getvalue(), [_spent_signal(session.spent, session)]
    return printed.getvalue()[: options.max_output_bytes], []


def _python_signal(error: BaseException, session: Session) -> Signal:
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame.lineno for frame in frames if frame.filename == session.filename]
    code, hint = next(
        (entry for kind, entry in _CODES.items() if isinstance(error, kind)), ("runtime", "")
    )
    if isinstance(error, Spent):
        code = error.code
    elif isinstance(error, ValueError | TypeError):
        code = "value"
    return Signal(
        severity="error",
        code=code,
        message=f"{type(error).__name__}: {error}"[:600],
        line=own[-1] if own else None,
        hint=hint,
    )
