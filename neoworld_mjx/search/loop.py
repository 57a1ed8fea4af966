"""The loop of Algorithm 1, with a clock, reports, and scores by a model.

The pure functions of `algorithm` propose, score and update; `evaluation` places, settles and
simulates.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass

import jax
import numpy as np

from ..physics.model import SceneModel
from ..progress import update as update_progress
from .algorithm import SearchState, converged, init, propose, update
from .evaluation import Evaluation, Round, timed
from .scorer import SemanticScorer
from .user_terms import refuse_not_finite


@dataclass(frozen=True)
class Iteration:
    """Summary of one iteration of a search, which `refine` passes to `on_iteration`."""

    number: int
    """Number of the iteration, counted from 1."""
    candidates: int
    """Number of candidates that were rolled out."""
    valid: int
    """Number of valid candidates."""
    best: float | None
    """Largest finite reward; None if no candidate has one."""
    mean: float | None
    """Mean of the finite rewards; None if there are none."""
    terms: dict[str, float]
    """Reward terms of the candidate with the best reward; empty if `best` is None."""


def search(
    evaluation: Evaluation,
    *,
    seed: int = 0,
    scorer: SemanticScorer | None = None,
    progress: Callable[[str], None] | None = None,
    on_iteration: Callable[[Iteration], bool | None] | None = None,
) -> list[Round]:
    """Run Algorithm 1, without the final check of the winner, and return its iterations.

    The clock of the evaluation gets the time up to the first valid candidate (`to_valid`, NaN if
    there is none).

    Args:
        evaluation: places, simulates and scores candidates.
        seed: random seed of the populations.
        scorer: source of S_sem by a model.
        progress: called with one line per iteration.
        on_iteration: called after each iteration; the search ends if it returns True.
    """
    began, clock = time.perf_counter(), evaluation.clock
    clock["to_valid"] = float("nan")
    total, rounds = evaluation.options.cem.iterations, list[Round]()
    state = init(evaluation.problem, seed)
    for number in range(1, total + 1):
        state, round_ = iterate(evaluation, state, number, scorer)
        rounds.append(round_)
        step, seconds = summarize(number, round_), time.perf_counter() - began
        if step.valid and np.isnan(clock["to_valid"]):
            clock["to_valid"] = seconds
        if progress is not None:
            best = "none" if step.best is None else f"{step.best:.3f}"
            outcome = _outcome(evaluation.scene, round_)
            progress(f"iteration {number}/{total}: best {best}, {outcome}")
        rate, left_s = number * step.candidates / seconds, seconds / number * (total - number)
        update_progress(done=number, of=total, unit="iteration", rate=rate, left_s=left_s)
        ended = on_iteration is not None and on_iteration(step)
        if ended or converged(evaluation.problem, state):
            break
    return rounds


def _outcome(scene: SceneModel, round_: Round) -> str:
    """Return how many candidates are valid and, if none is, which objects rest in none."""
    valid, rests = np.asarray(round_.scores.valid), np.asarray(round_.scores.rests)
    outcome = f"{int(valid.sum())} of {len(valid)} candidates valid"
    if valid.any():
        return outcome
    never = [name for k, name in enumerate(scene.names) if not rests[:, k].any()]
    return f"{outcome}; " + (
        f"in none did {', '.join(never)} rest" if never else "each object rests in some"
    )


def iterate(
    evaluation: Evaluation, state: SearchState, number: int, scorer: SemanticScorer | None = None
) -> tuple[SearchState, Round]:
    """Run one iteration of Algorithm 1, lines 3 to 12.

    Args:
        evaluation: places, simulates and scores candidates.
        state: state of the search.
        number: number of the iteration, counted from 1.
        scorer: source of S_sem by a model, which scores while physics runs.
    """
    problem, s_sem, sources = evaluation.problem, None, None
    layouts = jax.device_get(propose(problem, state, evaluation.options.cem.population))
    placed = evaluation.place(layouts)
    if scorer is not None:
        before = evaluation.score_before_physics(layouts, placed)
        candidates = evaluation.unpadded(layouts), evaluation.unpadded(placed.poses)
        scorer.submit(before.reward, before.terms["s_sem"], *candidates)
    rollout = evaluation.roll_out(placed.poses)
    if scorer is not None:
        with timed(evaluation.clock, "wait"):
            s_sem, sources = scorer.collect()
    scores = evaluation.score(layouts, placed, rollout, s_sem)
    refuse_not_finite(problem.terms, scores.terms, rollout.status, f"iteration {number}")
    state = jax.device_get(update(problem, state, layouts, scores))
    return state, evaluation.round(layouts, placed.poses, scores, sources)


def summarize(number: int, round_: Round) -> Iteration:
    """Summarize the iteration with this number."""
    scores = round_.scores
    finite = np.isfinite(scores.reward)
    best = int(np.argmax(scores.reward)) if finite.any() else None
    return Iteration(
        number=number,
        candidates=len(scores.valid),
        valid=int(np.sum(scores.valid)),
        best=None if best is None else float(scores.reward[best]),
        mean=None if best is None else float(np.mean(scores.reward[finite])),
        terms={} if best is None else {n: float(x[best]) for n, x in scores.terms.items()},
    )
