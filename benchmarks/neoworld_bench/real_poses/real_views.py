"""Scores of run folders against the views of a data set.

RUNS/NAME/composed.json | compose/scene.json     composed; aligned if compose/align.json is there
RUNS/NAME/aligned.json, RUNS/NAME/scene.json     aligned, and refined
"""

from collections.abc import Collection, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.errors import SpecError
from neoworld_mjx.spec import read_scene

from ..measures.mean import mean_of_known
from ..measures.pose_measure import RECALL, recall
from ..rows import RowStore
from .bop import bop_views, is_bop
from .pose_rows import MadeView, RealObjectRow, RealViewRow, real_rows
from .true_views import TrueView, depth_views, is_depth_folder

STAGES = (
    ("composed", "composed.json"),
    ("composed", "compose/scene.json"),
    ("aligned", "aligned.json"),
    ("refined", "scene.json"),
)
"""Stage of a run and its file; of several files of a stage the first counts."""
ALIGNED = "compose/align.json"
MEANS = ("position_mm", "add_s", "icp_rot_deg", "box_iou")


def true_views(data: Path, names: Collection[str]) -> Iterator[TrueView]:
    """Read views of a data set in the BOP format, or of a folder of depth images.

    Args:
        data: its folder.
        names: of the views to read, as far as there are any.

    Raises:
        SpecError: the folder has neither format, or a file is missing or broken.
    """
    if is_bop(data):
        return bop_views(data, names)
    if is_depth_folder(data):
        return depth_views(data, names)
    raise SpecError(
        f"{data} has neither scene_gt.json (BOP) nor NAME-depth.png; docs/real-poses.md has the "
        "layouts"
    )


def score_real_views(
    data: Path,
    runs: Path,
    options: RefineOptions | None = None,
    kept: RowStore | None = None,
) -> tuple[list[RealViewRow], list[RealObjectRow]]:
    """Score the reconstructions of the views of a data set.

    Args:
        data: folder of the data set.
        runs: folder of run folders that are named after views.
        options: of the final check.
        kept: rows of an interrupted run.

    Raises:
        SpecError: a file cannot be read, or no run folder has the name of a view.
    """
    if not runs.is_dir():
        raise SpecError(f"{runs} is no folder")
    names = sorted(folder.name for folder in runs.iterdir() if folder.is_dir())
    rows: list[RealViewRow | RealObjectRow] = []
    for view in true_views(data, names):
        score = partial(_scored, view, runs / view.name, options or RefineOptions())
        rows += (kept or RowStore(None)).rows(view.name, score)
    if not rows:
        raise SpecError(
            f"{data}: no view with a reconstruction is named {', '.join(names[:8])}; run folders "
            "are named after the views (docs/real-poses.md)"
        )
    return (
        [row for row in rows if isinstance(row, RealViewRow)],
        [row for row in rows if isinstance(row, RealObjectRow)],
    )


def _scored(view: TrueView, run: Path, o: RefineOptions) -> Iterator[RealViewRow | RealObjectRow]:
    for made in run_stages(run):
        row, object_rows = real_rows(view, made, o)
        yield row
        yield from object_rows


def run_stages(folder: Path) -> Iterator[MadeView]:
    """Read the stages of a run folder.

    Raises:
        SpecError: a scene cannot be read.
    """
    stages = set()
    for stage, file in STAGES:
        if file.startswith("compose/") and (folder / ALIGNED).is_file():
            stage = "aligned"
        if stage not in stages and (folder / file).is_file():
            stages.add(stage)
            yield MadeView(stage, read_scene(folder / file))


def real_figures(
    views: Sequence[RealViewRow], objects: Sequence[RealObjectRow]
) -> dict[str, dict[str, Any]]:
    """Return the means by stage, each with its n, and the recall over true objects."""
    figures = {}
    for stage in dict.fromkeys(row.stage for row in views):
        stage_views = [row for row in views if row.stage == stage]
        stage_objects = [row for row in objects if row.stage == stage]
        true = [row for row in stage_objects if row.true_object]
        errors = [row.error_mm for row in stage_objects if row.error_mm is not None]
        figure: dict[str, Any] = {
            "views": len(stage_views),
            "check_passed": float(np.mean([row.check_passed for row in stage_views])),
        }
        if errors:
            figure["median_error_mm"] = {"value": float(np.median(errors)), "n": len(errors)}
        if true:
            figure |= {
                "true_objects": len(true),
                "missed": sum(not row.object for row in true),
                "extra": sum(row.extra for row in stage_views),
                f"add_s_recall_{RECALL:g}d": recall([row.add_s for row in true]),
            }
            for name in MEANS:
                figure[name] = mean_of_known([getattr(row, name) for row in true]).model_dump()
        figures[stage] = figure
    return figures
