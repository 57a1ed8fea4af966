"""Composition of the bundled photographs with and without the steps that the paper lacks."""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from neoworld_bench.machine import machine

from benchmarks.suites import Composing
from neoworld_mjx.config import load_config
from neoworld_mjx.measure import measured, scene_checks, visible_box_iou
from neoworld_mjx.pipeline import reconstruct
from neoworld_mjx.pipeline.bundled_examples import bundled_examples
from neoworld_mjx.refinement.scene_refinement import read_composed

VARIANTS: dict[str, dict[str, dict[str, bool]]] = {
    "as it is": {},
    "without refit": {"compose": {"refit": False}},
    "without settle": {"compose": {"settle": False}},
}


def run_suite(options: Composing) -> dict[str, Any]:
    """Measure each composed scene, before any search."""
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as place:
        for name in options.example or tuple(bundled_examples()):
            run = Path(place) / name
            for variant, changed in VARIANTS.items():
                config = load_config(None, {"provider": "replay", **changed})
                photo = bundled_examples()[name].photo
                reconstruct(photo, run, config, until="compose", resume=run.exists())
                scene = read_composed(run)
                ious = visible_box_iou(scene)
                checks = scene_checks(measured(scene, config.refine), config.refine)
                rows.append(
                    {
                        "example": name,
                        "variant": variant,
                        "box_iou": float(np.mean(list(ious.values()))),
                        "objects": ious,
                        "failed": [check.name for check in checks if not check.passed],
                    }
                )
    means = {
        variant: float(np.mean([row["box_iou"] for row in rows if row["variant"] == variant]))
        for variant in VARIANTS
    }
    return {"machine": machine(), "passed": True, "mean_box_iou": means, "rows": rows}
