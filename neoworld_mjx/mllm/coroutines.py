"""Run a coroutine from synchronous code, even inside a running event loop such as a notebook's."""

import asyncio
import contextvars
from collections.abc import Coroutine
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

T = TypeVar("T")


def run_coroutine(work: Coroutine[Any, Any, T]) -> T:
    """Run a coroutine and return its result; the call blocks.

    Inside a running event loop, the coroutine runs on a separate loop in another thread. It sees
    the caller's context variables in both cases.
    """
    try:
        asyncio.get_running_loop()
    except RuntimeError:
        return asyncio.run(work)
    with ThreadPoolExecutor(1, thread_name_prefix="neoworld-steps") as thread:
        return thread.submit(contextvars.copy_context().run, asyncio.run, work).result()
