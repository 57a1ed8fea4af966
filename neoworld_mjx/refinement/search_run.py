"""One run of a search: what it is asked to do, and how far it has come."""

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
    """A run's search as far as it has come, before the exact check of its winner."""

    run: SearchRun
    origin: Layout
    """Where the search starts, after the gradient refinement; pop axis of length 1."""
    problem: Problem
    state: SearchState
    rounds: list[Round] = field(default_factory=list)
    summaries: list[dict[str, Any]] = field(default_factory=list)
    """Each iteration in numbers; see `outcome.iteration_summary`."""
    rollouts: int = 0
    pruned: int = 0
    """Candidates that were drawn and not rolled out."""
    first_valid_s: float = float("nan")
    """When the batch of the first valid candidate was scored, since the start of the search."""
    marks: list[np.ndarray] = field(default_factory=list)
    """How each S_sem came about, by iteration; see `scorer.Mark`."""
    stages: list[np.ndarray] = field(default_factory=list)
    """Masks [object] of what moves: now, and after iterations in which nothing was valid."""
    share: np.ndarray | None = None
    """Of the initial deviations of yaw and log scale [object]; None is 1."""
    later: np.ndarray | None = None
    """Mask [object] of what may also move once the search has a valid candidate and converges."""
    checked: SceneMeasure | None = None
    """Final check of where the run starts, where the search needed it."""
    stage_began: int = 0
    """Iteration in which the first of `stages` began."""
    judged_from: int = 0
    """Iteration from which on what falls in every candidate counts."""
    searched_farther: bool = False
    """Whether what fell in every candidate was looked for farther away."""
    falling: np.ndarray | None = None
    """Mask [object] of what fell in every candidate, where that ended the search."""
    settles: bool = False
    """Whether candidates come to rest before they are judged."""
    finished: bool = False


def population_at(options: RefineOptions, t: int) -> int:
    """Return N of an iteration; the first one may be smaller."""
    c = options.cem
    return min(c.first, c.population) if t == 0 and c.first else c.population


def prunes(options: RefineOptions, problem: Problem) -> bool:
    """Tell whether candidates that cannot become elites are left out."""
    return options.cem.prune and bounded(options, problem)


def bounded(options: RefineOptions, problem: Problem) -> bool:
    """Tell whether rewards are known to lie below bounds before physics.

    Only where every term has a bound, and elites are those of the whole scene.
    """
    fixed = options.reward.normalisation == "fixed" and options.cem.credit in ("auto", "scene")
    return fixed and not problem.objective.unbounded
