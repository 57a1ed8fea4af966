"""Sweeps and ablations of the options of the search."""

from .cases import Case, Source, case
from .merge import merge
from .plan import Ablation, Plan
from .result import SweepResult
from .run import ablate, sweep

__all__ = ["Ablation", "Case", "Plan", "Source", "SweepResult", "ablate", "case", "merge", "sweep"]
