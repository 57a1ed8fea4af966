"""Step 5: CEM-based scene refinement (paper Section 3.3, Algorithm 1)."""

from .cem import open_cem
from .optimizer import OPTIMIZERS, Optimizer
from .rewards import Term
from .scene_refinement import refine

__all__ = [
    "OPTIMIZERS",
    "Optimizer",
    "Term",
    "open_cem",
    "refine",
]
