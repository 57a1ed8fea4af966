"""Runs of methods on scenes from initial scenes, in separate processes, with one row per run."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from neoworld_mjx.checks.joint_sweep import sweep_combinations, sweep_joints
from neoworld_mjx.checks.static_checks import Probe, is_placeholder
from neoworld_mjx.config import JointSweepOptions
from neoworld_mjx.errors import SpecError, choices
from neoworld_mjx.measure import visible_box_iou
from neoworld_mjx.spec import ObjectSpec, SceneSpec

from ..dataset.declaration import ARRANGEMENTS, declaration, declarations
from ..dataset.truth_scene import photographed
from ..noise.known_evidence import kinds_of
from ..noise.parse_noise import NoiseLog
from .layout_errors import camera_errors, layout_errors, validity
from .method_runs import MethodJob, MethodRow, RunSettings
from .scene_methods import MethodResult
from .stated_deviations import stated_deviations
from .submission import submission_name, submitted

KNOWN_PLACE = {"depth", "pose"}
"""Kinds of evidence with which deviations are about places in the world."""
NEAR_M = 0.01
"""Distance in the camera's frame up to which an object counts in `within_10mm` [m]."""
P_PEN_M = 1e-3
"""Penetration of two parts above which an object counts in P-Pen [m]."""
_DEEPEST_M = 10.0
"""Allowed penetration [m] that no pair reaches, so that every pair is also measured in motion."""


def articulated(spec: ObjectSpec) -> bool:
    """Return True if an object has a joint that moves."""
    return any(joint.type != "fixed" for joint in spec.joints)


def part_depth(spec: ObjectSpec) -> float:
    """Return the deepest penetration of two parts of an object [m]; 0 if no parts overlap.

    Parts are measured with all joints at zero, over the range of every joint, and with all joints
    moved at once. In states with all joints moved, only penetrations over P_PEN_M count. Pairs of a
    parent and a child count, and so do overlaps that the object's program allows. Parts that are
    fixed to each other may overlap.
    """
    o = JointSweepOptions()
    placeholders = [part.name for part in spec.parts if is_placeholder(part)]
    free = o.model_copy(update={"max_depth_m": _DEEPEST_M})
    sweep = sweep_joints(Probe(spec), free, ignored=placeholders)
    overlaps = [*sweep.at_rest.values()]
    for swept in sweep.ranges:
        overlaps += swept.deepest.values()
    strict = replace(sweep, allowed=dict.fromkeys(sweep.allowed, P_PEN_M))
    overlaps += sweep_combinations(strict).values()
    return max((overlap.depth for overlap in overlaps if overlap.depth > 0), default=0.0)


class SceneRow(MethodRow):
    """Result of one method on one scene from one initial scene."""

    scene: str
    room: str
    tabletop: bool
    objects: int
    """Movable objects of the ground truth."""
    refused: str
    """Kinds of errors that were sampled but not injected, because no variant passes the checks;
    comma-separated."""
    missed: int
    """Number of movable objects of the ground truth that the result lacks."""
    extra: int
    """Number of movable objects of the result that the ground truth lacks."""
    valid: bool
    """True if the result passes the final check, no object is displaced, and no object that the
    method was given is missed; see `validity`.
    """
    check_passed: bool
    """True if the result passes the final check."""
    accepted: bool | None
    """Verdict of the search, which also requires that no object settled away from its composed
    position; None for methods without a search."""
    displaced: int
    """Number of objects that have toppled or fallen compared with the ground truth."""
    s_pen: int
    """1 if two objects penetrate deeper than the bound in the result, else 0."""
    s_stab: bool
    o_stab: float
    """Fraction of the movable objects whose drift and tilt stay within the bounds, and that are not
    held."""
    articulated: int
    """Number of objects with joints that move."""
    p_pen: int
    """Number of articulated objects in which two parts penetrate deeper than 1 mm, over the ranges
    of the joints."""
    max_depth_m: float
    max_drift_m: float
    max_tilt_deg: float
    xy_error_m: float
    yaw_error_deg: float
    scale_error: float
    edge_error: float
    """Error of an object's three edges, whereas `scale_error` is the error of its diagonal; see
    `layout_errors`."""
    camera_error_m: float
    """Distance of an object's center from the truth in the camera's frame, with nothing removed, as
    a mean over objects [m]; see `camera_errors`."""
    within_10mm: float
    """Share of the objects whose distance is at most 10 mm."""
    deviations: dict[str, list[float]]
    """Errors of objects in stated standard deviations, by quantity; see `stated_deviations`."""
    box_iou: float
    """Intersection over union of visible 2D boxes with those of the ground truth, as a mean over
    objects."""
    seconds_to_valid: float | None
    """Time until the first valid candidate [s]; None if the result is not valid."""
    seconds: float | None
    """Time of the method [s]; None for a submission."""

    @property
    def found(self) -> int:
        """Number of movable objects of the ground truth in the result; errors are means of them."""
        return self.objects - self.missed

    @property
    def subject(self) -> str:
        """Name of the scene."""
        return self.scene

    @property
    def summary(self) -> str:
        """One line for the log."""
        valid = "valid" if self.valid else "not valid"
        time = "" if self.seconds is None else f", {self.seconds:.1f} s"
        error = f"{1e3 * self.xy_error_m:.1f} mm"
        return f"{self.scene} start {self.start} {self.label}: {valid}, {error}{time}"


def chosen_scenes(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the chosen scenes.

    Args:
        names: names of scenes. If empty, all thirty scenes are chosen. If it is a single number,
            this many of them are chosen, evenly spaced in the list; if it is "arrangements", the
            twelve arrangements.

    Raises:
        SpecError: there is no scene of this name, or there are fewer scenes than the number.
    """
    every, arrangements = tuple(declarations()), tuple(declarations(ARRANGEMENTS))
    if tuple(names) == ("arrangements",):
        return arrangements
    if len(names) == 1 and names[0].isdecimal():
        count = int(names[0])
        if not 1 <= count <= len(every):
            raise SpecError(f"scenes: got {count}, valid is from 1 to {len(every)}")
        return tuple(every[int(k * len(every) / count)] for k in range(count))
    for name in names:
        if name not in every + arrangements:
            raise SpecError(f"scenes: {choices(name, (*every, *arrangements, 'arrangements'))}")
    return tuple(names) or every


def scene_rows(job: MethodJob) -> Iterator[SceneRow]:
    """Run the methods of a job, and yield a row for each."""
    truth, errors = photographed(declaration(job.subject)), NoiseLog()
    initial = job.initial(truth, job.subject, errors)
    for method, result in job.outcomes(job.methods, initial, truth):
        yield _row(job, method, result, truth, initial.scene, errors)


def submission_rows(
    scenes: Sequence[str], folder: Path, settings: RunSettings
) -> Iterator[SceneRow]:
    """Score the scenes of another method, and yield a row for each.

    Args:
        scenes: names of the scenes.
        folder: folder of the submission; see `submission`.
        settings: settings of the run.

    Raises:
        SpecError: a scene is missing or cannot be read.
    """
    method = submission_name(folder)
    for name in scenes:
        truth = photographed(declaration(name))
        job = MethodJob(name, 0, (method,), settings, threads=1)
        result = submitted(folder, truth, settings.refine)
        yield _row(job, method, result, truth, None, NoiseLog())


def _row(
    job: MethodJob,
    method: str,
    result: MethodResult,
    truth: SceneSpec,
    initial: SceneSpec | None,
    errors: NoiseLog,
) -> SceneRow:
    declared, m, o = declaration(job.subject), result.measure, job.settings.refine
    verdict = validity(result.scene, m, truth, o, given=initial)
    still = [
        m.drift_m[name] < o.max_drift_m and m.tilt_deg[name] < o.max_tilt_deg for name in m.drift_m
    ] + [False] * len(m.held)
    part_depths = [
        part_depth(item.spec)
        for item in result.scene.objects
        if not item.environment and articulated(item.spec)
    ]
    distance = camera_errors(result.scene, truth)
    columns: dict[str, Any] = {
        **job.columns(method, errors),
        **layout_errors(result.scene, truth),
    }
    return SceneRow(
        **columns,
        scene=job.subject,
        room=declared.room,
        tabletop=declared.tabletop,
        objects=len(declared.movable()),
        refused=", ".join(errors.refused),
        missed=len(verdict.missed),
        extra=len(verdict.extra),
        valid=verdict.valid,
        check_passed=verdict.check_passed,
        accepted=result.accepted,
        displaced=len(verdict.displaced),
        s_pen=m.s_pen or 0,
        s_stab=bool(m.s_stab),
        o_stab=float(np.mean(still)),
        articulated=len(part_depths),
        p_pen=sum(depth > P_PEN_M for depth in part_depths),
        max_depth_m=m.max_depth_m,
        max_drift_m=min(m.max_drift_m, 1e6),
        max_tilt_deg=min(m.max_tilt_deg, 1e6),
        camera_error_m=float(np.mean(distance)),
        deviations=stated_deviations(
            result.scene, truth, measured=not KNOWN_PLACE.isdisjoint(kinds_of(job.evidence))
        ),
        within_10mm=float(np.mean(distance <= NEAR_M)),
        box_iou=_box_iou(result.scene, truth),
        seconds_to_valid=result.seconds_to_result if verdict.valid else None,
        seconds=result.seconds,
        rollouts=result.rollouts,
    )


def _box_iou(scene: SceneSpec, truth: SceneSpec) -> float:
    """Return the mean IoU of visible boxes with the true ones, in the camera of the result.

    An object that the ground truth lacks has no true box, but can hide other objects.
    """
    true_objects = {item.name: item for item in truth.objects}
    objects = []
    for item in scene.objects:
        true = true_objects.get(item.name)
        box = {"box2d": None} if true is None else {"box2d": true.box2d, "occluded": true.occluded}
        objects.append(item.model_copy(update=box))
    ious = visible_box_iou(scene.model_copy(update={"objects": tuple(objects)}))
    return float(np.mean(list(ious.values())))
