"""Scores of run folders against the views of a data set with true poses.

RUNS/NAME/compose/scene.json     composed; aligned if compose/align.json is there
RUNS/NAME/scene.json             refined
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.errors import SpecError
from neoworld_mjx.measure import measured, passes
from neoworld_mjx.render import visible_surface
from neoworld_mjx.spec import Camera, SceneSpec, read_scene, world_poses

from ..measures.joint_measure import mean_of_known
from ..measures.pose_measure import RECALL, axis_box_iou, layout_measure, recall
from ..measures.surface_measure import sampled
from ..rows import Row, RowStore
from .object_matching import PosedMesh, in_camera, intrinsics_of, matched, scale_of
from .true_views import PosedObject, TrueView, bop_views

POINTS = 10_000
ASPECT = 0.01
"""Largest difference of the logarithms of the image's and the camera's aspect."""


@dataclass(frozen=True)
class MadeView:
    """A reconstruction of a view at one stage: composed, aligned or refined."""

    stage: str
    scene: SceneSpec


class RealObjectRow(Row):
    """One object of a view at one stage."""

    view: str
    stage: str
    object: str
    """Name in the reconstruction; empty where it has no object for the true one."""
    true_object: str
    """Name in the ground truth; empty for objects that it does not have."""
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
    """Scale about the camera that aligns the scene with the truth."""
    true_objects: int
    matched: int
    extra: int
    """Movable objects of the reconstruction without a partner."""
    check_passed: bool
    """True if the scene passes the final check of `neoworld check`."""


def real_rows(
    view: TrueView, made: MadeView, o: RefineOptions
) -> tuple[RealViewRow, list[RealObjectRow]]:
    """Score a reconstruction of a view.

    One photograph does not determine the scale, so the whole scene is scaled about the camera by
    the median ratio of the objects' distances.

    Args:
        view: the ground truth.
        made: the reconstruction.
        o: options of the final check.

    Raises:
        SpecError: the reconstruction has no camera or one of another aspect.
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
    true = [item for item in view.objects if item.name in pairs]
    scale = scale_of([free[pairs[item.name]] for item in true], true)
    check = measured(made.scene, o)
    return RealViewRow(
        view=view.name,
        stage=made.stage,
        scale=scale,
        true_objects=len(view.objects),
        matched=len(pairs),
        extra=len(free) - len(pairs),
        check_passed=passes(check, o),
    ), list(_object_rows(view, made.stage, free, pairs, scale))


def posed_meshes(scene: SceneSpec, camera: Camera) -> dict[str, PosedMesh]:
    """Return the visible surfaces of a scene's objects in a camera's frame."""
    poses, result = world_poses(scene), {}
    for item in scene.objects:
        vertices, faces = visible_surface(item.spec, item.joint_state)
        points = in_camera(camera, poses[item.name].apply(vertices))
        result[item.name] = PosedMesh(points, np.asarray(faces, np.int64))
    return result


def _object_rows(
    view: TrueView,
    stage: str,
    meshes: dict[str, PosedMesh],
    pairs: dict[str, str],
    scale: float,
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
            **_pose_columns(meshes.get(name), true_objects.get(true), scale),
        )


def _pose_columns(
    posed: PosedMesh | None, true: PosedObject | None, scale: float
) -> dict[str, Any]:
    import trimesh

    if posed is None or true is None or not len(posed.faces):
        return dict.fromkeys(("position_mm", "add_s", "icp_rot_deg", "box_iou"))
    a = trimesh.Trimesh(scale * posed.vertices, posed.faces, process=False)
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
    for view in bop_views(data, names):
        score = partial(_scored, view, runs / view.name, options or RefineOptions())
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
    first = "aligned" if (folder / ALIGNED).is_file() else "composed"
    for stage, file in ((first, "compose/scene.json"), ("refined", "scene.json")):
        if (folder / file).is_file():
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
        figure: dict[str, Any] = {
            "views": len(stage_views),
            "check_passed": float(np.mean([row.check_passed for row in stage_views])),
        }
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
