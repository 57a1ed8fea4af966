"""One run of a search: its inputs, and its progress and results."""

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from ..config import RefineOptions
from ..measure import SceneMeasure
from ..physics.layout import Layout
from .algorithm import Problem, SearchState
from .rounds import Round


class SearchRun(NamedTuple):
    """One refinement of a scene."""

    options: RefineOptions
    seed: int
    start: Layout | None = None
    """Pop axis of length 1; None is the composed scene."""


@dataclass
class SearchResult:
    """Progress and results of a run's search, before the exact check of its winner."""

    run: SearchRun
    origin: Layout
    """Initial layout after the gradient refinement, pop axis of length 1."""
    problem: Problem
    state: SearchState
    rounds: list[Round] = field(default_factory=list)
    summaries: list[dict[str, Any]] = field(default_factory=list)
    """Summary of each iteration; see `outcome.iteration_summary`."""
    rollouts: int = 0
    pruned: int = 0
    """Number of candidates that were drawn but not rolled out."""
    first_valid_s: float = float("nan")
    """Time from the start of the search to the score of the first valid candidate [s]."""
    marks: list[np.ndarray] = field(default_factory=list)
    """Source of each S_sem, by iteration; see `scorer.Mark`."""
    stages: list[np.ndarray] = field(default_factory=list)
    """Masks [object] of the movable objects, of the current and later stages."""
    share: np.ndarray | None = None
    """Factor of the initial deviations of yaw and log scale [object]; None is 1."""
    later: np.ndarray | None = None
    """Mask [object] of the objects that may also move after the search first converges."""
    checked: SceneMeasure | None = None
    """Final check of the initial layout, if the search needed it."""
    stage_began: int = 0
    """Iteration in which the current stage began."""
    judged_from: int = 0
    """First iteration that is examined for objects that always fall."""
    searched_farther: bool = False
    """True once the search has been widened for objects that always fall."""
    falling: np.ndarray | None = None
    """Mask [object] of the objects that always fell, if that ended the search."""
    settles: bool = False
    """True if candidates are settled before they are scored."""
    finished: bool = False


def population_at(options: RefineOptions, t: int) -> int:
    """Return N of an iteration; the first population may be smaller."""
    c = options.cem
    return min(c.first, c.population) if t == 0 and c.first else c.population


def prunes(options: RefineOptions, problem: Problem) -> bool:
    """Return whether candidates that cannot become elites are pruned."""
    return options.cem.prune and bounded(options, problem)


def bounded(options: RefineOptions, problem: Problem) -> bool:
    """Return whether rewards have upper bounds before physics.

    They do if every term has a bound, and elites are those of the whole scene.
    """
    fixed = options.reward.normalisation == "fixed" and options.cem.credit in ("auto", "scene")
    return fixed and not problem.objective.unbounded
