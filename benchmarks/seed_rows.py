"""Rows of suites by seed: made in a process that may crash or hang, and kept as they come.

Shards of the seeds run side by side, each with a log of its own. A run of all seeds with the joined
logs makes only what is missing, and gives the whole result.
"""

import json
import logging
import os
import queue
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

from neoworld_mjx.io.names import plain_text
from tests.support.processor_time import processor_s

log = logging.getLogger(__name__)
Row = dict[str, Any]

HANG_S, WALL_S = 120.0, 1800.0
"""Processor time of a process and its children [s] after which a seed counts as a hang, and wall
time, which includes waiting for cores that others keep busy."""


def logged_rows(file: Path | None) -> list[Row]:
    """Return the rows of a log; a torn line of an interrupted run is skipped."""
    rows = []
    if file is not None and file.is_file():
        for line in file.read_text(encoding="utf-8").splitlines():
            with suppress(ValueError):
                rows.append(json.loads(line))
    return rows


def log_row(file: Path | None, row: Row) -> None:
    """Append a row to a log, on a line of its own even behind a torn one."""
    if file is not None:
        with file.open("a", encoding="utf-8") as stream:
            stream.write(f"\n{json.dumps(row)}\n")


def rows_of_seeds(
    module: str, seeds: range, words: Sequence[str] = (), file: Path | None = None
) -> list[Row]:
    """Return the row of every seed: that of the log, or else a new one.

    Args:
        module: `python -m MODULE FIRST COUNT WORDS` prints one JSON line for each seed in order,
            with "seed" and "wrong", which is empty for a good outcome.
        seeds: consecutive seeds.
        words: further arguments of the module.
        file: the log.
    """
    rows = {row["seed"]: row for row in logged_rows(file)}
    while missing := [seed for seed in seeds if seed not in rows]:
        first = missing[0]
        count = next((k for k, seed in enumerate(missing) if seed != first + k), len(missing))
        command = [sys.executable, "-m", module, str(first), str(count), *words]
        for row in _made(command, first, count):
            rows[row["seed"]] = row
            log_row(file, row)
            level = logging.WARNING if row["wrong"] else logging.INFO
            log.log(level, "seed %d: %s", row["seed"], row["wrong"] or "contained")
    return [rows[seed] for seed in seeds]


def _made(command: list[str], first: int, count: int) -> Iterator[Row]:
    """Yield rows as a process prints them; if it crashes or hangs, the last one records that."""
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}  # As the command line sets it.
    lines: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    with (
        tempfile.TemporaryFile() as errors,
        subprocess.Popen(
            command, env=environment, stdout=subprocess.PIPE, stderr=errors, start_new_session=True
        ) as process,
    ):
        assert process.stdout is not None
        threading.Thread(target=_pump, args=(process.stdout, lines), daemon=True).start()
        try:
            for seed in range(first, first + count):
                line, wrong = _next(process.pid, lines)
                if not line:
                    if not wrong:
                        errors.seek(0)
                        said = plain_text(errors.read().decode("utf-8", "replace")[-400:], 400)
                        wrong = f"the process ended with code {process.wait()}: {said}"
                    yield {"seed": seed, "wrong": wrong}
                    return
                yield json.loads(line)
            process.wait()
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)


def _next(pid: int, lines: "queue.SimpleQueue[bytes]") -> tuple[bytes, str]:
    """Return the next line, empty at the end, and what is wrong if there is none in time."""
    began, used = time.monotonic(), processor_s(pid)
    while True:
        with suppress(queue.Empty):
            return lines.get(timeout=2.0), ""
        if processor_s(pid) - used > HANG_S:
            return b"", f"no result within {HANG_S:g} s of processor time"
        if time.monotonic() - began > WALL_S:
            return b"", f"no result within {WALL_S:g} s"


def _pump(stream: IO[bytes], lines: "queue.SimpleQueue[bytes]") -> None:
    for line in stream:
        if line.startswith(b"{"):
            lines.put(line)
    lines.put(b"")
