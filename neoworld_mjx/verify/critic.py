"""Step 3 with models (3.2): the critic judges key frames, the reasoner proposes edits.

Models see objects that direct repairs left with failed or borderline checks, or all on request.
The reasoner proposes a `Patch`, which must lower the fault score like every repair. The critic's
findings are reported with the verdict and change no outcome. An object that passes with borderline
checks goes only to the critic: its fault score is 0, and no edit could lower that.
"""

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field

from ..checks.object_tests import ObjectTests
from ..errors import MissingResponseError
from ..mllm import Panel, Request, ask_or_record, package_text, revise
from ..spec import ObjectSpec, inertial
from .key_frames import questionable, strips
from .patch import Patch
from .repairs import Repair

T = TypeVar("T", bound=BaseModel)

# Titles, docstrings and descriptions of the responses are part of the requests, the keys of tapes.


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
        inertia = inertial(spec, part)
        x, y, z = inertia.pos
        geoms = ", ".join(f"{g.name} ({g.shape.type}, {g.role})" for g in part.geoms[:12])
        lines.append(
            f"part {part.name}: {inertia.mass:.4g} kg, centre ({x:.3f}, {y:.3f}, {z:.3f}); {geoms}"
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


def revise_with_models(
    repaired: Repair, models: Panel, *, rounds: int = 2, always: bool = False
) -> list[MotionCritique]:
    """Request findings from the critic and edits from the reasoner, in at most `rounds` rounds.

    An object that passes gets findings but no edits; so does every object if `rounds` is 0.

    Args:
        repaired: the result of direct repairs; edits that help are added to it.
        models: critic and reasoner.
        rounds: largest number of edits.
        always: True if the critic also sees valid objects; then a tape must hold its responses.

    Returns:
        The critique of each round.

    Raises:
        BudgetError: the cost cap is reached.
        MissingResponseError: with `always`, a tape lacks the response.
    """

    async def ask(request: Request[T]) -> T | None:
        try:
            return await ask_or_record(models, request, request.name, repaired.lost_critics)
        except MissingResponseError:
            if always:
                raise
            # By default, a response that the tape does not hold is skipped without a fallback.
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
        critique = attempts[-1].critique
        assert critique is not None
        proposed = await ask(edit_request(repaired.tests, critique))
        if proposed is None or proposed.patch.empty:
            return None
        helped = await asyncio.to_thread(repaired.try_patches, [proposed.patch])
        return _Round(repaired.tests) if helped and not repaired.after.passed else None

    attempts = models.run(
        revise(
            _Round(repaired.tests),
            rounds=max(rounds, 1),
            accept=accept,
            next_attempt=edit,
            criticise=criticise,
            criticise_last=False,
        )
    )
    return [attempt.critique for attempt in attempts if attempt.critique is not None]
