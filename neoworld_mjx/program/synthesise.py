"""Step 2, from the crop of an object to its program: ask, run, repair, draw, criticise, revise.

The model is given the object's measured box. Errors of the program or of its checks go back to it
(debug rounds); a critic sees pictures from the photo's own view, and its faults go back to the
programmer (critic rounds). The program with the best score of its own is kept, whatever came last.
"""

import asyncio
import io
import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol, TypeVar, runtime_checkable

import numpy as np
from PIL import Image
from pydantic import BaseModel

from ..config import ProgramOptions
from ..mllm import Model, Picture, Request, ask_or_record, package_text, revise
from ..spec import Camera, ObjectSpec, TreeNode, bounds
from .allowance import Allowance
from .ask import (
    ProgramAnswer,
    ProgramCritique,
    Subject,
    judge_request,
    program_request,
    repair_request,
    revise_request,
)
from .conformance import fit, losses, lost_checks
from .make import build
from .sandbox import Built, run
from .signals import Signal, deduplicated, has_errors
from .supports import support_program
from .views import draw

T = TypeVar("T", bound=BaseModel)

_WEIGHTS = {"geometry": 0.5, "articulation": 0.3, "colour": 0.2}
UNJUDGED = 5.0
"""Critic's score of a program without a critique."""


@runtime_checkable
class Cutout(Protocol):
    """A picture of an object cut out of the photo, encoded as PNG or JPEG."""

    @property
    def data(self) -> bytes:
        """The file's bytes."""
        ...

    @property
    def note(self) -> str:
        """Description of the parts that the picture does not show; empty if it shows all."""
        ...


@dataclass(frozen=True)
class ProgramAttempt:
    """One program of a synthesis, with the results of its checks and its critique."""

    stage: str
    """Its origin: "program", "debug" or "revise", or "support" for one that no model wrote."""
    text: str
    built: Built
    notes: str = ""
    verdict: ProgramCritique | None = None

    @property
    def score(self) -> float:
        """Critic's score, 0 to 10, less one point for each error and the deviation of its size."""
        if self.built.spec is None:
            return 0.0
        score = UNJUDGED if self.verdict is None else marks(self.verdict)
        errors = [signal for signal in self.built.signals if signal.severity == "error"]
        deviation = sum(
            min(1.0, abs(signal.value or 0.0))
            for signal in self.built.signals
            if signal.code == "proportions"
        )
        return max(0.0, score - len(errors) - deviation)

    @property
    def rank(self) -> tuple[bool, bool, bool, float]:
        """Key by which attempts are compared, the larger the better."""
        lost = any(signal.code == "lost" for signal in self.built.signals)
        return self.built.spec is not None, not lost, self.built.ok, self.score


@dataclass(frozen=True)
class Programmed:
    """The result of a synthesis."""

    spec: ObjectSpec | None
    text: str
    signals: tuple[Signal, ...]
    score: float
    rounds: tuple[ProgramAttempt, ...]
    fallbacks: tuple[tuple[str, str], ...] = ()
    """Stages that failed, and errors that remain, with the reasons."""
    allowances: tuple[Allowance, ...] = ()
    """Overlaps that the program declares."""

    @property
    def reason(self) -> str:
        """Why there is no object, in one line; empty if there is one."""
        if self.spec is not None:
            return ""
        first = next((s.phrase() for s in self.signals if s.severity == "error"), "no program")
        return f"no program of {len(self.rounds)} could be built; the last: {first}"

    def to_json(self) -> str:
        """Return all rounds as JSON."""
        rounds = [
            {
                "stage": attempt.stage,
                "program": attempt.text,
                "notes": attempt.notes,
                "signals": [
                    s.model_dump(mode="json", exclude_none=True) for s in attempt.built.signals
                ],
                "verdict": None
                if attempt.verdict is None
                else attempt.verdict.model_dump(mode="json"),
                "score": round(attempt.score, 4),
                "kept": attempt.text == self.text,
            }
            for attempt in self.rounds
        ]
        data = {
            "score": round(self.score, 4),
            "signals": [
                signal.model_dump(mode="json", exclude_none=True) for signal in self.signals
            ],
            "fallbacks": [list(item) for item in self.fallbacks],
            "allowances": [one._asdict() for one in self.allowances],
            "rounds": rounds,
        }
        return json.dumps(data, indent=1) + "\n"


async def synthesise(
    node: TreeNode,
    crop: Cutout | bytes,
    models: Model,
    options: ProgramOptions,
    *,
    camera: Camera | None = None,
    colour: tuple[float, float, float] | None = None,
) -> Programmed:
    """Have models program an object after its crop.

    Supports of the environment get a simple program from their box without a model.

    Args:
        node: the object, as parsed.
        crop: its picture.
        models: answer as programmer and critic.
        options: rounds, critics, sandbox.
        camera: the photo's, so that the critic sees the object from the same side.
        colour: of a support, red, green, blue from 0 to 1; by default the median of its crop.

    Raises:
        ModelError: the first request failed, a tape lacks an answer, or the cost cap is reached.
    """
    plain = isinstance(crop, bytes)
    picture = Picture("crop", crop if plain else crop.data)
    subject = Subject(node, picture, "" if plain else crop.note)
    work = _Synthesis(subject, models, options, camera)
    if node.environment:
        program = support_program(node, colour or median_colour(picture))
        built = await asyncio.to_thread(run, program, options)
        return work.result(ProgramAttempt("support", program, built))
    answer = (await models.ask(program_request(subject))).value
    await revise(
        await work.debugged("program", answer, None),
        rounds=options.critic_rounds,
        accept=lambda attempt: attempt.verdict is None or _accepted(attempt.verdict, options),
        next_attempt=work.revised,
        criticise=work.criticised,
    )
    return work.result(max(work.attempts, key=lambda attempt: attempt.rank))


def guide() -> str:
    """Return the authoring contract that programmers are given."""
    return package_text(__package__, "guide")


def marks(critique: ProgramCritique) -> float:
    """Return the weighted mean of a critic's three scores, 0 to 10."""
    return sum(weight * getattr(critique, name) for name, weight in _WEIGHTS.items())


def median_colour(picture: Picture) -> tuple[float, float, float]:
    """Return the median red, green, blue of a picture, 0 to 1."""
    with Image.open(io.BytesIO(picture.data)) as image:
        rgb = np.asarray(image.convert("RGB")).reshape(-1, 3)
    r, g, b = (np.median(rgb, axis=0) / 255).tolist()
    return r, g, b


def unfenced(program: str) -> str:
    """Remove the code fence that some models put around a program."""
    lines = program.strip().splitlines()
    if len(lines) >= 2 and lines[0].startswith("```") and lines[-1].strip() == "```":
        lines = lines[1:-1]
    return "\n".join(lines) + "\n"


@dataclass
class _Synthesis:
    """One object's synthesis: its inputs, all attempts so far, and the stages that failed."""

    subject: Subject
    models: Model
    options: ProgramOptions
    camera: Camera | None
    attempts: list[ProgramAttempt] = field(default_factory=list)
    fallbacks: list[tuple[str, str]] = field(default_factory=list)

    async def debugged(
        self, stage: str, answer: ProgramAnswer, before: ProgramAttempt | None
    ) -> ProgramAttempt:
        """Build a program, send its errors back for bounded rounds, and return the best attempt."""

        async def repaired(attempts: Sequence[ProgramAttempt]) -> ProgramAttempt | None:
            signals = attempts[-1].built.signals
            earlier = attempts[-2].built.signals if len(attempts) > 1 else None
            request = repair_request(self.subject, attempts[-1].text, signals, earlier)
            repair = await self._ask("debug", request)
            best = max(attempts, key=lambda attempt: attempt.rank)
            return None if repair is None else await self._checked("debug", repair, best)

        attempts = await revise(
            await self._checked(stage, answer, before),
            rounds=self.options.debug_rounds,
            accept=lambda attempt: not has_errors(attempt.built.signals),
            next_attempt=repaired,
        )
        return max(attempts, key=lambda attempt: attempt.rank)

    async def revised(self, attempts: Sequence[ProgramAttempt]) -> ProgramAttempt | None:
        """Ask for a program without the critic's faults, and debug it."""
        last = attempts[-1]
        assert last.verdict is not None
        request = revise_request(self.subject, last.text, last.verdict)
        answer = await self._ask("revise", request)
        return None if answer is None else await self.debugged("revise", answer, last)

    async def criticised(self, attempt: ProgramAttempt) -> ProgramAttempt:
        """Return an attempt with its critique, if it has an object and a critic is on."""
        spec, options, node = attempt.built.spec, self.options, self.subject.node
        if spec is None or not (options.geometry_critic or options.articulation_critic):
            return attempt
        pictures: list[Picture] = [self.subject.crop]
        pictures.append(await asyncio.to_thread(draw, spec, node, self.camera))
        moves = any(joint.type != "fixed" for joint in spec.joints)
        if moves and options.articulation_critic:
            pictures.append(await asyncio.to_thread(draw, spec, node, self.camera, opened=True))
        low, high = bounds(spec)
        x, y, z = (high - low).tolist()
        request = judge_request(node, pictures, _described(spec), (x, y, z), options)
        critique = await self._ask("judge", request)
        if critique is None:
            return attempt
        criticised = replace(attempt, verdict=critique)
        self.attempts[self.attempts.index(attempt)] = criticised
        return criticised

    def result(self, best: ProgramAttempt) -> Programmed:
        """Return the result with the best attempt; its remaining errors become a fallback."""
        errors = [signal for signal in best.built.signals if signal.severity == "error"]
        if best.built.spec is not None and errors:
            reasons = "; ".join(signal.phrase() for signal in errors[:4])
            name = self.subject.node.name
            self.fallbacks.append((f"{name}: kept with {len(errors)} errors", reasons))
        return Programmed(
            best.built.spec,
            best.text,
            best.built.signals,
            best.score,
            tuple(self.attempts) or (best,),
            tuple(self.fallbacks),
            best.built.allowances,
        )

    async def _checked(
        self, stage: str, answer: ProgramAnswer, before: ProgramAttempt | None
    ) -> ProgramAttempt:
        """Build a program and check it against its subject and the attempt before."""
        program = unfenced(answer.program)
        built = await asyncio.to_thread(build, program, self.options)
        if built.spec is not None:
            signals = [*built.signals, *fit(built.spec, self.subject.node)]
            if before is not None and before.built.spec is not None:
                signals += losses(before.built.spec, built.spec, answer.removed)
                signals += lost_checks(before.text, program, answer.removed)
            built = replace(built, signals=deduplicated(signals))
        attempt = ProgramAttempt(stage, program, built, answer.notes)
        self.attempts.append(attempt)
        return attempt

    async def _ask(self, stage: str, request: Request[T]) -> T | None:
        skipped = f"{self.subject.node.name}: no {stage} round"
        return await ask_or_record(self.models, request, skipped, self.fallbacks)


def _accepted(critique: ProgramCritique, options: ProgramOptions) -> bool:
    content = critique.verdict == "accept" or marks(critique) >= options.accept_score
    return content or not critique.faults


def _described(spec: ObjectSpec) -> dict[str, str]:
    joints = [
        f"{joint.name} ({joint.type}, {joint.child} on {joint.parent})" for joint in spec.joints
    ]
    return {
        "parts": ", ".join(part.name for part in spec.parts),
        "joints": ", ".join(joints) or "none",
    }


__all__ = [
    "Cutout",
    "ProgramAttempt",
    "Programmed",
    "guide",
    "marks",
    "median_colour",
    "synthesise",
]
