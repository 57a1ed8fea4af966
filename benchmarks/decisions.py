"""Agreement of `neoworld check` with the verdict of the `neoworld refine` that wrote a scene."""

import logging
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from neoworld_bench.machine import machine

from benchmarks.suites import Decisions
from neoworld_mjx.commands.object_commands import CheckCommand
from neoworld_mjx.config import RefineOptions, load_config
from neoworld_mjx.measure import scene_checks
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.pipeline import reconstruct
from neoworld_mjx.pipeline.bundled_examples import bundled_examples
from neoworld_mjx.refinement import refine
from neoworld_mjx.refinement.scene_refinement import compile_for_search, read_composed
from neoworld_mjx.spec import SceneSpec

log = logging.getLogger(__name__)

SEARCH = {
    "cem": {"population": 8, "iterations": 1, "elite_ratio": 0.5},
    "rollout": {"engine": "native", "samples_per_object": 64},
    "finalists": 1,
}
"""Short search that repairs few scenes, so that both verdicts occur."""


def run_suite(options: Decisions) -> dict[str, Any]:
    """Compare the verdicts on the examples and on perturbed scenes of them."""
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        composed: dict[str, SceneSpec] = {}
        for name, example in bundled_examples().items():
            run = folder / name
            result = reconstruct(example.photo, run, load_config(None, {"provider": "replay"}))
            composed[name] = read_composed(run)
            # An example that passed has failed no check; otherwise only the verdict is known.
            rows.append(_row(name, "example", bool(result.passed), [], run))
        short = load_config(None, {"refine": SEARCH}).refine
        names = list(composed)
        for number in range(options.scenes):
            name = names[number % len(names)]
            scene = _perturbed(composed[name], short, options.seed + number)
            refined = refine(scene, short, seed=options.seed + number)
            path = folder / f"{number}.json"
            path.write_text(refined.scene.to_json(), encoding="utf-8")
            failed = [c.name for c in scene_checks(refined.measure, short) if not c.passed]
            rows.append(_row(name, f"disturbed {number}", refined.passed, failed, path))
            log.info("%s %s: refine %s, check %s", *(str(v) for v in list(rows[-1].values())[:4]))
    agree = sum(
        row["refine"] == row["check"] and row["failed_in_refine"] == row["failed_in_check"]
        for row in rows
    )
    return {
        "machine": machine(),
        "passed": agree == len(rows),
        "scenes": len(rows),
        "agree": agree,
        "passed_by_both": sum(row["refine"] and row["check"] for row in rows),
        "failed_by_both": sum(not row["refine"] and not row["check"] for row in rows),
        "rows": rows,
    }


def _row(name: str, scene: str, passed: bool, failed: list[str], path: Path) -> dict[str, Any]:
    """Check a written scene by the command, and return the row with the refinement's verdict."""
    checked = CheckCommand(target=path, quiet=True).run()
    failed_in_check = [check["name"] for check in checked["checks"] if not check["passed"]]
    return {
        "example": name,
        "scene": scene,
        "refine": passed,
        "check": bool(checked["passed"]),
        "failed_in_refine": failed,
        "failed_in_check": failed_in_check,
    }


def _perturbed(scene: SceneSpec, options: RefineOptions, seed: int) -> SceneSpec:
    """Perturb movable objects: xy by 15 % of the diagonal, yaw by 20 degrees, size by 15 %."""
    model = compile_for_search(scene, options)
    rng = np.random.default_rng(seed)
    free = np.asarray(model.optimised, float)
    reach = 0.15 * np.asarray(model.diagonal)[:, None] * free[:, None]
    layout = Layout(
        np.asarray(rng.normal(size=(1, len(free), 2)) * reach, np.float32),
        np.asarray(rng.normal(0, np.radians(20), (1, len(free))) * free, np.float32),
        np.asarray(rng.normal(0, 0.15, (1, len(free))) * free, np.float32),
    )
    return model.apply(layout, 0)
