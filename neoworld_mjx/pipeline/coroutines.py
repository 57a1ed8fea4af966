"""Run a coroutine from plain code, also where an event loop runs already, as in a notebook."""

import asyncio
import contextvars
from collections.abc import Coroutine
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

T = TypeVar("T")


def run_coroutine(work: Coroutine[Any, Any, T]) -> T:
    """Return a coroutine's result; in a running event loop it gets a loop and thread of its own.

    The caller waits either way, and context variables are the caller's.
    """
    try:
        asyncio.get_running_loop()
    except RuntimeError:
        return asyncio.run(work)
    with ThreadPoolExecutor(1, thread_name_prefix="neoworld-steps") as thread:
        return thread.submit(contextvars.copy_context().run, asyncio.run, work).result()
