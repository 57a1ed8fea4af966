"""Step 1: ask for the scene in a photo, check it, have it judged, keep the best (paper Step 1)."""

import asyncio
import json
from dataclasses import dataclass, field
from typing import Any

from ..config import ParseOptions
from ..errors import BudgetError, MissingAnswerError, ModelError, SpecError
from ..mllm import Model
from ..spec import SceneTree
from .draw import draw_parse
from .photo import Photo
from .prompts import Verdict, judge_request, parse_request
from .schema import SceneSeen, to_tree

ACCEPT = 9.0
"""Lowest of the critic's three scores from which no further round is asked for."""


@dataclass(frozen=True)
class Attempt:
    """One answer, with what was found about it."""

    seen: SceneSeen
    tree: SceneTree | None
    findings: tuple[str, ...]
    verdict: Verdict | None = None

    @property
    def rank(self) -> tuple[bool, float]:
        """What attempts are compared by, the larger the better."""
        judged = 0.5 if self.verdict is None else self.verdict.score
        return self.tree is not None, judged - 0.1 * len(self.findings)


@dataclass(frozen=True)
class Parsed:
    """The outcome of Step 1."""

    tree: SceneTree
    picture: bytes
    """The parse drawn on the photo, PNG."""
    rounds: tuple[Attempt, ...]
    fallbacks: tuple[tuple[str, str], ...] = field(default=())
    """What had to be done without, and why."""

    def to_json(self) -> str:
        """Write down all rounds."""
        rounds = [
            {
                "answer": attempt.seen.model_dump(mode="json"),
                "findings": list(attempt.findings),
                "verdict": None
                if attempt.verdict is None
                else attempt.verdict.model_dump(mode="json"),
                "kept": attempt.tree == self.tree,
            }
            for attempt in self.rounds
        ]
        return json.dumps({"rounds": rounds}, indent=1) + "\n"


async def parse(photo: Photo, models: Model, options: ParseOptions | None = None) -> Parsed:
    """Parse a photograph into a scene tree.

    Args:
        photo: the photograph.
        models: who is asked.
        options: rounds.

    Raises:
        ModelError: the first answer could not be had, or no answer gave a tree.
    """
    o = options or ParseOptions()
    attempts: list[Attempt] = []
    fallbacks: list[tuple[str, str]] = []
    current = _tried(photo, (await models.ask(parse_request(photo))).value)
    for round_ in range(o.critic_rounds + 1):
        if current.tree is not None and o.critic_rounds:
            current = await _judged(photo, models, current, fallbacks)
        attempts.append(current)
        wanted = list(current.findings)
        if current.verdict is not None and current.verdict.lowest < ACCEPT:
            wanted += [
                f"{f.node or 'scene'}: {f.what} {f.correction}" for f in current.verdict.faults
            ]
        if not wanted or round_ == o.critic_rounds:
            break
        again = await _asked(models, parse_request(photo, current.seen, wanted), "mend", fallbacks)
        if again is None:
            break
        current = _tried(photo, again)
    best = max(attempts, key=lambda attempt: attempt.rank)
    if best.tree is None:
        raise ModelError(f"no answer of {len(attempts)} gave a scene: {'; '.join(best.findings)}")
    drawn = await asyncio.to_thread(draw_parse, photo, best.tree, solid=True)
    return Parsed(best.tree, drawn.data, tuple(attempts), tuple(fallbacks))


def _tried(photo: Photo, seen: SceneSeen) -> Attempt:
    try:
        return Attempt(seen, to_tree(seen, photo), ())
    except SpecError as error:
        return Attempt(seen, None, (str(error),))


async def _judged(
    photo: Photo, models: Model, attempt: Attempt, fallbacks: list[tuple[str, str]]
) -> Attempt:
    assert attempt.tree is not None
    drawn = draw_parse(photo, attempt.tree)
    verdict = await _asked(models, judge_request(photo, attempt.seen, drawn), "judge", fallbacks)
    return Attempt(attempt.seen, attempt.tree, attempt.findings, verdict)


async def _asked(models: Model, request: Any, stage: str, fallbacks: list[tuple[str, str]]) -> Any:
    """Ask for something the parse can do without; what could not be had is noted."""
    try:
        return (await models.ask(request)).value
    except (BudgetError, MissingAnswerError):
        raise
    except ModelError as error:
        fallbacks.append((f"no {stage} round", str(error)))
        return None
