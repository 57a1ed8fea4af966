"""Sweeps over the settings of the search, and ablations.

`neoworld_mjx.sweep` is this module, and may be called as the function `sweep` of it.
"""

import sys
from types import ModuleType
from typing import Any

from .cases import Case, Source
from .plan import Ablation, Plan
from .run import Swept, ablate, answer, sweep

__all__ = ["Ablation", "Case", "Plan", "Source", "Swept", "ablate", "answer", "sweep"]


class _Callable(ModuleType):
    def __call__(self, *args: Any, **kwargs: Any) -> Swept:
        return sweep(*args, **kwargs)


sys.modules[__name__].__class__ = _Callable
