"""Step 3, object-level physics (paper Section 3.2): object tests and repairs."""

from .patch import Patch
from .verification import verify_and_repair

__all__ = ["Patch", "verify_and_repair"]
