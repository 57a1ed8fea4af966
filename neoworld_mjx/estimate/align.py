"""Align a composed scene with the photograph: camera and layout together, by Gauss-Newton steps.

The evidence consists of the contours of all objects in the photograph, from coarse to fine
resolution, of its vertical edges, and of the parsed 2D boxes. The prior is the composed scene.
Contacts keep objects from overlapping. An object without contour evidence stays near its composed
pose, and its 2D box keeps it in place in the image if the camera moves.
"""

import itertools
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from jaxtyping import Float, UInt8

from ..config import AlignOptions
from ..errors import PhotoError
from ..evidence.evidence import Evidence
from ..physics.photo_view import see_through
from ..render.rasterize import height_of
from ..spec import SceneSpec
from ..spec.correlation import PoseCorrelation
from ..spec.scene import PoseUncertainty
from .image.colors import LabImage
from .prior import is_misjudged
from .problem import COARSE_PX, FINE_PX, AlignmentProblem, AlignmentStage
from .result import (
    Alignment,
    DepthOutcome,
    EvidenceKind,
    FittedUnknowns,
    ObjectAlignment,
    ViewOutcome,
)
from .rows.contacts import SceneGeoms
from .rows.edges import camera_estimates
from .rows.standing import Standing
from .solve import NormalEquations
from .unknowns import CAMERA, FOCAL, ROLL, Placement, Unknowns
from .views import located_views

SAME_ASPECT = 0.02
"""Difference between the logarithms of two aspect ratios up to which they count as equal."""
NO_CONTOUR = "no visible contour has different colors on its two sides"
"""Reason reported for objects without contour evidence."""
CALIBRATION = (1.85, 2.0, 1.1, 1.6)
"""Factors that multiply the standard deviations along the view, across the view, of the heading and
of the log scale. They were set on the development half of the benchmark scenes. `neoworld
bench run scenes` counts the 90 % intervals that contain the true value."""


BOXES = AlignmentStage(9, COARSE_PX)
"""Steps by the 2D boxes alone, from the parsed places."""
STAGES = (
    AlignmentStage(2, COARSE_PX, open_focal=True, depth_reach=0.1),
    AlignmentStage(2, COARSE_PX, 16.0, 1.5, open_focal=True, depth_reach=0.06),
    AlignmentStage(2, FINE_PX, 10.0, 1.0, open_focal=True, depth_reach=0.03),
    AlignmentStage(3, FINE_PX, 6.0, 0.5, local_colors=True),
)
STAGES_AGAIN = (
    AlignmentStage(2, FINE_PX, 10.0, 1.0),
    AlignmentStage(2, FINE_PX, 6.0, 0.5, local_colors=True),
)
"""Stages of an alignment that starts from an aligned scene."""


def align(
    scene: SceneSpec,
    photo: UInt8[np.ndarray, "row column 3"],
    options: AlignOptions | None = None,
    *,
    measured: Collection[str] = (),
    stated: Mapping[str, float] | None = None,
    evidence: Evidence | None = None,
    parsed: SceneSpec | None = None,
) -> Alignment:
    """Align a composed scene with its photograph.

    If the solver fails, the composed scene is returned, with the reason in `Alignment.failure`.

    Args:
        scene: the composed scene, with a camera.
        photo: the photograph (sRGB), at any size of the camera's aspect ratio.
        options: which unknowns are estimated, and which evidence is used.
        measured: camera parameters that the response measured, as in `SceneTree.camera_measured`.
            Their prior is narrower, but they still move if the contours clearly contradict them.
        stated: standard deviations of the camera that the response states, as
            `SceneTree.camera_deviations`.
        evidence: known camera, depth image and masks; its photograph is not used. The scene's
            camera must have the known values.
        parsed: the objects at their parsed places, about which the prior is; by default, the
            composed scene. If the composed places come from the same 2D boxes, these would count
            twice.

    Returns:
        The aligned scene, with its camera and each object's uncertainty. If the scene has no
        camera, or if no object is free to move, the scene is returned unchanged.

    Raises:
        PhotoError: the photograph does not have the camera's aspect ratio.
    """
    o = options or AlignOptions()
    known = evidence or Evidence()
    return _aligned(
        scene,
        photo,
        o,
        STAGES,
        measured=frozenset(measured),
        stated=stated,
        evidence=known,
        parsed=parsed,
    )


def align_to_boxes(
    scene: SceneSpec,
    *,
    measured: Collection[str] = (),
    stated: Mapping[str, float] | None = None,
    evidence: Evidence | None = None,
) -> Alignment:
    """Move the camera and the objects of a composed scene to where their 2D boxes show them.

    A response localizes objects well in the picture and knows their common sizes, but estimates
    distances less accurately.

    Args:
        scene: the scene composed at the parsed places.
        measured: as for `align`.
        stated: as for `align`.
        evidence: known camera, and a metric depth image from whose places the estimate starts.

    Returns:
        The alignment; its scene is unchanged if it has no camera or no free object.
    """
    if scene.camera is None:
        return Alignment(scene)
    given = evidence or Evidence()
    depth = given.depth if given.depth is not None and given.depth.kind == "metric" else None
    known = Evidence(camera=given.camera, depth=depth, masks=given.masks)
    # Boxes cannot tell a wrong field of view from wrong distances, nor show the roll, which the
    # plane of a support does.
    held = (FOCAL,) if depth is not None else (ROLL, FOCAL)
    unknowns_of = partial(Unknowns.of, camera=scene.camera, held=held)
    unknowns = unknowns_of(scene)
    if not len(unknowns.free):
        return Alignment(scene)
    options = AlignOptions(contours=False, contacts=False)
    problem = AlignmentProblem(
        unknowns,
        options,
        frozenset(measured),
        stated or {},
        None,
        Standing.of(unknowns, SceneGeoms.of(scene), parsed=True),
        known,
        misjudged=False,
        boxes_only=True,
    )
    try:
        # Depth states where an object is, but only near its place which of its pixels are its own.
        problem = problem.measured(unknowns_of, supports=True)
        x = problem.start()
        problem = replace(problem, evidence=Evidence(camera=given.camera), mean=x)
        solution = _solution(problem, x, None, {COARSE_PX: [None]}, (BOXES,))
    except (ValueError, ArithmeticError, np.linalg.LinAlgError) as error:
        return Alignment(scene, failure=_failure(error))
    fitted = solution.fitted
    # Deviations by boxes alone are not calibrated.
    if fitted is None:
        return solution
    return replace(solution, scene=fitted.unknowns.scene_at(fitted.x))


def align_again(
    scene: SceneSpec,
    photo: UInt8[np.ndarray, "row column 3"],
    only: Collection[str],
    options: AlignOptions | None = None,
    *,
    evidence: Evidence | None = None,
) -> Alignment:
    """Align some objects of an aligned scene once more; all others and the camera keep their poses.

    Args:
        scene: the scene, with a camera.
        photo: the photograph (sRGB), at any size of the camera's aspect ratio.
        only: names of the objects that may move.
        options: as for `align`.
        evidence: depth image and masks.

    Returns:
        The alignment. Its uncertainties do not include that of the camera.

    Raises:
        PhotoError: the photograph does not have the camera's aspect ratio.
    """
    o = (options or AlignOptions()).model_copy(update={"camera": False})
    return _aligned(scene, photo, o, STAGES_AGAIN, only=only, evidence=evidence or Evidence())


def _aligned(
    scene: SceneSpec,
    photo: UInt8[np.ndarray, "row column 3"],
    o: AlignOptions,
    stages: Sequence[AlignmentStage],
    *,
    evidence: Evidence,
    measured: frozenset[str] = frozenset(),
    stated: Mapping[str, float] | None = None,
    only: Collection[str] | None = None,
    parsed: SceneSpec | None = None,
) -> Alignment:
    camera = scene.camera
    if camera is None:
        return Alignment(scene)
    aspect = photo.shape[1] * camera.height_px / (photo.shape[0] * camera.width)
    if abs(math.log(aspect)) > SAME_ASPECT:
        size = f"{photo.shape[1]} x {photo.shape[0]}"
        raise PhotoError(
            f"the photograph has {size} pixels, which is not the aspect ratio of the scene's "
            f"camera ({camera.width} x {camera.height_px})"
        )
    rises = evidence.depth is not None
    further = () if only is not None else evidence.further
    views, unlocated = located_views(scene, camera, further)
    refused = {
        photo.source: ViewOutcome(len(photo.boxes), None, reason=unlocated[photo.source])
        for photo in further
        if photo.source in unlocated
    }
    unknowns_of = partial(
        Unknowns.of,
        camera=camera,
        only=only,
        rises=rises,
        views=views,
        held=() if o.camera else tuple(range(CAMERA)),
    )
    unknowns = unknowns_of(scene)
    if not len(unknowns.free):
        return Alignment(scene)
    widths = {stage.width for stage in stages}
    photos = [(photo, camera), *((view.photo.photo, view.camera) for view in views)]
    images = {
        w: [LabImage.of(rgb, w, height_of(taken_by, w)) for rgb, taken_by in photos] for w in widths
    }
    colliders = SceneGeoms.of(scene) if o.contacts else None
    standing = None if colliders is None else Standing.of(unknowns, colliders)
    problem = AlignmentProblem(unknowns, o, measured, stated or {}, colliders, standing, evidence)
    try:
        problem = problem.measured(unknowns_of, supports=only is None)
        x, problem = problem.start(), replace(problem, mean=problem.prior_mean(parsed))
        solution = _solution(problem, x, photo, images, stages)
        return replace(solution, views=solution.views | refused)
    except (ValueError, ArithmeticError, np.linalg.LinAlgError) as error:
        return Alignment(scene, failure=_failure(error))


def _failure(error: Exception) -> str:
    return f"the solver failed: {str(error).splitlines()[0]}"


def _solution(
    problem: AlignmentProblem,
    x: Float[np.ndarray, " u"],
    photo: UInt8[np.ndarray, "row column 3"] | None,
    images: Mapping[int, Sequence[LabImage | None]],
    stages: Sequence[AlignmentStage],
) -> Alignment:
    scene = problem.unknowns.scene
    reasons = {
        k: "it is see-through" for k, item in enumerate(scene.objects) if see_through(item.spec)
    }
    if not problem.options.contours:
        reasons = dict.fromkeys(range(len(scene.objects)), "contours are disabled")
    misjudged, equations = True, None
    for width, of_width in itertools.groupby(stages, lambda stage: stage.width):
        if photo is not None and problem.uses_edges:
            # Only edges that are almost vertical for the current camera count.
            problem = problem.with_edges(x, photo)
        for stage in of_width:
            problem = replace(problem, misjudged=misjudged or stage.open_focal)
            for _ in range(stage.steps):
                equations = problem.linearized(x, images[width], stage, reasons)
                x = equations.solved()
                if stage.open_focal:
                    deviation = math.sqrt(equations.covariance()[FOCAL, FOCAL])
                    misjudged = is_misjudged(float(x[FOCAL]), deviation)
    assert equations is not None
    return _result(problem, x, equations, reasons, problem.depth_outcomes(x))


def _result(
    problem: AlignmentProblem,
    x: Float[np.ndarray, " u"],
    equations: NormalEquations,
    reasons: dict[int, str],
    depths: dict[int, DepthOutcome],
) -> Alignment:
    unknowns = problem.unknowns
    scene = unknowns.scene_at(x)
    before, after = unknowns.camera, scene.camera
    assert after is not None
    covariance = equations.covariance()
    now = unknowns.place(x[None])[0]
    objects, items = {}, list(scene.objects)
    correlation = _correlation(unknowns, now, covariance)
    for k in unknowns.free.tolist():
        entries = x[unknowns.columns(k)]
        evidence: EvidenceKind = "box" if k in equations.shown["box"] else "none"
        if k in equations.shown["contour"]:
            evidence = "pixels"
        reason = "" if evidence == "pixels" else reasons.get(k, NO_CONTOUR)
        uncertainty = _uncertainty(unknowns, now, k, covariance[unknowns.columns(k)])
        items[k] = items[k].model_copy(update={"uncertainty": uncertainty})
        shift = (float(entries[0]), float(entries[1]))
        objects[items[k].name] = ObjectAlignment(
            evidence,
            reason,
            shift,
            math.degrees(entries[2]),
            math.exp(entries[3]),
            uncertainty,
            depths.get(k),
        )
    return Alignment(
        scene.model_copy(update={"objects": tuple(items), "correlation": correlation}),
        math.degrees(after.pitch - before.pitch),
        math.degrees(after.roll - before.roll),
        math.degrees(after.fovy - before.fovy),
        after.height - before.height,
        objects,
        camera_estimates(
            after,
            np.sqrt(np.diag(covariance)[:CAMERA]),
            problem.evidence,
            measured=problem.measured_camera,
            edges=problem.edges is not None,
        ),
        misleading_edges=problem.misleading_edges,
        views=_views(unknowns, now),
        fitted=FittedUnknowns(unknowns, x),
    )


def _correlation(
    unknowns: Unknowns, now: Placement, covariance: Float[np.ndarray, "u u"]
) -> PoseCorrelation:
    """Return the correlations of the camera and of the free objects, in their view axes.

    The deviations of the camera are multiplied by the factor of positions along the view, so that
    camera and objects still agree about the pixels.
    """
    free = unknowns.free.tolist()
    turn = np.eye(unknowns.first_rise)
    for k in free:
        rows = unknowns.columns(k)
        if unknowns.in_wall[k].any():
            turn[rows, rows] = np.diag([0.0, 0.0, 1.0, 1.0])
            turn[rows.start + 1, rows.start] = 1.0  # across is along the wall
        else:
            turn[rows, rows][:2, :2] = unknowns.view_axes(now, k)
    names = tuple(unknowns.scene.objects[k].name for k in free)
    known = covariance[: unknowns.first_rise, : unknowns.first_rise]
    turn[:CAMERA] *= CALIBRATION[0]
    return PoseCorrelation.of(names, turn @ known @ turn.T)


def _views(unknowns: Unknowns, now: Placement) -> dict[str, ViewOutcome]:
    """Return the outcomes of the further photographs, by their names."""
    middle = np.median(now.pos[unknowns.free], axis=0)
    first = now.camera.position() - middle
    outcomes = {}
    for view, camera in zip(unknowns.views, now.views, strict=True):
        other = camera.position() - middle
        cosine = float(first @ other / max(np.linalg.norm(first) * np.linalg.norm(other), 1e-9))
        angle = math.degrees(math.acos(min(max(cosine, -1.0), 1.0)))
        outcomes[view.photo.source] = ViewOutcome(len(view.photo.boxes), camera, angle)
    return outcomes


def _uncertainty(
    unknowns: Unknowns,
    now: Placement,
    k: int,
    rows: Float[np.ndarray, "4 u"],
) -> PoseUncertainty:
    """Return the calibrated standard deviations of an object, given its rows of the covariance."""
    block = rows[:, unknowns.columns(k)]
    axes = unknowns.view_axes(now, k)
    along, across = np.sqrt(np.diag(axes @ block[:2, :2] @ axes.T))
    if unknowns.in_wall[k].any():
        # The wall determines the distance, so it has no deviation along the view.
        along, across = 0.0, math.sqrt(block[0, 0])
    yaw, log_scale = np.sqrt(np.diag(block)[2:])
    along, across, yaw, log_scale = (
        np.array([along, across, yaw, log_scale]) * CALIBRATION
    ).tolist()
    if unknowns.round[k] and not unknowns.in_wall[k].any():
        yaw = None
    return PoseUncertainty(along=along, across=across, yaw=yaw, log_scale=log_scale)
