"""Sweeps over the options of the search, and ablations."""

from .cases import Case, Source
from .plan import Ablation, Plan
from .run import SweepResult, ablate, sweep

__all__ = ["Ablation", "Case", "Plan", "Source", "SweepResult", "ablate", "sweep"]
