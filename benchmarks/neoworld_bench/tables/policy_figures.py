"""Success of policies by where they were trained, and how well scenes predict it.

Pearson's correlation and the mean maximum rank violation (MMRV) are computed over policies, between
success in draws of the own scene and in the ground truth, as SIMPLER (Li et al., CoRL 2024) and
SimFoundry do between simulation and reality. Calibration is the difference of the two.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from neoworld_mjx.environments.trials import wilson
from neoworld_mjx.sweeps.intervals import mean

from ..tasks.policy_runs import PolicyResult, PolicyRow


def mean_maximum_rank_violation(
    truth: Float[np.ndarray, " policy"], predicted: Float[np.ndarray, " policy"]
) -> float:
    """Return the MMRV of Li et al., 2024: 0 if the predictions rank policies as the truth does.

    The violation of a pair is the difference of the true rates if the predicted rates order it
    otherwise; the result is the mean over policies of the largest violation.
    """
    apart = np.abs(truth[:, None] - truth)
    otherwise = (predicted[:, None] < predicted) != (truth[:, None] < truth)
    return float(np.mean(np.max(apart * otherwise, axis=1)))


def policy_summary(rows: Sequence[PolicyRow]) -> dict[str, Any]:
    """Summarize rows by where policies were trained; all snapshots count for the agreement."""
    methods = list(dict.fromkeys(row.method for row in rows))
    return {
        "n": len(rows),
        "tasks": sorted({row.task for row in rows}),
        "methods": {m: _figures([row for row in rows if row.method == m]) for m in methods},
        "kinds": {
            kind: {
                m: _figures([r for r in rows if r.method == m and r.kind == kind]) for m in methods
            }
            for kind in dict.fromkeys(row.kind for row in rows)
        },
        "agreement": {
            m: _agreement([r for row in rows if row.method == m for r in row.results])
            for m in methods
            if m != "plan"
        },
        "failures": [f"{r.task} start {r.start} {r.method}: {r.reason}" for r in rows if r.reason],
    }


def _figures(rows: Sequence[PolicyRow]) -> dict[str, Any]:
    """Return the mean success of trained policies, with its interval over tasks.

    Rows without a policy count as failures; `episodes` are all episodes together, with Wilson's
    interval.
    """
    figures: dict[str, Any] = {"n": len(rows), "no_policy": sum(not r.results for r in rows)}
    for name, count in (("on_truth", "truth_n"), ("unaligned", "truth_n"),
                        ("predicted", "predicted_n")):  # fmt: skip
        ends = [row.results[-1] if row.results else None for row in rows]
        hits = [getattr(end, name) if end else 0 for end in ends]
        counts = [getattr(end, count) if end else 0 for end in ends]
        rates = [a / max(b, 1) for a, b in zip(hits, counts, strict=True)]
        own = mean(rates, [row.task for row in rows])
        figures[name] = float(np.mean(rates)) if rates else None
        figures[f"{name}_interval"] = [max(own.low, 0.0), min(own.high, 1.0)]
        figures[f"{name}_episodes"] = [sum(hits), sum(counts), *wilson(sum(hits), sum(counts))]
    return figures


def _agreement(results: Sequence[PolicyResult]) -> dict[str, Any]:
    """Return how well success in the own scene predicts that in the ground truth."""
    ran = [r for r in results if r.truth_n and r.predicted_n]
    truth = np.array([r.on_truth / r.truth_n for r in ran])
    predicted = np.array([r.predicted / r.predicted_n for r in ran])
    if len(ran) < 3 or not truth.std() or not predicted.std():
        return {"n": len(ran)}
    return {
        "n": len(ran),
        "pearson": float(np.corrcoef(truth, predicted)[0, 1]),
        "mmrv": mean_maximum_rank_violation(truth, predicted),
        "calibration": float(np.mean(predicted - truth)),
        "calibration_abs": float(np.mean(np.abs(predicted - truth))),
    }
