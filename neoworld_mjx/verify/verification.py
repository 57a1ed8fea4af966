"""Step 3 for one object: object tests, repairs, and requests to models."""

import asyncio
import threading
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, TypeVar

from pydantic import BaseModel

from ..checks.object_tests import run_object_tests
from ..checks.signals import Allowance
from ..config import VerifyOptions
from ..errors import MissingResponseError
from ..mllm import Model, Request, ask_or_record
from ..mllm.panel import run_coroutine
from ..program.ask import SynthesisResult
from ..program.synthesise import ProgramSource, reprogram
from ..spec import ObjectSpec, Quat
from ..spec.pose import IDENTITY
from .critic import MotionCritique, edit_request, findings, key_frames_request, standard_runs
from .repairs import Repair, repair

_simulating = threading.Lock()
R = TypeVar("R")
T = TypeVar("T", bound=BaseModel)


async def verify_object(
    spec: ObjectSpec,
    options: VerifyOptions,
    *,
    fixed_base: bool = False,
    tilt: Quat = IDENTITY,
    allowed: Sequence[Allowance] = (),
    models: Model | None = None,
    surroundings: str = "",
    source: ProgramSource | None = None,
) -> Repair:
    """Test an object, and repair it in at most `options.rounds` rounds (paper Section 3.2).

    Direct repairs come first. Then models are shown an object with failed or borderline checks, or,
    with `options.critic: always`, every object. Several objects can be verified concurrently; they
    are simulated one after another while others wait for models.

    Args:
        spec: the object.
        options: options of the tests. If `rounds` is 0, the object is not changed. If
            `direct_repairs` is False, only models change the object.
        fixed_base: if True, the base of the object is fixed.
        tilt: orientation in which the object rests.
        allowed: overlaps that the object's program declares.
        models: models for the critic, the reasoner and the programmer; if None, no requests are
            sent.
        surroundings: a sentence for the models that says what the object stands on or in.
        source: the object's program, for a request of another one. If None, the rounds end when
            the critic asks for another program.

    Raises:
        BudgetError: the cost cap is reached.
        MissingResponseError: `options.critic` is "always", and the recorded responses lack a
            response.
    """
    run = partial(
        run_object_tests, options=options, fixed_base=fixed_base, tilt=tilt, allowed=allowed
    )
    direct = options.rounds if options.direct_repairs else 0
    repaired = await _simulated(lambda: repair(spec, run, rounds=direct))
    # A fixed object without joints has no scenarios, so there is nothing to show.
    always = options.critic == "always" and bool(standard_runs(repaired.tests))
    shown = repaired.verdict.questionable or always
    if models is not None and shown:
        critiques = await revise_with_models(
            repaired, models, options, surroundings=surroundings, source=source
        )
        repaired.seen = [f"{f.where}: {f.what}" for c in critiques for f in c.findings]
    return repaired


def verify_and_repair(
    spec: ObjectSpec, options: VerifyOptions | None = None, **arguments: Any
) -> Repair:
    """Test an object and repair it; this is the blocking form of `verify_object`."""
    return run_coroutine(verify_object(spec, options or VerifyOptions(), **arguments))


async def revise_with_models(
    repaired: Repair,
    models: Model,
    options: VerifyOptions,
    *,
    surroundings: str = "",
    source: ProgramSource | None = None,
) -> list[MotionCritique]:
    """Request critiques, and the edits or new programs for which the critic asks.

    An object that passes with borderline checks is only shown to the critic, because its fault
    score is 0 and no edit could lower it. The same holds if `options.rounds` is 0.

    Args:
        repaired: the result of direct repairs, to which changes that help are added.
        models: models for the critic, the reasoner and the programmer.
        options: the number of rounds; with `critic: always`, a response that the recorded responses
            (tape) lack is an error.
        surroundings: a sentence that says what the object stands on or in.
        source: the object's program; if None, no other program can be requested.

    Returns:
        The critiques, one for each round in which the critic responded.
    """
    always = options.critic == "always"
    critiques: list[MotionCritique] = []
    tried: list[str] = []
    for _ in range(options.rounds or 1):
        request = key_frames_request(
            repaired.tests, surroundings=surroundings, tried=tried, always=always
        )
        critique = await _ask(models, request, repaired, always=always)
        if critique is None:
            break
        critiques.append(critique)
        if critique.verdict == "sound":
            repaired.waive()
            break
        if not options.rounds or repaired.verdict.passed:
            break
        tried_before = len(repaired.tried)
        if critique.verdict == "reprogram":
            result = await _reprogram(critique, models, repaired, source, always=always)
            if result is None:
                break
            await _simulated(partial(repaired.try_program, result))
        else:
            request = edit_request(repaired.tests, critique, surroundings=surroundings, tried=tried)
            proposed = await _ask(models, request, repaired, always=always)
            if proposed is None or proposed.patch.empty:
                break
            await _simulated(partial(repaired.try_patch, proposed.patch))
        tried += repaired.tried[tried_before:]
        if repaired.verdict.passed:
            break
    return critiques


async def _ask(models: Model, request: Request[T], repaired: Repair, *, always: bool) -> T | None:
    """Return a model's response; None if the model fails or if the tape lacks the response."""
    try:
        return await ask_or_record(models, request, request.name, repaired.lost_critics)
    except MissingResponseError:
        if always:
            raise
        # By default, a response that the tape lacks is skipped without recording a fallback.
        repaired.tried.append(f"{request.name}: the tape does not hold the answer")
        return None


async def _reprogram(
    critique: MotionCritique,
    models: Model,
    repaired: Repair,
    source: ProgramSource | None,
    *,
    always: bool,
) -> SynthesisResult | None:
    """Request another program; return None if it cannot be requested."""
    lines = findings(critique)
    if source is None:
        repaired.unmet.append("; ".join(lines) or "the critic states no finding")
        return None
    failed = [
        f"simulated by itself: {check.scenario.replace('_', ' ')} {check.phrase()}"
        for check in repaired.verdict.checks
        if check.outcome == "FAIL"
    ]
    try:
        result = await reprogram(source, [*lines, *failed], models)
    except MissingResponseError:
        if always:
            raise
        repaired.tried.append("new program: the tape does not hold the answer")
        return None
    repaired.lost_critics += result.fallbacks
    return result


async def _simulated(work: Callable[[], R]) -> R:
    """Run simulations in a thread, one call at a time in this process."""

    def locked() -> R:
        with _simulating:
            return work()

    return await asyncio.to_thread(locked)
