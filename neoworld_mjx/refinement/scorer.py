"""S_sem by a model, which scores the best candidates while rollouts run.

    with SemanticScorer(model, photo, panel, options, log=path) as scorer:
        scorer.submit(t, scorer.best(reward), layouts, poses)     # returns at once
        ...                                                       # run the rollout
        scorer.collect(t)                                         # waits according to options.wait
        s_sem, sources = scorer.s_sem_of(t, layouts, geometric)         # for every candidate

Before the winner is chosen, `await_for` waits for the scores of the finalists. After that,
`s_sem_of` computes the S_sem of any iteration from all known scores.
"""

import time
from collections.abc import Iterable, Sequence
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import ArrayLike, Float, Int8

from ..config import CEMOptions, SemanticOptions
from ..errors import ConfigError
from ..mllm import Panel, Picture
from ..physics.layout import Layout, Poses
from ..physics.model import SceneModel
from .score_log import (
    CandidateId,
    RecordedScores,
    Score,
    ScoreLog,
    ScoringJob,
    Stage,
    layout_digest,
)
from .score_worker import Draw, ScoreWorkers
from .surrogate import surrogate_scores


class ScoreSource(IntEnum):
    """Source of a candidate's S_sem."""

    GEOMETRIC = 0
    """Computed from the parsed boxes and depths."""
    ESTIMATED = 1
    """Estimated by the surrogate from the scores of other candidates."""
    SCORED = 2
    """Scored by the model."""


class SemanticScorer:
    """Scores candidates by a model, and estimates the scores of all others by a surrogate.

    Args:
        model: the compiled scene.
        photo: the photograph; not needed for a replay.
        panel: models, of which the critic scores candidates; not needed for a replay.
        options: options such as the number of candidates to score and the scores to wait for.
        cem: options whose initial standard deviations normalize layouts for the surrogate.
        log: scores.jsonl to write; an existing file is replaced.
        recorded: scores.jsonl of an earlier run. Each score is used in the iteration in which that
            run first used it. Nothing is rendered, and no requests are sent.
        draw: function that renders the scene of a candidate as RGB bytes [height, width, 3]. If
            None, scenes are rendered through the parsed camera.

    Raises:
        ConfigError: the photograph or the panel is missing, the scene has no camera, or costs
            are limited but the price of the model is unknown.
        ModelError: a file cannot be read or written.
    """

    def __init__(
        self,
        model: SceneModel,
        photo: Picture | None,
        panel: Panel | None,
        options: SemanticOptions | None = None,
        *,
        cem: CEMOptions | None = None,
        log: Path | None = None,
        recorded: Path | None = None,
        draw: Draw | None = None,
    ) -> None:
        self.options = options or SemanticOptions(scorer="mllm")
        self.waited_s = 0.0
        self._model = model
        self._sigma = cem or CEMOptions()
        self._optimised = np.asarray(model.optimised)
        self._source: ScoreWorkers | RecordedScores
        if recorded is not None:
            # Read this file before the log is opened, because both may be the same file.
            self._source = RecordedScores(recorded)
        elif photo is None or panel is None:
            raise ConfigError(
                "refine.semantic.scorer: mllm needs the photograph and a model; "
                "choose geometric without them"
            )
        elif draw is None and model.spec.camera is None:
            raise ConfigError(
                "refine.semantic.scorer: mllm needs the parsed camera, but the scene has none; "
                "add it to the scene, or choose geometric"
            )
        else:
            self._source = ScoreWorkers(panel, photo, self.options, draw)
        self._log = ScoreLog(log)
        self._jobs: dict[CandidateId, ScoringJob] = {}
        self._geometric: dict[CandidateId, float] = {}
        self._known: dict[CandidateId, Score] = {}
        """All scores taken so far, including failed ones."""
        self._untaken: list[Score] = []
        """Scores that had not been taken when the scorer was closed."""
        self._closed = False

    def best(self, reward: Float[ArrayLike, " pop"], top: int | None = None) -> list[int]:
        """Return the candidates to score, best first. Candidates of non-finite reward are omitted.

        Args:
            reward: reward that ranks the candidates. Candidates of equal reward keep the order of
                the population.
            top: largest number of candidates. If None, it is `options.top`.
        """
        rewards = np.asarray(reward, float)
        order = np.argsort(-np.where(np.isfinite(rewards), rewards, -np.inf), kind="stable")
        return [int(k) for k in order[: top or self.options.top] if np.isfinite(rewards[k])]

    def submit(
        self, iteration: int, candidates: Sequence[int], layouts: Layout, poses: Poses
    ) -> None:
        """Submit candidates for scoring and return at once.

        Candidates that were submitted before are skipped.

        Args:
            iteration: iteration of the candidates.
            candidates: indices in the population, the most urgent first.
            layouts: layouts of the whole population.
            poses: poses of the whole population.

        Raises:
            ModelError: scores are replayed, but this run differs from the recorded run.
        """
        host = Layout(*(np.asarray(x) for x in (layouts.xy, layouts.yaw, layouts.log_scale)))
        placed = Poses(*(np.asarray(x) for x in (poses.pos, poses.quat, poses.scale, poses.height)))
        jobs = []
        for rank, k in enumerate(candidates):
            if (iteration, k) in self._jobs:
                continue
            single = Layout(*(x[k : k + 1] for x in (host.xy, host.yaw, host.log_scale)))
            rendered = isinstance(self._source, ScoreWorkers)
            scene = self._model.apply(host, k, placed) if rendered else None
            job = ScoringJob((iteration, k), rank, layout_digest(single), single, scene)
            jobs.append(job)
            self._jobs[job.identity] = job
        self._source.put(jobs)

    def collect(self, iteration: int) -> list[Score]:
        """Collect scores before the elites of an iteration are selected; return the new scores.

        The option `wait` selects the scores to wait for:

        - `all`: scores of all submitted candidates. The result then does not depend on the order in
          which responses arrive.
        - `bounded`: scores of candidates that were submitted at least `late` iterations ago.
        - `none`: no scores.

        All other scores that have arrived are collected, too.
        """
        wait, late = self.options.wait, self.options.late
        newest = {"all": iteration, "bounded": iteration - late, "none": -1}[wait]
        required = [key for key in self._jobs if key[0] <= newest and key not in self._known]
        return self._take(iteration, required, others=True)

    def await_for(self, identities: Iterable[CandidateId]) -> list[Score]:
        """Wait for the scores of the given candidates, and return the new scores.

        These candidates are requested before all others.

        Args:
            identities: (iteration, candidate) of each. Candidates that were never submitted are
                skipped.
        """
        required = [key for key in identities if key in self._jobs and key not in self._known]
        return self._take("final", required, others=False)

    def known(self, identity: CandidateId) -> Score | None:
        """Return the score of a candidate; None if it is pending or has failed."""
        score = self._known.get(identity)
        return score if score is not None and score.value is not None else None

    def s_sem_of(
        self, iteration: int, layouts: Layout, geometric: Float[ArrayLike, " pop"]
    ) -> tuple[Float[np.ndarray, " pop"], Int8[np.ndarray, " pop"]]:
        """Return the S_sem of a whole population, based on the scores that are known now.

        Args:
            iteration: iteration of the population.
            layouts: layouts of the population.
            geometric: geometric S_sem of the population.

        Returns:
            S_sem of each candidate in [0, 1] (float32), and the `ScoreSource` of each candidate. As
            long as no candidate of the run has a score, all candidates have the geometric S_sem.
        """
        geometric_scores = np.asarray(geometric, float)
        for key in self._jobs:
            if key[0] == iteration:
                self._geometric[key] = float(geometric_scores[key[1]])
        scored = sorted(key for key in self._geometric if self.known(key) is not None)
        sources = np.full(
            len(geometric_scores),
            ScoreSource.ESTIMATED if scored else ScoreSource.GEOMETRIC,
            np.int8,
        )
        values = geometric_scores
        if scored:
            variables = [self._normalized_variables(self._jobs[key].layouts) for key in scored]
            base_scores = np.array([self._geometric[key] for key in scored])
            model_scores = np.array([self._known[key].value for key in scored])
            values = surrogate_scores(
                self._normalized_variables(layouts),
                geometric_scores,
                np.concatenate(variables),
                base_scores,
                model_scores,
            )
        for key in scored:
            if key[0] == iteration:
                values[key[1]], sources[key[1]] = self._known[key].value, ScoreSource.SCORED
        return np.asarray(values, np.float32), sources

    @property
    def stopped(self) -> str | None:
        """Reason why no more requests are sent; None while requests are sent."""
        return self._source.stopped

    @property
    def fallbacks(self) -> tuple[str, ...]:
        """Descriptions of missing scores; empty if no score is missing."""
        scores = list(self._known.values())
        failed = [score for score in scores if score.error is not None]
        if self.stopped is not None:
            source = "geometry alone" if len(failed) == len(scores) else "estimates"
            unrequested = sum(score.asked is None for score in failed)
            return (
                f"S_sem comes from {source}, because scores of {unrequested} of {len(self._jobs)} "
                f"candidates were not requested: {self.stopped}",
            )
        if failed:
            return (
                f"S_sem is estimated for {len(failed)} of {len(scores)} candidates, because "
                f"their scores failed; the first error: {failed[0].error}",
            )
        return ()

    def summary(self) -> dict[str, Any]:
        """Return the statistics for run.json. They are complete after `close`."""
        scores = [*self._known.values(), *self._untaken]
        live = self._source if isinstance(self._source, ScoreWorkers) else None
        return {
            "scorer": "recorded" if live is None else "mllm",
            "submitted": len(self._jobs),
            "scored": sum(s.value is not None for s in self._known.values()),
            "equal_pictures": sum(s.cached for s in scores),
            "failed": sum(s.error is not None for s in self._known.values()),
            "unused": len(self._untaken),
            "stopped": self.stopped,
            "cost_usd": None if live is None else round(live.cost_usd, 6),
            "drawing_s": None if live is None else round(live.drawing_s, 3),
            "waited_s": round(self.waited_s, 3),
        }

    def close(self) -> None:
        """End all requests. In the log, pending candidates are marked as abandoned."""
        if not self._closed:
            self._closed = True
            self._untaken = self._source.close()
            self._log.add(self._untaken)

    def __enter__(self) -> "SemanticScorer":
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def _take(self, stage: Stage, required: Sequence[CandidateId], *, others: bool) -> list[Score]:
        began = time.perf_counter()
        scores = self._source.take(stage, required, others=others)
        self.waited_s += time.perf_counter() - began
        self._known |= {score.identity: score for score in scores}
        self._log.add(scores)
        return scores

    def _normalized_variables(self, layouts: Layout) -> np.ndarray:
        """Divide the variables of optimized objects by their initial standard deviations.

        Returns:
            Array [pop, variable].
        """
        o, moves = self._sigma, self._optimised
        diagonal = np.asarray(self._model.diagonal, float)[moves]
        xy = np.asarray(layouts.xy, float)[:, moves] / (_nonzero(o.sigma_xy) * diagonal[:, None])
        yaw = np.asarray(layouts.yaw, float)[:, moves] / _nonzero(np.radians(o.sigma_yaw_deg))
        log = np.asarray(layouts.log_scale, float)[:, moves] / _nonzero(o.sigma_log_scale)
        return np.concatenate([xy.reshape(len(xy), -1), yaw, log], axis=1)


def _nonzero(sigma: float) -> float:
    return max(float(sigma), 1e-6)
