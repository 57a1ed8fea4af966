"""Run a program in a worker process of the Monty sandbox.

The text is type-checked against the SDK's stubs first. A worker has no files, no network and no
imports besides the SDK, `math` and a few like it; time, memory, recursion, output and calls are
limited. The SDK's objects stay in this process: a worker holds handles of them, and the SDK
validates every value that a program passes.
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

from ..checks.signals import Signal
from ..config import ProgramOptions
from .call_clock import CallClock
from .exception_signals import ENDLESS_HINT, MODULE, exception_signal, limit_signal
from .part import Geom, Joint, Part
from .placing import Shape
from .sdk_object import Object
from .session import LimitExceeded, Session
from .type_signals import type_signals


def public_members(kind: type, select: Callable[[object], bool]) -> tuple[str, ...]:
    """Return the names of a class's public members that `select` accepts."""
    members = inspect.getmembers_static(kind, select)
    return tuple(name for name, _ in members if not name.startswith("_"))


_START_S, _GRACE_S = 10.0, 0.5
_STARVED = 0.25
"""Share of the time limit that a worker on a busy machine got, below which it runs once more."""
_PATIENCE = 30.0
"""Wall time of that run, in units of the limit, which then holds for processor time."""
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
    """Handle of an SDK object: exposes its public fields, properties and methods, nothing else."""

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
    """Return a handle of an SDK object, and any other value unchanged."""
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

    def bound(function: Any) -> Any:
        def call(*args: Any, **kwargs: Any) -> Any:
            with session.call():
                return _exposed(function(*args, **kwargs), session)

        return call

    exposed: dict[str, Any] = {}
    sdk = import_module(MODULE)
    for name in sdk.__all__:
        value = getattr(sdk, name)
        # Programs name these classes in annotations; only `Object` may be called.
        class_only = inspect.isclass(value) and value is not Object
        exposed[name] = monty.ClassType(value) if class_only else bound(value)
    module = monty.ExternalModule(exposed, stubs=stubs())
    *packages, last = MODULE.split(".")
    for inner in (last, *reversed(packages[1:])):
        module = monty.ExternalModule({inner: module}, stubs="")
    return {packages[0]: module}


class Starved(Exception):
    """A program's time ran out while the machine hardly let it run; nothing is known of it."""


def run_sandboxed(
    text: str, session: Session, options: ProgramOptions, *, patient: bool = False
) -> tuple[str, list[Signal]]:
    """Run a program in a worker.

    Args:
        text: the program.
        session: collects the objects that the program makes, and counts what it uses.
        options: the limits.
        patient: count the limit of time in processor time of the worker, and wait for that.

    Returns:
        Printed text, and errors.

    Raises:
        Starved: the worker was stopped at the limit of wall time with little processor time; never
            if `patient`.
    """
    printed = monty.CollectString(max_bytes=options.max_output_bytes)
    limits: monty.ResourceLimits = {
        "max_feed_duration_secs": options.timeout_s * (_PATIENCE if patient else 1.0),
        "max_memory": options.memory_mib << 20,
        "max_recursion_depth": options.max_recursion,
        "max_suspensions": options.max_calls,
    }
    policy: monty.OSPolicy = {"sleep": "zero", "random_start": {"seed": 0}}
    problems: list[Signal] = []
    starts = [0, *(match.end() for match in re.finditer(rb"\n", text.encode()))]
    clock = session.clock = CallClock()
    try:
        with (
            clock.watching(),
            _pool(options.workers, os.getpid()).checkout(
                script_name="program.py",
                limits=limits,
                type_check=options.type_check,
                type_check_format="json",
                os_policy=policy,
                external_modules=_module(session),
            ) as worker,
        ):
            clock.watch_worker(worker.worker_pid, options.timeout_s if patient else float("inf"))
            progress = worker.feed_start(text, print_callback=printed)
            while not isinstance(progress, monty.MontyComplete):
                if progress.position.filename.startswith("<python-input"):
                    session.line = bisect_right(starts, progress.position.start)
                progress = progress.resume_auto()
                if session.exceeded is not None:
                    raise session.exceeded
    except monty.MontyTypingError as error:
        problems = type_signals(json.loads(error.display()))
    except LimitExceeded:
        pass  # Reported below, as it is when the program has caught it.
    except monty.MontyError as error:
        problem = _monty_signal(error, options)
        if clock.worker_killed:
            problem = problem.model_copy(update={"code": "timeout"})
        used = clock.worker_s
        starved = used is not None and used < _STARVED * options.timeout_s
        if problem.code == "timeout" and starved and not patient:
            raise Starved from None
        problems = [problem]
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
