"""Settle a declared scene, and write its resting poses into its file.

Run `python -m neoworld_bench.dataset.settle_scene FILE.yaml ...` once when a scene is added, so
that the data set never depends on a simulation.
"""

import math
import re
import sys
from pathlib import Path

import numpy as np

from neoworld_mjx.config import RefineOptions, SettleOptions
from neoworld_mjx.errors import NeoWorldError
from neoworld_mjx.measure import SceneCheck, measured, scene_checks
from neoworld_mjx.physics.rest import settle_scene
from neoworld_mjx.spec import SceneObject, SceneSpec
from neoworld_mjx.spec.pose import IDENTITY, angle_between

from .declaration import ObjectDeclaration, SceneDeclaration, read_declaration
from .truth_scene import truth_scene

GROUND_TRUTH = SettleOptions(duration_s=6.0, fade_s=3.0)
"""Longer than for candidates, as ground truth is settled once."""
UPRIGHT_DEG = 0.3
"""Tilt up to which an object is written as upright, as nobody sees a smaller one [deg]."""


def settled(declared: SceneDeclaration) -> tuple[SceneDeclaration, SceneSpec]:
    """Return a declaration with resting poses, and its scene."""
    scene = settle_scene(truth_scene(declared), GROUND_TRUTH)
    objects = [_posed(item, scene.object(item.name)) for item in declared.objects]
    resting = declared.model_copy(update={"objects": tuple(objects)})
    return resting, truth_scene(resting)


def _posed(item: ObjectDeclaration, at: SceneObject) -> ObjectDeclaration:
    tilt = np.round(at.base_tilt, 7)
    if np.degrees(angle_between(tilt, IDENTITY)) < UPRIGHT_DEG:
        tilt = np.array(IDENTITY)
    return item.model_copy(
        update={
            "at": tuple(np.round([*at.xy, at.z], 5).tolist()),
            "yaw_deg": round(math.degrees(at.yaw), 3),
            "tilt": tuple((tilt / np.linalg.norm(tilt)).tolist()),
        }
    )


def rewritten(text: str, declared: SceneDeclaration) -> str:
    """Return a file's text with the poses of a declaration; the rest is unchanged.

    Every object is a flow mapping on a line of its own, `- {name: ..., at: [...], ...}`.
    """
    lines = text.splitlines()
    for item in declared.objects:
        k = next(k for k, line in enumerate(lines) if re.match(rf"\s*- {{name: {item.name},", line))
        values = {"at": list(item.at), "yaw_deg": item.yaw_deg}
        if item.tilt != (1.0, 0.0, 0.0, 0.0):
            values["tilt"] = [round(v, 7) for v in item.tilt]
        line = re.sub(r", (at|tilt): \[[^\]]*\]|, yaw_deg: [^,}]+", "", lines[k])
        shown = "".join(f", {key}: {value}" for key, value in values.items())
        lines[k] = line.rstrip()[:-1] + shown + "}"
    return "\n".join(lines) + "\n"


def failures(scene: SceneSpec) -> list[SceneCheck]:
    """Return the bounds of the final check that a scene breaks."""
    o = RefineOptions()
    return [check for check in scene_checks(measured(scene, o), o) if not check.passed]


def main() -> None:
    """Settle the files named on the command line."""
    bad = False
    for path in map(Path, sys.argv[1:]):
        try:
            declared = read_declaration(path)
            resting, scene = settled(declared)
        except NeoWorldError as error:
            sys.exit(f"{path}: {error}")
        moved = {
            item.name: float(np.linalg.norm(np.subtract(item.at, old.at)))
            for item, old in zip(resting.objects, declared.objects, strict=True)
        }
        worst = max(moved, key=moved.__getitem__)
        broken = failures(scene)
        bad |= bool(broken)
        path.write_text(rewritten(path.read_text(encoding="utf-8"), resting), encoding="utf-8")
        verdict = "; ".join(check.phrase() for check in broken) or "stable and free of penetration"
        sys.stdout.write(
            f"{path.stem}: {worst} moved most, {1e3 * moved[worst]:.1f} mm; {verdict}\n"
        )
    sys.exit(bad)


if __name__ == "__main__":
    main()
