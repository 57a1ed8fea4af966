"""Step 1: ask for the scene in a photo, fit and check it, have it judged, keep the best (paper Step 1).

Checks that need no model come first: an answer is fitted to its own 2D boxes, and only what then
still does not hold is said back, beside what the critic finds on the drawn picture. The answer that
is kept is the one with the best score of its own; no truth is known here.
"""

import asyncio
import json
from dataclasses import dataclass, field, replace
from typing import Any

from ..config import ParseOptions
from ..errors import BudgetError, MissingAnswerError, ModelError, SpecError
from ..mllm import Model
from ..spec import SceneTree
from .checks import Finding, check_score, check_tree
from .draw import draw_parse
from .fit import FitReport, fit_tree
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
    """Fitted where that helps; None if the answer gives no tree."""
    broken: str = ""
    """Why it gives none."""
    checks: tuple[Finding, ...] = ()
    """What the checks find after the fit."""
    fit: FitReport | None = None
    verdict: Verdict | None = None

    @property
    def score(self) -> float:
        """Of the checks alone, or their mean with the critic's; 0 to 1, and -1 without a tree."""
        if self.tree is None:
            return -1.0
        own = check_score(self.tree, self.checks)
        return own if self.verdict is None else (own + self.verdict.score) / 2

    @property
    def wrong(self) -> tuple[str, ...]:
        """What the author should mend, one line each; empty if it may stay as it is."""
        if self.tree is None:
            return (self.broken,)
        disliked = self.verdict is not None and self.verdict.lowest < ACCEPT
        if not disliked and not any(finding.severity == "error" for finding in self.checks):
            return ()
        faults = () if self.verdict is None else self.verdict.faults
        return (
            *(finding.phrase() for finding in self.checks),
            *(f"{fault.node or 'scene'}: {fault.what} {fault.correction}" for fault in faults),
        )


@dataclass(frozen=True)
class Parsed:
    """The outcome of Step 1."""

    tree: SceneTree
    picture: bytes
    """The parse drawn on the photo, PNG."""
    rounds: tuple[Attempt, ...]
    kept: int
    """Which of the rounds `tree` is from."""
    fallbacks: tuple[tuple[str, str], ...] = field(default=())
    """What had to be done without, and why."""

    @property
    def checks(self) -> tuple[Finding, ...]:
        """What the checks still find wrong with `tree`."""
        return self.rounds[self.kept].checks

    @property
    def fit(self) -> FitReport | None:
        """How far the fit moved `tree` from what was answered; None if it was not asked for."""
        return self.rounds[self.kept].fit

    def to_json(self) -> str:
        """Write down all rounds."""
        rounds = [
            {
                "answer": attempt.seen.model_dump(mode="json"),
                "broken": attempt.broken,
                "checks": [finding.model_dump(mode="json") for finding in attempt.checks],
                "fit": None if attempt.fit is None else attempt.fit.to_json(),
                "verdict": None
                if attempt.verdict is None
                else attempt.verdict.model_dump(mode="json"),
                "score": round(attempt.score, 4),
                "kept": number == self.kept,
            }
            for number, attempt in enumerate(self.rounds)
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
    current = await _tried(photo, (await models.ask(parse_request(photo))).value, o)
    for round_ in range(o.critic_rounds + 1):
        if current.tree is not None and o.critic_rounds:
            current = await _judged(photo, models, current, fallbacks)
        attempts.append(current)
        if not current.wrong or round_ == o.critic_rounds:
            break
        mend = parse_request(photo, current.seen, current.wrong)
        again = await _asked(models, mend, "mend", fallbacks)
        if again is None or again == current.seen:
            break
        current = await _tried(photo, again, o)
    kept = max(range(len(attempts)), key=lambda number: attempts[number].score)
    tree = attempts[kept].tree
    if tree is None:
        raise ModelError(f"no answer of {len(attempts)} gave a scene: {attempts[kept].broken}")
    drawn = await asyncio.to_thread(draw_parse, photo, tree, solid=True)
    return Parsed(tree, drawn.data, tuple(attempts), kept, tuple(fallbacks))


async def _tried(photo: Photo, seen: SceneSeen, options: ParseOptions) -> Attempt:
    try:
        tree = to_tree(seen, photo)
    except SpecError as error:
        return Attempt(seen, None, str(error))
    report = None
    if options.fit:
        tree, report = await asyncio.to_thread(fit_tree, tree)
    return Attempt(seen, tree, checks=check_tree(tree), fit=report)


async def _judged(
    photo: Photo, models: Model, attempt: Attempt, fallbacks: list[tuple[str, str]]
) -> Attempt:
    assert attempt.tree is not None
    # 2D boxes alone, which no fit moves: the picture is the same on every machine.
    drawn = draw_parse(photo, attempt.tree)
    verdict = await _asked(models, judge_request(photo, attempt.seen, drawn), "judge", fallbacks)
    return replace(attempt, verdict=verdict)


async def _asked(models: Model, request: Any, stage: str, fallbacks: list[tuple[str, str]]) -> Any:
    """Ask for something the parse can do without; what could not be had is noted."""
    try:
        return (await models.ask(request)).value
    except (BudgetError, MissingAnswerError):
        raise
    except ModelError as error:
        fallbacks.append((f"no {stage} round", str(error)))
        return None
