"""Step 3, object-level physics (paper Section 3.2): scenarios, verdicts, restricted edits."""

from ..checks.object_tests import VERSION, Battery
from ..checks.verdict import Check, Fault, Verdict
from .patch import Patch, apply, overlay_path, read_overlay, write_overlay
from .repairs import Repaired, repair
from .verification import VerificationResult, verify_and_repair

__all__ = [
    "VERSION",
    "Battery",
    "Check",
    "Fault",
    "Patch",
    "Repaired",
    "Verdict",
    "VerificationResult",
    "apply",
    "overlay_path",
    "read_overlay",
    "repair",
    "verify_and_repair",
    "write_overlay",
]
