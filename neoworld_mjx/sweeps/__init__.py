"""Sweeps and ablations of the options of the search."""

from .plan import Plan
from .run import ablate, merge, sweep
from .runs import Case, case

__all__ = ["Case", "Plan", "ablate", "case", "merge", "sweep"]
