"""Step 5: CEM-based scene refinement (paper Section 3.3, Algorithm 1).

`neoworld_mjx.refine` is this module, and may be called as the function `refine` of it.
"""

import sys
from types import ModuleType
from typing import Any

from .cem import CEM, CEMParams, CEMState, open_cem
from .loop import Refined, refine

__all__ = ["CEM", "CEMParams", "CEMState", "Refined", "open_cem", "refine"]


class _Callable(ModuleType):
    def __call__(self, *args: Any, **kwargs: Any) -> Refined:
        return refine(*args, **kwargs)


sys.modules[__name__].__class__ = _Callable
