"""Faults injected into runs of an example at random moments, and the resumed runs after them."""

from collections import Counter
from typing import Any

from neoworld_bench.machine import machine

from benchmarks.seed_rows import rows_of_seeds
from benchmarks.suites import Faults


def run_suite(options: Faults) -> dict[str, Any]:
    """Inject the faults of consecutive seeds into runs, and count those that were contained."""
    seeds = range(options.seed, options.seed + options.count)
    words = (options.until, options.photo)
    rows = rows_of_seeds("tests.faults.strikes", seeds, words, options.log)
    kinds = Counter(row.get("fault", "lost") for row in rows)
    good = Counter(row.get("fault", "lost") for row in rows if not row["wrong"])
    moments = {(row.get("fault", "lost"), row.get("moment", "")) for row in rows}
    photos = Counter(row.get("photo", options.photo) for row in rows)
    places = Counter(fault for fault, _ in moments)
    return {
        "machine": machine(),
        "n": f"{len(rows)} faults of {len(kinds)} kinds: "
        + ", ".join(f"{n} in {photo}" for photo, n in sorted(photos.items())),
        "passed": good == kinds,
        "table": [
            {"fault": k, "n": n, "moments": places[k], "contained": good[k]}
            for k, n in sorted(kinds.items())
        ],
        "rows": rows,
    }
