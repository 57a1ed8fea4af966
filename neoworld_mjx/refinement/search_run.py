"""One run of a search: its inputs, and its progress and results."""

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from ..config import RefineOptions
from ..physics.layout import Layout
from ..physics.model import SceneModel
from ..physics.scene_arrays import SceneArrays
from .algorithm import Problem, SearchState
from .finishing import Finished
from .rounds import Round


class SearchRun(NamedTuple):
    """One refinement of a scene."""

    options: RefineOptions
    seed: int
    start: Layout | None = None
    """Pop axis of length 1; None is the composed scene."""


class FirstValid(NamedTuple):
    """When a search found its first valid candidate."""

    iteration: int
    """Counted from 1; 0 is the initial layout."""
    rollouts: int
    """Candidates that had been rolled out by the end of this iteration, which draws a whole
    population at once."""


@dataclass
class SearchResult:
    """Progress and results of a run's search, before the exact check of its winner."""

    run: SearchRun
    problem: Problem
    state: SearchState
    scene: SceneModel
    """The scene of the candidates, in which objects may be held; see `finishing.held`."""
    arrays: SceneArrays
    """Its arrays, padded or not."""
    padded: SceneArrays
    """Its padded arrays."""
    initial: Finished
    """The initial layout at rest, with its final check."""
    accept_initial: bool
    """True if the initial layout is the result if it passes."""
    rounds: list[Round] = field(default_factory=list)
    rollouts: int = 0
    """Number of candidates that were rolled out, kept or not."""
    summaries: list[dict[str, Any]] = field(default_factory=list)
    """Summary of each iteration; see `outcome.iteration_summary`."""
    first_valid_s: float = float("nan")
    """Time from the start of the search to the score of the first valid candidate [s]."""
    first_valid: FirstValid | None = None
    """None if no candidate was valid."""
    marks: list[np.ndarray] = field(default_factory=list)
    """Source of each S_sem, by iteration; see `scorer.Mark`."""
    stuck: tuple[str, ...] = ()
    """Objects that rested in no candidate, if that ended the search."""
    finished: bool = False
