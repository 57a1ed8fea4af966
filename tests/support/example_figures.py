"""Comparison of a reconstruction of a bundled example with the table of docs/results.md."""

from collections.abc import Mapping
from typing import Any

import pytest

EXPECTED: dict[str, dict[str, float]] = {
    "coffee": {
        "objects": 3, "joints": 0, "calls": 8, "valid": True,
        "drift_mm": 0.109, "tilt_deg": 0.167, "overlap_mm": 0.0671, "box_iou": 0.952,
    },
    "drawers": {
        "objects": 6, "joints": 3, "calls": 16, "valid": True,
        "drift_mm": 0.0, "tilt_deg": 0.0158, "overlap_mm": 0.108, "box_iou": 0.929,
    },
    "microwave": {
        "objects": 1, "joints": 5, "calls": 5, "valid": True,
        "drift_mm": 0.0, "tilt_deg": 0.0, "overlap_mm": 0.0124, "box_iou": 0.974,
    },
}  # fmt: skip
TOLERANCES = {"drift_mm": 0.1, "tilt_deg": 0.2, "overlap_mm": 0.1, "box_iou": 0.01}
"""Tolerances; other values must be equal."""


def check_figures(name: str, measured: Mapping[str, Any]) -> None:
    """Compare measured values, by the names of EXPECTED, within TOLERANCES."""
    for key, value in measured.items():
        known = pytest.approx(EXPECTED[name][key], abs=TOLERANCES.get(key, 0.0) + 1e-9)
        assert value == known, (
            f"{name}, {key}: {value} is not what docs/results.md states; measure again: "
            "neoworld bench run examples --json"
        )
