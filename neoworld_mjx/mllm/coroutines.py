"""Run a coroutine from synchronous code, even inside a running event loop, as in a notebook."""

import asyncio
import contextvars
from collections.abc import Coroutine
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

T = TypeVar("T")


def run_coroutine(work: Coroutine[Any, Any, T]) -> T:
    """Return a coroutine's result; inside a running event loop, use a separate thread and loop.

    The call blocks, and the coroutine sees the caller's context variables.
    """
    try:
        asyncio.get_running_loop()
    except RuntimeError:
        return asyncio.run(work)
    with ThreadPoolExecutor(1, thread_name_prefix="neoworld-steps") as thread:
        return thread.submit(contextvars.copy_context().run, asyncio.run, work).result()
