"""Task success by method and kind of task."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from neoworld_mjx.sweeps.intervals import Interval, ratio_interval

from ..tasks.success_runs import SuccessRow

SHARES: dict[str, Callable[[SuccessRow], bool]] = {
    "success_on_truth": lambda r: r.on_truth,
    "success_in_scene": lambda r: r.in_scene,
    "success_unaligned": lambda r: r.unaligned,
    "valid_rate": lambda r: r.valid,
}
"""Shares over tasks and initial scenes; the first is task success."""
PAPER = {
    "NeoWorld-Pro": 0.9285,
    "w/o S_sem": 0.4881,
    "w/o D_pen": 0.7647,
    "w/o D_drift": 0.8824,
    "w/o simul. (open-loop)": 0.4405,
}
"""Success of the paper's own tasks, which are not public, in its reconstructed scenes."""


def task_summary(rows: Sequence[SuccessRow]) -> dict[str, Any]:
    """Summarize rows by method: all of them, the evaluation half, and kinds of tasks."""
    return {
        "n": len(rows),
        "tasks": len({row.task for row in rows}),
        "starts": len({row.start for row in rows}),
        "methods": _figures(rows),
        "evaluation": _figures([row for row in rows if row.evaluation]),
        "kinds": {
            kind: _figures([row for row in rows if row.kind == kind])
            for kind in dict.fromkeys(row.kind for row in rows)
        },
        "failures": [
            f"{row.task} start {row.start} {row.label}: {row.reason}"
            for row in rows
            if not row.on_truth
        ],
        "paper": PAPER,
    }


def _figures(rows: Sequence[SuccessRow]) -> dict[str, Any]:
    return {method: success_figures(some) for method, some in _by_method(rows)}


def _by_method(rows: Sequence[SuccessRow]) -> Iterator[tuple[str, list[SuccessRow]]]:
    for label in dict.fromkeys(row.label for row in rows):
        yield label, [row for row in rows if row.label == label]


def success_figures(rows: Sequence[SuccessRow]) -> dict[str, Any]:
    """Return the shares of rows of one method, each with its interval.

    "no_plan" counts rows without a plan that could be carried out.
    """
    shares: dict[str, Any] = {}
    for name in SHARES:
        shares[name], low, high = success_interval(rows, name)
        shares[f"{name}_interval"] = [low, high]
    return {
        "n": len(rows),
        **shares,
        "no_plan": sum(row.reason.startswith("no ") for row in rows),
        "shift_m": float(np.median([row.shift_m for row in rows])),
        "seconds": float(np.median([row.seconds for row in rows])),
        "executing_s": float(np.median([row.executing_s for row in rows])),
    }


def success_interval(rows: Sequence[SuccessRow], share: str) -> Interval:
    """Return one of SHARES with its interval, clustered by task."""
    return ratio_interval([(row.task, float(SHARES[share](row)), 1.0) for row in rows], share=True)
