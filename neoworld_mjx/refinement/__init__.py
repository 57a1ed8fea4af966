"""Step 5: CEM-based scene refinement (paper Section 3.3, Algorithm 1)."""

from .cem import CEM, CEMParams, CEMState, open_cem
from .loop import Refined, refine

__all__ = ["CEM", "CEMParams", "CEMState", "Refined", "open_cem", "refine"]
