"""Inputs, progress and results of one run of a search."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ..config import RefineOptions
from ..physics.layout import Layout
from ..physics.model import SceneModel
from ..physics.scene_arrays import SceneArrays
from .algorithm import Problem, SearchState
from .finishing import Finished
from .rounds import Round


class SearchRun(NamedTuple):
    """Inputs of one refinement of a scene."""

    options: RefineOptions
    seed: int
    start: Layout | None = None
    """Initial layout, with a population axis of length 1. If None, it is the composed scene."""


class TimeToValid(NamedTuple):
    """When a search found its first valid candidate."""

    iteration: int
    """Iteration that contains the candidate, counted from 1; 0 is the initial layout."""
    rollouts: int
    """Number of candidates that were rolled out up to and including this iteration."""


@dataclass
class SearchResult:
    """Progress and results of a run's search, before the final check of its winner."""

    run: SearchRun
    problem: Problem
    state: SearchState
    scene: SceneModel
    """Scene that is searched, in which some objects may be fixed.

    See `finishing.with_resting_fixed`.
    """
    arrays: SceneArrays
    """Arrays of the scene that terms and optimizers receive, padded or not."""
    padded: SceneArrays
    """Padded arrays of the scene."""
    initial: Finished
    """Final scene of the initial layout, with its final check."""
    accept_initial: bool
    """If True, the initial layout is the result if it passes the final check."""
    rounds: list[Round] = field(default_factory=list)
    rollouts: int = 0
    """Number of candidates that were rolled out."""
    first_valid_s: float = float("nan")
    """Time from the start of the search to the score of the first valid candidate [s]."""
    first_valid: TimeToValid | None = None
    """When the search found its first valid candidate; None if no candidate was valid."""
    score_sources: list[np.ndarray] = field(default_factory=list)
    """Source of each candidate's S_sem, by iteration; see `scorer.Mark`."""
    stuck: tuple[str, ...] = ()
    """Names of objects that rested in no candidate, if the search ended for this reason."""
    finished: bool = False
    """True if the search has ended."""
