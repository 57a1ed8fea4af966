"""Faults injected into runs of an example at random moments, and the resumed runs after them."""

import json
import logging
import subprocess
import sys
from collections import Counter
from typing import Any

from neoworld_bench.machine import machine

from benchmarks.suites import Faults

log = logging.getLogger(__name__)


def run_suite(options: Faults) -> dict[str, Any]:
    """Inject the faults of consecutive seeds into runs, and count those that were contained."""
    command = [sys.executable, "-m", "tests.faults.strikes", str(options.seed), str(options.count)]
    command += [options.until, options.photo]
    struck: list[dict[str, Any]] = []
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        for line in process.stdout:
            row = json.loads(line)
            struck.append(row)
            log.info("%d %s: %s", row["seed"], row["fault"], row["wrong"] or "contained")
    kinds = Counter(row["fault"] for row in struck)
    good = Counter(row["fault"] for row in struck if not row["wrong"])
    return {
        "machine": machine(),
        "passed": len(struck) == options.count and good == kinds,
        "faults": len(struck),
        "contained": good.total(),
        "by_kind": [{"kind": k, "n": n, "contained": good[k]} for k, n in sorted(kinds.items())],
        "struck": struck,
    }
