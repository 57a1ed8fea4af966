"""Rows of objects, for P-Pen and curves over thresholds."""

from collections.abc import Mapping
from pathlib import Path

from neoworld_mjx.measure import SceneMeasure
from neoworld_mjx.spec import SceneSpec

from ..row_files import stored_rows
from ..rows import Row
from .part_depths import articulated, part_depth

OBJECTS = "objects.parquet"
FAR = 1e6
"""Drift [m] and tilt [deg] of objects that left all bounds, so that columns are finite."""


class ObjectRow(Row):
    """Result of one object in the final scene of a method."""

    scene: str
    start: int
    seed: int
    method: str
    object: str
    drift_m: float | None
    """Largest displacement in the final check's free fall; None of what cannot move."""
    tilt_deg: float | None
    depth_m: float
    """Deepest overlap with another object where it was placed."""
    part_depth_m: float | None
    """Deepest overlap of two of its parts over its joints' ranges; None without joints."""

    @property
    def key(self) -> tuple[str, int, int, str]:
        """Key of its scene's row."""
        return self.scene, self.start, self.seed, self.method


def object_rows(
    scene: SceneSpec, measure: SceneMeasure, key: tuple[str, int, int, str]
) -> list[ObjectRow]:
    """Return the rows of a scene's objects, supports left out.

    Args:
        scene: what a method made.
        measure: of it.
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
    # A comparison that a NaN fails as well.
    return values[name] if values[name] < FAR and not diverged else FAR


def read_object_rows(folder: Path) -> list[ObjectRow]:
    """Read the rows of a folder; none where it has no such file.

    Raises:
        RunError: they cannot be read.
    """
    file = folder / OBJECTS
    return stored_rows(file, ObjectRow) if file.exists() else []
