"""Rows of reconstructions of real views: depth against a sensor, and poses against truth."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.errors import SpecError
from neoworld_mjx.measure import measured, passes
from neoworld_mjx.render import visible_surface
from neoworld_mjx.spec import Camera, SceneSpec, world_poses

from ..measures.depth_measure import DepthMeasure, Intrinsics, Similarity, depth_measure
from ..measures.depth_measure import measured_points as sensor_points
from ..measures.pose_measure import axis_box_iou, layout_measure
from ..measures.surface_measure import sampled
from ..rows import Row
from .scene_depth import PosedMesh, in_camera, intrinsics_of, matched, scale_of, scene_points
from .true_views import PosedObject, TrueView

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
    """Name in the ground truth; empty for supports and objects that it does not have."""
    visible_px: int
    """Pixels that show the object in the rendered image."""
    measured_px: int
    """Those of them with a depth of the sensor."""
    error_mm: float | None
    """Median distance of the rendered from the measured points after the alignment."""
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
    columns: dict[str, Any] = dict.fromkeys(("error_mm", "depth_error_mm", "bias_mm"))
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
