"""Step 3, object-level physics (paper Section 3.2): object tests and repairs."""

from .patch import Patch
from .verification import VerificationResult, verify_and_repair

__all__ = ["Patch", "VerificationResult", "verify_and_repair"]
