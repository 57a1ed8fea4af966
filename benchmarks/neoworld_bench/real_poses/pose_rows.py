"""Rows of reconstructions of real views: depth against a sensor, poses and shapes against truth."""

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.errors import SpecError
from neoworld_mjx.export.read_mesh_scene import FileCamera, viewpoint
from neoworld_mjx.measure import measured, passes
from neoworld_mjx.render import visible_surface
from neoworld_mjx.spec import Camera, SceneSpec, world_poses
from neoworld_mjx.spec.scene import transformed_scene

from ..measures.collider_measure import collider_gap
from ..measures.depth_measure import (
    IDENTITY,
    DepthMeasure,
    Intrinsics,
    Similarity,
    depth_measure,
    measured_points,
)
from ..measures.pose_measure import axis_box_iou, layout_measure
from ..measures.surface_measure import sampled
from ..measures.volume_measure import volume_measure
from ..rows import Row
from .made_views import MadeView
from .object_matching import PosedMesh, matched, scale_of, similarity_of
from .scene_depth import ScenePoints, in_camera, intrinsics_of, scene_points
from .true_views import PosedObject, TrueView

AlignBy = Literal["auto", "none", "scale", "depth", "objects"]
"""Alignment of the whole scene: none; a scale about the camera; the similarity of the rendered with
the sensor's depth; the similarity of the objects' centroids. auto takes depth if the view has it,
else scale, or objects without a camera."""
POINTS = 10_000
ASPECT = 0.01
"""Largest difference of the logarithms of the image's and the camera's aspect."""


class RealObjectRow(Row):
    """One object of a view at one stage of a method."""

    view: str
    method: str
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
    chamfer: float | None
    """In the frame in which the true object fits [-1, 1]^3, as the two following."""
    f_score: float | None
    voxel_iou: float | None
    collider_protruding_mm: float | None
    collider_short_mm: float | None
    collider_sound: bool | None

    @property
    def key(self) -> tuple[str, str]:
        """Key of its view's row."""
        return self.view, self.method


class RealViewRow(Row):
    """One view at one stage of a method."""

    view: str
    method: str
    stage: str
    align: str
    """Alignment of the scene with the truth."""
    scale: float
    """Scale factor of that alignment."""
    rotation_deg: float
    inliers: float | None
    """Share of the compared pixels within 1.5 % of the median depth; None without depth."""
    true_objects: int
    matched: int
    extra: int
    """Movable objects of the reconstruction without a partner, where objects are known."""
    s_pen: int
    max_depth_m: float
    s_stab: bool | None
    max_drift_m: float
    max_tilt_deg: float
    check_passed: bool
    """True if the scene passes the final check of `neoworld check`."""
    notes: str

    @property
    def key(self) -> tuple[str, str]:
        """View and method, whose rows are replaced together."""
        return self.view, self.method


def real_rows(
    view: TrueView, made: MadeView, align: AlignBy, o: RefineOptions, *, volumes: bool = True
) -> tuple[RealViewRow, list[RealObjectRow]]:
    """Score a reconstruction of a view.

    Args:
        view: the ground truth.
        made: the reconstruction.
        align: how the scene is aligned with the truth.
        o: options of the final check.
        volumes: False to leave out Chamfer distance, F-score and voxel IoU, which take seconds.

    Raises:
        SpecError: the reconstruction's camera has another aspect, or it cannot be aligned.
    """
    where = f"{view.name}, {made.method} {made.stage}"
    made = _before_camera(made, view)
    camera, intrinsics = _camera_of(made, view, where)
    meshes = posed_meshes(made.scene, camera)
    supports = {item.name for item in made.scene.objects if item.environment}
    free = {name: mesh for name, mesh in meshes.items() if name not in supports}
    pairs = matched(
        free, view.objects, made.matches, made_camera=intrinsics, true_camera=view.camera
    )
    align = _chosen(align, view)
    rendered = _rendered_points(view, made.scene, camera, intrinsics)
    depth, similarity = _aligned(view, rendered, free, pairs, align, where)
    rows = list(_object_rows(view, made, meshes, pairs, depth, similarity, volumes))
    measure = measured(made.scene, o)
    known = len(free) - len(pairs) if view.objects else 0
    return RealViewRow(
        view=view.name,
        method=made.method,
        stage=made.stage,
        align=align,
        scale=similarity.scale,
        rotation_deg=similarity.angle_deg,
        inliers=None if depth is None else depth.inliers,
        true_objects=len(view.objects),
        matched=len(pairs),
        extra=known,
        s_pen=measure.s_pen or 0,
        max_depth_m=measure.max_depth_m,
        s_stab=measure.s_stab,
        max_drift_m=min(measure.max_drift_m, 1e6),
        max_tilt_deg=min(measure.max_tilt_deg, 1e6),
        check_passed=passes(measure, o),
        notes="; ".join(made.notes),
    ), rows


def posed_meshes(scene: SceneSpec, camera: Camera | None) -> dict[str, PosedMesh]:
    """Return the visible surfaces of a scene's objects in a camera's frame, or in the world."""
    poses, result = world_poses(scene), {}
    for item in scene.objects:
        vertices, faces = visible_surface(item.spec, item.joint_state)
        points = poses[item.name].apply(vertices)
        result[item.name] = PosedMesh(
            points if camera is None else in_camera(camera, points), np.asarray(faces, np.int64)
        )
    return result


def _before_camera(made: MadeView, view: TrueView) -> MadeView:
    """Return a reconstruction with the camera that its file states, with the view's intrinsics."""
    stated = made.camera
    if stated is None or stated.pose is None or view.camera is None or view.size is None:
        return made
    fovy = 2 * math.atan(view.size[1] / 2 / view.camera.fy)
    camera, scene_transform, _, _ = viewpoint(FileCamera(pose=stated.pose, fovy=fovy), *view.size)
    scene = transformed_scene(made.scene, scene_transform).model_copy(update={"camera": camera})
    return replace(made, scene=scene)


def _camera_of(
    made: MadeView, view: TrueView, where: str
) -> tuple[Camera | None, Intrinsics | None]:
    """Return the pose of the camera in the scene, and the intrinsics of its image.

    A scene without a camera is in the view's camera frame: x ahead, y to the left, z up.
    """
    if view.camera is None or view.size is None:
        return None, None
    (width, height), camera = view.size, made.scene.camera
    if camera is None:
        fovy = 2 * math.atan(height / 2 / view.camera.fy)
        return Camera(width=width, height_px=height, fovy=fovy, height=0, pitch=0), view.camera
    if abs(np.log(width / height * camera.height_px / camera.width)) > ASPECT:
        raise SpecError(
            f"{where}: the view has {width} x {height} pixels and the scene's camera "
            f"{camera.width} x {camera.height_px}: expected is the same aspect"
        )
    stated = made.camera is not None and made.camera.pose is not None
    return camera, view.camera if stated else intrinsics_of(camera, width, height)


def _rendered_points(
    view: TrueView, scene: SceneSpec, camera: Camera | None, intrinsics: Intrinsics | None
) -> ScenePoints | None:
    """Cast the scene in the image of a view with depth; None for other views."""
    if view.depth is None or view.size is None or camera is None or intrinsics is None:
        return None
    return scene_points(scene, camera, intrinsics, view.size)


def _chosen(align: AlignBy, view: TrueView) -> AlignBy:
    if align != "auto":
        return align
    if view.depth is not None:
        return "depth"
    return "scale" if view.camera is not None else "objects"


def _aligned(
    view: TrueView,
    rendered: ScenePoints | None,
    free: dict[str, PosedMesh],
    pairs: dict[str, str],
    align: AlignBy,
    where: str,
) -> tuple[DepthMeasure | None, Similarity]:
    """Return the depth measure, if the view has depth, and the similarity of the alignment."""
    true = [item for item in view.objects if item.name in pairs]
    meshes = [free[pairs[item.name]] for item in true]
    if align in ("scale", "depth") and view.camera is None:
        raise SpecError(f"{where}: --align {align} needs a camera, which the data does not give")
    if align == "depth" and rendered is None:
        raise SpecError(f"{where}: --align depth needs a depth image, which the data does not give")
    try:
        known_similarity = None
        if align == "none":
            known_similarity = IDENTITY
        elif align == "scale":
            known_similarity = scale_of(meshes, true)
        elif align == "objects":
            known_similarity = similarity_of(meshes, true)
        if rendered is None or view.depth is None or view.camera is None:
            return None, known_similarity or IDENTITY
        sensor = measured_points(view.depth, view.camera)
        depth = depth_measure(
            rendered.points,
            rendered.segmentation,
            rendered.names,
            sensor,
            similarity=known_similarity,
        )
    except (SpecError, ValueError) as error:
        raise SpecError(f"{where}: {error}") from None
    return depth, depth.similarity


def _object_rows(
    view: TrueView,
    made: MadeView,
    meshes: dict[str, PosedMesh],
    pairs: dict[str, str],
    depth: DepthMeasure | None,
    similarity: Similarity,
    volumes: bool,
) -> Iterator[RealObjectRow]:
    partner = {name: true for true, name in pairs.items()}
    true_objects = {item.name: item for item in view.objects}
    for name, mesh in meshes.items():
        true = partner.get(name, "")
        yield RealObjectRow(
            view=view.name,
            method=made.method,
            stage=made.stage,
            object=name,
            true_object=true,
            **_depth_columns(depth, name),
            **_pose_columns(mesh, true_objects.get(true), similarity, volumes),
            **_collider_columns(made.scene, name),
        )
    for item in view.objects:
        if item.name not in pairs:
            yield RealObjectRow(
                view=view.name,
                method=made.method,
                stage=made.stage,
                object="",
                true_object=item.name,
                **_depth_columns(None, ""),
                **_pose_columns(None, item, similarity, volumes),
                collider_protruding_mm=None,
                collider_short_mm=None,
                collider_sound=None,
            )


def _depth_columns(depth: DepthMeasure | None, name: str) -> dict[str, Any]:
    error = None if depth is None else depth.objects.get(name)
    columns: dict[str, Any] = dict.fromkeys(("error_mm", "depth_error_mm", "bias_mm"))
    if error is None:
        return columns | {"visible_px": 0, "measured_px": 0}
    known = error._asdict()
    return known if error.measured_px else known | columns


def _pose_columns(
    posed: PosedMesh | None, true: PosedObject | None, similarity: Similarity, volumes: bool
) -> dict[str, Any]:
    import trimesh

    columns: dict[str, Any] = dict.fromkeys(
        ("position_mm", "add_s", "icp_rot_deg", "box_iou", "chamfer", "f_score", "voxel_iou")
    )
    if posed is None or true is None or not len(posed.faces):
        return columns
    a = trimesh.Trimesh(similarity.apply(posed.vertices), posed.faces, process=False)
    b = trimesh.Trimesh(true.posed, true.faces, process=False)
    middles = [(mesh.bounds[0] + mesh.bounds[1]) / 2 for mesh in (a, b)]
    columns["position_mm"] = 1e3 * float(np.linalg.norm(middles[0] - middles[1]))
    columns["box_iou"] = axis_box_iou(np.asarray(a.vertices), np.asarray(b.vertices))
    if not true.meshed:
        return columns
    own_points, true_points = (sampled([mesh], POINTS, 0) for mesh in (a, b))
    layout = layout_measure(own_points, true_points, true.diameter)
    columns |= {"add_s": layout.add_s, "icp_rot_deg": layout.icp_rot_deg}
    if not volumes:
        return columns
    try:
        return columns | volume_measure(a, b)._asdict()
    except ValueError:
        return columns  # Too large for voxels: no common volume to measure.


def _collider_columns(scene: SceneSpec, name: str) -> dict[str, Any]:
    gap = collider_gap(scene.object(name).spec)
    return {
        "collider_protruding_mm": None if gap is None else 1e3 * gap.protruding_m,
        "collider_short_mm": None if gap is None else 1e3 * gap.short_m,
        "collider_sound": None if gap is None else gap.sound,
    }
