"""Scores of reconstructed objects against ground-truth objects of the same name, and their totals.

Both are files of objects: programs, spec.json, URDF or MJCF, such as ID/mobility.urdf of
PartNet-Mobility.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from neoworld_mjx.config import ProgramOptions
from neoworld_mjx.errors import SpecError, choices
from neoworld_mjx.export.importing import import_object
from neoworld_mjx.io import read_model
from neoworld_mjx.spec import ObjectSpec
from neoworld_mjx.verify.read_target import build_patched

from ..rows import Row
from .joint_measure import Front, Mean, ObjectTruth, canonical_points, joint_measure, truth_of
from .surface_measure import SAMPLES, geometry_measure, surface_points

OBJECT_FILES = (
    *("resized.json", "verified.json", "spec.json", "program.py", "object.urdf", "object.xml"),
    "mobility.urdf",
)
"""Names of an object's file in its folder, by priority."""
SUFFIXES = (".py", ".urdf", ".xml", ".mjcf")
"""Suffixes of an object's file without a folder."""
SURFACE = ("chamfer_x10", "f_01", "f_05")
"""Measures of surfaces after the fit."""
TRUE_SEED = 1
"""Seed of the samples of the ground truth; that of reconstructed objects is 0."""


class ObjectScoreRow(Row):
    """Scores of one reconstructed object."""

    object: str
    total: int
    """Ground-truth joints."""
    predicted: int
    hits: int
    correct: int
    """Hits of the true type, with the axis within 10 degrees and the pivot within a tenth of the
    diagonal."""
    wrong_type: int
    """Hits of another type."""
    axis_deg: float | None
    """Mean over axis_n hits; pivot and limits likewise."""
    axis_n: int
    pivot: float | None
    pivot_n: int
    limits: float | None
    limits_n: int
    chamfer_x10: float | None
    """Chamfer distance after the fit; None without an object."""
    f_01: float | None
    f_05: float | None
    raw_chamfer_x10: float | None
    """Without the fit; so is raw_f_05."""
    raw_f_05: float | None
    scale: float | None
    """Scale factor of the fit."""
    missed: str
    """Names of the missed joints, with those of their parts."""
    reason: str
    """Reason why there is no object; all its joints then count as missed."""


def _object(file: Path, options: ProgramOptions) -> ObjectSpec:
    """Read the object of a file: a program (.py), JSON, URDF or MJCF."""
    if file.suffix == ".json":
        return read_model(file, ObjectSpec, SpecError, "an object")
    return build_patched(file, options).spec if file.suffix == ".py" else import_object(file).spec


def object_files(folder: Path) -> dict[str, Path]:
    """Return the files of the objects of a folder by name: files, or folders of one object each.

    Raises:
        SpecError: there is no such folder, or it holds no object.
    """
    if not folder.is_dir():
        raise SpecError(f"there is no folder {folder}")
    files: dict[str, Path] = {}
    for path in sorted(folder.iterdir()):
        file = path
        if path.is_dir():
            file = next((path / name for name in OBJECT_FILES if (path / name).is_file()), None)
        if file is not None and (path.is_dir() or path.suffix.lower() in SUFFIXES):
            files[path.name if path.is_dir() else path.stem] = file
    if not files:
        raise SpecError(
            f"{folder} holds no object: expected is NAME with one of {', '.join(SUFFIXES)}, or "
            f"NAME/ with one of {', '.join(OBJECT_FILES)}"
        )
    return files


def object_names(made: Path, truth: Path, objects: Sequence[str] = ()) -> list[str]:
    """Return the named ground-truth objects, or those that were reconstructed.

    Raises:
        SpecError: a folder holds no object, a name is unknown, or no object is in both.
    """
    files, known = object_files(made), object_files(truth)
    for name in objects:
        if name not in known:
            raise SpecError(f"object: {choices(name, known)}")
    names = list(objects) or [name for name in known if name in files]
    if not names:
        raise SpecError(
            f"{made} has no object of {truth}: it has {', '.join(list(files)[:8])}, which has "
            f"{', '.join(list(known)[:8])}"
        )
    return names


def score_object(
    name: str,
    made: Path,
    truth: Path,
    *,
    front: Front,
    options: ProgramOptions,
    samples: int = SAMPLES,
) -> Iterator[ObjectScoreRow]:
    """Yield the row of a ground-truth object.

    Args:
        name: of the object in both folders; if it was not made, all its joints are missed.
        made: folder of reconstructed objects.
        truth: folder of ground-truth objects.
        front: direction in which ground-truth objects face.
        options: of made programs.
        samples: of each surface.

    Raises:
        SpecError: the ground-truth object cannot be read.
    """
    true_spec = _object(object_files(truth)[name], options)
    true = truth_of(true_spec).model_copy(update={"front": front})
    file, spec, reason = object_files(made).get(name), None, "not made"
    if file is not None:
        try:
            spec, reason = _object(file, options), ""
        except SpecError as error:
            reason = str(error)[:300]
    joints = joint_measure(ObjectTruth(name=name, box=true.box) if spec is None else spec, true)
    parts = {joint.name: joint.child for joint in true.joints}
    yield ObjectScoreRow(
        object=name,
        total=joints.total,
        predicted=joints.predicted,
        hits=joints.hits,
        correct=joints.correct,
        wrong_type=sum(pair.true_type != pair.predicted_type for pair in joints.pairs),
        axis_deg=joints.axis_deg.value,
        axis_n=joints.axis_deg.n,
        pivot=joints.pivot.value,
        pivot_n=joints.pivot.n,
        limits=joints.limits.value,
        limits_n=joints.limits.n,
        **_surface(spec, true, surface_points(true_spec, samples, TRUE_SEED)),
        missed=", ".join(f"{joint} ({parts[joint]})" for joint in joints.missed),
        reason=reason,
    )


def _surface(
    spec: ObjectSpec | None, true: ObjectTruth, points: np.ndarray
) -> dict[str, float | None]:
    if spec is None:
        return dict.fromkeys((*SURFACE, "raw_chamfer_x10", "raw_f_05", "scale"))
    geometry = geometry_measure(spec, canonical_points(points, true), samples=len(points))
    plain = geometry.unaligned
    raw = {"raw_chamfer_x10": plain.chamfer_x10, "raw_f_05": plain.f_05, "scale": geometry.scale}
    return {name: getattr(geometry.aligned, name) for name in SURFACE} | raw


def score_figures(rows: Sequence[ObjectScoreRow]) -> dict[str, Any]:
    """Return the totals of objects: every joint counts once, surfaces are means over objects.

    Means have their n; they are None if n is 0.
    """
    total, hits = sum(row.total for row in rows), sum(row.hits for row in rows)
    wrong = sum(row.wrong_type for row in rows)
    share = lambda count, of: count / of if of else None
    figures: dict[str, Any] = {
        "objects": len(rows),
        "not_made": sum(bool(row.reason) for row in rows),
        "total": total,
        "predicted": sum(row.predicted for row in rows),
        "hits": hits,
        "correct": sum(row.correct for row in rows),
        "miss": share(total - hits, total),
        "type_error": share(total - hits + wrong, total),
        "type_error_hits": share(wrong, hits),
    }
    for name in ("axis", "pivot", "limits"):
        column = "axis_deg" if name == "axis" else name
        pairs = [(getattr(row, column), getattr(row, f"{name}_n")) for row in rows]
        figures[column] = _mean([(value, n) for value, n in pairs if n]).model_dump()
    for name in (*SURFACE, "raw_chamfer_x10", "raw_f_05", "scale"):
        values = [getattr(row, name) for row in rows]
        figures[name] = _mean([(value, 1) for value in values if value is not None]).model_dump()
    return figures


def _mean(values: Sequence[tuple[float, int]]) -> Mean:
    n = sum(count for _, count in values)
    if not n:
        return Mean(value=None, n=0)
    means, counts = zip(*values, strict=True)
    return Mean(value=float(np.average(means, weights=counts)), n=n)
