"""Step 3: object-level physics (paper Section 3.2): scenarios and numeric verdicts."""

from .battery import Check, Verdict, verify

__all__ = ["Check", "Verdict", "verify"]
