"""Lines on what each kind of evidence says of an object, for the report and the viewer."""

import math
from collections.abc import Mapping
from typing import Any

from ..estimate.prior import YAW

BOX, CONTOUR, DEPTH, MASK = "2D box", "contour", "depth", "mask"
UNSEEN = 0.9
"""Ratio of a heading's standard deviation to that of its prior at and above which the photograph
counts as not showing the heading."""
_STEPS = {"parsed": "parsed", "composed": "composed", "refined": "refined"}


def evidence_lines(
    aligned: Mapping[str, Any], agreement: Mapping[str, Any], name: str, support: str
) -> dict[str, str]:
    """Return one line for each kind of evidence that a run has of an object, by the kind.

    Args:
        aligned: contents of compose/align.json; empty without an alignment.
        agreement: IoU of the object's 2D boxes by step, as in run.json.
        name: name of the object.
        support: name of its support.
    """
    lines = {}
    overlaps = _values(agreement, _STEPS, ".2f")
    if overlaps:
        lines[BOX] = f"IoU {overlaps}"
    change = aligned.get("objects", {}).get(name)
    if change is None:
        return lines
    steps = {"composed": "composed", "aligned": "aligned"}
    if change["evidence"] == "pixels":
        off = _values(aligned.get("outlines_px", {}).get(name, {}), steps, ".1f px")
        lines[CONTOUR] = f"off by {off}" if off else "used; its distance is unknown"
    else:
        lines[CONTOUR] = f"not used: {change['reason']}"
    if change.get("depth") is not None:
        lines[DEPTH] = _depth(change["depth"], support)
    if "masks_iou" in aligned:
        overlap = _values(aligned["masks_iou"].get(name, {}), steps, ".2f")
        lines[MASK] = f"IoU {overlap}" if overlap else "none"
    return lines


def _values(values: Mapping[str, Any], labels: Mapping[str, str], style: str) -> str:
    """Return the known values with their labels; `style` is a format with an optional unit."""
    digits, _, unit = style.partition(" ")
    return ", ".join(
        f"{label} {values[key]:{digits}} {unit}".rstrip()
        for key, label in labels.items()
        if values.get(key) is not None
    )


def _depth(outcome: Mapping[str, Any], support: str) -> str:
    """Return the line on an object's depth, from the fields of `DepthOutcome`."""
    pixels = outcome["pixels"]
    if not pixels:
        return "not used: no pixel is measured"
    before, after = (_mm(outcome[key]) for key in ("before_m", "after_m"))
    residual = f"median residual {before} before and {after} after, {pixels} pixels"
    rise = round(1000 * outcome["rise_m"])
    side = "above" if rise >= 0 else "below"
    return f"{residual}; puts it {abs(rise)} mm {side} {support}"


def _mm(meters: float) -> str:
    value = abs(1000 * meters)
    return f"{value:.0f} mm" if value >= 9.95 else f"{value:.1f} mm"


def deviation_phrase(deviations: Mapping[str, Any]) -> str:
    """Return the standard deviations of an object, as those of `PoseUncertainty`."""
    along, across = 1000 * deviations["along"], 1000 * deviations["across"]
    # An object on a wall moves only in the plane of the wall, so its distance has no deviation.
    if along == 0:
        texts = [f"along the wall {_deviation(across)} mm"]
    else:
        yaw = deviations["yaw"]
        heading = "heading not seen"
        if yaw is not None and yaw < UNSEEN * YAW:
            heading = f"heading {_deviation(math.degrees(yaw))}°"
        texts = [f"along the view {_deviation(along)} mm", f"across {_deviation(across)} mm"]
        texts.append(heading)
    return ", ".join([*texts, f"size {_deviation(100 * deviations['log_scale'])} %"])


def digits_of(deviation: float) -> int:
    """Return the number of decimals to show for a value with the given standard deviation."""
    return 0 if deviation >= 0.95 else 1


def _deviation(value: float) -> str:
    return f"±{max(value, 0.1):.{digits_of(value)}f}"
