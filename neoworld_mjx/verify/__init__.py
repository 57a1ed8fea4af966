"""Step 3: object-level physics (paper Section 3.2): scenarios, numeric verdicts, restricted edits."""

from .battery import VERSION, Battery, verify
from .patch import Patch, apply, overlay_path, read_overlay, write_overlay
from .repairs import Repaired, repair
from .sound import Sound, make_sound
from .verdict import Check, Fault, Verdict

__all__ = [
    "VERSION",
    "Battery",
    "Check",
    "Fault",
    "Patch",
    "Repaired",
    "Sound",
    "Verdict",
    "apply",
    "make_sound",
    "overlay_path",
    "read_overlay",
    "repair",
    "verify",
    "write_overlay",
]
