import asyncio
from contextvars import ContextVar

from neoworld_mjx.mllm.panel import run_coroutine

WHO: ContextVar[str] = ContextVar("who", default="nobody")


async def _answer():
    await asyncio.sleep(0)
    return WHO.get()


def test_a_coroutine_runs_with_and_without_a_loop_in_the_callers_context():
    WHO.set("caller")
    assert run_coroutine(_answer()) == "caller"

    async def in_a_loop():
        return run_coroutine(_answer())

    assert asyncio.run(in_a_loop()) == "caller"
