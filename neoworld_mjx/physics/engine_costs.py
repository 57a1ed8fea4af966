"""What rollouts cost on this machine, by engine, as measured; kept beside the compile cache.

Batched engines cost much before the first candidate and little for each further one, `native` the
other way round, and all of them depend on the scene. So a cost is a table of (candidates, seconds)
for each class of scenes, filled by what was really rolled out. Until then tables that were measured
on one machine stand in.
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
"""Seconds are those of so many steps; other lengths count in proportion."""
NEW_WEIGHT = 0.3
"""Of a new measurement beside the one that a table holds."""
MOST_SIZES = 32
"""Most numbers of candidates that a table holds."""


@dataclass
class EngineCost:
    """Cost of one engine's rollouts."""

    start_s: float
    """What the first rollout of a scene costs beyond later ones: compiling, capturing graphs."""
    prior: tuple[tuple[int, float], ...]
    """(candidates, seconds) of classes without measurements."""
    tables: dict[str, dict[int, float]] = field(default_factory=dict)
    """Measured seconds by class of scenes and number of candidates."""

    def predict(self, scenes: str, candidates: int, steps: int, *, started: bool) -> float:
        """Predict a rollout's seconds, linearly between sizes and in proportion beyond them.

        Args:
            scenes: class of the scene, by `scene_class`.
            candidates: number of candidates.
            steps: of the simulation.
            started: whether the engine has rolled this scene out before.
        """
        table = self.tables.get(scenes) or dict(self.prior)
        sizes = sorted(table)
        predicted = float(np.interp(candidates, sizes, [table[size] for size in sizes]))
        predicted *= max(candidates / sizes[-1], 1.0) * steps / COST_STEPS
        return predicted + (0.0 if started else self.start_s)

    def add(
        self, scenes: str, candidates: int, steps: int, seconds: float, *, started: bool
    ) -> None:
        """Take in a measurement: of a first rollout, as the cost of starting.

        A machine's first rollout of a class also compiles what the disk then keeps: minutes of
        kernels, which no later start costs. So it only counts where it was cheaper than thought.
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
    """Return the class of scenes that cost alike: powers of two of objects and convex pieces."""
    most = [1 << max(count - 1, 0).bit_length() for count in (objects, pieces)]
    return f"{most[0]} objects, {most[1]} pieces{', early stop' if early_stop else ''}"


def prior_costs(cores: int) -> dict[str, EngineCost]:
    """Return costs of six objects on an H200, and of `native` on that many cores of its host."""
    one = 1 / 31.0
    native = tuple((n, one * math.ceil(n / cores)) for n in (1, cores, 4096))
    return {
        "native": EngineCost(0.05, native),
        "warp": EngineCost(12.0, ((1, 0.5), (64, 0.5), (1024, 0.71), (4096, 1.38))),
        "mjx": EngineCost(16.0, ((4096, 2.06),)),
    }


def read_costs(machine: str, cores: int) -> dict[str, EngineCost]:
    """Return the costs kept for a machine; priors stand in for what is missing or broken."""
    costs = prior_costs(cores)
    kept = _kept().get(machine)
    for name, row in kept.items() if isinstance(kept, dict) else ():
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
    """Keep a machine's costs; where the folder cannot be written, they are measured again."""
    row = {name: {"start_s": cost.start_s, "tables": cost.tables} for name, cost in costs.items()}
    path = cache_folder() / COST_FILE
    part = path.with_name(f"{COST_FILE}.{os.getpid()}")
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        part.write_text(json.dumps({**_kept(), machine: row}, indent=1), encoding="utf-8")
        part.replace(path)


def _kept() -> dict[str, object]:
    try:
        kept = json.loads((cache_folder() / COST_FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    return kept if isinstance(kept, dict) else {}
