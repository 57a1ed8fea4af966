"""Views of real photographs by the format of their data, and the scores of all reconstructions."""

from collections.abc import Collection, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.errors import ConfigError, SpecError

from ..measures.mean import mean_of_known
from ..measures.pose_measure import RECALL, recall
from ..rows import ROWS, RowStore, log
from .aria_twin import aria_views, is_aria_twin
from .bop import bop_views, is_bop
from .depth_folder import depth_views, is_depth_folder
from .made_views import MadeView, folder_names, run_views, submitted_view
from .messy_kitchens import is_messy_kitchens, messy_views
from .pose_rows import AlignBy, RealObjectRow, RealViewRow, real_rows
from .true_views import TrueView

DataFormat = Literal["auto", "depth", "bop", "messy-kitchens", "aria-twin"]
MEANS = ("position_mm", "add_s", "icp_rot_deg", "box_iou", "chamfer", "f_score", "voxel_iou")


def true_views(
    data: Path,
    kind: DataFormat,
    names: Collection[str],
    *,
    intrinsics: tuple[float, float, float, float] | None = None,
    depth_scale: float | None = None,
) -> Iterator[TrueView]:
    """Read views of a data set.

    Args:
        data: its folder.
        kind: format; auto takes what the folder's files show.
        names: of the views to read, as far as there are any.
        intrinsics: fx, fy, cx and cy [px] of a folder of depth images without a camera.json.
        depth_scale: millimeters of a unit of its depth images.

    Raises:
        SpecError: the folder has no known format, or a file is missing or broken.
        ConfigError: intrinsics are given for data that has its own.
    """
    if not data.is_dir():
        raise SpecError(f"{data} is no folder")
    if kind == "auto":
        kind = format_of(data)
    if kind == "depth":
        yield from depth_views(data, names, intrinsics=intrinsics, depth_scale=depth_scale)
        return
    if intrinsics is not None or depth_scale is not None:
        raise ConfigError("--intrinsics and --depth-scale are for folders of depth images alone")
    readers = {"bop": bop_views, "messy-kitchens": messy_views, "aria-twin": aria_views}
    yield from readers[kind](data, names)


def format_of(data: Path) -> DataFormat:
    """Return the format that a folder's files show.

    Raises:
        SpecError: none.
    """
    if is_bop(data):
        return "bop"
    if is_messy_kitchens(data):
        return "messy-kitchens"
    if is_aria_twin(data):
        return "aria-twin"
    if is_depth_folder(data):
        return "depth"
    raise SpecError(
        f"{data} has the files of none of these formats: scene_gt.json (BOP), object_models and "
        "scenes (MessyKitchens), scene_objects.csv (Aria Digital Twin), NAME-depth.png; "
        "docs/real-poses.md has their layouts"
    )


def score_real_views(
    data: Path,
    *,
    runs: Sequence[Path] = (),
    submission: Path | None = None,
    kind: DataFormat = "auto",
    views: Sequence[str] = (),
    align: AlignBy = "auto",
    intrinsics: tuple[float, float, float, float] | None = None,
    depth_scale: float | None = None,
    volumes: bool = True,
    options: RefineOptions | None = None,
    out: Path | None = None,
    kept: RowStore | None = None,
) -> tuple[list[RealViewRow], list[RealObjectRow]]:
    """Score the reconstructions of the views of a data set.

    Args:
        data: folder of the data set.
        runs: run folders named after views, or folders of such folders.
        submission: folder of another method's scenes.
        kind: format of the data.
        views: names of views; all that have a reconstruction by default.
        align: alignment of each scene.
        intrinsics: as for `true_views`, as depth_scale.
        depth_scale: millimeters of a unit.
        volumes: False to leave out Chamfer distance, F-score and voxel IoU.
        options: of the final check.
        out: folder of results, in which rows replace those of the same view and method.
        kept: rows of an interrupted run.

    Raises:
        ConfigError: there is nothing to score.
        SpecError: a file cannot be read, or no reconstruction has the name of a view.
        RunError: the row files cannot be read or written.
    """
    if not runs and submission is None:
        raise ConfigError(
            "real-poses needs --runs DIR, run folders, --submission DIR or --poses FILE"
        )
    roots = [*runs, *([] if submission is None else [submission])]
    names = list(views) or folder_names(roots)
    stored = RowStore(out and out / ROWS)
    view_rows: list[RealViewRow] = []
    object_rows: list[RealObjectRow] = []
    matched = set()
    for view in true_views(data, kind, names, intrinsics=intrinsics, depth_scale=depth_scale):
        reconstructions = _reconstructions(view.name, runs, submission)
        by_method: dict[str, list[MadeView]] = {}
        for stage in reconstructions:
            by_method.setdefault(stage.method, []).append(stage)
        for method, stages in by_method.items():
            score = partial(_scored, view, stages, align, options or RefineOptions(), volumes)
            rows = (kept or RowStore(None)).rows(f"{view.name} {method}", score)
            stored.put(f"real {view.name} {method}", rows)
            view_part = [row for row in rows if isinstance(row, RealViewRow)]
            object_part = [row for row in rows if isinstance(row, RealObjectRow)]
            view_rows += view_part
            object_rows += object_part
            for line in lines(view_part, object_part):
                log.info(line)
            matched.add(view.name)
    missing = [name for name in views if name not in matched]
    if missing or not matched:
        raise SpecError(
            f"{data}: no view with a reconstruction is named {', '.join((missing or names)[:8])}; "
            "folders of reconstructions are named after the views (docs/real-poses.md)"
        )
    return view_rows, object_rows


def _scored(
    view: TrueView, stages: Sequence[MadeView], align: AlignBy, o: RefineOptions, volumes: bool
) -> Iterator[RealViewRow | RealObjectRow]:
    for stage in stages:
        row, rows = real_rows(view, stage, align, o, volumes=volumes)
        yield row
        yield from rows


def _reconstructions(name: str, runs: Sequence[Path], submission: Path | None) -> list[MadeView]:
    reconstructions = list(run_views(runs, name))
    submitted = None if submission is None else submitted_view(submission, name)
    return reconstructions if submitted is None else [*reconstructions, submitted]


def lines(views: Sequence[RealViewRow], objects: Sequence[RealObjectRow]) -> Iterator[str]:
    """Yield lines of the log: one for each stage, and one for each of its objects."""
    for view in views:
        share = "" if view.inliers is None else f", {100 * view.inliers:.0f} % of the pixels within"
        yield f"{view.view} {view.method} {view.stage}: scale {view.scale:.3f}{share}"
        for row in objects:
            if (row.view, row.method, row.stage) == (view.view, view.method, view.stage):
                yield "  " + _line(row)


def _line(row: RealObjectRow) -> str:
    figures = [
        f"{label} {value:.{digits}f}"
        for label, value, digits in (
            ("error mm", row.error_mm, 1),
            ("bias mm", row.bias_mm, 1),
            ("ADD-S", row.add_s, 3),
            ("ICP deg", row.icp_rot_deg, 1),
            ("box IoU", row.box_iou, 3),
        )
        if value is not None
    ]
    name = row.object or f"{row.true_object} (missed)"
    return f"{name}: {', '.join(figures) or 'nothing to compare'}"


def real_figures(views: Sequence[RealViewRow], objects: Sequence[RealObjectRow]) -> dict[str, Any]:
    """Return the means by method and stage, each with its n, and the recall over true objects."""
    figures: dict[str, Any] = {}
    for method, stage in dict.fromkeys((row.method, row.stage) for row in views):
        stage_views = [row for row in views if (row.method, row.stage) == (method, stage)]
        stage_objects = [row for row in objects if (row.method, row.stage) == (method, stage)]
        true = [row for row in stage_objects if row.true_object]
        errors = [row.error_mm for row in stage_objects if row.error_mm is not None]
        gaps = [row.collider_sound for row in stage_objects if row.collider_sound is not None]
        figure: dict[str, Any] = {"views": len(stage_views)}
        if errors:
            figure["median_error_mm"] = {"value": float(np.median(errors)), "n": len(errors)}
        if true:
            figure |= {
                "true_objects": len(true),
                "missed": sum(not row.object for row in true),
                "extra": sum(row.extra for row in stage_views),
                f"add_s_recall_{RECALL:g}d": recall([row.add_s for row in true]),
                **{
                    name: mean_of_known([getattr(row, name) for row in true]).model_dump()
                    for name in MEANS
                },
            }
        figure["check_passed"] = float(np.mean([row.check_passed for row in stage_views]))
        figure["collider_sound"] = float(np.mean(gaps)) if gaps else None
        figures[f"{method} {stage}"] = figure
    return figures
