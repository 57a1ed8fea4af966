"""Generated hostile inputs, read in a separate process that may hang or crash."""

from collections import Counter
from typing import Any

from neoworld_bench.machine import machine

from benchmarks.seed_rows import rows_of_seeds
from benchmarks.suites import Inputs


def run_suite(options: Inputs) -> dict[str, Any]:
    """Read the inputs of consecutive seeds and count those that were contained."""
    seeds = range(options.seed, options.seed + options.count)
    rows = rows_of_seeds("tests.support.hostile_inputs", seeds, file=options.log)
    kinds = Counter(row.get("kind", "lost") for row in rows)
    good = Counter(row.get("kind", "lost") for row in rows if not row["wrong"])
    seconds = [row.get("seconds", 0.0) for row in rows]
    wait = sum(row.get("wall_s", 0.0) for row in rows) / max(sum(seconds), 1e-9)
    figures = {
        "contained": f"{good.total()} of {len(rows)}",
        "read without an error": str(sum(row.get("outcome") == "read" for row in rows)),
        "the most processor time": f"{max(seconds):.1f} s",
        "the most memory grown": f"{max(row.get('grown_mb', 0.0) for row in rows):.0f} MB",
        "wall time / processor time": f"{wait:.1f}",
    }
    return {
        "machine": machine(),
        "n": f"{len(rows)} generated inputs of {len(kinds)} kinds, "
        f"{min(kinds.values())} to {max(kinds.values())} of each",
        "passed": good == kinds,
        "table": [{"figure": name, "value": value} for name, value in figures.items()],
        "by_kind": [{"kind": k, "n": n, "contained": good[k]} for k, n in sorted(kinds.items())],
        "wrong": [row for row in rows if row["wrong"]],
    }
