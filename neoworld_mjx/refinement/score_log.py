"""Log of semantic scores, one line of scores.jsonl each, and its replay by a later run.

A line holds the candidate's identity, the model's response, the times of request and response, and
the iteration in which the score was first used. Unless a run waits for scores, that iteration
depends on the server; a replay uses each score in the iteration of the recorded run.
"""

import hashlib
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from ..errors import ModelError
from ..io import read_outside_text
from ..io.validation_message import validation_message
from ..physics.layout import Layout
from ..spec import SceneSpec

Identity = tuple[int, int]
"""(iteration, candidate)."""
SAME_LAYOUT = 1e-3
"""Largest difference of any number [m, rad, 1] between two layouts of the same candidate."""
Stage = int | Literal["final"]
"""Iteration whose elites were selected with a score; "final": the choice of the winner."""


class Score(BaseModel):
    """Score of one candidate, or the reason why there is none."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    iteration: int
    candidate: int
    rank: int
    """Rank among the candidates submitted with it, 0 first."""
    layout: str
    """Digest of the candidate's layout."""
    numbers: tuple[float, ...] | None = None
    """Layout, which identifies the candidate on another machine: x, y [m], yaw [rad] and log scale
    of each object; None in older records."""
    value: float | None = None
    """S_sem in [0, 1]; None if scoring failed."""
    levels: dict[str, int] | None = None
    """Level of each criterion, 0 to 4."""
    reasons: dict[str, str] | None = None
    picture: str | None = None
    """Digest of the candidate's pixels."""
    drawn_s: float | None = None
    """Time to render the image [s]."""
    model: str = ""
    asked: str | None = None
    """Time of the request, UTC."""
    answered: str | None = None
    cached: bool = False
    """True if copied from another candidate with an identical image."""
    cost_usd: float | None = None
    """Cost [USD]; None if unknown."""
    error: str | None = None
    used: Stage | None = None
    """Stage of its first use; None if it was never used."""

    @property
    def identity(self) -> Identity:
        """(iteration, candidate)."""
        return self.iteration, self.candidate


@dataclass(frozen=True)
class Job:
    """One candidate to be scored."""

    identity: Identity
    rank: int
    layout: str
    layouts: Layout
    """Layout of the candidate, NumPy, pop axis of length 1."""
    scene: SceneSpec | None = None
    """Scene of the candidate; None if it will not be rendered."""

    def score(self, **fields: object) -> Score:
        """Build a score of this candidate with the given fields."""
        iteration, candidate = self.identity
        return Score.model_validate(
            {
                "iteration": iteration,
                "candidate": candidate,
                "rank": self.rank,
                "layout": self.layout,
                "numbers": layout_numbers(self.layouts),
                **fields,
            }
        )


def layout_digest(layout: Layout) -> str:
    """Return a hash of a single candidate's layout, 16 hex digits."""
    parts = (layout.xy, layout.yaw, layout.log_scale)
    data = b"".join(np.ascontiguousarray(part, np.float32).tobytes() for part in parts)
    return hashlib.sha256(data).hexdigest()[:16]


def layout_numbers(layout: Layout) -> tuple[float, ...]:
    """Return x, y [m], yaw [rad], log scale of each object of a single candidate, to 1e-6."""
    columns = np.stack([*np.asarray(layout.xy)[0].T, layout.yaw[0], layout.log_scale[0]], axis=1)
    return tuple(np.round(columns.astype(float), 6).ravel().tolist())


class ScoreLog:
    """Writer of scores.jsonl, which appends whole lines.

    Args:
        path: the file, replaced if it exists; None disables the log.

    Raises:
        ModelError: the file cannot be written.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        if path is not None:
            self._write("", "w")

    def add(self, scores: Iterable[Score]) -> None:
        """Append scores in the order given."""
        text = "".join(score.model_dump_json() + "\n" for score in scores)
        if self._path is not None and text:
            self._write(text, "a")

    def _write(self, text: str, mode: Literal["w", "a"]) -> None:
        assert self._path is not None
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with self._path.open(mode, encoding="utf-8") as file:
                file.write(text)
        except OSError as error:
            raise ModelError(f"cannot write {self._path}: {error.strerror}") from None


def read_scores(path: Path) -> list[Score]:
    """Read a scores.jsonl.

    Raises:
        ModelError: the file cannot be read, or a line is not a valid score.
    """
    lines = read_outside_text(path, ModelError, "scores").splitlines()
    scores = []
    for number, line in enumerate(lines, start=1):
        try:
            scores.append(Score.model_validate_json(line))
        except ValidationError as error:
            raise ModelError(f"{path}, line {number}: {validation_message(error, Score)}") from None
    return scores


class Recorded:
    """Replay of the scores of an earlier run, each in the stage of its first use.

    Rounding differs between processors, so a candidate matches the recorded one if no number of its
    layout differs by more than `SAME_LAYOUT`.

    Args:
        path: scores.jsonl of that run.

    Raises:
        ModelError: the file cannot be read.
    """

    stopped: str | None = None

    def __init__(self, path: Path) -> None:
        self._path = path
        self._scores = {score.identity: score for score in read_scores(path)}
        self._put: list[Score] = []

    def put(self, jobs: Sequence[Job]) -> None:
        """Look up the scores of candidates.

        Raises:
            ModelError: the record lacks a candidate, or holds it with another layout.
        """
        for job in jobs:
            score = self._scores.get(job.identity)
            iteration, candidate = job.identity
            if score is None or not _same_layout(score, job):
                content = "no score" if score is None else "the score of another layout"
                raise ModelError(
                    f"{self._path} has {content} for candidate {candidate} of iteration "
                    f"{iteration}: a record can only be replayed in the same run "
                    f"(same scene, options, seed, engine)"
                )
            self._put.append(score)

    def take(self, stage: Stage, must: Collection[Identity], *, rest: bool) -> list[Score]:
        """Return the scores that the recorded run first used at a stage, ordered by identity."""
        return sorted(
            (s for s in self._put if s.used == stage and (rest or s.identity in must)),
            key=lambda score: score.identity,
        )

    def close(self) -> list[Score]:
        """Return the scores that were never used."""
        return sorted((s for s in self._put if s.used is None), key=lambda s: s.identity)


def _same_layout(score: Score, job: Job) -> bool:
    if score.layout == job.layout:
        return True
    numbers = layout_numbers(job.layouts)
    if score.numbers is None or len(score.numbers) != len(numbers):
        return False
    return bool(np.max(np.abs(np.subtract(score.numbers, numbers)), initial=0.0) <= SAME_LAYOUT)
