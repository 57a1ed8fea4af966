"""Step 3 with models: the critic judges key frames of failed checks, the reasoner proposes edits
(3.2).

Models see objects that direct repairs left with failed or doubtful checks, or on request all. The
reasoner proposes a `Patch`, which must lower the fault score like every repair. The critic's
findings are reported beside the verdict and change no outcome. An object that passes with doubtful
checks goes to the critic alone: its fault score is 0, and no edit could lower that.
"""

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field

from ..checks.object_tests import ObjectTests
from ..errors import MissingAnswerError
from ..mllm import Panel, Request, ask_or_record, package_text, revise
from ..spec import ObjectSpec, inertial
from .key_frames import questionable, strips
from .patch import Patch
from .repairs import Repaired, RunTests, try_patches

T = TypeVar("T", bound=BaseModel)

# Titles, docstrings and descriptions of the answers are part of the requests: tapes hold answers to
# these very ones.


class Finding(BaseModel):
    """One observation in the key frames."""

    model_config = ConfigDict(extra="forbid")

    where: Annotated[str, Field(max_length=60)]
    """Part or joint."""
    what: Annotated[str, Field(max_length=400)]
    suggestion: Annotated[str, Field(max_length=400)] = ""


class MotionCritique(BaseModel):
    """The critic's verdict on an object's motion."""

    model_config = ConfigDict(extra="forbid", title="MotionVerdict")

    findings: list[Finding] = Field(default=[], max_length=6)
    verdict: Literal["sound", "edit", "reprogram"]


class ProposedEdit(BaseModel):
    """The reasoner's edit of an object."""

    model_config = ConfigDict(extra="forbid", title="Edit")

    patch: Patch
    why: Annotated[str, Field(max_length=600)] = ""


def key_frames_request(tests: ObjectTests, *, always: bool = False) -> Request[MotionCritique]:
    """Return the request to the critic about an object's key frames; see `strips`."""
    prompt = f"The object: {tests.spec.label or tests.spec.name}.\n\n{_numbers(tests)}"
    name, frames = f"simulation:{tests.spec.name}", strips(tests, always=always)
    return Request("critic", name, _instructions("critic"), prompt, MotionCritique, frames)


def edit_request(tests: ObjectTests, critique: MotionCritique) -> Request[ProposedEdit]:
    """Return the request to the reasoner for a patch."""
    findings = "\n".join(f"- {f.where}: {f.what} -> {f.suggestion}" for f in critique.findings)
    prompt = (
        f"{_numbers(tests)}\n\nThe critic's findings:\n{findings or '- none'}\n\n"
        f"The object:\n{described(tests.spec)}"
    )
    name = f"edit:{tests.spec.name}"
    return Request("reasoner", name, _instructions("editor"), prompt, ProposedEdit)


def _instructions(name: str) -> str:
    return package_text(__package__, name).removesuffix("\n")


def _numbers(tests: ObjectTests) -> str:
    lines = []
    for check in questionable(tests.verdict):
        value = "none" if check.value is None else f"{check.value:.3g}"
        outcome = "BARELY PASSED" if check.borderline else check.outcome
        lines.append(
            f"- {outcome} {check.scenario} {check.name}: {value}, threshold "
            f"{check.threshold:.3g} {check.unit} {check.evidence}".rstrip()
        )
    return "Values that failed or barely passed:\n" + "\n".join(lines or ["- none"])


def described(spec: ObjectSpec) -> str:
    """Describe the editable parts and joints of an object with their present values."""
    lines = []
    for part in spec.parts:
        own = inertial(spec, part)
        x, y, z = own.pos
        geoms = ", ".join(f"{g.name} ({g.shape.type}, {g.role})" for g in part.geoms[:12])
        lines.append(
            f"part {part.name}: {own.mass:.4g} kg, centre ({x:.3f}, {y:.3f}, {z:.3f}); {geoms}"
        )
    for j in spec.joints:
        x, y, z = j.pos
        lines.append(
            f"joint {j.name}: {j.type}, {j.child} on {j.parent}, at ({x:.3f}, {y:.3f}, {z:.3f}) "
            f"along {tuple(round(v, 3) for v in j.axis)}, {j.lower:.4g} to {j.upper:.4g}, damping "
            f"{j.damping:.4g}, friction {j.friction:.4g}"
        )
    return "\n".join(lines)


@dataclass(frozen=True)
class _Round:
    tests: ObjectTests
    critique: MotionCritique | None = None


def with_models(
    repaired: Repaired,
    now: ObjectTests,
    models: Panel,
    run: RunTests,
    spec: ObjectSpec,
    *,
    rounds: int = 2,
    always: bool = False,
) -> list[MotionCritique]:
    """Ask the critic for findings and the reasoner for edits, at most `rounds` times.

    An object that passes gets findings but no edits; so does every object with `rounds` 0.

    Args:
        repaired: the result of direct repairs; edits that help are added to it.
        now: the tests's result for it.
        models: critic and reasoner.
        run: runs the tests on an object.
        spec: the object before all repairs.
        rounds: most edits.
        always: whether the critic also sees what passes, and whose answers a tape must hold.

    Returns:
        The critique of each round.

    Raises:
        BudgetError: the cost cap is reached.
        MissingAnswerError: with `always`, a tape lacks the answer.
    """
    return models.run(_edited(repaired, now, models, run, spec, rounds, always))


async def _edited(
    repaired: Repaired,
    now: ObjectTests,
    models: Panel,
    run: RunTests,
    spec: ObjectSpec,
    rounds: int,
    always: bool,
) -> list[MotionCritique]:
    lost = repaired.lost_critics

    async def ask(request: Request[T]) -> T | None:
        try:
            return await ask_or_record(models, request, request.name, lost)
        except MissingAnswerError:
            if always:
                raise
            # No fallback: by default nobody is asked for what the tape does not hold.
            repaired.tried.append(f"{request.name}: the tape does not hold the answer")
            return None

    async def criticise(attempt: _Round) -> _Round:
        request = key_frames_request(attempt.tests, always=always)
        return replace(attempt, critique=await ask(request))

    def accept(attempt: _Round) -> bool:
        critique = attempt.critique
        editable = critique is not None and critique.verdict == "edit"
        return not editable or not rounds or attempt.tests.verdict.passed

    async def edit(attempts: Sequence[_Round]) -> _Round | None:
        tests, critique = attempts[-1].tests, attempts[-1].critique
        assert critique is not None
        request = edit_request(tests, critique)
        proposed = await ask(request)
        if proposed is None or proposed.patch.empty:
            return None
        edited = await asyncio.to_thread(try_patches, repaired, tests, [proposed.patch], run, spec)
        return None if edited is None or edited.verdict.passed else _Round(edited)

    attempts = await revise(
        _Round(now),
        rounds=max(rounds, 1),
        accept=accept,
        next_attempt=edit,
        criticise=criticise,
        criticise_last=False,
    )
    return [attempt.critique for attempt in attempts if attempt.critique is not None]
