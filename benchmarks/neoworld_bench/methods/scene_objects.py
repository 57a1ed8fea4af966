"""Rows of single objects, for P-Pen and for curves over thresholds."""

from collections.abc import Mapping
from pathlib import Path

from neoworld_mjx.measure import SceneMeasure
from neoworld_mjx.spec import SceneSpec

from ..row_files import stored_rows
from ..rows import Row
from .part_depths import articulated, part_depth

OBJECTS = "objects.parquet"
MOTION_CAP = 1e6
"""Maximum drift [m] and tilt [deg]. It also replaces NaN and all values of a diverged simulation,
so that columns are finite."""


class ObjectRow(Row):
    """Result of one object in the final scene of a method."""

    scene: str
    start: int
    seed: int
    method: str
    object: str
    drift_m: float | None
    """Largest displacement during the simulation of the final check [m]; None if the object cannot
    move."""
    tilt_deg: float | None
    """Largest tilt during the simulation of the final check [deg]; None if the object cannot
    move."""
    depth_m: float
    """Deepest penetration with another object in the final scene [m]."""
    part_depth_m: float | None
    """Deepest penetration of two parts of the object over the ranges of its joints [m]; None if it
    has no joints that move."""

    @property
    def key(self) -> tuple[str, int, int, str]:
        """Key of the scene's row: scene, start, seed and method."""
        return self.scene, self.start, self.seed, self.method


def object_rows(
    scene: SceneSpec, measure: SceneMeasure, key: tuple[str, int, int, str]
) -> list[ObjectRow]:
    """Return the rows of a scene's objects, without environment supports.

    Args:
        scene: final scene of a method.
        measure: measure of this scene.
        key: scene, start, seed and method.
    """
    name, start, seed, method = key
    return [
        ObjectRow(
            scene=name,
            start=start,
            seed=seed,
            method=method,
            object=item.name,
            drift_m=_largest(measure.drift_m, item.name, measure.diverged),
            tilt_deg=_largest(measure.tilt_deg, item.name, measure.diverged),
            depth_m=max(
                (d for pair, d in measure.depths_m.items() if item.name in pair.split("|")),
                default=0.0,
            ),
            part_depth_m=part_depth(item.spec) if articulated(item.spec) else None,
        )
        for item in scene.objects
        if not item.environment
    ]


def _largest(values: Mapping[str, float], name: str, diverged: bool) -> float | None:
    if name not in values:
        return None
    # The comparison is also false for NaN.
    return values[name] if values[name] < MOTION_CAP and not diverged else MOTION_CAP


def read_object_rows(folder: Path) -> list[ObjectRow]:
    """Read the rows of objects in a folder; if there is no such file, return none.

    Raises:
        RunError: the rows cannot be read.
    """
    file = folder / OBJECTS
    return stored_rows(file, ObjectRow) if file.exists() else []
