"""Sweeps and ablations of the options of the search."""

from .plan import Ablation, Plan
from .result import SweepResult
from .run import ablate, merge, sweep
from .runs import Case, case

__all__ = ["Ablation", "Case", "Plan", "SweepResult", "ablate", "case", "merge", "sweep"]
