"""Step 4: deterministic scene composition (paper Section 3.3)."""

from .compose import Composed, compose

__all__ = ["Composed", "compose"]
