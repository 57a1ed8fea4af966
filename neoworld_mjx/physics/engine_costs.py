"""Measured costs of each engine's rollouts on this machine, stored next to the compilation cache.

Batched engines have a large fixed cost and a small cost per candidate; `native` has a small fixed
cost and a large cost per candidate. Both depend on the scene. The cost of an engine is therefore a
table of (candidates, seconds) for each class of scenes, which is filled by actual rollouts. Before
these, tables apply that were measured on another machine.
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
"""Number of steps of the rollouts in tables. The cost of a rollout is proportional to its steps."""
NEW_WEIGHT = 0.3
"""Weight of a new measurement in the average with the stored value."""
MAX_SIZES = 32
"""Largest number of entries of a table."""


@dataclass
class EngineCost:
    """Cost of one engine's rollouts."""

    start_s: float
    """Additional time of the first rollout of a scene, for compiling and capturing graphs [s]."""
    prior: tuple[tuple[int, float], ...]
    """(candidates, seconds) for classes of scenes without measurements."""
    tables: dict[str, dict[int, float]] = field(default_factory=dict)
    """Measured seconds by class of scenes and number of candidates."""

    def predict(self, cost_class: str, candidates: int, steps: int, *, started: bool) -> float:
        """Return the predicted time of a rollout [s].

        The time is linear between the numbers of candidates in the table, and proportional beyond
        the largest one.
        """
        table = self.tables.get(cost_class) or dict(self.prior)
        sizes = sorted(table)
        predicted = float(np.interp(candidates, sizes, [table[size] for size in sizes]))
        predicted *= max(candidates / sizes[-1], 1.0) * steps / COST_STEPS
        return predicted + (0.0 if started else self.start_s)

    def add(
        self, cost_class: str, candidates: int, steps: int, seconds: float, *, started: bool
    ) -> None:
        """Add a measurement. A scene's first rollout updates `start_s` instead of the table.

        The first rollout of a class on a machine may compile kernels for minutes, but these are
        then cached. Such a rollout can therefore only decrease `start_s`.
        """
        if not started:
            without_start = self.predict(cost_class, candidates, steps, started=True)
            change = max(seconds - without_start, 0.0) - self.start_s
            self.start_s += (
                NEW_WEIGHT * change if cost_class in self.tables else min(NEW_WEIGHT * change, 0.0)
            )
            return
        table = self.tables.setdefault(cost_class, {})
        new = seconds * COST_STEPS / steps
        stored = table.get(candidates, new)
        if candidates in table or len(table) < MAX_SIZES:
            table[candidates] = stored + NEW_WEIGHT * (new - stored)


def scene_class(objects: int, pieces: int, *, early_stop: bool) -> str:
    """Return the class of scenes of similar cost: powers of two of objects and convex pieces."""
    rounded = [1 << max(count - 1, 0).bit_length() for count in (objects, pieces)]
    return f"{rounded[0]} objects, {rounded[1]} pieces{', early stop' if early_stop else ''}"


def prior_costs(cores: int) -> dict[str, EngineCost]:
    """Return the costs that apply before any measurement on this machine.

    They were measured with six objects on an H200. The costs of `native` were measured on its host
    and are converted to `cores` cores.
    """
    native = tuple((n, math.ceil(n / cores) / 31.0) for n in (1, cores, 4096))
    return {
        "native": EngineCost(0.05, native),
        "warp": EngineCost(12.0, ((1, 0.5), (64, 0.5), (1024, 0.71), (4096, 1.38))),
        "mjx": EngineCost(16.0, ((4096, 2.06),)),
    }


def read_costs(machine: str, cores: int) -> dict[str, EngineCost]:
    """Return the stored costs of a machine; missing or invalid costs are replaced by priors."""
    costs = prior_costs(cores)
    stored = _read_cost_file().get(machine)
    for name, row in stored.items() if isinstance(stored, dict) else ():
        with contextlib.suppress(AttributeError, TypeError, ValueError, KeyError):
            start = float(row["start_s"])
            tables = {
                str(scenes): {int(n): float(s) for n, s in list(table.items())[:MAX_SIZES]}
                for scenes, table in row["tables"].items()
            }
            seconds = [start, *(s for table in tables.values() for s in table.values())]
            sizes = [n for table in tables.values() for n in table]
            if all(map(math.isfinite, seconds)) and min(seconds) >= 0 and min([1, *sizes]) > 0:
                costs[name].start_s = start
                costs[name].tables = {key: table for key, table in tables.items() if table}
    return costs


def write_costs(machine: str, costs: dict[str, EngineCost]) -> None:
    """Store a machine's costs. If the folder is not writable, nothing is stored."""
    row = {name: {"start_s": cost.start_s, "tables": cost.tables} for name, cost in costs.items()}
    path = cache_folder() / COST_FILE
    part = path.with_name(f"{COST_FILE}.{os.getpid()}")
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        part.write_text(json.dumps({**_read_cost_file(), machine: row}, indent=1), encoding="utf-8")
        part.replace(path)


def _read_cost_file() -> dict[str, object]:
    try:
        stored = json.loads((cache_folder() / COST_FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    return stored if isinstance(stored, dict) else {}
