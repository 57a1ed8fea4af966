"""Worker threads that request scores of candidates from a model while rollouts run.

Each worker takes the most urgent candidate, renders it, sends the request, and stores the response
under the identity of the candidate, so the order of responses does not matter. If several
candidates have identical images, one request is sent for all of them.
"""

import heapq
import threading
import time
from collections.abc import Callable, Collection, Sequence
from concurrent.futures import CancelledError, Future
from datetime import UTC, datetime
from typing import Any

import mujoco
from jaxtyping import UInt8
from numpy import ndarray

from ..config import SemanticOptions
from ..errors import BudgetError, ConfigError, ModelError, NeoWorldError
from ..mllm import Panel, Picture, Request, Response
from ..mllm.ledger import price_of
from ..mllm.requests import digest
from ..render import render_plain, render_scene
from ..spec import SceneSpec
from .score_log import CandidateId, Score, ScoringJob, Stage
from .score_request import Judgement, score_request

Draw = Callable[[SceneSpec], UInt8[ndarray, "height width 3"]]

EXTRA_WORKERS = 2
"""Number of workers in excess of the limit of concurrent requests.

These workers render candidates while the others wait for responses.
"""
_ABANDONED = "abandoned: the search had ended"


def scene_renderer(options: SemanticOptions) -> Draw:
    """Return a function that renders the scene of a candidate through the parsed camera."""

    def draw(scene: SceneSpec) -> UInt8[ndarray, "height width 3"]:
        assert scene.camera is not None
        if options.shadows:
            return render_scene(scene, width=options.picture_px).color
        return render_plain(scene, scene.camera, width=options.picture_px)

    return draw


class ScoreWorkers:
    """Pool of worker threads that request scores from a model.

    Args:
        panel: models, of which the critic scores candidates.
        photo: the photograph.
        options: time limit, number of consecutive failures that ends all requests, and cost limit.
        draw: function that renders a candidate; called by one thread at a time. If None, it is the
            result of `scene_renderer`.

    Raises:
        ConfigError: costs are limited, but the price of the critic's model is unknown.
    """

    def __init__(
        self, panel: Panel, photo: Picture, options: SemanticOptions, draw: Draw | None = None
    ) -> None:
        self.stopped: str | None = None
        """Reason why no more requests are sent; None while requests are sent."""
        self.drawing_s = 0.0
        """Time spent on rendering [s]."""
        self._panel, self._photo, self._options = panel, photo, options
        self._draw = draw or scene_renderer(options)
        self._price = price_of(panel.options.critic.model, panel.ledger.prices)
        if options.max_cost_usd is not None and self._price is None and panel.provider.online:
            raise ConfigError(
                f"refine.semantic.max_cost_usd is set but {panel.options.critic.model!r} has no "
                f"price: add the price to a YAML file, and name this file in mllm.prices"
            )
        self._spent_before = panel.ledger.spent_usd
        self._changed = threading.Condition()
        self._drawing = threading.Lock()
        self._queue: list[tuple[tuple[bool, int, int, int], ScoringJob]] = []
        """Heap of the candidates. Those that `take` waits for come first, then the order is by
        iteration, rank and order of submission."""
        self._count = 0
        self._pending: dict[CandidateId, ScoringJob] = {}
        """Candidates that have neither a score nor an error yet."""
        self._outcomes: dict[CandidateId, Score] = {}
        """Scores and errors that `take` has not returned yet."""
        self._pictures: dict[str, Score | list[tuple[ScoringJob, float]]] = {}
        """For the digest of each image, the score; while it is pending, the other candidates with
        this image and the times to render them."""
        self._requests: set[Future[Response[Judgement]]] = set()
        self._failed_in_row = 0
        self._gave_up = self._closed = False
        self._crash: BaseException | None = None
        self._threads: list[threading.Thread] = []

    @property
    def cost_usd(self) -> float:
        """Cost of all requests whose prices are known so far, including failed requests [USD]."""
        return self._panel.ledger.spent_usd - self._spent_before

    def put(self, jobs: Sequence[ScoringJob]) -> None:
        """Queue candidates for scoring and return at once."""
        with self._changed:
            for job in jobs:
                self._pending[job.identity] = job
                if self.stopped is not None:
                    self._finish(job.score(error=f"not requested: {self.stopped}"))
                else:
                    self._count += 1
                    key = (True, job.identity[0], job.rank, self._count)
                    heapq.heappush(self._queue, (key, job))
            while len(self._threads) < self._panel.options.concurrency + EXTRA_WORKERS:
                thread = threading.Thread(
                    target=self._work, name=f"neoworld-score-{len(self._threads)}", daemon=True
                )
                self._threads.append(thread)
                thread.start()
            self._changed.notify_all()

    def take(self, stage: Stage, required: Collection[CandidateId], *, others: bool) -> list[Score]:
        """Wait for scores and return them, ordered by identity. Each score is returned once.

        Args:
            stage: stage that is stored in each score as its first use.
            required: candidates to wait for. They are requested before all others. If too many
                scores have failed in a row, the call does not wait.
            others: if True, also return the scores of other candidates that have arrived.
        """
        required = set(required)
        with self._changed:
            self._queue = [
                ((job.identity not in required, *key[1:]), job) for key, job in self._queue
            ]
            heapq.heapify(self._queue)
            self._changed.wait_for(
                lambda: self._crash or self._gave_up or required.isdisjoint(self._pending)
            )
            if self._crash is not None:
                raise self._crash
            ready = [key for key in self._outcomes if others or key in required]
            return [
                self._outcomes.pop(key).model_copy(update={"used": stage}) for key in sorted(ready)
            ]

    def close(self) -> list[Score]:
        """End all requests; return the scores that were not taken, ordered by identity."""
        with self._changed:
            self._closed = True
            self._queue.clear()
            requests = list(self._requests)
            self._changed.notify_all()
        for future in requests:
            future.cancel()
        for thread in self._threads:
            thread.join()
        with self._changed:
            for job in list(self._pending.values()):
                self._finish(job.score(error=_ABANDONED))
            remaining, self._outcomes = self._outcomes, {}
        return [remaining[key] for key in sorted(remaining)]

    # The methods below run in the worker threads.

    def _work(self) -> None:
        while (job := self._next()) is not None:
            try:
                self._serve(job)
            except BaseException as error:  # Otherwise `take` would wait forever.
                with self._changed:
                    self._crash = error
                    self._changed.notify_all()
                return

    def _next(self) -> ScoringJob | None:
        max_cost_usd = self._options.max_cost_usd
        with self._changed:
            while True:
                self._changed.wait_for(lambda: self._queue or self._closed)
                if self._closed:
                    return None
                if max_cost_usd is None or self.cost_usd < max_cost_usd:
                    return heapq.heappop(self._queue)[1]
                self._stop(f"refine.semantic.max_cost_usd of {max_cost_usd:g} USD is reached")

    def _serve(self, job: ScoringJob) -> None:
        assert job.scene is not None
        try:
            with self._drawing:
                began = time.perf_counter()
                rgb = self._draw(job.scene)
                draw_s = time.perf_counter() - began
                self.drawing_s += draw_s
        except (NeoWorldError, ValueError, mujoco.FatalError) as error:
            with self._changed:
                self._finish(job.score(error=f"cannot be rendered: {error}"))
            return
        key = digest(f"{rgb.shape}".encode() + rgb.tobytes())
        with self._changed:
            earlier = self._pictures.get(key)
            if isinstance(earlier, Score):
                self._finish(_copy_score(job, draw_s, earlier))
                return
            if earlier is not None:
                earlier.append((job, draw_s))
                return
            if self.stopped is not None or self._closed:
                self._finish(job.score(error=f"not requested: {self.stopped or _ABANDONED}"))
                return
            self._pictures[key] = []
        request = score_request(self._photo, Picture.of("candidate", rgb), job.scene)
        outcome = {"picture": key[:16], "drawn_s": round(draw_s, 4), "asked": _now()}
        outcome |= self._request_score(request)
        self._store(key, job.score(**outcome, answered=_now()))

    def _request_score(self, request: Request[Judgement]) -> dict[str, Any]:
        """Send a request; return the fields of `Score` that follow from its response or failure."""
        # A person who responds has no time limit.
        timeout = self._options.timeout_s if self._panel.provider.online else None
        future = self._panel.ask_soon(request)
        with self._changed:
            self._requests.add(future)
            if self._closed:
                future.cancel()
        try:
            response = future.result(timeout)
        except TimeoutError:
            future.cancel()
            return {"error": f"no response in {timeout:g} s; see refine.semantic.timeout_s"}
        except CancelledError:
            return {"error": _ABANDONED}
        except BudgetError as error:
            with self._changed:
                self._stop(str(error))
            return {"error": str(error)}
        except ModelError as error:
            return {"error": str(error)}
        finally:
            with self._changed:
                self._requests.discard(future)
        if not self._panel.provider.online:
            cost = 0.0
        else:
            cost = None if self._price is None else round(self._price.cost(response.usage), 6)
        judgement = response.value
        return {
            "value": judgement.value,
            "levels": judgement.levels,
            "reasons": judgement.reasons,
            "model": response.model,
            "cost_usd": cost,
        }

    def _store(self, key: str, score: Score) -> None:
        """Store a score for its candidate, and for all candidates that wait for the same image."""
        with self._changed:
            others = self._pictures.pop(key)
            if score.value is not None:
                self._pictures[key] = score
            self._finish(score)
            assert not isinstance(others, Score)
            for job, draw_s in others:
                self._finish(_copy_score(job, draw_s, score))
            if score.value is not None:
                self._failed_in_row = 0
            elif not self._closed:
                self._failed_in_row += 1
                if self._failed_in_row >= self._options.give_up_after and self.stopped is None:
                    self._gave_up = True
                    self._stop(
                        f"{self._failed_in_row} consecutive scores failed; "
                        f"the last error: {score.error}"
                    )

    # The methods below require the lock.

    def _finish(self, score: Score) -> None:
        if self._pending.pop(score.identity, None) is not None:
            self._outcomes[score.identity] = score
            self._changed.notify_all()

    def _stop(self, reason: str) -> None:
        self.stopped = self.stopped or reason
        queue, self._queue = self._queue, []
        for _, job in queue:
            self._finish(job.score(error=f"not requested: {self.stopped}"))
        self._changed.notify_all()


def _copy_score(job: ScoringJob, draw_s: float, score: Score) -> Score:
    """Copy a score to another candidate with an identical image."""
    fields = score.model_dump(exclude={"iteration", "candidate", "rank", "layout"})
    return job.score(**fields | {"drawn_s": round(draw_s, 4), "cached": True, "cost_usd": 0.0})


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds")
