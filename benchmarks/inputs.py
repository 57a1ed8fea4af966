"""Generated hostile inputs, read in a separate process that may hang or crash."""

import json
import logging
import os
import queue
import subprocess
import sys
import threading
from collections import Counter
from typing import IO, Any

from neoworld_bench.machine import machine

from benchmarks.suites import Inputs

log = logging.getLogger(__name__)

HANG_S = 120.0
"""Wall time after which an input counts as a hang, with a margin for busy machines."""


def run_suite(options: Inputs) -> dict[str, Any]:
    """Read the inputs of consecutive seeds and count those that were contained."""
    outcomes: list[dict[str, Any]] = []
    end = options.seed + options.count
    seed = options.seed
    while seed < end:
        for outcome in _outcomes(seed, end - seed):
            outcomes.append(outcome)
            seed = outcome["seed"] + 1
            if outcome["wrong"]:
                log.warning("seed %d, %s: %s", seed - 1, outcome["kind"], outcome["wrong"])
    kinds = Counter(outcome["kind"] for outcome in outcomes)
    good = Counter(outcome["kind"] for outcome in outcomes if not outcome["wrong"])
    return {
        "machine": machine(),
        "passed": good == kinds,
        "inputs": len(outcomes),
        "contained": good.total(),
        "by_kind": [{"kind": k, "n": n, "contained": good[k]} for k, n in sorted(kinds.items())],
        "read_without_error": sum(outcome["outcome"] == "read" for outcome in outcomes),
        "slowest_s": max(outcome["seconds"] for outcome in outcomes),
        "most_grown_mb": max(outcome["grown_mb"] for outcome in outcomes),
        "wrong": [outcome for outcome in outcomes if outcome["wrong"]],
    }


def _outcomes(first: int, count: int) -> list[dict[str, Any]]:
    """Run a process and return its outcomes; if it hangs or crashes, the last one records that."""
    command = [sys.executable, "-m", "tests.support.hostile_inputs", str(first), str(count)]
    outcomes: list[dict[str, Any]] = []
    streams: Any = {"stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}  # As the command line sets it.
    with subprocess.Popen(command, env=environment, **streams) as process:
        assert process.stdout is not None
        lines: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        threading.Thread(target=_pump, args=(process.stdout, lines), daemon=True).start()
        while True:
            try:
                line = lines.get(timeout=HANG_S)
            except queue.Empty:
                process.kill()
                wrong = f"no result within {HANG_S:g} s"
                break
            if not line:
                wrong = f"the process ended with code {process.wait()}"
                break
            outcomes.append(json.loads(line))
    if len(outcomes) < count:
        lost = {"seed": first + len(outcomes), "kind": "unknown", "outcome": "lost"}
        outcomes.append({**lost, "seconds": 0.0, "grown_mb": 0.0, "wrong": wrong})
    return outcomes


def _pump(stream: IO[bytes], lines: "queue.SimpleQueue[bytes]") -> None:
    for line in stream:
        if line.startswith(b"{"):
            lines.put(line)
    lines.put(b"")
