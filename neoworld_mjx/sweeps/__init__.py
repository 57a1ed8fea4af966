"""Sweeps over the settings of the search, and ablations."""

from .cases import Case, Source
from .plan import Ablation, Plan
from .run import Swept, ablate, answer, sweep

__all__ = ["Ablation", "Case", "Plan", "Source", "Swept", "ablate", "answer", "sweep"]
