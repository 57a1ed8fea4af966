"""Processor time of a process with all that it started."""

import os
from pathlib import Path


def processor_s(pid: int) -> float:
    """Return the processor time [s] of a process and its descendants, ended ones included.

    It does not grow while the process waits for a core. 0 where the system has no /proc.
    """
    ticks, left = 0, [pid]
    while left:
        folder = Path(f"/proc/{left.pop()}")
        try:
            # User and system time, then those of the children that have been waited for.
            fields = (folder / "stat").read_text(encoding="ascii", errors="replace")
            ticks += sum(map(int, fields.rpartition(")")[2].split()[11:15]))
            for thread in (folder / "task").iterdir():
                left += map(int, (thread / "children").read_text(encoding="ascii").split())
        except OSError:  # It has just ended.
            continue
    return ticks / os.sysconf("SC_CLK_TCK")
