"""Overlap of model scoring with physics: each alone, both together, and with a dead server.

A server on this machine is as slow and unreliable as a real one. Physics is either a pause of a
given length, which leaves the processor to drawing, or rollouts on all cores.
"""

import math
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from neoworld_bench.engines.table_scenes import Noise, crowded, noisy_layouts
from neoworld_bench.machine import machine
from neoworld_bench.rows import collect, plain
from pydantic import BaseModel, ConfigDict

from benchmarks.suites import Scoring
from neoworld_mjx.config import CEMOptions, MLLMOptions, SemanticOptions
from neoworld_mjx.mllm import Panel, Picture
from neoworld_mjx.mllm.anthropic import Anthropic
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.physics.model import SceneModel, compile_scene
from neoworld_mjx.physics.native import NativeEngine
from neoworld_mjx.refinement.score_worker import scene_renderer
from neoworld_mjx.refinement.scorer import SemanticScorer
from neoworld_mjx.spec import Camera, SceneSpec
from tests.support.messages import MessagesServer, levels_of

Physics = Callable[[Layout], object]


class ScoringRow(BaseModel):
    """One way of waiting; wall times of all iterations [s]."""

    model_config = ConfigDict(extra="forbid")

    wait: str
    physics: str
    """"pause" or "native"."""
    objects: int
    iterations: int
    top: int
    delay_s: float
    failing: float
    physics_s: float
    """Physics alone."""
    scoring_s: float
    """Scoring alone: rendering, requests, waiting."""
    both_s: float
    ratio: float
    """`both_s` over the larger of the two alone."""
    submitted: int
    scored: int
    """Scores that arrived by the end, after waiting for finalists."""
    misplaced: int
    """Scores that differ from the server's for the candidate's own picture."""
    calls: int
    failed_calls: int
    drawing_s: float
    """Rendering time while both run, in one thread alongside physics."""
    dead_server_s: float
    """Both together without a server."""
    dead_stopped: str | None
    """Message of the scorer in that case."""


def scoring(
    wait: str = "all",
    *,
    objects: int = 6,
    iterations: int = 6,
    top: int = 8,
    delay_s: float = 3.0,
    at_once: int = 8,
    failing: float = 0.1,
    physics_s: float = 3.0,
    real: bool = False,
    population: int = 64,
    backoff_s: float = 0.5,
    late: int = 1,
    seed: int = 0,
    options: SemanticOptions | None = None,
) -> ScoringRow:
    """Time physics alone, scoring alone, and both.

    Args:
        wait: all, bounded or none.
        objects: number of objects on the table.
        iterations: iterations of the search.
        top: candidates of an iteration that are scored.
        delay_s: time of a call to the server [s].
        at_once: calls that the server responses at once.
        failing: share of its calls that fail.
        physics_s: time of physics in one iteration alone [s].
        real: whether physics is rollouts on all cores, repeated until `physics_s` are filled;
            otherwise it is a pause.
        population: candidates of an iteration.
        backoff_s: first wait after a failed call.
        late: iterations that scores may be late by, if `wait` is bounded.
        seed: seed of layouts and failures.
        options: further options of scoring.
    """
    o = (options or SemanticOptions()).model_copy(
        update={"scorer": "mllm", "top": top, "wait": wait, "late": late}
    )
    model = compile_scene(_seen(crowded(objects)), samples=32)
    # The standard deviation that the search starts with.
    draws = [
        noisy_layouts(model, population, seed=seed + t, noise=Noise(xy=0.05))
        for t in range(iterations)
    ]
    rounds = [(layouts, model.place(layouts)) for layouts in draws]
    physics = _physics(model, draws[0], physics_s, real)
    geometric = np.random.default_rng(seed).uniform(0.4, 0.9, population)
    photo = Picture.of("photo", scene_renderer(o)(model.spec))

    alone = _timed(lambda: [physics(layouts) for layouts in draws])

    def search(url: str, work: Physics) -> tuple[float, SemanticScorer, Panel]:
        with _panel(url, at_once, backoff_s) as panel:
            scorer = SemanticScorer(model, photo, panel, o, cem=CEMOptions())

            def run() -> None:
                for t, (layouts, poses) in enumerate(rounds):
                    scorer.submit(t, scorer.best(geometric), layouts, poses)
                    work(layouts)
                    scorer.collect(t)
                    scorer.s_sem_of(t, layouts, geometric)
                scorer.await_for([(t, k) for t in range(iterations) for k in range(population)])

            with scorer:
                duration = _timed(run)
        return duration, scorer, panel

    server_options = {"delay_s": delay_s, "at_once": at_once, "failing": failing, "seed": seed}
    with MessagesServer(**server_options) as server:
        scored_alone, _, _ = search(server.url, lambda _: None)
    with MessagesServer(**server_options) as server:
        both, scorer, panel = search(server.url, physics)
    draw = scene_renderer(o)
    summary = scorer.summary()
    misplaced = 0
    for t, (layouts, poses) in enumerate(rounds):
        for k in scorer.best(geometric):
            score = scorer.known((t, k))
            own = levels_of(draw(model.apply(layouts, k, poses)))
            misplaced += score is not None and score.levels != own
    dead, silent, _ = search(_nobody(), physics)
    return ScoringRow(
        wait=wait,
        physics="native" if real else "pause",
        objects=objects,
        iterations=iterations,
        top=top,
        delay_s=delay_s,
        failing=failing,
        physics_s=round(alone, 3),
        scoring_s=round(scored_alone, 3),
        both_s=round(both, 3),
        ratio=round(both / max(alone, scored_alone), 3),
        submitted=summary["submitted"],
        scored=summary["scored"],
        misplaced=misplaced,
        calls=panel.ledger.to_json()["calls"],
        failed_calls=sum(server.failures.values()),
        drawing_s=summary["drawing_s"],
        dead_server_s=round(dead, 3),
        dead_stopped=silent.stopped,
    )


def _timed(run: Callable[[], object]) -> float:
    start = time.perf_counter()
    run()
    return time.perf_counter() - start


def _physics(model: SceneModel, layouts: Layout, seconds: float, real: bool) -> Physics:
    if not real:
        return lambda _: time.sleep(seconds)
    engine = NativeEngine()
    engine.rollout(model, model.place(layouts))
    duration = float(
        np.median([_timed(lambda: engine.rollout(model, model.place(layouts))) for _ in range(3)])
    )
    times = max(1, round(seconds / duration))
    # The work is fixed; its time varies.
    return lambda population: [engine.rollout(model, model.place(population)) for _ in range(times)]


@contextmanager
def _panel(url: str, at_once: int, backoff_s: float) -> Iterator[Panel]:
    options = MLLMOptions(base_url=url, concurrency=at_once)
    with Panel(Anthropic(options), options, backoff_s=backoff_s) as panel:
        yield panel


def _nobody() -> str:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return f"http://127.0.0.1:{free.getsockname()[1]}"


def _seen(scene: SceneSpec) -> SceneSpec:
    """Return a scene moved in front of a camera that sees all of it."""
    away = 1.3 * max(math.hypot(*obj.xy) for obj in scene.objects) + 0.5
    camera = Camera(width=600, height_px=400, fovy=0.6, height=0.75 * away, pitch=0.62)
    objects = tuple(
        obj if obj.parent is not None else obj.model_copy(update={"xy": (away, 0.0)})
        for obj in scene.objects
    )
    return scene.model_copy(update={"camera": camera, "objects": objects})


def run_suite(o: Scoring) -> dict[str, Any]:
    """Score while physics runs, with every way of waiting and kind of physics."""
    rows = collect(
        scoring(
            wait,
            real=physics == "native",
            iterations=o.iterations,
            physics_s=o.physics_s,
            delay_s=o.delay_s,
            failing=o.failing,
            seed=o.seed,
        )
        for physics in o.physics
        for wait in o.wait
    )
    return {
        "worst_ratio": max(row.ratio for row in rows),
        "lost": sum(row.submitted - row.scored for row in rows),
        "misplaced": sum(row.misplaced for row in rows),
        "machine": machine(),
        "rows": plain(rows),
    }
