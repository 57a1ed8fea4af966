"""Rescue: make the posed meshes of another method stand, free of penetration, and export them."""

import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..compose.mesh_supports import with_supports
from ..config import RefineOptions
from ..engines import EngineChoice
from ..errors import RunError
from ..export import export_scene
from ..export.importing_scene import ImportedScene, import_file
from ..io.files import write_output
from ..measure import SceneMeasure, measured, passes
from ..physics.engine import Engine
from ..refinement.scene_refinement import refine
from ..spec import SceneSpec, world_poses

REPORT = "rescue.json"


@dataclass(frozen=True)
class Rescued:
    """A scene of another method that was made to stand."""

    scene: SceneSpec
    passed: bool
    """True if it passes the final check."""
    before: SceneMeasure
    """Final check of the objects as they were given, on the supports that were found."""
    moves_m: dict[str, float]
    """Distance of each free object from where it was given."""
    notes: tuple[str, ...]
    seconds: float

    def to_json(self) -> dict[str, Any]:
        """Return the report as JSON."""
        return {
            "passed": self.passed,
            "seconds": self.seconds,
            "depth_before_m": self.before.max_depth_m,
            "drift_before_m": min(self.before.max_drift_m, 1e6),
            "moves_m": self.moves_m,
            "notes": list(self.notes),
        }


def rescue(
    given: SceneSpec | ImportedScene,
    options: RefineOptions | None = None,
    *,
    seed: int = 0,
    engine: Engine | EngineChoice | None = None,
) -> Rescued:
    """Put the objects of a scene upright on their supports, settle them, and search if need be.

    Sizes and shapes are not corrected; the search may scale objects within its bounds.

    Args:
        given: objects at their poses without parents, as `import_file` reads them.
        options: of the search and the final check.
        seed: of the search.
        engine: physics engine or its name; default: the engine that the options name.

    Raises:
        SpecError: nothing is free to move, or the scene has parents already.
    """
    began, o = time.perf_counter(), options or RefineOptions()
    scene = given.spec if isinstance(given, ImportedScene) else given
    supported = with_supports(scene)
    refined = refine(supported.scene, o, seed=seed, engine=engine)
    starts, ends = world_poses(scene), world_poses(refined.scene)
    moves = {
        item.name: float(np.linalg.norm(ends[item.name].pos - starts[item.name].pos))
        for item in refined.scene.objects
        if not item.static
    }
    read = given.notes if isinstance(given, ImportedScene) else ()
    fixed = {item.name for item in supported.scene.objects if item.environment}
    on_supports = scene.model_copy(
        update={
            "objects": tuple(
                item.model_copy(update={"environment": item.name in fixed or item.environment})
                for item in scene.objects
            )
        }
    )
    return Rescued(
        refined.scene,
        passes(refined.measure, o),
        measured(on_supports, o),
        moves,
        (*read, *supported.notes, *refined.fallbacks),
        time.perf_counter() - began,
    )


def rescue_file(
    file: Path,
    out: Path,
    options: RefineOptions | None = None,
    *,
    seed: int = 0,
    engine: Engine | EngineChoice | None = None,
) -> Rescued:
    """Rescue a glTF scene or a poses.json, and write the scene in every format and rescue.json.

    Args:
        file: the scene; see `export.read_mesh_scene`.
        out: folder, new or empty.
        options: as for `rescue`, as are seed and engine.
        seed: of the search.
        engine: physics engine.

    Raises:
        SpecError: the file cannot be read, or nothing in it is free to move.
        RunError: the folder is not empty, or cannot be written.
    """
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise RunError(f"{out} is not empty; name a new folder")
    read = import_file(file)
    if not isinstance(read, ImportedScene):
        raise RunError(f"{file} holds one object; rescue needs a scene")
    rescued = rescue(read, options, seed=seed, engine=engine)
    export_scene(rescued.scene, out)
    write_output(out / REPORT, json.dumps(rescued.to_json(), indent=1) + "\n", RunError)
    return rescued
