"""Figures of methods on the thirty scenes: means with intervals, and differences."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from neoworld_mjx.sweeps.intervals import Interval, mean, ratio_interval

from ..methods.method_runs import by_method
from ..methods.scene_runs import SceneRow


class Measure(NamedTuple):
    """Measure of a row, as a mean over scenes and initial scenes."""

    value: Callable[[SceneRow], float]
    share: bool = True
    """True for shares of scenes or objects."""
    weight: Callable[[SceneRow], int] = lambda r: 1
    """Number of scenes or objects that the value is a mean over."""


MEASURES = {
    "valid_rate": Measure(lambda r: r.valid),
    "check_rate": Measure(lambda r: r.check_passed),
    "accepted_rate": Measure(lambda r: bool(r.accepted), weight=lambda r: r.accepted is not None),
    "displaced": Measure(lambda r: r.displaced / r.found, weight=lambda r: r.found),
    "missed": Measure(lambda r: r.missed / r.objects, weight=lambda r: r.objects),
    "extra": Measure(lambda r: r.extra / r.objects, share=False, weight=lambda r: r.objects),
    "s_pen": Measure(lambda r: r.s_pen),
    "p_pen": Measure(
        lambda r: r.p_pen / r.articulated if r.articulated else 0.0,
        weight=lambda r: r.articulated,
    ),
    "s_stab": Measure(lambda r: r.s_stab),
    "o_stab": Measure(lambda r: r.o_stab, weight=lambda r: r.found + r.extra),
    "xy_error_m": Measure(lambda r: r.xy_error_m, share=False),
    "yaw_error_deg": Measure(lambda r: r.yaw_error_deg, share=False),
    "scale_error": Measure(lambda r: r.scale_error, share=False),
    "edge_error": Measure(lambda r: r.edge_error, share=False),
    "camera_error_m": Measure(lambda r: r.camera_error_m, share=False),
    "within_10mm": Measure(lambda r: r.within_10mm, weight=lambda r: r.found),
    "box_iou": Measure(lambda r: r.box_iou, share=False),
}
"""Measures by name."""
LEVEL, Z = 0.9, 1.645
"""Probability of an interval, and its half-width in standard deviations of a Gaussian."""
COMPARED = (
    *("xy_error_m", "yaw_error_deg", "scale_error", "edge_error", "camera_error_m"),
    *("box_iou", "displaced"),
)
"""Measures of the paired differences."""
PAPER: dict[str, dict[str, dict[str, float]]] = {
    "all": {
        "VIGA": {"s_pen": 56.67, "p_pen": 63.37, "s_stab": 23.33, "o_stab": 27.33},
        "SAGE": {"s_pen": 6.67, "p_pen": 2.41, "s_stab": 70.0, "o_stab": 91.6},
        "NeoWorld-Pro": {"s_pen": 0.0, "p_pen": 0.0, "s_stab": 100.0, "o_stab": 100.0},
    },
    "tabletop": {
        "VIGA": {"s_pen": 54.55, "p_pen": 67.26, "s_stab": 18.18, "o_stab": 25.66},
        "TabletopGen": {"s_pen": 45.45, "p_pen": 26.53, "s_stab": 36.36, "o_stab": 67.35},
        "SAGE": {"s_pen": 9.09, "p_pen": 4.17, "s_stab": 100.0, "o_stab": 100.0},
        "NeoWorld-Pro": {"s_pen": 0.0, "p_pen": 0.0, "s_stab": 100.0, "o_stab": 100.0},
    },
}
"""Scene-level table of the paper [%], on its own 30 scenes and on the 11 tabletop ones."""


def scene_summary(rows: Sequence[SceneRow]) -> dict[str, Any]:
    """Summarize rows: figures by method, of the evaluation half alone, differences,
    and the coverage of confidence intervals.
    """
    return {
        "n": len(rows),
        "scenes": len({row.scene for row in rows}),
        "starts": len({row.start for row in rows}),
        "methods": {name: figures(some) for name, some in by_method(rows)},
        "tabletop": {
            name: figures(some) for name, some in by_method([r for r in rows if r.tabletop])
        },
        "evaluation": {
            name: figures(some) for name, some in by_method([r for r in rows if r.evaluation])
        },
        "differences": differences(rows),
        "coverage": {name: coverage(some) for name, some in by_method(rows)},
        "paper": PAPER,
    }


def figures(rows: Sequence[SceneRow]) -> dict[str, Any]:
    """Return the figures of rows of one method.

    "objects" is the number of the ground truth's movable objects over all rows, "found" of those
    that the results have, over which errors are means; O-Stab is over these and the extra ones,
    P-Pen over "articulated". "camera_error_median_m" is the median over rows. A mean over nothing
    is None, and so is "seconds_to_valid", the median over valid results, without any.
    """
    times = [row.seconds_to_valid for row in rows if row.seconds_to_valid is not None]
    whole = [row.seconds for row in rows if row.seconds is not None]
    result: dict[str, Any] = {
        "n": len(rows),
        "objects": sum(row.objects for row in rows),
        "found": sum(row.found for row in rows),
        "articulated": sum(row.articulated for row in rows),
        "seconds_to_valid": float(np.median(times)) if times else None,
        "seconds": float(np.median(whole)) if whole else None,
        "camera_error_median_m": float(np.median([row.camera_error_m for row in rows])),
    }
    for name in MEASURES:
        value, low, high = interval(rows, name)
        result |= {name: value, f"{name}_interval": [low, high]}
    return result


def interval(rows: Sequence[SceneRow], name: str) -> Interval:
    """Return the mean of one of MEASURES and its interval, clustered by scene.

    All values are None for a mean over nothing, the ends for a single scene.
    """
    of = MEASURES[name]
    parts = [(row.scene, of.weight(row) * of.value(row), of.weight(row)) for row in rows]
    return ratio_interval(parts, share=of.share)


def differences(rows: Sequence[SceneRow]) -> dict[str, Any]:
    """Compare each method with the first one of the rows, from the same initial scenes.

    Returns:
        Mean difference to the first method by method and measure of COMPARED, with the ends of its
        interval, clustered by scene, and the number of pairs.
    """
    methods = dict(by_method(rows))
    first = next(iter(methods), None)
    base = {(r.scene, r.start, r.seed): r for r in methods.get(first or "", [])}
    result: dict[str, Any] = {}
    for name, some in methods.items():
        pairs = [(r, base[key]) for r in some if (key := (r.scene, r.start, r.seed)) in base]
        scenes = [row.scene for row, _ in pairs]
        if name != first:
            result[name] = {
                of: mean(
                    [MEASURES[of].value(a) - MEASURES[of].value(b) for a, b in pairs], scenes
                )._asdict()
                for of in COMPARED
            }
    return {"to": first, "methods": result}


def coverage(rows: Sequence[SceneRow]) -> list[dict[str, Any]]:
    """Return the share of 90 % intervals that hold the truth, for each half and quantity.

    `low` and `high` are its interval, clustered by scene; `factor` is the factor on the stated
    deviations at which exactly 90 % would hold it.
    """
    table = []
    for half, evaluation in (("development", False), ("evaluation", True)):
        some = [row for row in rows if row.evaluation is evaluation]
        for quantity in sorted({name for row in some for name in row.deviations}):
            errors = [(r.scene, e) for r in some for e in r.deviations.get(quantity, [])]
            parts = [(scene, float(error <= Z), 1.0) for scene, error in errors]
            held, low, high = ratio_interval(parts, share=True)
            factor = float(np.quantile([error for _, error in errors], LEVEL) / Z)
            table.append(
                {
                    **{"half": half, "quantity": quantity, "n": len(errors)},
                    **{"held": held, "low": low, "high": high, "factor": factor},
                }
            )
    return table
