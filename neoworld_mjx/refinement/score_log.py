"""Log of semantic scores in scores.jsonl, one score per line, and its replay by a later run.

A line contains the identity of the candidate, the response of the model, the times of request and
response, and the iteration in which the score was first used. If a run does not wait for all
scores, that iteration depends on how fast the server responds. A replay therefore uses each score
in the iteration that the log gives.
"""

import hashlib
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from ..errors import ModelError
from ..io import read_untrusted_text
from ..io.validation_message import validation_message
from ..physics.layout import Layout
from ..spec import SceneSpec

CandidateId = tuple[int, int]
"""(iteration, candidate)."""
SAME_LAYOUT = 1e-3
"""Two layouts are of the same candidate if no variable [m, rad, 1] differs by more than this."""
Stage = int | Literal["final"]
"""Iteration whose elites were selected with a score, or "final" for the choice of the winner."""


class Score(BaseModel):
    """Score of one candidate, or the error that prevented it."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    iteration: int
    candidate: int
    rank: int
    """Rank of the candidate among those that were submitted together; 0 is the most urgent."""
    layout: str
    """Digest of the candidate's layout."""
    numbers: tuple[float, ...] | None = None
    """Variables of the candidate's layout: x, y [m], yaw [rad] and log scale of each object.

    They identify the candidate on another machine. None in older logs.
    """
    value: float | None = None
    """S_sem in [0, 1]; None if scoring failed."""
    levels: dict[str, int] | None = None
    """Level of each criterion, 0 to 4."""
    reasons: dict[str, str] | None = None
    """Reason for the level of each criterion."""
    picture: str | None = None
    """Digest of the pixels of the candidate's image."""
    drawn_s: float | None = None
    """Time to render the image [s]."""
    model: str = ""
    """Name of the model that responded."""
    asked: str | None = None
    """Time of the request, UTC."""
    answered: str | None = None
    """Time of the response, UTC."""
    cached: bool = False
    """True if the score was copied from another candidate with an identical image."""
    cost_usd: float | None = None
    """Cost of the request [USD]; None if unknown."""
    error: str | None = None
    """Reason why scoring failed; None if it succeeded."""
    used: Stage | None = None
    """Stage in which the score was first used; None if it was never used."""

    @property
    def identity(self) -> CandidateId:
        """(iteration, candidate)."""
        return self.iteration, self.candidate


@dataclass(frozen=True)
class ScoringJob:
    """One candidate that is to be scored."""

    identity: CandidateId
    rank: int
    """Rank of the candidate; see `Score.rank`."""
    layout: str
    """Digest of the candidate's layout."""
    layouts: Layout
    """Layout of the candidate as NumPy arrays, with a population axis of length 1."""
    scene: SceneSpec | None = None
    """Scene of the candidate; None if the candidate will not be rendered."""

    def score(self, **fields: object) -> Score:
        """Build the score of this candidate with the given fields."""
        iteration, candidate = self.identity
        return Score.model_validate(
            {
                "iteration": iteration,
                "candidate": candidate,
                "rank": self.rank,
                "layout": self.layout,
                "numbers": layout_values(self.layouts),
                **fields,
            }
        )


def layout_digest(layout: Layout) -> str:
    """Return the hash of a single candidate's layout, 16 hex digits."""
    parts = (layout.xy, layout.yaw, layout.log_scale)
    data = b"".join(np.ascontiguousarray(part, np.float32).tobytes() for part in parts)
    return hashlib.sha256(data).hexdigest()[:16]


def layout_values(layout: Layout) -> tuple[float, ...]:
    """Return the variables of a single candidate's layout, rounded to 1e-6.

    The order is x, y [m], yaw [rad] and log scale of the first object, then of the second object,
    and so on.
    """
    columns = np.stack([*np.asarray(layout.xy)[0].T, layout.yaw[0], layout.log_scale[0]], axis=1)
    return tuple(np.round(columns.astype(float), 6).ravel().tolist())


class ScoreLog:
    """Writer of scores.jsonl, which appends whole lines.

    Args:
        path: the file, which is replaced if it exists. If None, nothing is written.

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
    """Read the scores in a scores.jsonl.

    Raises:
        ModelError: the file cannot be read, or a line is not a valid score.
    """
    lines = read_untrusted_text(path, ModelError, "scores").splitlines()
    scores = []
    for number, line in enumerate(lines, start=1):
        try:
            scores.append(Score.model_validate_json(line))
        except ValidationError as error:
            raise ModelError(f"{path}, line {number}: {validation_message(error, Score)}") from None
    return scores


class RecordedScores:
    """Replay of the scores of an earlier run, each in the stage in which it was first used.

    Rounding differs between processors. A candidate therefore matches the recorded candidate if no
    variable of their layouts differs by more than `SAME_LAYOUT`.

    Args:
        path: scores.jsonl of the earlier run.

    Raises:
        ModelError: the file cannot be read.
    """

    stopped: str | None = None

    def __init__(self, path: Path) -> None:
        self._path = path
        self._scores = {score.identity: score for score in read_scores(path)}
        self._put: list[Score] = []

    def put(self, jobs: Sequence[ScoringJob]) -> None:
        """Look up the scores of candidates.

        Raises:
            ModelError: the log lacks a candidate, or contains it with another layout.
        """
        for job in jobs:
            score = self._scores.get(job.identity)
            iteration, candidate = job.identity
            if score is None or not _same_layout(score, job):
                content = "no score" if score is None else "the score of another layout"
                raise ModelError(
                    f"{self._path} has {content} for candidate {candidate} of iteration "
                    f"{iteration}: scores can only be replayed in a run with the same scene, "
                    f"options, seed and engine"
                )
            self._put.append(score)

    def take(self, stage: Stage, required: Collection[CandidateId], *, others: bool) -> list[Score]:
        """Return the scores that the recorded run first used at a stage, ordered by identity.

        Args:
            stage: the stage.
            required: candidates whose scores are returned.
            others: if True, also return the scores of all other candidates.
        """
        return sorted(
            (s for s in self._put if s.used == stage and (others or s.identity in required)),
            key=lambda score: score.identity,
        )

    def close(self) -> list[Score]:
        """Return the scores that the recorded run never used, ordered by identity."""
        return sorted((s for s in self._put if s.used is None), key=lambda s: s.identity)


def _same_layout(score: Score, job: ScoringJob) -> bool:
    if score.layout == job.layout:
        return True
    numbers = layout_values(job.layouts)
    if score.numbers is None or len(score.numbers) != len(numbers):
        return False
    return bool(np.max(np.abs(np.subtract(score.numbers, numbers)), initial=0.0) <= SAME_LAYOUT)
