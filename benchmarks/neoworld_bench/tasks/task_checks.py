"""Checks of the tasks on truth: reference plans, waiting, and plans in displaced scenes."""

import math
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from ..rows import Row
from .execution import execute, wait
from .task import ManipulationTask

DISPLACED_SHARE = 0.1
"""Largest share of displaced runs in which a plan may still succeed."""


class TaskRow(Row):
    """One task on truth."""

    task: str
    kind: str
    reference: bool
    """True if the reference plan succeeds."""
    reason: str
    """Why not; empty if it does."""
    waiting: bool
    """True if success is there after 2 s without a plan."""
    drift_mm: float
    """Farthest that an object moves in the 2 s without a plan."""
    displaced: int
    """In how many directions, each half a size away, the plan still succeeds."""
    directions: int
    lag_mm: float
    """Farthest that the tool stayed behind the plan."""
    simulated_s: float
    wall_s: float


def check_tasks(tasks: Sequence[ManipulationTask], directions: int) -> Iterator[TaskRow]:
    """Check each task on truth.

    Args:
        tasks: what to check.
        directions: directions, evenly about a first one that is drawn by the task's name, in
            which the object concerned is displaced.
    """
    for task in tasks:
        start = time.monotonic()
        outcome = execute(task.scene, task.plan, task.predicate)
        displaced_count = sum(
            execute(task.displaced(heading), task.plan, task.predicate).success
            for heading in _headings(task.name, directions)
        )
        waiting = wait(task.scene, task.predicate)
        yield TaskRow(
            task=task.name,
            kind=task.kind,
            reference=outcome.success,
            reason=outcome.reason,
            waiting=waiting.success,
            drift_mm=1000 * waiting.drift_m,
            displaced=displaced_count,
            directions=directions,
            lag_mm=1000 * outcome.lag_m,
            simulated_s=outcome.seconds,
            wall_s=time.monotonic() - start,
        )


def _headings(name: str, directions: int) -> list[float]:
    first = float(np.random.default_rng(list(name.encode())).uniform(0, 2 * math.pi))
    return [first + 2 * math.pi * k / directions for k in range(directions)]


def summarised(rows: Sequence[TaskRow]) -> dict[str, Any]:
    """Return the figures of the checks, and whether they hold."""
    runs = sum(row.directions for row in rows)
    displaced = sum(row.displaced for row in rows)
    share = displaced / runs if runs else None
    reference = sum(row.reference for row in rows)
    waiting = sum(row.waiting for row in rows)
    return {
        "tasks": len(rows),
        "kinds": dict(sorted(Counter(row.kind for row in rows).items())),
        "reference_succeeds": reference,
        "true_without_a_plan": waiting,
        "largest_drift_mm": max((row.drift_mm for row in rows), default=0.0),
        "displaced_succeeds": displaced,
        "displaced_runs": runs,
        "displaced_share": share,
        "passed": reference == len(rows)
        and waiting == 0
        and (share is None or share <= DISPLACED_SHARE),
        "missed": [
            f"{row.task}: {row.reason or 'true without a plan'}"
            for row in rows
            if row.waiting or not row.reference
        ],
        "succeeds_displaced": {row.task: row.displaced for row in rows if row.displaced},
        "table": [_of_kind(kind, rows) for kind in (*dict.fromkeys(r.kind for r in rows), "all")],
    }


def _of_kind(kind: str, rows: Sequence[TaskRow]) -> dict[str, Any]:
    """Return the figures of a kind of tasks, or of "all"."""
    chosen = [row for row in rows if kind in (row.kind, "all")]
    return {
        "kind": kind,
        "tasks": len(chosen),
        "reference_succeeds": sum(row.reference for row in chosen),
        "true_without_a_plan": sum(row.waiting for row in chosen),
        "displaced_succeeds": sum(row.displaced for row in chosen),
        "displaced_runs": sum(row.directions for row in chosen),
        "largest_drift_mm": max((row.drift_mm for row in chosen), default=0.0),
    }
