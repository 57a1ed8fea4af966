"""Step 3, object-level physics (paper Section 3.2): scenarios, verdicts, restricted edits."""

from .patch import Patch, apply, overlay_path, read_overlay, write_overlay
from .repairs import Repaired, repair
from .verification import VerificationResult, verify_and_repair

__all__ = [
    "Patch",
    "Repaired",
    "VerificationResult",
    "apply",
    "overlay_path",
    "read_overlay",
    "repair",
    "verify_and_repair",
    "write_overlay",
]
