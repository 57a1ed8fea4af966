"""Step 2: synthesis of an object's program from the object's crop, with debug and critic rounds.

The first request states the object's box in the response of Step 1. In debug rounds, errors of the
program and of the checks are sent back to the programmer. In critic rounds, critics compare the
crop with pictures that are rendered from the photo's view, and the faults that they find are sent
to the programmer.
The result is the best of all programs. With `program.stages: three`, the stages geometry,
articulation and export follow one another, each with separate debug and critic rounds.
"""

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple, TypeVar

import numpy as np
from pydantic import BaseModel

from ..checks.signals import Signal, deduplicated, has_errors
from ..config import ProgramOptions
from ..mllm import Model, Picture, Request, ask_or_record, package_text
from .ask import (
    ProgramAttempt,
    ProgramResponse,
    Size,
    StageInput,
    SynthesisResult,
    instructions,
    join_texts,
    program_request,
    repair_request,
    reprogram_request,
    revise_request,
    written_without_model,
)
from .building import BuildResult, run
from .critique import Critique, Subject, accepts, corrected_box, critic_request
from .stages import (
    NOTHING_MOVES,
    STAGES,
    Stage,
    compare_geometry,
    compare_to_node,
    in_stage_lines,
    lost_parts,
    needs_model,
    urdf_round_trip,
)
from .supports import support_program
from .views import compare, draw, draw_exported

T = TypeVar("T", bound=BaseModel)

MAX_RESIZE = 4.0
"""Largest factor by which an edge of the given box may be corrected, up or down."""


class ProgramSource(NamedTuple):
    """An object's program, and the inputs from which it was written."""

    subject: Subject
    """The parsed object, with the size that the program fills, and its picture."""
    text: str
    options: ProgramOptions


async def synthesise(
    subject: Subject,
    models: Model,
    options: ProgramOptions,
    *,
    colour: tuple[float, float, float] | None = None,
) -> SynthesisResult:
    """Synthesize the program of an object from the object's crop.

    The program of a slab of the environment is written from the parsed box, without a model.

    Args:
        subject: the parsed object and its picture.
        models: models for the programmer and the critics.
        options: rounds, critics and sandbox.
        colour: red, green and blue of a slab, from 0 to 1. If None, the color is that of the parsed
            surface, or else that of its material.

    Raises:
        ModelError: the first request of a stage failed, the recorded responses (tape) lack a
            response, or the cost cap is reached.
    """
    node = subject.node
    if node.slab:
        program = support_program(node, colour)
        return written_without_model(
            "support", program, await asyncio.to_thread(run, program, options)
        )
    work = _Synthesis(subject, models, options)
    best: ProgramAttempt | None = None
    for stage in STAGES[options.stages]:
        last = best
        best = await work.write_stage(stage, last)
        if stage.file == "export" and last is not None and last.built.ok and not best.built.ok:
            work.fallbacks.append((f"{node.name}: no export program", best.built.errors))
            best = last
        if best.built.spec is None:
            break
    assert best is not None
    return work.result(best)


async def reprogram(
    source: ProgramSource, findings: Sequence[str], models: Model
) -> SynthesisResult:
    """Request a new program for an object that does not behave like the real object, and debug it.

    Args:
        source: the program so far, and the inputs from which it was written.
        findings: faults of the object's motion, one line each.
        models: model for the programmer.

    Returns:
        The result. It contains no object if the model failed or if the new program lost parts.

    Raises:
        MissingResponseError: the recorded responses (tape) lack a response.
        BudgetError: the cost cap is reached.
    """
    text, options = source.text, source.options
    work = _Synthesis(source.subject, models, options)
    previous = ProgramAttempt("program", text, await asyncio.to_thread(run, text, options))
    stage = StageInput(language=options.language)
    request = reprogram_request(work.subject, stage, text.strip(), findings)
    response = await work.ask("reprogram", request)
    if response is None:
        return work.result(ProgramAttempt("reprogram", text, BuildResult(None)))
    best = await work.build_and_debug(
        "reprogram", response.model_copy(update={"box": None}), previous
    )
    lost = any(signal.code == "lost" for signal in best.built.signals)
    return work.result(replace(best, built=replace(best.built, spec=None)) if lost else best)


def guide() -> str:
    """Return the guide to the SDK, which is part of every request to a programmer."""
    return package_text(__package__, "guide")


def all_instructions(options: ProgramOptions) -> str:
    """Return the system prompts of all requests for programs, joined by newlines."""
    return "\n".join(instructions(s.file, options.language) for s in STAGES[options.stages])


def without_fence(program: str) -> str:
    """Remove the code fence that some models put around a program."""
    lines = program.strip().splitlines()
    if len(lines) >= 2 and lines[0].startswith("```") and lines[-1].strip() == "```":
        lines = lines[1:-1]
    return "\n".join(lines) + "\n"


@dataclass
class _Synthesis:
    """State of the synthesis of one object: inputs, attempts so far, and failed rounds."""

    subject: Subject
    models: Model
    options: ProgramOptions
    attempts: list[ProgramAttempt] = field(default_factory=list)
    fallbacks: list[tuple[str, str]] = field(default_factory=list)
    size: Size | None = None
    """Edges [m] of the box after a model's last correction; None if no model corrected the box."""
    stage: Stage = STAGES["one"][0]
    accepted: ProgramAttempt | None = None
    """Best attempt of the previous stage; None in the first stage."""

    async def write_stage(self, stage: Stage, accepted: ProgramAttempt | None) -> ProgramAttempt:
        """Request a stage's program, debug and criticize it, and return the best attempt.

        In each critic round, the faults that critics found are sent to the programmer. If a request
        fails, the rounds end.
        """
        self.stage, self.accepted = stage, accepted
        if accepted is not None:
            assert accepted.built.spec is not None
            if not needs_model(stage, accepted.built.spec, self.subject.node):
                earlier_texts = accepted.texts
                return replace(
                    accepted, text=NOTHING_MOVES, earlier_texts=earlier_texts, file=stage.file
                )
        request = program_request(self.subject, self._stage_input)
        response = (await self.models.ask(request)).value
        attempt = await self.build_and_debug("program", response, None)
        rounds = self.options.critic_rounds
        for round_ in range(rounds + 1 if rounds else 0):
            attempt = await self.request_critiques(attempt)
            critiques = self._stage_critiques(attempt)
            if round_ == rounds or all(map(accepts, critiques)):
                break
            for box in filter(None, map(corrected_box, critiques)):
                self._resize(box, "the critic")
            rejecting = [critique for critique in critiques if not accepts(critique)]
            built = self._compared(attempt)[-1] if attempt.built.spec is not None else None
            request = revise_request(
                self.subject, self._stage_input, attempt.text, rejecting, built
            )
            revision = await self.ask("revise", request)
            if revision is None:
                break
            attempt = await self.build_and_debug("revise", revision, attempt)
        candidates = [attempt for attempt in self.attempts if attempt.file == stage.file]
        return max(candidates, key=lambda attempt: attempt.rank)

    async def build_and_debug(
        self, stage: str, response: ProgramResponse, previous: ProgramAttempt | None
    ) -> ProgramAttempt:
        """Build a program, repair it in up to `debug_rounds` rounds, and return the best one."""
        attempts = [await self._build_and_check(stage, response, previous)]
        for _ in range(self.options.debug_rounds):
            signals = attempts[-1].built.signals
            if not has_errors(signals):
                break
            earlier = attempts[-2].built.signals if len(attempts) > 1 else None
            request = repair_request(
                self.subject, self._stage_input, attempts[-1].text, signals, earlier
            )
            repair = await self.ask("debug", request)
            if repair is None:
                break
            best = max(attempts, key=lambda attempt: attempt.rank)
            attempts.append(await self._build_and_check("debug", repair, best))
        return max(attempts, key=lambda attempt: attempt.rank)

    async def request_critiques(self, attempt: ProgramAttempt) -> ProgramAttempt:
        """Request the critiques of the enabled critics, and return the attempt with them."""
        requests = self._critic_requests(attempt)
        responses = await asyncio.gather(
            *(self.ask(f"judge ({name})", request) for name, request in requests.items())
        )
        verdicts = {
            name: response
            for name, response in zip(requests, responses, strict=True)
            if response is not None
        }
        if not verdicts:
            return attempt
        criticised = replace(attempt, critiques={**attempt.critiques, **verdicts})
        self.attempts[self.attempts.index(attempt)] = criticised
        return criticised

    def result(self, best: ProgramAttempt) -> SynthesisResult:
        """Return the result with the best attempt; record its remaining errors as a fallback."""
        errors = [signal for signal in best.built.signals if signal.severity == "error"]
        if best.built.spec is not None and errors:
            reasons = "; ".join(signal.phrase() for signal in errors[:4])
            name = self.subject.node.name
            self.fallbacks.append((f"{name}: kept with {len(errors)} errors", reasons))
        return SynthesisResult(
            best.built.spec,
            best.texts,
            best.built.signals,
            best.score,
            tuple(self.attempts) or (best,),
            tuple(self.fallbacks),
            best.built.allowances,
            best.size,
        )

    @property
    def _stage_input(self) -> StageInput:
        """The current stage, with the accepted texts of the earlier stages."""
        earlier_texts = {} if self.accepted is None else self.accepted.texts
        return StageInput(self.stage.file, earlier_texts, self.options.language)

    def _stage_critiques(self, attempt: ProgramAttempt) -> list[Critique]:
        """Return the critiques by the stage's critics."""
        return [attempt.critiques[name] for name in self.stage.critics if name in attempt.critiques]

    def _compared(self, attempt: ProgramAttempt) -> list[Picture]:
        """Return the crop beside an attempt's object, or as another picture; see `compare`."""
        node, crop, _, camera, window = self.subject
        spec = attempt.built.spec
        return [crop] if spec is None else compare(crop, spec, node, camera, window)

    def _critic_requests(self, attempt: ProgramAttempt) -> dict[str, Request[Critique]]:
        """Return the requests by critic, for enabled critics that can judge the object.

        The articulation critic needs a joint that moves, and the export critic needs a readable
        URDF file.
        """
        spec, node, camera = attempt.built.spec, self.subject.node, self.subject.camera
        if spec is None:
            return {}
        moves = any(joint.type != "fixed" for joint in spec.joints)
        open_pictures = [draw(spec, node, camera, opened=True)] if moves else []
        requests: dict[str, Request[Critique]] = {}
        for name in self.stage.critics:
            if not getattr(self.options, f"{name}_critic"):
                continue
            pictures = self._compared(attempt)
            if name == "articulation":
                if not moves:
                    continue
                pictures += open_pictures
            if name == "export":
                read, _ = urdf_round_trip(spec)
                if read is None:
                    continue
                pictures = [self.subject.crop, *draw_exported(spec, read, node, camera)]
            requests[name] = critic_request(name, node, spec, pictures)
        return requests

    async def _build_and_check(
        self, stage: str, response: ProgramResponse, previous: ProgramAttempt | None
    ) -> ProgramAttempt:
        """Build a program, and compare its object with the parsed object and the last attempt."""
        program = without_fence(response.program)
        if response.box is not None:
            self._resize(response.box, "the programmer")
        attempt = ProgramAttempt(
            stage,
            program,
            BuildResult(None),
            response.notes,
            critiques={} if self.accepted is None else self.accepted.critiques,
            earlier_texts=self._stage_input.earlier_texts,
            file=self.stage.file,
        )
        built = await asyncio.to_thread(self.stage.build, join_texts(attempt.texts), self.options)
        built = replace(built, signals=in_stage_lines(built.signals, attempt.earlier_texts))
        if built.spec is not None:
            compare = compare_geometry if self.stage.file == "geometry" else compare_to_node
            signals: list[Signal] = [*built.signals, *compare(built.spec, self.subject.node)]
            if previous is not None and previous.built.spec is not None:
                signals += lost_parts(previous.built.spec, built.spec, response.removed)
            built = replace(built, signals=deduplicated(signals))
        attempt = replace(attempt, built=built, size=self.size)
        self.attempts.append(attempt)
        return attempt

    def _resize(self, edges: Sequence[float], role: str) -> None:
        """Apply a model's correction of the given box, unless it exceeds MAX_RESIZE."""
        node = self.subject.node
        x, y, z = edges
        ratio = np.array(edges) / np.array(node.box3d.size)
        edges_text = " x ".join(f"{v:.3f}" for v in edges)
        if np.max(np.maximum(ratio, 1 / ratio)) > MAX_RESIZE:
            reason = (
                f"{role} requested {edges_text} m, which differs by a factor of over {MAX_RESIZE:g}"
            )
            self.fallbacks.append((f"{node.name}: the box of the parse", reason))
            return
        self.size = (x, y, z)
        box = node.box3d.model_copy(update={"size": self.size})
        node = node.model_copy(update={"box3d": box})
        self.subject = self.subject._replace(node=node)

    async def ask(self, stage: str, request: Request[T]) -> T | None:
        failure = f"{self.subject.node.name}: no {stage} round"
        return await ask_or_record(self.models, request, failure, self.fallbacks)
