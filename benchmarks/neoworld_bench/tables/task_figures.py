"""Task success by method and kind of task."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from neoworld_mjx.sweeps.intervals import Interval, ratio_interval

from ..methods.method_runs import by_method
from ..tasks.success_runs import SuccessRow

SHARES: dict[str, Callable[[SuccessRow], bool]] = {
    "success_on_truth": lambda r: r.on_truth,
    "success_in_scene": lambda r: r.in_scene,
    "success_unaligned": lambda r: r.unaligned,
    "valid_rate": lambda r: r.valid,
}
"""Shares over tasks and initial scenes; the first is task success."""
BINS = 5
"""Number of bins of predicted success."""
CERTAIN = 0.8
"""Share of the draws in which a plan has to succeed to be attempted."""
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
    return {method: success_figures(some) for method, some in by_method(rows)}


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
        **_reliability([row for row in rows if row.on_truths is not None]),
    }


def _reliability(rows: Sequence[SuccessRow]) -> dict[str, Any]:
    """Return how well success in draws predicts that in draws of the truth's physics.

    The error is the mean difference between the two over BINS of predicted success of equal width,
    weighted by their rows. Abstaining leaves out plans that succeed in fewer than CERTAIN of the
    draws. Nothing is returned without draws.
    """
    if not rows:
        return {}
    predicted = np.array([row.predicted for row in rows], float)
    truth = np.array([row.on_truths for row in rows], float)
    bins = np.minimum((predicted * BINS).astype(int), BINS - 1)
    diagram = [
        {
            "n": int(np.sum(bins == k)),
            "predicted": float(predicted[bins == k].mean()),
            "success": float(truth[bins == k].mean()),
        }
        for k in np.unique(bins)
    ]
    chosen = [(row.task, float(bool(row.chosen_on_truth)), 1.0) for row in rows]
    success, low, high = ratio_interval(chosen, share=True)
    certain = [row for row in rows if (row.chosen_predicted or 0.0) >= CERTAIN]
    return {
        "reliability": diagram,
        "reliability_error": float(
            sum(b["n"] * abs(b["predicted"] - b["success"]) for b in diagram) / len(rows)
        ),
        "success_of_chosen": success,
        "success_of_chosen_interval": [low, high],
        "attempted": len(certain) / len(rows),
        "success_of_attempted": (
            float(np.mean([bool(row.chosen_on_truth) for row in certain])) if certain else None
        ),
    }


def success_interval(rows: Sequence[SuccessRow], share: str) -> Interval:
    """Return one of SHARES with its interval, clustered by task."""
    return ratio_interval([(row.task, float(SHARES[share](row)), 1.0) for row in rows], share=True)
