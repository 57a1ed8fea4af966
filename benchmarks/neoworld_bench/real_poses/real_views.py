"""Scores of run folders against the views of a data set.

RUNS/NAME/composed.json | compose/scene.json     composed; aligned if compose/align.json is there
RUNS/NAME/aligned.json, RUNS/NAME/scene.json     aligned, and refined
"""

from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.errors import ConfigError, SpecError
from neoworld_mjx.spec import read_scene

from ..measures.mean import mean_of_known
from ..measures.pose_measure import RECALL, recall
from ..rows import RowStore
from .bop import bop_views, is_bop
from .depth_folder import depth_views, is_depth_folder
from .pose_rows import MadeView, RealObjectRow, RealViewRow, real_rows
from .true_views import TrueView

STAGES = (
    ("composed", "composed.json"),
    ("composed", "compose/scene.json"),
    ("aligned", "aligned.json"),
    ("refined", "scene.json"),
)
"""Stage of a run and its file; of several files of a stage the first counts."""
ALIGNED = "compose/align.json"
MEANS = ("position_mm", "add_s", "icp_rot_deg", "box_iou")


def true_views(
    data: Path,
    names: Collection[str],
    *,
    intrinsics: tuple[float, float, float, float] | None = None,
    depth_scale: float | None = None,
) -> Iterator[TrueView]:
    """Read views of a data set in the BOP format, or of a folder of depth images.

    Args:
        data: its folder.
        names: of the views to read, as far as there are any.
        intrinsics: fx, fy, cx and cy [px] of a folder of depth images without a camera.json.
        depth_scale: millimeters of a unit of its depth images.

    Raises:
        SpecError: the folder has neither format, or a file is missing or broken.
        ConfigError: intrinsics are given for data that has its own.
    """
    if not data.is_dir():
        raise SpecError(f"{data} is no folder")
    if is_bop(data):
        if intrinsics is not None or depth_scale is not None:
            raise ConfigError("--intrinsics and --depth-scale are for folders of depth images")
        return bop_views(data, names)
    if is_depth_folder(data):
        return depth_views(data, names, intrinsics=intrinsics, depth_scale=depth_scale)
    raise SpecError(
        f"{data} has neither scene_gt.json (BOP) nor NAME-depth.png; docs/real-poses.md has the "
        "layouts"
    )


def score_real_views(
    data: Path,
    runs: Sequence[Path],
    *,
    views: Sequence[str] = (),
    intrinsics: tuple[float, float, float, float] | None = None,
    depth_scale: float | None = None,
    options: RefineOptions | None = None,
    kept: RowStore | None = None,
) -> tuple[list[RealViewRow], list[RealObjectRow]]:
    """Score the reconstructions of the views of a data set.

    Args:
        data: folder of the data set.
        runs: run folders named after views, or folders of such folders.
        views: names of views; all that have a reconstruction by default.
        intrinsics: as for `true_views`, as depth_scale.
        depth_scale: millimeters of a unit.
        options: of the final check.
        kept: rows of an interrupted run.

    Raises:
        ConfigError: there is nothing to score.
        SpecError: a file cannot be read, or no reconstruction has the name of a view.
    """
    if not runs:
        raise ConfigError("real-poses needs --runs DIR, run folders named after the views")
    names = list(views) or _folder_names(runs)
    rows: list[RealViewRow | RealObjectRow] = []
    for view in true_views(data, names, intrinsics=intrinsics, depth_scale=depth_scale):
        o = options or RefineOptions()
        score = lambda view=view, o=o: list(_scored(view, runs, o))
        rows += (kept or RowStore(None)).rows(view.name, score)
    missing = [name for name in views if name not in {row.view for row in rows}]
    if missing or not rows:
        raise SpecError(
            f"{data}: no view with a reconstruction is named {', '.join((missing or names)[:8])}; "
            "run folders are named after the views (docs/real-poses.md)"
        )
    return (
        [row for row in rows if isinstance(row, RealViewRow)],
        [row for row in rows if isinstance(row, RealObjectRow)],
    )


def _scored(
    view: TrueView, runs: Sequence[Path], o: RefineOptions
) -> Iterator[RealViewRow | RealObjectRow]:
    for made in run_views(runs, view.name):
        row, object_rows = real_rows(view, made, o)
        yield row
        yield from object_rows


def run_views(runs: Sequence[Path], name: str) -> Iterator[MadeView]:
    """Read the stages of the run of a view; none where no folder has it.

    Args:
        runs: run folders named after their views, or folders of such folders.
        name: of the view.

    Raises:
        SpecError: a scene cannot be read.
    """
    for root in runs:
        folder = root if root.resolve().name == name else root / name
        stages = set()
        for stage, file in STAGES:
            if file.startswith("compose/") and (folder / ALIGNED).is_file():
                stage = "aligned"
            if stage not in stages and (folder / file).is_file():
                stages.add(stage)
                yield MadeView(stage, read_scene(folder / file))


def _folder_names(roots: Sequence[Path]) -> list[str]:
    """Return the names that views may have: of the folders, and of those within them."""
    names = []
    for root in roots:
        if not root.is_dir():
            raise SpecError(f"{root} is no folder")
        names += [root.resolve().name]
        names += sorted(folder.name for folder in root.iterdir() if folder.is_dir())
    return list(dict.fromkeys(names))


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
