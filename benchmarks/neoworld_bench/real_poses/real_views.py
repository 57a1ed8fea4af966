"""Rows of reconstructions of real views: depth against a sensor, and poses against truth.

Scores of run folders against the views of a data set.

RUNS/NAME/compose/scene.json     composed; aligned if compose/align.json is there
RUNS/NAME/scene.json             refined
"""

import itertools
from collections.abc import Collection, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from neoworld_mjx.config import Config, RefineOptions
from neoworld_mjx.errors import SpecError
from neoworld_mjx.measure import measured, passes
from neoworld_mjx.render import visible_surface
from neoworld_mjx.spec import Camera, SceneSpec, read_scene, world_poses

from ..measures.joint_measure import mean_of_known
from ..measures.pose_measure import (
    RECALL,
    DepthMeasure,
    Intrinsics,
    Similarity,
    axis_box_iou,
    depth_measure,
    layout_measure,
    recall,
)
from ..measures.pose_measure import measured_points as sensor_points
from ..measures.surface_measure import sampled
from ..rows import Row, RowStore
from ..suites import KnownView
from .placed_views import MadeView, placed_views
from .scene_depth import PosedMesh, in_camera, intrinsics_of, matched, scale_of, scene_points
from .true_views import PosedObject, TrueView, bop_views, depth_views, is_bop, is_depth_folder

POINTS = 10_000
ASPECT = 0.01
"""Largest difference of the logarithms of the image's and the camera's aspect."""


class RealObjectRow(Row):
    """One object of a view at one stage."""

    view: str
    stage: str
    object: str
    """Name in the reconstruction; empty where it has no object for the true one."""
    true_object: str
    """Name in the ground truth; empty for supports and objects that it does not have."""
    visible_px: int
    """Pixels that show the object in the rendered image."""
    measured_px: int
    """Those of them with a depth of the sensor."""
    error_mm: float | None
    """Median distance of the rendered from the measured points after the alignment."""
    absolute_mm: float | None
    """The same without the alignment: nothing is removed."""
    depth_error_mm: float | None
    """Median absolute difference of the depths."""
    bias_mm: float | None
    """Median difference of the depths; positive if the object is too far."""
    position_mm: float | None
    """Distance of the centers of the axis-aligned boxes; this and the following are None for
    objects without a partner."""
    add_s: float | None
    """ADD-S over the true diameter (SAM 3D)."""
    icp_rot_deg: float | None
    box_iou: float | None


class RealViewRow(Row):
    """One view at one stage."""

    view: str
    stage: str
    scale: float
    """Scale factor of the alignment of the scene with the truth."""
    rotation_deg: float
    inliers: float | None
    """Share of the compared pixels within 1.5 % of the median depth; None without depth."""
    true_objects: int
    matched: int
    extra: int
    """Movable objects of the reconstruction without a partner, where objects are known."""
    check_passed: bool
    """True if the scene passes the final check of `neoworld check`."""


def real_rows(
    view: TrueView, made: MadeView, o: RefineOptions
) -> tuple[RealViewRow, list[RealObjectRow]]:
    """Score a reconstruction of a view.

    The whole scene is aligned with the truth by the similarity of the rendered with the sensor's
    depth; without a depth image, by a scale about the camera.

    Args:
        view: the ground truth.
        made: the reconstruction.
        o: options of the final check.

    Raises:
        SpecError: the reconstruction has no camera or one of another aspect, or it cannot be
            aligned.
    """
    where = f"{view.name}, {made.stage}"
    camera = made.scene.camera
    if camera is None:
        raise SpecError(f"{where}: the scene has no camera")
    width, height = size = view.size or (camera.width, camera.height_px)
    if abs(np.log(width / height * camera.height_px / camera.width)) > ASPECT:
        raise SpecError(
            f"{where}: the view has {width} x {height} pixels and the scene's camera "
            f"{camera.width} x {camera.height_px}: expected is the same aspect"
        )
    intrinsics = intrinsics_of(camera, *size)
    meshes = posed_meshes(made.scene, camera)
    supports = {item.name for item in made.scene.objects if item.environment}
    free = {name: mesh for name, mesh in meshes.items() if name not in supports}
    pairs = matched(free, view.objects, intrinsics, view.camera)
    depth = None
    if view.depth is None:
        true = [item for item in view.objects if item.name in pairs]
        similarity = scale_of([free[pairs[item.name]] for item in true], true)
    else:
        depth = _depth(view, made.scene, camera, intrinsics, where)
        similarity = depth.similarity
    check = measured(made.scene, o)
    return RealViewRow(
        view=view.name,
        stage=made.stage,
        scale=similarity.scale,
        rotation_deg=similarity.angle_deg,
        inliers=None if depth is None else depth.inliers,
        true_objects=len(view.objects),
        matched=len(pairs),
        extra=len(free) - len(pairs) if view.objects else 0,
        check_passed=passes(check, o),
    ), list(_object_rows(view, made.stage, meshes, pairs, depth, similarity))


def posed_meshes(scene: SceneSpec, camera: Camera) -> dict[str, PosedMesh]:
    """Return the visible surfaces of a scene's objects in a camera's frame."""
    poses, result = world_poses(scene), {}
    for item in scene.objects:
        vertices, faces = visible_surface(item.spec, item.joint_state)
        points = in_camera(camera, poses[item.name].apply(vertices))
        result[item.name] = PosedMesh(points, np.asarray(faces, np.int64))
    return result


def _depth(
    view: TrueView, scene: SceneSpec, camera: Camera, intrinsics: Intrinsics, where: str
) -> DepthMeasure:
    assert view.depth is not None and view.size is not None
    rendered = scene_points(scene, camera, intrinsics, view.size)
    sensor = sensor_points(view.depth, view.camera)
    try:
        return depth_measure(rendered.points, rendered.segmentation, rendered.names, sensor)
    except ValueError as error:
        raise SpecError(f"{where}: {error}") from None


def _object_rows(
    view: TrueView,
    stage: str,
    meshes: dict[str, PosedMesh],
    pairs: dict[str, str],
    depth: DepthMeasure | None,
    similarity: Similarity,
) -> Iterator[RealObjectRow]:
    partner = {name: true for true, name in pairs.items()}
    true_objects = {item.name: item for item in view.objects}
    objects = [(name, partner.get(name, "")) for name in meshes]
    objects += [("", item.name) for item in view.objects if item.name not in pairs]
    for name, true in objects:
        yield RealObjectRow(
            view=view.name,
            stage=stage,
            object=name,
            true_object=true,
            **_depth_columns(depth, name),
            **_pose_columns(meshes.get(name), true_objects.get(true), similarity),
        )


def _depth_columns(depth: DepthMeasure | None, name: str) -> dict[str, Any]:
    error = None if depth is None else depth.objects.get(name)
    columns: dict[str, Any] = dict.fromkeys(
        ("error_mm", "absolute_mm", "depth_error_mm", "bias_mm")
    )
    if error is None:
        return columns | {"visible_px": 0, "measured_px": 0}
    known = error._asdict()
    return known if error.measured_px else known | columns


def _pose_columns(
    posed: PosedMesh | None, true: PosedObject | None, similarity: Similarity
) -> dict[str, Any]:
    import trimesh

    if posed is None or true is None or not len(posed.faces):
        return dict.fromkeys(("position_mm", "add_s", "icp_rot_deg", "box_iou"))
    a = trimesh.Trimesh(similarity.apply(posed.vertices), posed.faces, process=False)
    b = trimesh.Trimesh(true.posed, true.faces, process=False)
    middles = [(mesh.bounds[0] + mesh.bounds[1]) / 2 for mesh in (a, b)]
    predicted, truth = (sampled([mesh], POINTS, 0) for mesh in (a, b))
    layout = layout_measure(predicted, truth, true.diameter)
    return {
        "position_mm": 1e3 * float(np.linalg.norm(middles[0] - middles[1])),
        "add_s": layout.add_s,
        "icp_rot_deg": layout.icp_rot_deg,
        "box_iou": axis_box_iou(np.asarray(a.vertices), np.asarray(b.vertices)),
    }


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
    config: Config,
    kept: RowStore | None = None,
    *,
    place_with: Sequence[KnownView] = (),
) -> tuple[list[RealViewRow], list[RealObjectRow]]:
    """Score the reconstructions of the views of a data set.

    Args:
        data: folder of the data set.
        runs: folder of run folders that are named after views.
        config: options of the final check, and of Step 4 for `place_with`.
        kept: rows of an interrupted run.
        place_with: what is known when the objects of each run are placed anew.

    Raises:
        SpecError: a file cannot be read, or no run folder has the name of a view.
    """
    if not runs.is_dir():
        raise SpecError(f"{runs} is no folder")
    names = sorted(folder.name for folder in runs.iterdir() if folder.is_dir())
    rows: list[RealViewRow | RealObjectRow] = []
    for view in true_views(data, names):
        score = partial(_scored, view, runs / view.name, config, place_with)
        rows += (kept or RowStore(None)).rows(view.name, score)
    if not rows:
        raise SpecError(
            f"{data}: no view with a reconstruction is named {', '.join(names[:8])}; run folders "
            "are named after the views (docs/benchmark.md)"
        )
    return (
        [row for row in rows if isinstance(row, RealViewRow)],
        [row for row in rows if isinstance(row, RealObjectRow)],
    )


def _scored(
    view: TrueView, run: Path, config: Config, place_with: Sequence[KnownView]
) -> Iterator[RealViewRow | RealObjectRow]:
    placed = placed_views(view, run, place_with, config)
    for made in itertools.chain(run_stages(run), placed):
        row, object_rows = real_rows(view, made, config.refine)
        yield row
        yield from object_rows


def run_stages(folder: Path) -> Iterator[MadeView]:
    """Read the stages of a run folder.

    Raises:
        SpecError: a scene cannot be read.
    """
    first = "aligned" if (folder / ALIGNED).is_file() else "composed"
    for stage, file in ((first, "compose/scene.json"), ("refined", "scene.json")):
        if (folder / file).is_file():
            yield MadeView(stage, read_scene(folder / file))


def real_figures(
    views: Sequence[RealViewRow], objects: Sequence[RealObjectRow]
) -> dict[str, dict[str, Any]]:
    """Return the means by stage, each with its n, and the recall over true objects.

    "unmeasured" is the number of objects that have no error, as they show no measured pixel.
    """
    figures = {}
    for stage in dict.fromkeys(row.stage for row in views):
        stage_views = [row for row in views if row.stage == stage]
        stage_objects = [row for row in objects if row.stage == stage]
        true = [row for row in stage_objects if row.true_object]
        errors = [row.error_mm for row in stage_objects if row.error_mm is not None]
        absolute = [row.absolute_mm for row in stage_objects if row.absolute_mm is not None]
        figure: dict[str, Any] = {
            "views": len(stage_views),
            "check_passed": float(np.mean([row.check_passed for row in stage_views])),
        }
        if errors:
            for name, values in (("error_mm", errors), ("absolute_mm", absolute)):
                figure[f"median_{name}"] = {"value": float(np.median(values)), "n": len(values)}
            made = [row for row in stage_objects if row.object]
            figure["unmeasured"] = sum(row.absolute_mm is None for row in made)
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
