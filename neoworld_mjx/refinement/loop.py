"""The loop of Algorithm 1.

The host measures time, reports progress, settles and rolls out candidates, and requests scores from
a model. The pure functions of `algorithm` and `objective` do everything else.
"""

import dataclasses
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from ..config import RefineOptions
from ..physics.engine import Engine
from ..physics.layout import Layout
from ..physics.model import SceneModel
from ..physics.placed import Placed
from ..physics.scene_arrays import on_device, pad_objects, pad_scene
from ..progress import update as update_progress
from .algorithm import Problem, SearchState, converged, init, open_problem, propose, update
from .choosing import NOT_SAMPLED, Round
from .evaluation import Evaluation
from .finishing import Finished, compile_for_search, finish, with_resting_fixed
from .objective import (
    Scores,
    has_builtin_terms_only,
    open_objective,
    refuse_not_finite,
    try_terms,
)
from .optimizer import Optimizer
from .rewards import Term
from .scorer import ScoreSource, SemanticScorer

PADDED_OPTIMIZERS = ("cem", "random")
"""Optimizers that accept a padded scene."""
CLOCKS = ("propose", "settle", "rollout", "score", "wait")
"""Steps of a search whose time is measured."""


class TimeToValid(NamedTuple):
    """When a search found its first valid candidate."""

    iteration: int
    """Iteration that contains the candidate, counted from 1; 0 is the initial layout."""
    rollouts: int
    """Number of candidates that were rolled out up to and including this iteration."""


@dataclass
class SearchResult:
    """Progress and results of a search, before the final check of its winner."""

    evaluation: Evaluation
    """Evaluation of candidates in the scene that is searched.

    Some of its objects may be fixed; see `finishing.with_resting_fixed`.
    """
    problem: Problem
    state: SearchState
    initial: Finished
    """Final scene of the initial layout, with its final check."""
    accept_initial: bool
    """If True, the initial layout is the result if it passes the final check."""
    began: float
    """Start of the search, by `time.perf_counter`."""
    rounds: list[Round] = field(default_factory=list)
    rollouts: int = 0
    """Number of candidates that were rolled out."""
    first_valid_s: float = float("nan")
    """Time from the start of the search to the score of the first valid candidate [s]."""
    first_valid: TimeToValid | None = None
    """When the search found its first valid candidate; None if no candidate was valid."""
    score_sources: list[np.ndarray] = field(default_factory=list)
    """Source of each candidate's S_sem, by iteration; see `scorer.ScoreSource`."""
    stuck: tuple[str, ...] = ()
    """Names of objects that rested in no candidate, if the search ended for this reason."""
    finished: bool = False
    """True if the search has ended."""

    @property
    def iterations_done(self) -> int:
        """Number of iterations so far, not counting the initial layout."""
        return len(self.rounds) - self.evaluation.options.settle.enabled

    def add(self, round_: Round) -> None:
        """Add an iteration."""
        self.rounds.append(round_)
        self.rollouts += len(round_.scores.valid)
        if bool(np.any(round_.scores.valid)):
            self.note_valid()

    def note_valid(self) -> None:
        """Record the last iteration as the first one with a valid candidate, if it is the first."""
        if self.first_valid is None:
            self.first_valid = TimeToValid(self.iterations_done, self.rollouts)
            self.first_valid_s = time.perf_counter() - self.began


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
    """Largest finite absolute reward; None if no candidate has one."""
    mean: float | None
    """Mean of the finite absolute rewards; None if there are none."""
    merit: float | None
    """Largest merit of a valid candidate; None if no candidate is valid."""
    terms: dict[str, float]
    """Reward terms of the candidate with the best absolute reward; empty if `best` is None."""


def search(
    scene: SceneModel,
    o: RefineOptions,
    engine: Engine,
    *,
    seed: int = 0,
    start: Layout | None = None,
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
        terms: reward terms in addition to those that the options name.
        optimizer: replaces the optimizer that the options name.
        scorer: source of S_sem by a model.
        clock: seconds spent on each step; updated in place.
        progress: called with one line per iteration.
        on_iteration: called after each iteration; the search ends if it returns True.

    Raises:
        ConfigError: two options contradict each other, or a reward term is invalid or not finite.
    """
    clock = {} if clock is None else clock
    clock |= dict.fromkeys(CLOCKS, 0.0) | clock
    r = _open_search(
        scene, o, engine, seed, start, terms, optimizer, scorer is None, clock, progress
    )
    if on_iteration is not None and r.rounds:
        r.finished |= bool(on_iteration(summarize(0, r.rounds[0].scores)))
    evaluation, problem = r.evaluation, r.problem
    while not r.finished and r.iterations_done < o.cem.iterations:
        began = time.perf_counter()
        layouts = jax.device_get(propose(evaluation.arrays, problem, r.state, o.cem.population))
        clock["propose"] += time.perf_counter() - began
        placed = evaluation.place(layouts)
        geometric = None if scorer is None else _submit(r, layouts, placed, scorer)
        rollout = evaluation.roll_out(placed.poses)
        s_sem = None
        if scorer is not None and geometric is not None:
            s_sem = _collect(r, geometric, scorer)
        scores = evaluation.score(layouts, placed, rollout, s_sem)
        r.state = evaluation.on_devices(
            update, evaluation.arrays, problem, r.state, layouts, scores
        )
        name = f"iteration {r.iterations_done + 1}"
        refuse_not_finite(problem.objective, scores, np.asarray(rollout.status), name)
        r.add(evaluation.unpadded_round(layouts, placed.poses, scores))
        if progress is not None:
            progress(_line(r, scores))
        r.finished = converged(problem, r.state)
        stuck = np.flatnonzero(r.state.stuck)
        if len(stuck) and not bool(r.state.any_valid):
            r.finished, r.stuck = True, tuple(scene.names[k] for k in stuck)
        if on_iteration is not None:
            r.finished |= bool(on_iteration(summarize(r.iterations_done, scores)))
        _update_progress(r)
    clock["search"] = time.perf_counter() - r.began
    return r


def _open_search(
    scene: SceneModel,
    o: RefineOptions,
    engine: Engine,
    seed: int,
    start: Layout | None,
    terms: Sequence[Term],
    optimizer: Optimizer | None,
    by_geometry: bool,
    clock: dict[str, float],
    progress: Callable[[str], None] | None,
) -> SearchResult:
    """Prepare a search. With settling, the initial layout is its first iteration.

    With user-defined terms, another optimizer or scores by a model, every object moves, and a scene
    that passes the final check is searched, too.
    """
    began = time.perf_counter()
    objective = open_objective(o, terms=terms)
    try_terms(scene, objective, o)
    layout = Layout.zero(1, len(scene.names)) if start is None else start
    initial = finish(scene, layout, 0, o)
    if progress is not None:
        progress(_initial_line(scene, initial, o))
    builtin_only = optimizer is None and by_geometry and has_builtin_terms_only(objective)
    rests = initial.rests(o)
    hold = o.cem.hold_resting and builtin_only
    searched = scene
    if hold and start is None and not initial.passed and rests.any():
        fixed = compile_for_search(with_resting_fixed(scene.spec, initial, o), o)
        searched = dataclasses.replace(fixed, photo=scene.photo)
    padded = pad_scene(searched)
    use_padded = objective.padded and optimizer is None and o.optimizer in PADDED_OPTIMIZERS
    arrays = padded if use_padded else searched
    origin = on_device(pad_objects(layout, arrays.count))
    problem = open_problem(arrays, o, origin, terms=terms, optimizer=optimizer)
    evaluation = Evaluation(searched, arrays, padded, engine, o, problem.objective, clock)
    state = init(problem, seed, _initial_factors(arrays.count, rests, hold))
    r = SearchResult(evaluation, problem, state, initial, builtin_only, began)
    if o.settle.enabled:
        r.add(evaluation.score_initial(initial.scene, origin))
        r.score_sources.append(np.array([ScoreSource.GEOMETRIC], np.int8))
        r.finished = initial.passed and builtin_only
        if initial.passed:
            r.note_valid()
    return r


def _initial_factors(
    count: int, rests: np.ndarray, hold_resting: bool
) -> Float[np.ndarray, " object"]:
    """Return the initial factor of each object's standard deviations.

    The factor is 0 for objects that rest in the initial layout if `hold_resting` is True, and else
    1.
    """
    factors = np.ones(count, np.float32)
    if hold_resting:
        factors[: len(rests)][rests] = 0.0
    return factors


def _initial_line(scene: SceneModel, initial: Finished, o: RefineOptions) -> str:
    moving = np.asarray(scene.optimised)
    failing = [scene.names[k] for k in np.flatnonzero(moving & ~initial.rests(o))]
    if not failing:
        return f"all {int(moving.sum())} objects rest where they were placed"
    return f"{len(failing)} of {int(moving.sum())} objects do not rest: {', '.join(failing)}"


def _submit(r: SearchResult, layouts: Layout, placed: Placed, scorer: SemanticScorer) -> np.ndarray:
    """Submit the candidates that score best before physics; return the geometric S_sem of all."""
    evaluation = r.evaluation
    before = evaluation.score_before_physics(layouts, placed)
    geometric = np.asarray(before.terms["s_sem"])
    candidates = evaluation.unpadded(layouts), evaluation.unpadded(placed.poses)
    scorer.submit(len(r.rounds), np.asarray(before.reward), geometric, *candidates)
    return geometric


def _collect(r: SearchResult, geometric: np.ndarray, scorer: SemanticScorer) -> np.ndarray:
    """Wait for scores by a model, and return S_sem of all candidates of an iteration."""
    began = time.perf_counter()
    scorer.collect(len(r.rounds))
    r.evaluation.clock["wait"] += time.perf_counter() - began
    values, sources = scorer.s_sem_of(len(r.rounds), geometric)
    r.score_sources.append(sources)
    return values


def summarize(number: int, scores: Scores) -> Iteration:
    """Summarize the scores of the iteration with this number."""
    absolute, valid = np.asarray(scores.absolute, float), np.asarray(scores.valid)
    finite = np.isfinite(absolute)
    best = int(np.where(finite, absolute, -np.inf).argmax()) if finite.any() else None
    return Iteration(
        number=number,
        candidates=int(np.sum(np.asarray(scores.status) != NOT_SAMPLED)),
        valid=int(np.sum(valid)),
        best=None if best is None else float(absolute[best]),
        mean=None if best is None else float(absolute[finite].mean()),
        merit=float(np.asarray(scores.merit)[valid].max()) if valid.any() else None,
        terms={}
        if best is None
        else {name: float(np.asarray(x)[best]) for name, x in scores.terms.items()},
    )


def _line(r: SearchResult, scores: Scores) -> str:
    best, scene = float(np.asarray(scores.absolute).max()), r.evaluation.scene
    valid, rested = np.asarray(scores.valid), np.asarray(scores.rested)
    outcome = f"{int(valid.sum())} of {len(valid)} candidates valid"
    if not valid.any():
        never = [name for k, name in enumerate(scene.names) if not rested[:, k].any()]
        outcome += (
            f"; in none did {', '.join(never)} rest" if never else "; each object rests in some"
        )
    return (
        f"iteration {r.iterations_done}/{r.evaluation.options.cem.iterations}: best {best:.3f}, "
        f"elites {float(r.state.elite_mean):.3f}, {outcome}"
    )


def _update_progress(r: SearchResult) -> None:
    """Report the number of iterations, the candidates per second and the longest remaining time."""
    seconds = time.perf_counter() - r.began
    done, total = r.iterations_done, r.evaluation.options.cem.iterations
    update_progress(
        done=done,
        of=total,
        unit="iteration",
        rate=r.rollouts / max(seconds, 1e-9),
        left_s=seconds / max(done, 1) * (total - done),
    )
