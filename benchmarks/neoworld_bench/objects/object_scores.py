"""Scores of reconstructed objects, and their totals."""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from neoworld_mjx.config import ProgramOptions
from neoworld_mjx.errors import SpecError, choices
from neoworld_mjx.io import read_arrays
from neoworld_mjx.spec import ObjectSpec
from neoworld_mjx.verify.checking import object_of_file

from ..measures import canonical_points, geometry_measure, joint_measure, read_truth
from ..measures.mean import Mean
from ..measures.object_truth import Front, ObjectTruth
from ..measures.surface_measure import SAMPLES
from ..rows import ROWS, Row, RowStore
from .made_objects import object_files
from .partnet import TrueObject, partnet_folders, partnet_object

SURFACE = ("chamfer_x10", "f_01", "f_05")
"""Measures of surfaces after the fit."""


class ObjectScoreRow(Row):
    """Scores of one reconstructed object."""

    object: str
    category: str
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
    """Chamfer distance after the fit; None without samples of the ground truth or without an
    object."""
    f_01: float | None
    f_05: float | None
    raw_chamfer_x10: float | None
    """Without the fit, for ground truth in metres; so is raw_f_05."""
    raw_f_05: float | None
    scale: float | None
    """Scale factor of the fit."""
    missed: str
    """Names of the missed joints, with those of their parts."""
    reason: str
    """Reason why there is no object; all its joints then count as missed."""


def true_folder(path: Path) -> Mapping[str, Path]:
    """Return the ground-truth files of a folder by object.

    Raises:
        SpecError: there are none.
    """
    files = {file.stem: file for file in sorted(path.glob("*.json"))}
    if not files:
        raise SpecError(f"{path} holds no truth: expected NAME.json, with NAME.npz where sampled")
    return files


def read_true(file: Path, front: Front, samples: int = SAMPLES) -> TrueObject:
    """Read an object of PartNet-Mobility (a folder) or a ground-truth file with its samples.

    Raises:
        SpecError: a file cannot be read.
    """
    if file.is_dir():
        return partnet_object(file, front=front, samples=samples)
    truth, beside = read_truth(file), file.with_suffix(".npz")
    if not beside.exists():
        return TrueObject(truth, None)
    arrays = read_arrays(beside, SpecError)
    if "points" not in arrays or arrays["points"].ndim != 2 or arrays["points"].shape[1] != 3:
        raise SpecError(f"{beside} must hold points [n, 3]")
    return TrueObject(truth, canonical_points(arrays["points"], truth))


def score_objects(
    made: Path,
    *,
    partnet: Path | None = None,
    truth: Path | None = None,
    objects: Sequence[str] = (),
    front: Front = "-x",
    options: ProgramOptions | None = None,
    out: Path | None = None,
    kept: RowStore | None = None,
    samples: int = SAMPLES,
) -> Iterator[ObjectScoreRow]:
    """Yield a row for each ground-truth object that was reconstructed, or for all named ones.

    Args:
        made: folder of reconstructed objects, by the names of the ground-truth ones.
        partnet: folder of PartNet-Mobility.
        truth: folder of truth files instead.
        objects: names of ground-truth objects; one that was not made is missed whole.
        front: direction in which objects of PartNet-Mobility face.
        options: of made programs.
        out: folder of results, in which rows replace those of the same objects.
        kept: rows of an interrupted run.
        samples: of each surface.

    Raises:
        SpecError: there is no truth, or none of a reconstructed object.
    """
    if (partnet is None) == (truth is None):
        raise SpecError("name the truth: --partnet PATH, or --truth DIR")
    files = object_files(made)
    known = partnet_folders(partnet) if partnet is not None else true_folder(truth or Path())
    for name in objects:
        if name not in known:
            raise SpecError(f"object: {choices(name, known)}")
    names = list(objects) or [name for name in known if name in files]
    if not names:
        raise SpecError(
            f"{made} has no object of {partnet or truth}: it has {', '.join(list(files)[:8])}, "
            f"which has {', '.join(list(known)[:8])}"
        )
    stored = RowStore(None if out is None else out / ROWS)

    def scored(name: str) -> list[ObjectScoreRow]:
        true = read_true(known[name], front, samples)
        return [_scored(name, files.get(name), true, options or ProgramOptions(), samples)]

    for name in names:
        rows = (kept or RowStore(None)).rows(name, partial(scored, name))
        stored.put(f"joints {name}", rows)
        yield from rows


def _scored(
    name: str, file: Path | None, true: TrueObject, options: ProgramOptions, samples: int
) -> ObjectScoreRow:
    spec, reason = None, "not made"
    if file is not None:
        try:
            spec, reason = object_of_file(file, options), ""
        except SpecError as error:
            reason = str(error)[:300]
    predicted = ObjectTruth(name=name, box=true.truth.box) if spec is None else spec
    joints = joint_measure(predicted, true.truth)
    parts = {joint.name: joint.child for joint in true.truth.joints}
    return ObjectScoreRow(
        object=name,
        category=true.category,
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
        **_surface(spec, true, samples),
        missed=", ".join(f"{joint} ({parts[joint]})" for joint in joints.missed),
        reason=reason,
    )


def _surface(spec: ObjectSpec | None, true: TrueObject, samples: int) -> dict[str, float | None]:
    if spec is None or true.points is None:
        return dict.fromkeys((*SURFACE, "raw_chamfer_x10", "raw_f_05", "scale"))
    geometry = geometry_measure(spec, true.points, samples=samples)
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
