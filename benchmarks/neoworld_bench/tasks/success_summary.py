"""Task success by method and kind of task, alongside the paper's."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from neoworld_mjx.sweeps.intervals import ratio_interval

from .success_runs import SuccessRow

SHARES: dict[str, Callable[[SuccessRow], bool]] = {
    "success_on_truth": lambda r: r.on_truth,
    "success_in_scene": lambda r: r.in_scene,
    "success_unaligned": lambda r: r.unaligned,
    "valid_rate": lambda r: r.valid,
}
"""Shares over tasks and starts; the first is task success."""
PAPER = {
    "NeoWorld-Pro": 0.9285,
    "w/o S_sem": 0.4881,
    "w/o D_pen": 0.7647,
    "w/o D_drift": 0.8824,
    "w/o simul. (open-loop)": 0.4405,
}
"""Success of the paper's own tasks, which are not public."""
OF_THE_PAPER = (
    "of the paper's own scenes and tasks: a model's end-effector start and displacement, carried "
    "out in the reconstructed scene in Isaac Sim, as far as it says; nearer to success_in_scene"
)


def success_summary(rows: Sequence[SuccessRow]) -> dict[str, Any]:
    """Summarize rows: all starts by method, the evaluation half apart, kinds of tasks, the
    paper."""
    return {
        "tasks": len({row.task for row in rows}),
        "starts": len({row.start for row in rows}),
        "methods": _by_method(rows),
        "evaluation": _by_method([row for row in rows if row.evaluation]),
        "kinds": {
            kind: _by_method([row for row in rows if row.kind == kind])
            for kind in dict.fromkeys(row.kind for row in rows)
        },
        "paper": {"success": PAPER, "measures": OF_THE_PAPER},
    }


def _by_method(rows: Sequence[SuccessRow]) -> dict[str, Any]:
    names = dict.fromkeys(row.method for row in rows)
    return {name: success_figures([row for row in rows if row.method == name]) for name in names}


def success_figures(rows: Sequence[SuccessRow]) -> dict[str, Any]:
    """Return the shares of rows of one method, each with its interval, clustered by task.

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


def success_interval(
    rows: Sequence[SuccessRow], share: str
) -> tuple[float | None, float | None, float | None]:
    """Return one of SHARES with its interval, clustered by task."""
    return ratio_interval([(row.task, float(SHARES[share](row)), 1.0) for row in rows], share=True)
