"""Run a program in the Monty sandbox: worker processes that hold nothing but handles.

The text is type-checked against the SDK's stubs first. A worker knows no files, no network and no
imports besides `math` and its like; time, memory, recursion, output and calls are limited.
The SDK's objects live here, and every value that crosses is checked by the SDK.
"""

import atexit
import inspect
import json
import os
import re
from bisect import bisect_right
from collections.abc import Callable
from functools import lru_cache
from importlib import import_module, resources
from typing import Any

import pydantic_monty as monty

from ..config import ProgramOptions
from .exception_signals import ENDLESS_HINT, IMPORT_HINT, MODULE, exception_signal, limit_signal
from .part import Geom, Joint, Part
from .placing import Shape
from .sdk_object import Object
from .session import LimitExceeded, Session
from .signals import Signal


def public_members(kind: type, select: Callable[[object], bool]) -> tuple[str, ...]:
    """Return the names of a class's own public members of a sort: what programs may use."""
    members = vars(kind).items()
    return tuple(name for name, value in members if not name.startswith("_") and select(value))


_START_S, _GRACE_S = 10.0, 0.5
_MAX_TYPE_SIGNALS = 20
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
        lazy_attrs=_PROPERTIES[kind] or None,
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
        made_here = inspect.isclass(value) and value is not Object
        exposed[name] = monty.ClassType(value) if made_here else bound(value)
    module = monty.ExternalModule(exposed, stubs=stubs())
    *packages, last = MODULE.split(".")
    for inner in (last, *reversed(packages[1:])):
        module = monty.ExternalModule({inner: module}, stubs="")
    return {packages[0]: module}


def run_sandboxed(text: str, session: Session, options: ProgramOptions) -> tuple[str, list[Signal]]:
    """Run a program in a worker.

    Args:
        text: the program.
        session: its account; the objects that it makes end up there.
        options: the limits.

    Returns:
        What it printed, and what went wrong.
    """
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
            script_name="program.py",
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
                if session.exceeded is not None:
                    raise session.exceeded
    except monty.MontyTypingError as error:
        problems = _typing_signals(error)
    except LimitExceeded:
        pass  # told below, where it is told too when the program has caught it
    except monty.MontyError as error:
        problems = [_monty_signal(error, options)]
    except TimeoutError:
        message = "all sandbox workers are busy"
        hint = "raise program.workers, or run fewer programs at once"
        problems = [Signal(severity="error", code="busy", message=message, hint=hint)]
    if session.exceeded is not None:
        problems = [limit_signal(session.exceeded, session)]
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


def stubs() -> str:
    """Return the SDK's type stubs, as programs are checked against."""
    return resources.files("neoworld_mjx.program").joinpath("sdk.pyi").read_text(encoding="utf-8")


_TYPE_HINTS = {
    "unresolved-import": IMPORT_HINT,
    "unresolved-attribute": "the SDK has only what the guide lists",
    "unknown-argument": "the SDK has only the arguments that the guide lists",
}


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


def _monty_signal(error: monty.MontyError, options: ProgramOptions) -> Signal:
    if isinstance(error, monty.MontyCrashedError):
        code = "timeout" if error.timed_out else "crashed"
        message = f"the sandbox had to be stopped: {error}"[:400]
        return Signal(severity="error", code=code, message=message, hint=ENDLESS_HINT)
    shows = isinstance(error, monty.MontySyntaxError | monty.MontyRuntimeError)
    frames = error.traceback() if shows else []
    own = [frame for frame in frames if frame.filename.startswith("<python-input")]
    inner = error.exception()
    signal = exception_signal(inner, own[-1].line if own else None, own[-1].column if own else None)
    update: dict[str, str] = {}
    if isinstance(error, monty.MontySyntaxError):
        update = {"code": "syntax", "hint": ""}
    elif signal.code == "memory" and "print" in signal.message:
        update = {"code": "output", "hint": f"print at most {options.max_output_bytes} bytes"}
    elif isinstance(inner, RuntimeError) and "suspension" in signal.message:
        hint = f"make at most {options.max_calls} calls of the SDK"
        update = {"code": "too_many_calls", "hint": hint}
    return signal.model_copy(update=update)
