"""From the crop of an object to its program: ask, run, mend, draw, judge, revise (paper Step 2).

The model is given the object's measured box. Errors of the program or of its checks go back to it
(debug rounds); pictures from the photo's own view go to a critic, and its faults back to the programmer
(critic rounds). The best program by its own score is kept, whatever came last.
"""

import asyncio
import io
import json
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np
from PIL import Image

from ..config import ProgramOptions
from ..errors import BudgetError, MissingAnswerError, ModelError
from ..mllm import Model, Picture, Request
from ..spec import Camera, ObjectSpec, TreeNode, bounds
from .allowance import Allowance
from .ask import (
    Subject,
    Verdict,
    Written,
    judge_request,
    mend_request,
    program_request,
    revise_request,
    text,
)
from .conformance import fit, losses, lost_checks
from .make import build
from .sandbox import Built, run
from .signals import Signal, deduplicated, has_errors
from .supports import support_program
from .views import draw

_WEIGHTS = {"geometry": 0.5, "articulation": 0.3, "colour": 0.2}
UNJUDGED = 5.0
"""Critic's score of a program that no critic has seen."""


class Cutout(Protocol):
    """A picture of an object cut out of the photo, encoded as PNG or JPEG."""

    @property
    def data(self) -> bytes:
        """The file's bytes."""
        ...

    @property
    def note(self) -> str:
        """What of the object it does not show, in words; empty if it shows all."""
        ...


@dataclass(frozen=True)
class Attempt:
    """One program of a synthesis, with what was found about it."""

    stage: str
    """How it came about: "program", "debug" or "revise", or "support" for one that no model wrote."""
    text: str
    built: Built
    notes: str = ""
    verdict: Verdict | None = None

    @property
    def score(self) -> float:
        """Critic's score from 0 to 10, less a point for each error and the misfit of its size."""
        if self.built.spec is None:
            return 0.0
        score = UNJUDGED if self.verdict is None else marks(self.verdict)
        errors = [signal for signal in self.built.signals if signal.severity == "error"]
        misfit = sum(
            min(1.0, abs(signal.value or 0.0))
            for signal in self.built.signals
            if signal.code == "proportions"
        )
        return max(0.0, score - len(errors) - misfit)

    @property
    def rank(self) -> tuple[bool, bool, bool, float]:
        """What attempts are compared by, the larger the better."""
        lost = any(signal.code == "lost" for signal in self.built.signals)
        return self.built.spec is not None, not lost, self.built.ok, self.score


@dataclass(frozen=True)
class Programmed:
    """The outcome of a synthesis."""

    spec: ObjectSpec | None
    text: str
    signals: tuple[Signal, ...]
    score: float
    rounds: tuple[Attempt, ...]
    fallbacks: tuple[tuple[str, str], ...] = ()
    """What had to be done without, and why."""
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
        """Write down all rounds."""
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


@dataclass
class _Work:
    subject: Subject
    models: Model
    options: ProgramOptions
    camera: Camera | None
    attempts: list[Attempt] = field(default_factory=list)
    fallbacks: list[tuple[str, str]] = field(default_factory=list)


async def synthesise(
    node: TreeNode,
    crop: Cutout | bytes,
    models: Model,
    options: ProgramOptions,
    *,
    camera: Camera | None = None,
    colour: tuple[float, float, float] | None = None,
) -> Programmed:
    """Have an object programmed after its crop.

    Supports of the environment get a plain program from their box; no model is asked.

    Args:
        node: the object, as parsed.
        crop: its picture.
        models: who is asked.
        options: rounds, critics, sandbox.
        camera: the photo's, so that the critic sees the object from the same side.
        colour: of a support, red, green, blue from 0 to 1; by default the median of its crop.

    Raises:
        ModelError: the first program could not be had, an answer is missing, or the budget is spent.
    """
    plain = isinstance(crop, bytes)
    picture = Picture("crop", crop if plain else crop.data)
    subject = Subject(node, picture, "" if plain else crop.note)
    work = _Work(subject, models, options, camera)
    if node.environment:
        program = support_program(node, colour or median_colour(picture))
        built = await asyncio.to_thread(run, program, options)
        return _finished(work, Attempt("support", program, built))
    answer = await models.ask(program_request(subject))
    current = await _debugged(work, await _tried(work, "program", answer.value, None))
    for _ in range(options.critic_rounds):
        current = await _judged(work, current)
        if current.verdict is None or _accepted(current.verdict, options):
            break
        revised = await _asked(
            work, "revise", revise_request(subject, current.text, current.verdict)
        )
        if revised is None:
            break
        current = await _debugged(work, await _tried(work, "revise", revised, current))
    else:
        if options.critic_rounds:
            await _judged(work, current)
    return _finished(work, max(work.attempts, key=lambda attempt: attempt.rank))


def guide() -> str:
    """Return the authoring contract that programmers are given."""
    return text("guide")


def marks(verdict: Verdict) -> float:
    """Weigh a critic's three scores to one from 0 to 10."""
    return sum(weight * getattr(verdict, name) for name, weight in _WEIGHTS.items())


def median_colour(picture: Picture) -> tuple[float, float, float]:
    """Return the median red, green, blue of a picture, 0 to 1."""
    with Image.open(io.BytesIO(picture.data)) as image:
        rgb = np.asarray(image.convert("RGB")).reshape(-1, 3)
    r, g, b = (np.median(rgb, axis=0) / 255).tolist()
    return r, g, b


def _accepted(verdict: Verdict, options: ProgramOptions) -> bool:
    content = verdict.verdict == "accept" or marks(verdict) >= options.accept_score
    return content or not verdict.faults


async def _tried(work: _Work, stage: str, written: Written, before: Attempt | None) -> Attempt:
    """Build a program, hold it against what was asked and had, and keep it among the attempts."""
    program = unfenced(written.program)
    built = await asyncio.to_thread(build, program, work.options)
    if built.spec is not None:
        more = list(fit(built.spec, work.subject.node))
        if before is not None and before.built.spec is not None:
            more += losses(before.built.spec, built.spec, written.removed)
            more += lost_checks(before.text, program, written.removed)
        built = replace(built, signals=deduplicated((*built.signals, *more)))
    attempt = Attempt(stage, program, built, written.notes)
    work.attempts.append(attempt)
    return attempt


async def _debugged(work: _Work, attempt: Attempt) -> Attempt:
    """Send errors back until there are none or the rounds are used up; return the best of it."""
    best, earlier = attempt, None
    for _ in range(work.options.debug_rounds):
        if not has_errors(attempt.built.signals):
            break
        signals = attempt.built.signals
        request = mend_request(work.subject, attempt.text, signals, earlier)
        written = await _asked(work, "debug", request)
        if written is None:
            break
        earlier = signals
        attempt = await _tried(work, "debug", written, best)
        best = max(best, attempt, key=lambda one: one.rank)
    return best


async def _judged(work: _Work, attempt: Attempt) -> Attempt:
    """Show an attempt to the critic, where it can be shown and a critic is on."""
    spec, options = attempt.built.spec, work.options
    if spec is None or not (options.geometry_critic or options.articulation_critic):
        return attempt
    pictures: list[Picture] = [work.subject.crop]
    pictures.append(await asyncio.to_thread(draw, spec, work.subject.node, work.camera))
    moves = any(joint.type != "fixed" for joint in spec.joints)
    if moves and options.articulation_critic:
        opened = await asyncio.to_thread(draw, spec, work.subject.node, work.camera, opened=True)
        pictures.append(opened)
    low, high = bounds(spec)
    x, y, z = (high - low).tolist()
    request = judge_request(work.subject.node, pictures, _described(spec), (x, y, z), options)
    verdict = await _asked(work, "judge", request)
    if verdict is None:
        return attempt
    judged = replace(attempt, verdict=verdict)
    work.attempts[work.attempts.index(attempt)] = judged
    return judged


async def _asked(work: _Work, stage: str, request: Request[Any]) -> Any:
    """Ask for something the object can do without; what could not be had is noted."""
    try:
        return (await work.models.ask(request)).value
    except (BudgetError, MissingAnswerError):
        raise
    except ModelError as error:
        work.fallbacks.append((f"{work.subject.node.name}: no {stage} round", str(error)))
        return None


def _described(spec: ObjectSpec) -> dict[str, str]:
    joints = [
        f"{joint.name} ({joint.type}, {joint.child} on {joint.parent})" for joint in spec.joints
    ]
    return {
        "parts": ", ".join(part.name for part in spec.parts),
        "joints": ", ".join(joints) or "none",
    }


def _finished(work: _Work, best: Attempt) -> Programmed:
    left = [signal for signal in best.built.signals if signal.severity == "error"]
    if best.built.spec is not None and left:
        why = "; ".join(signal.phrase() for signal in left[:4])
        work.fallbacks.append((f"{work.subject.node.name}: kept with {len(left)} errors", why))
    return Programmed(
        best.built.spec,
        best.text,
        best.built.signals,
        best.score,
        tuple(work.attempts) or (best,),
        tuple(work.fallbacks),
        best.built.allowances,
    )


def unfenced(program: str) -> str:
    """Take a program out of the code fence that some models put around it all the same."""
    lines = program.strip().splitlines()
    if len(lines) >= 2 and lines[0].startswith("```") and lines[-1].strip() == "```":
        lines = lines[1:-1]
    return "\n".join(lines) + "\n"


__all__ = ["Attempt", "Cutout", "Programmed", "guide", "marks", "median_colour", "synthesise"]
