"""Statistics of methods over scenes and initial scenes, and the difficulty of the data set."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from neoworld_mjx.sweeps.intervals import mean, ratio_interval

from ..methods.scene_runs import SceneRow

BOUNDS = {"open_loop": 0.1, "gravity": 0.5, "no_simulation": 0.7}
"""Maximum valid rates of simple methods; above them the data set is too easy."""
MEASURES: dict[str, Callable[[SceneRow], float]] = {
    "valid_rate": lambda r: r.valid,
    "check_rate": lambda r: r.check_passed,
    "accepted_rate": lambda r: bool(r.accepted),
    "displaced": lambda r: r.displaced / r.found,
    "missed": lambda r: r.missed / r.objects,
    "extra": lambda r: r.extra / r.objects,
    "s_pen": lambda r: r.s_pen,
    "p_pen": lambda r: r.p_pen / r.articulated if r.articulated else 0.0,
    "s_stab": lambda r: r.s_stab,
    "o_stab": lambda r: r.o_stab,
    "xy_error_m": lambda r: r.xy_error_m,
    "yaw_error_deg": lambda r: r.yaw_error_deg,
    "scale_error": lambda r: r.scale_error,
    "edge_error": lambda r: r.edge_error,
    "box_iou": lambda r: r.box_iou,
}
"""Measures, as means over scenes and initial scenes."""
COMPARED = ("xy_error_m", "yaw_error_deg", "scale_error", "edge_error", "box_iou", "displaced")
"""Measures of the paired differences."""
SHARES = ("valid_rate", "check_rate", "accepted_rate", "displaced", "missed")
SHARES += ("s_pen", "p_pen", "s_stab", "o_stab")
"""Measures that are shares of scenes or objects."""
OF_OBJECTS: dict[str, Callable[[SceneRow], int]] = {
    "accepted_rate": lambda r: r.accepted is not None,
    "displaced": lambda r: r.found,
    "missed": lambda r: r.objects,
    "extra": lambda r: r.objects,
    "o_stab": lambda r: r.found + r.extra,
    "p_pen": lambda r: r.articulated,
}
"""Weights of measures that are means over objects: found ones, those of the ground truth, all of
the scene, or those with joints."""


def summarise(rows: Sequence[SceneRow]) -> dict[str, Any]:
    """Summarize rows: all initial scenes by method, the evaluation half, and the difficulty."""
    return {
        "scenes": len({row.scene for row in rows}),
        "starts": len({row.start for row in rows}),
        "methods": by_method(rows),
        "evaluation": by_method([row for row in rows if row.evaluation]),
        "differences": differences(rows),
        "difficulty": difficulty(rows),
    }


def by_method(rows: Sequence[SceneRow]) -> dict[str, Any]:
    """Return the statistics of each method."""
    names = dict.fromkeys(row.method for row in rows)
    return {name: figures([row for row in rows if row.method == name]) for name in names}


def differences(rows: Sequence[SceneRow]) -> dict[str, Any]:
    """Compare each method with the first one of the rows, from the same initial scenes.

    Returns:
        Mean difference to the first method by method and measure of COMPARED, with the ends of its
        interval, clustered by scene, and the number of pairs.
    """
    names = list(dict.fromkeys(row.method for row in rows))
    by = {name: {(r.scene, r.start, r.seed): r for r in rows if r.method == name} for name in names}
    result: dict[str, Any] = {}
    for name in names[1:]:
        pairs = [(row, by[names[0]][key]) for key, row in by[name].items() if key in by[names[0]]]
        scenes = [row.scene for row, _ in pairs]
        result[name] = {
            of: mean([MEASURES[of](a) - MEASURES[of](b) for a, b in pairs], scenes)._asdict()
            for of in COMPARED
        }
    return {"to": names[0] if names else None, "methods": result}


def figures(rows: Sequence[SceneRow]) -> dict[str, Any]:
    """Return the figures of rows of one method.

    "objects" is the number of the ground truth's movable objects over all rows, "found" of those
    that starts have, over which errors are means; O-Stab is over these and the extra ones, P-Pen
    over "articulated". A mean over nothing is None.
    "seconds_to_valid" is the median over the valid ones, None without any.
    """
    times = [row.seconds_to_valid for row in rows if row.seconds_to_valid is not None]
    whole = [row.seconds for row in rows if row.seconds is not None]
    return {
        "n": len(rows),
        "objects": sum(row.objects for row in rows),
        "found": sum(row.found for row in rows),
        "articulated": sum(row.articulated for row in rows),
        **{name: interval(rows, name)[0] for name in MEASURES},
        "seconds_to_valid": float(np.median(times)) if times else None,
        "seconds": float(np.median(whole)) if whole else None,
    }


def difficulty(rows: Sequence[SceneRow]) -> dict[str, Any]:
    """Compare the simple methods with BOUNDS, and the errors of gravity with ours."""
    by = by_method(rows)
    checks: dict[str, Any] = {
        name: {"n": by[name]["n"], "valid_rate": by[name]["valid_rate"], "at_most": most}
        | {"hard_enough": by[name]["valid_rate"] <= most}
        for name, most in BOUNDS.items()
        if name in by
    }
    if {"gravity", "ours"} <= set(by):
        for error in ("xy_error_m", "yaw_error_deg"):
            gravity, ours = by["gravity"][error], by["ours"][error]
            checks[f"gravity_{error}"] = {
                "gravity": gravity,
                "ours": ours,
                "hard_enough": gravity > ours,
            }
    return checks


def interval(
    rows: Sequence[SceneRow], measure: str
) -> tuple[float | None, float | None, float | None]:
    """Return the mean of one of MEASURES and its interval, clustered by scene.

    All values are None for a mean over nothing, the ends for a single scene.
    """
    of, weigh = MEASURES[measure], OF_OBJECTS.get(measure, lambda r: 1)
    parts = [(row.scene, weigh(row) * of(row), weigh(row)) for row in rows]
    return ratio_interval(parts, share=measure in SHARES)
