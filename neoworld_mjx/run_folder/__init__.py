"""A run folder: written step by step and atomically, locked, resumable by content hashes."""

from .open_folder import STEPS, RunFolder
from .run_json import FORMAT, read_run, versions

__all__ = ["FORMAT", "STEPS", "RunFolder", "read_run", "versions"]
