"""Measured costs of rollouts on this machine by engine, stored next to the compilation cache.

Batched engines have a large fixed cost and a small one per candidate, `native` the reverse, and all
depend on the scene. A cost is therefore a table of (candidates, seconds) for each class of scenes,
filled by actual rollouts. Initially, tables measured on one machine apply.
"""

import contextlib
import json
import math
import os
from dataclasses import dataclass, field

import numpy as np

from ..cache import cache_folder

COST_FILE = "engine-costs.json"
COST_STEPS = 250
"""Number of steps that the seconds in tables refer to; other rollouts cost proportionally."""
NEW_WEIGHT = 0.3
"""Weight of a new measurement in its average with the stored one."""
MOST_SIZES = 32
"""Largest number of entries of a table."""


@dataclass
class EngineCost:
    """Cost of one engine's rollouts."""

    start_s: float
    """Additional cost of the first rollout of a scene: compiling, capturing graphs [s]."""
    prior: tuple[tuple[int, float], ...]
    """(candidates, seconds) of classes without measurements."""
    tables: dict[str, dict[int, float]] = field(default_factory=dict)
    """Measured seconds by class of scenes and number of candidates."""

    def predict(self, scenes: str, candidates: int, steps: int, *, started: bool) -> float:
        """Return a rollout's predicted seconds, linear between sizes and proportional beyond."""
        table = self.tables.get(scenes) or dict(self.prior)
        sizes = sorted(table)
        predicted = float(np.interp(candidates, sizes, [table[size] for size in sizes]))
        predicted *= max(candidates / sizes[-1], 1.0) * steps / COST_STEPS
        return predicted + (0.0 if started else self.start_s)

    def add(
        self, scenes: str, candidates: int, steps: int, seconds: float, *, started: bool
    ) -> None:
        """Add a measurement; that of a scene's first rollout updates `start_s`.

        A machine's first rollout of a class may compile kernels for minutes, which are then cached.
        Its starting cost therefore counts only if it is below the prediction.
        """
        if not started:
            later = self.predict(scenes, candidates, steps, started=True)
            change = max(seconds - later, 0.0) - self.start_s
            self.start_s += (
                NEW_WEIGHT * change if scenes in self.tables else min(NEW_WEIGHT * change, 0.0)
            )
            return
        table = self.tables.setdefault(scenes, {})
        new = seconds * COST_STEPS / steps
        known = table.get(candidates, new)
        if candidates in table or len(table) < MOST_SIZES:
            table[candidates] = known + NEW_WEIGHT * (new - known)


def scene_class(objects: int, pieces: int, *, early_stop: bool) -> str:
    """Return the class of scenes of similar cost: powers of two of objects and convex pieces."""
    rounded = [1 << max(count - 1, 0).bit_length() for count in (objects, pieces)]
    return f"{rounded[0]} objects, {rounded[1]} pieces{', early stop' if early_stop else ''}"


def prior_costs(cores: int) -> dict[str, EngineCost]:
    """Return costs of six objects on an H200, and of `native` on `cores` cores of its host."""
    native = tuple((n, math.ceil(n / cores) / 31.0) for n in (1, cores, 4096))
    return {
        "native": EngineCost(0.05, native),
        "warp": EngineCost(12.0, ((1, 0.5), (64, 0.5), (1024, 0.71), (4096, 1.38))),
        "mjx": EngineCost(16.0, ((4096, 2.06),)),
    }


def read_costs(machine: str, cores: int) -> dict[str, EngineCost]:
    """Return the stored costs of a machine; missing or invalid ones are priors."""
    costs = prior_costs(cores)
    stored = _stored().get(machine)
    for name, row in stored.items() if isinstance(stored, dict) else ():
        with contextlib.suppress(AttributeError, TypeError, ValueError, KeyError):
            start = float(row["start_s"])
            tables = {
                str(scenes): {int(n): float(s) for n, s in list(table.items())[:MOST_SIZES]}
                for scenes, table in row["tables"].items()
            }
            numbers = [start, *(s for table in tables.values() for s in table.values())]
            sizes = [n for table in tables.values() for n in table]
            if all(map(math.isfinite, numbers)) and min(numbers) >= 0 and min([1, *sizes]) > 0:
                costs[name].start_s = start
                costs[name].tables = {key: table for key, table in tables.items() if table}
    return costs


def write_costs(machine: str, costs: dict[str, EngineCost]) -> None:
    """Store a machine's costs; if the folder cannot be written, they are measured again."""
    row = {name: {"start_s": cost.start_s, "tables": cost.tables} for name, cost in costs.items()}
    path = cache_folder() / COST_FILE
    part = path.with_name(f"{COST_FILE}.{os.getpid()}")
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        part.write_text(json.dumps({**_stored(), machine: row}, indent=1), encoding="utf-8")
        part.replace(path)


def _stored() -> dict[str, object]:
    try:
        stored = json.loads((cache_folder() / COST_FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    return stored if isinstance(stored, dict) else {}
