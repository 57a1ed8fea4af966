"""Execution of a program in a worker process of the Monty sandbox.

The program is first type-checked against the stubs of the SDK. A worker has no access to files or
the network, and can import only the SDK, `math` and similar modules. Time, memory, recursion,
output and calls are limited. The SDK's objects remain in this process, and a worker has only
handles of them. The SDK validates every value that a program passes.
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

from ..checks.signals import Signal, error_signal
from ..config import ProgramOptions
from .call_clock import CallClock
from .exception_signals import (
    ENDLESS_HINT,
    MODULE,
    exception_signal,
    limit_signal,
)
from .part import Geom, Joint, Part
from .placing import Shape
from .sdk_object import Object
from .session import LimitExceeded, Session
from .type_signals import type_signals


def public_members(kind: type, select: Callable[[object], bool]) -> tuple[str, ...]:
    """Return the names of the public members of a class that `select` accepts."""
    members = inspect.getmembers_static(kind, select)
    return tuple(name for name, _ in members if not name.startswith("_"))


_START_S, _GRACE_S = 10.0, 0.5
_MIN_CPU_FRACTION = 0.25
"""A worker that timed out is run again if it used less processor time than this.

The value is a fraction of the time limit.
"""
_WALL_TIME_FACTOR = 30.0
"""Limit of the second run's wall time, as a multiple of the time limit.

In the second run, the time limit applies to the processor time.
"""
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


class WorkerStarved(Exception):
    """Raised if a program timed out because the machine was too busy to run it."""


def run_sandboxed(
    text: str, session: Session, options: ProgramOptions, *, limit_cpu_time: bool = False
) -> tuple[str, list[Signal]]:
    """Run a program in a worker, and return its printed text and its errors.

    Args:
        text: the program.
        session: collects the program's objects and counts the resources that the program uses.
        options: the limits.
        limit_cpu_time: if True, the time limit applies to the worker's processor time instead of
            the wall time.

    Raises:
        WorkerStarved: the worker used little processor time before it reached the limit of wall
            time. Not raised if `limit_cpu_time` is True.
    """
    printed = monty.CollectString(max_bytes=options.max_output_bytes)
    limits: monty.ResourceLimits = {
        "max_feed_duration_secs": options.timeout_s
        * (_WALL_TIME_FACTOR if limit_cpu_time else 1.0),
        "max_memory": options.memory_mib << 20,
        "max_recursion_depth": options.max_recursion,
        "max_suspensions": options.max_calls,
    }
    policy: monty.OSPolicy = {"sleep": "zero", "random_start": {"seed": 0}}
    errors: list[Signal] = []
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
            clock.watch_worker(
                worker.worker_pid, options.timeout_s if limit_cpu_time else float("inf")
            )
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
            return run_sandboxed(text, session, unchecked, limit_cpu_time=limit_cpu_time)
    except LimitExceeded:
        pass  # Reported below, even if the program caught the exception.
    except monty.MontyError as error:
        signal = _monty_signal(error, options)
        if clock.worker_killed:
            signal = signal.model_copy(update={"code": "timeout"})
        used = clock.worker_s
        starved = used is not None and used < _MIN_CPU_FRACTION * options.timeout_s
        if signal.code == "timeout" and starved and not limit_cpu_time:
            raise WorkerStarved from None
        errors = [signal]
    except TimeoutError:
        hint = "raise program.workers, or run fewer programs at once"
        errors = [error_signal("busy", "all sandbox workers are busy", hint=hint)]
    if session.exceeded is not None:
        errors = [limit_signal(session.exceeded, session)]
    return printed.output, errors


@lru_cache(maxsize=4)
def _pool(workers: int, pid: int) -> monty.Monty:
    """Return a pool of running workers; each process, identified by `pid`, has a separate pool."""
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
    """Return the type stubs that programs are checked against."""
    return resources.files("neoworld_mjx.program").joinpath("sdk.pyi").read_text(encoding="utf-8")


def _monty_signal(error: monty.MontyError, options: ProgramOptions) -> Signal:
    if isinstance(error, monty.MontyCrashedError):
        code = "timeout" if error.timed_out else "crashed"
        message = f"the sandbox had to be stopped: {error}"[:400]
        return error_signal(code, message, hint=ENDLESS_HINT)
    located = isinstance(error, monty.MontySyntaxError | monty.MontyRuntimeError)
    frames = error.traceback() if located else []
    frames = [frame for frame in frames if frame.filename.startswith("<python-input")]
    inner = error.exception()
    position = (frames[-1].line, frames[-1].column) if frames else (None, None)
    signal = exception_signal(inner, *position)
    update: dict[str, str] = {}
    if isinstance(error, monty.MontySyntaxError):
        update = {"code": "syntax", "hint": ""}
    elif signal.code == "memory" and "print" in signal.message:
        update = {"code": "output", "hint": f"print at most {options.max_output_bytes} bytes"}
    elif isinstance(inner, RuntimeError) and "suspension" in signal.message:
        hint = f"make at most {options.max_calls} calls of the SDK"
        update = {"code": "too_many_calls", "hint": hint}
    return signal.model_copy(update=update)
