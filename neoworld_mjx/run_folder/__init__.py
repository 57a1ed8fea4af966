"""Run folder: locked, written atomically step by step, and resumable by content hashes."""

from .open_folder import STEPS, Mode, RunFolder
from .run_json import (
    CAMERA_NOTE,
    FORMAT,
    Result,
    read_run,
    run_options,
    step_times,
    verdict_line,
    versions,
)
from .staging import LOCK, lock_folder, refuse_links

__all__ = [
    "CAMERA_NOTE",
    "FORMAT",
    "LOCK",
    "STEPS",
    "Mode",
    "Result",
    "RunFolder",
    "lock_folder",
    "read_run",
    "refuse_links",
    "run_options",
    "step_times",
    "verdict_line",
    "versions",
]
