"""S_sem by a model (Appendix B), which scores the best candidates while their rollouts run.

    scorer.submit(reward, geometric, layouts, poses)  # returns at once
    ...                                               # run the rollout
    s_sem, sources = scorer.collect()                 # waits, at most `timeout_s`

A candidate without a score has the geometric S_sem plus the mean difference between the model's
scores and the geometric ones, so that scored and other candidates are comparable.

The panel records the responses on its tape. A run that replays them, or that is resumed, gives the
same scores; the result is the same if no score was late.
"""

import time
from concurrent.futures import Future, wait
from enum import IntEnum
from functools import cache
from importlib import resources
from typing import Any, Literal, get_args

import numpy as np
from jaxtyping import Float, Int8
from pydantic import BaseModel, ConfigDict, Field, field_validator

from ..config import SemanticOptions
from ..errors import BudgetError, ConfigError, NeoWorldError
from ..mllm import Panel, Picture, Request, Response
from ..physics.array_types import AnyArray
from ..physics.layout import Layout, Poses
from ..physics.model import SceneModel
from ..render import render_plain
from ..spec import SceneSpec

PICTURE_PX = 320
"""Width of the rendered image of a candidate [px]."""
GIVE_UP_AFTER = 5
"""Number of consecutive failures after which no more scores are requested."""

Level = Literal[0, 1, 2, 3, 4]
MAX_LEVEL = max(get_args(Level))
CRITERIA = ("depth_ordering", "relative_size", "relative_orientation", "intersections")
PROMPT = (
    "The objects and their supports:\n\n{listing}\n\n"
    "Compare the arrangement of the objects in the candidate with that in the photograph."
)


class Judged(BaseModel):
    """One criterion; the reason comes first, so that the level follows from it."""

    model_config = ConfigDict(extra="forbid")

    reason: str = Field(description="What agrees and what does not, in one or two sentences.")
    level: Level = Field(description="0 (most pairs disagree) to 4 (all agree).")

    @field_validator("level", mode="before")
    @classmethod
    def _reject_bool(cls, value: Any) -> Any:
        if isinstance(value, bool):
            raise ValueError("a level is a number from 0 to 4, not true or false")
        return value


class Judgement(BaseModel):
    """The critic's judgement of one candidate."""

    model_config = ConfigDict(extra="forbid")

    depth_ordering: Judged
    relative_size: Judged
    relative_orientation: Judged
    intersections: Judged

    @property
    def value(self) -> float:
        """S_sem: the sum of the levels over its maximum, in [0, 1]."""
        return sum(getattr(self, name).level for name in CRITERIA) / (MAX_LEVEL * len(CRITERIA))


@cache
def system_text() -> str:
    """Return the critic's system text."""
    return resources.files("neoworld_mjx.search").joinpath("scorer.md").read_text("utf-8")


def score_request(photo: Picture, candidate: Picture, scene: SceneSpec) -> Request[Judgement]:
    """Build the request that scores one candidate.

    The system text and the photograph come first and are equal for all candidates of a run, so a
    server with a prompt cache charges their full price only once.

    Args:
        photo: the photograph; pass the same Python object for all candidates.
        candidate: the rendered image of the candidate, labeled "candidate".
        scene: the scene of any candidate, for the names and the hierarchy of its objects.
    """
    return Request(
        role="critic",
        name="score",
        system=system_text(),
        prompt=PROMPT.format(listing=listing(scene)),
        schema=Judgement,
        pictures=[photo, candidate],
    )


def listing(scene: SceneSpec) -> str:
    """List the objects of a scene with their supports, one object per line."""
    lines = []
    for item in scene.objects:
        place = "the environment" if item.environment else "stands by itself"
        if item.parent is not None:
            place = f"{item.relation} {item.parent}"
            if item.parent_link is not None:
                place += f" ({item.parent_link})"
        lines.append(f"- {item.name}: {place}")
    return "\n".join(lines)


class ScoreSource(IntEnum):
    """Source of a candidate's S_sem."""

    GEOMETRIC = 0
    """Geometric score plus the mean difference of the model's scores."""
    SCORED = 1
    """Scored by the model."""


class SemanticScorer:
    """Requests scores of candidates from a model, which answers while physics runs.

    Args:
        model: the compiled scene.
        photo: the photograph.
        panel: models, of which the critic scores candidates.
        options: number of candidates per iteration, and time limit.

    Raises:
        ConfigError: the photograph, the panel or the scene's camera is missing.
    """

    def __init__(
        self,
        model: SceneModel,
        photo: Picture | None,
        panel: Panel | None,
        options: SemanticOptions,
    ) -> None:
        if photo is None or panel is None:
            raise ConfigError(
                "refine.semantic.scorer: mllm needs the photograph and a model; "
                "choose geometric without them"
            )
        if model.spec.camera is None:
            raise ConfigError(
                "refine.semantic.scorer: mllm needs the parsed camera, but the scene has none; "
                "add it to the scene, or choose geometric"
            )
        self.stopped: str | None = None
        """Reason why no more requests are sent; None while requests are sent."""
        self._model, self._photo, self._panel, self._options = model, photo, panel, options
        self._geometric: Float[AnyArray, " pop"] = np.zeros(0)
        self._pending: dict[int, Future[Response[Judgement]]] = {}
        """Requests of the last population, by candidate."""
        self._differences: list[float] = []
        """Score by the model minus the geometric score, of every scored candidate."""
        self._submitted, self._errors, self._failed_in_row = 0, list[str](), 0
        self._requested_at, self._spent_before = 0.0, panel.ledger.spent_usd

    def submit(
        self,
        reward: Float[AnyArray, " pop"],
        geometric: Float[AnyArray, " pop"],
        layouts: Layout,
        poses: Poses,
    ) -> None:
        """Render the `top` candidates of highest finite reward, and request their scores.

        Args:
            reward: reward that ranks the candidates; equal ones keep the order of the population.
            geometric: geometric S_sem of the candidates.
            layouts: layouts of the population, on the host.
            poses: poses of the population, on the host.
        """
        rewards, self._geometric = np.asarray(reward, float), np.asarray(geometric, float)
        best = np.argsort(-np.where(np.isfinite(rewards), rewards, -np.inf), kind="stable")
        chosen = [k for k in best[: self._options.top].tolist() if np.isfinite(rewards[k])]
        self._submitted, self._pending = self._submitted + len(chosen), {}
        if self.stopped is not None:
            self._errors += [self.stopped] * len(chosen)
            chosen = []
        for k in chosen:
            scene = self._model.apply(layouts, k, poses)
            assert scene.camera is not None
            picture = Picture("candidate", render_plain(scene, scene.camera, width=PICTURE_PX))
            self._pending[k] = self._panel.ask_soon(score_request(self._photo, picture, scene))
        self._requested_at = time.monotonic()

    def collect(self) -> tuple[Float[np.ndarray, " pop"], Int8[np.ndarray, " pop"]]:
        """Return S_sem of the submitted population in [0, 1], and each candidate's `ScoreSource`.

        The wait for scores ends `timeout_s` after the request. It has no time limit if the provider
        is offline, such as a tape or a person. A score that is late does not count.
        """
        left = self._requested_at + self._options.timeout_s - time.monotonic()
        wait(self._pending.values(), max(left, 0.0) if self._panel.provider.online else None)
        known: dict[int, float] = {}
        for k, future in self._pending.items():
            if not future.done():
                future.cancel()
                self._errors.append(f"later than {self._options.timeout_s:g} s")
                continue
            try:
                known[k] = future.result().value.value
                self._failed_in_row = 0
            except NeoWorldError as failure:
                self._count(failure)
        self._differences += [value - float(self._geometric[k]) for k, value in known.items()]
        # The mean is shrunk as if there were one more candidate, with a difference of zero.
        shift = sum(self._differences) / (len(self._differences) + 1)
        values = np.clip(self._geometric + shift, 0.0, 1.0).astype(np.float32)
        sources = np.full(len(values), ScoreSource.GEOMETRIC, np.int8)
        for k, value in known.items():
            values[k], sources[k] = value, ScoreSource.SCORED
        return values, sources

    def _count(self, failure: NeoWorldError) -> None:
        """Count a failed request; stop after GIVE_UP_AFTER in a row, or without budget."""
        self._errors.append(str(failure))
        self._failed_in_row += 1
        if isinstance(failure, BudgetError):
            self.stopped = self.stopped or str(failure)
        elif self._failed_in_row >= GIVE_UP_AFTER and self.stopped is None:
            self.stopped = f"{GIVE_UP_AFTER} consecutive scores failed; the last: {failure}"

    @property
    def fallbacks(self) -> tuple[str, ...]:
        """Descriptions of missing and late scores; empty if there are none."""
        if not self._errors:
            return ()
        return (
            f"the geometric S_sem took the place of {len(self._errors)} of {self._submitted} "
            f"requested scores: {self.stopped or self._errors[0]}",
        )

    def summary(self) -> dict[str, Any]:
        """Return the statistics for run.json."""
        return {
            "submitted": self._submitted,
            "scored": len(self._differences),
            "failed": len(self._errors),
            "stopped": self.stopped,
            "cost_usd": round(self._panel.ledger.spent_usd - self._spent_before, 6),
        }

    def close(self) -> None:
        """Abandon scores that have not been collected.

        Responses to requests that have been sent are still recorded; the others are not sent.
        """
        for future in self._pending.values():
            future.cancel()
