"""Step 5: CEM-based scene refinement (paper Section 3.3, Algorithm 1)."""

from .cem import CEM, CEMState, open_cem
from .optimizer import OPTIMIZERS, Optimizer
from .rewards import Term
from .scene_refinement import Refined, refine

__all__ = [
    "CEM",
    "OPTIMIZERS",
    "CEMState",
    "Optimizer",
    "Refined",
    "Term",
    "open_cem",
    "refine",
]
