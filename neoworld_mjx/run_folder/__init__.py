"""Run folder: locked, written atomically step by step, and resumable by content hashes."""

from .open_folder import STEPS, Mode, RunFolder
from .run_json import FORMAT, read_run, versions
from .run_result import Result
from .staging import LOCK, lock_folder, refuse_links

__all__ = [
    "FORMAT",
    "LOCK",
    "STEPS",
    "Mode",
    "Result",
    "RunFolder",
    "lock_folder",
    "read_run",
    "refuse_links",
    "versions",
]
