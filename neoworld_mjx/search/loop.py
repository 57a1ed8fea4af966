"""The loop of Algorithm 1, with an engine, a clock, reports, and scores by a model.

The pure functions of `algorithm` propose, score and update; `evaluation` places, settles and
simulates.
"""

import dataclasses
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import equinox as eqx
import jax
import numpy as np

from ..config import RefineOptions
from ..physics.engine import Engine
from ..physics.layout import Layout
from ..physics.model import SceneModel, is_optimised
from ..physics.scene_arrays import on_device, pad_axis, pad_objects, pad_scene
from ..progress import update as update_progress
from .algorithm import SearchState, converged, init, open_problem, propose, update
from .evaluation import CLOCKS, Evaluation, Round, timed
from .finishing import Finished, compile_for_search, finish, with_resting_fixed
from .optimizer import Optimizer
from .problem import open_terms
from .rewards import Term
from .scorer import SemanticScorer
from .user_terms import refuse_not_finite, try_terms

PADDED_OPTIMIZERS = ("cem", "random")
"""Optimizers that accept a padded scene."""


@dataclass
class SearchResult:
    """Iterations of a search, before the final check of its winner."""

    evaluation: Evaluation
    """Evaluation of candidates in the scene that is searched.

    Some of its objects may be fixed; see `finishing.with_resting_fixed`.
    """
    initial: Finished
    """Final scene of the initial layout, with its final check."""
    accept_initial: bool
    """If True, the initial layout is the result if it passes the final check."""
    rounds: list[Round] = field(default_factory=list)
    """The iterations. With settling, the first one consists of the initial layout."""

    @property
    def rollouts(self) -> int:
        """Number of candidates that were rolled out."""
        return sum(len(round_.scores.valid) for round_ in self.rounds)


@dataclass(frozen=True)
class Iteration:
    """Summary of one iteration of a search, which `refine` passes to `on_iteration`."""

    number: int
    """Number of the iteration, counted from 1. With settling, the initial layout comes before them
    as number 0."""
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
    scene: SceneModel,
    o: RefineOptions,
    engine: Engine,
    *,
    seed: int = 0,
    start: Layout | None = None,
    initial: Finished | None = None,
    terms: Sequence[Term] = (),
    optimizer: Optimizer | None = None,
    scorer: SemanticScorer | None = None,
    clock: dict[str, float] | None = None,
    progress: Callable[[str], None] | None = None,
    on_iteration: Callable[[Iteration], bool | None] | None = None,
) -> SearchResult:
    """Run Algorithm 1, without the final check of the winner.

    The initial layout is settled and checked first. If it passes, the search ends with it, unless
    there are user-defined terms, another optimizer or a scorer.

    Args:
        scene: the compiled scene.
        o: options of the search, the rewards and the final check.
        engine: physics engine of the rollouts.
        seed: random seed of the populations.
        start: initial layout, with a population axis of length 1. If None, it is the composed
            scene.
        initial: the final scene of the initial layout, if it is known.
        terms: reward terms in addition to those that the options name.
        optimizer: replaces the optimizer that the options name.
        scorer: source of S_sem by a model.
        clock: seconds spent on each step; updated in place.
        progress: called with one line per iteration.
        on_iteration: called after each iteration; the search ends if it returns True.

    Raises:
        ConfigError: an option names something that does not exist, or a reward term is invalid or
            not finite.
    """
    began, clock = time.perf_counter(), {} if clock is None else clock
    clock |= dict.fromkeys(CLOCKS, 0.0) | clock | {"to_valid": float("nan")}
    report = progress or (lambda line: None)
    if initial is None:
        initial = finish(scene, _origin(scene, start), 0, o)
    by_model = scorer is not None
    result = open_search(scene, o, engine, initial, start, terms, optimizer, by_model, clock)
    report(initial_line(initial, o))
    evaluation, total = result.evaluation, o.cem.iterations

    def add(number: int, round_: Round) -> bool:
        """Add an iteration and report it; return True if the search ends with it."""
        result.rounds.append(round_)
        step, seconds = summarize(number, round_), time.perf_counter() - began
        if step.valid and np.isnan(clock["to_valid"]):
            clock["to_valid"] = seconds
        if number:
            best = "none" if step.best is None else f"{step.best:.3f}"
            outcome = _outcome(evaluation.scene, round_)
            report(f"iteration {number}/{total}: best {best}, {outcome}")
            rate, left_s = result.rollouts / seconds, seconds / number * (total - number)
            update_progress(done=number, of=total, unit="iteration", rate=rate, left_s=left_s)
        return on_iteration is not None and bool(on_iteration(step))

    finished, state = False, init(evaluation.problem, seed)
    if o.settle.enabled:
        finished = add(0, evaluation.initial_round(result.initial.scene))
        finished |= result.initial.passed and result.accept_initial
    for number in range(1, o.cem.iterations + 1):
        if finished:
            break
        state, round_ = iterate(evaluation, state, number, scorer)
        finished = add(number, round_) or converged(evaluation.problem, state)
    clock["search"] = time.perf_counter() - began
    return result


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


def open_search(
    scene: SceneModel,
    o: RefineOptions,
    engine: Engine,
    initial: Finished,
    start: Layout | None,
    terms: Sequence[Term],
    optimizer: Optimizer | None,
    by_model: bool,
    clock: dict[str, float],
) -> SearchResult:
    """Decide which objects the search moves, given the final scene of the initial layout.

    Objects that rest do not move, unless an object that carries them moves. Where the search starts
    at the composed scene, they are fixed, so that rollouts are faster. With user-defined terms,
    another optimizer or scores by a model, every object moves, and a scene that passes the final
    check is searched, too.
    """
    every = open_terms(o, terms)
    try_terms(scene, every, o)
    own = any(term.fn is not None for term in every)
    as_given = optimizer is None and not by_model and not own
    searched, rests = scene, initial.rests(o)
    held = rests & (o.cem.hold_resting and as_given)
    if start is None and held.any() and not initial.passed:
        fixed = compile_for_search(with_resting_fixed(scene.spec, initial, o), o)
        searched = dataclasses.replace(fixed, photo=scene.photo)
    padded = pad_scene(searched)
    use_padded = not own and optimizer is None and o.optimizer in PADDED_OPTIMIZERS
    arrays = padded if use_padded else searched
    origin = on_device(pad_objects(_origin(scene, start), arrays.count))
    moves = np.asarray(arrays.optimised) & ~pad_axis(held, arrays.count)
    moving = eqx.tree_at(lambda s: s.optimised, arrays, on_device(moves))
    problem = open_problem(moving, o, origin, terms=terms, optimizer=optimizer)
    evaluation = Evaluation(searched, arrays, padded, engine, o, problem, clock)
    return SearchResult(evaluation, initial, as_given)


def _origin(scene: SceneModel, start: Layout | None) -> Layout:
    return Layout.zero(1, len(scene.names)) if start is None else start


def initial_line(initial: Finished, o: RefineOptions) -> str:
    """Return how many objects rest in the settled initial layout, and which do not."""
    moving, objects = is_optimised(initial.scene), initial.scene.objects
    failing = [objects[k].name for k in np.flatnonzero(moving & ~initial.rests(o))]
    if not failing:
        return f"all {int(moving.sum())} objects rest where they were placed"
    return f"{len(failing)} of {int(moving.sum())} objects do not rest: {', '.join(failing)}"


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
