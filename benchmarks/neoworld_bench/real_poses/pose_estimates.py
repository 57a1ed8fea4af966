"""Poses that other methods estimate for the models of a BOP data set, by BOP's results file.

    scene_id,im_id,obj_id,score,R,t,time
    48,1,1,0.93,1 0 0 0 1 0 0 0 1,10.5 -3.2 812.0,0.05

R has nine numbers row by row, t is in millimeters; both map the model's frame to the camera's
(thodan/bop_toolkit, docs/bop_challenge_2019.md, commit 0eafdbe).
"""

import csv
import io
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import linear_sum_assignment

from neoworld_mjx.errors import SpecError
from neoworld_mjx.io import read_untrusted_text
from neoworld_mjx.io.names import identifier

from ..measures.pose_measure import RECALL, add, adi, recall
from ..rows import Row
from .bop import bop_targets, bop_views
from .true_views import PosedObject, TrueView, rigid

COLUMNS = ("scene_id", "im_id", "obj_id", "score", "R", "t")


class PoseEstimate(NamedTuple):
    """One line of a results file."""

    stem: str
    """Name of the model, such as obj_000001."""
    score: float
    pose: Float[np.ndarray, "4 4"]
    """Pose of the model in the camera's frame [m]."""


class PoseEstimateRow(Row):
    """Pose estimate of one true object."""

    view: str
    method: str
    object: str
    add: float | None
    """ADD over the diameter; None without an estimate, as the following."""
    adi: float | None
    """ADD-S over the diameter, as BOP defines it for poses of one model (ADI)."""
    position_mm: float | None
    """Distance of the origins."""


def read_estimates(file: Path) -> dict[str, list[PoseEstimate]]:
    """Read a results file: the estimates of each view, the best first.

    Raises:
        SpecError: it cannot be read, or a line is no estimate.
    """
    reader = csv.DictReader(io.StringIO(read_untrusted_text(file, SpecError)))
    if not set(COLUMNS) <= set(reader.fieldnames or ()):
        raise SpecError(f"{file}: the first line must name {','.join(COLUMNS)}")
    views: dict[str, list[PoseEstimate]] = {}
    try:
        for number, line in enumerate(reader, start=2):
            name, estimate = _estimate(line, f"{file}, line {number}")
            views.setdefault(name, []).append(estimate)
    except csv.Error as error:
        raise SpecError(f"{file} is no table: {error}") from None
    return {name: sorted(of_view, key=lambda e: -e.score) for name, of_view in views.items()}


def estimate_rows(data: Path, file: Path) -> Iterator[PoseEstimateRow]:
    """Score the estimates of a results file, for every true object of its views.

    Where the data set lists BOP's targets, its objects and views are those, whether or not the
    file has estimates for them. Of each model as many estimates count as it has instances, the
    best first; they are paired with the instances by the least sum of ADD-S.

    Args:
        data: the data set, in the BOP format.
        file: the results file, whose name is that of the method.

    Raises:
        SpecError: a file cannot be read, or the data has none of its views.
    """
    views, method = read_estimates(file), f"poses:{identifier(file.stem, 'poses')}"
    targets, any_view = bop_targets(data), False
    for view in bop_views(data, targets or views):
        any_view = any_view or view.name in views
        yield from _rows(view, views.get(view.name, []), method, targets.get(view.name))
    if not any_view:
        raise SpecError(f"{file}: {data} has none of its views, such as {next(iter(views), '')}")


def estimate_figures(rows: Collection[PoseEstimateRow]) -> dict[str, Any]:
    """Return the recalls at a tenth of the diameter; missed objects count as errors."""
    return {
        "true_objects": len(rows),
        "missed": sum(row.adi is None for row in rows),
        f"add_recall_{RECALL:g}d": recall([row.add for row in rows]),
        f"add_s_recall_{RECALL:g}d": recall([row.adi for row in rows]),
    }


def _rows(
    view: TrueView, estimates: list[PoseEstimate], method: str, models: Collection[str] | None
) -> Iterator[PoseEstimateRow]:
    """Score the estimates of a view, for all its models or those that are named."""
    by_model: dict[str, list[PosedObject]] = {}
    for item in view.objects:
        stem = item.name[: len("obj_000000")]
        if models is None or stem in models:
            by_model.setdefault(stem, []).append(item)
    for stem, items in by_model.items():
        candidates = [each for each in estimates if each.stem == stem][: len(items)]
        cost = np.array(
            [[adi(item.vertices, e.pose, item.pose) for e in candidates] for item in items]
        )
        pairs = dict(zip(*linear_sum_assignment(cost), strict=True)) if candidates else {}
        for index, item in enumerate(items):
            estimate = candidates[pairs[index]].pose if index in pairs else None
            yield PoseEstimateRow(
                view=view.name, method=method, object=item.name, **_errors(item, estimate)
            )


def _errors(item: PosedObject, pose: Float[np.ndarray, "4 4"] | None) -> dict[str, float | None]:
    if pose is None:
        return dict.fromkeys(("add", "adi", "position_mm"))
    return {
        "add": add(item.vertices, pose, item.pose) / item.diameter,
        "adi": adi(item.vertices, pose, item.pose) / item.diameter,
        "position_mm": 1e3 * float(np.linalg.norm(pose[:3, 3] - item.pose[:3, 3])),
    }


def _estimate(line: Mapping[str, Any], where: str) -> tuple[str, PoseEstimate]:
    try:
        scene, image, model = (int(line[key]) for key in COLUMNS[:3])
        turn, shift = (np.array([float(v) for v in line[key].split()]) for key in ("R", "t"))
        score = float(line["score"])
    except (TypeError, ValueError, AttributeError):
        raise SpecError(f"{where} is no estimate: a value is no number") from None
    if turn.size != 9 or shift.size != 3 or not np.isfinite([*turn, *shift, score]).all():
        raise SpecError(f"{where}: R must be nine finite numbers and t three")
    return f"{scene:06d}_{image:06d}", PoseEstimate(
        f"obj_{model:06d}", score, rigid(turn, 1e-3 * shift, where)
    )
