"""Errors of the poses and sizes of a scene's movable objects, and validity, by the same rules for
every method and for submissions.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.errors import SpecError
from neoworld_mjx.measure import SceneMeasure, passes
from neoworld_mjx.physics.placed import BALL_EXTENT
from neoworld_mjx.spec import SceneObject, SceneSpec, bounds, world_poses
from neoworld_mjx.spec.pose import IDENTITY, Pose, conjugate, from_yaw, quat_mul, rotate, yaw_of

from ..measures.pose_measure import symmetry

MOST_TILT_DEG = 15.0
MOST_HEIGHT, MOST_HEIGHT_M = 0.1, 0.01
"""Bounds of `displaced`: tilt [deg], and change of height as a fraction of the diagonal plus a
length [m]. Errors of sizes in a response already move a center by a few percent of its height."""
LEAST_M = 1e-3
"""Shorter edges of a box count as this length when edges are compared [m]."""
Bounds = tuple[np.ndarray, np.ndarray]


def layout_errors(scene: SceneSpec, truth: SceneSpec) -> dict[str, float]:
    """Compare a scene with the ground truth, over the objects that both contain.

    The median offset of all objects is subtracted: it is an error of the response's camera, which
    no layout can correct.

    Returns:
        Means over the movable objects that both scenes contain; `unmatched` lists the others.

        - "xy_error_m": horizontal distance between the objects' centers [m].
        - "yaw_error_deg": difference of the headings [deg], see `heading_deg`.
        - "scale_error": absolute difference of the logarithms of the diagonals.
        - "edge_error": mean absolute difference of the logarithms of the three edges.

    Raises:
        SpecError: the scenes have no movable object in common.
    """
    ends, starts = world_poses(scene), world_poses(truth)
    items = [item for item in truth.objects if not item.static and item.name in ends]
    if not items:
        raise SpecError(f"scene {scene.name} has no movable object of the ground truth")
    turns, scales, edges = [], [], []
    for item in items:
        other = scene.object(item.name)
        scales.append(abs(math.log(_size(other) / _size(item))))
        ratio = np.maximum(_edges(other), LEAST_M) / np.maximum(_edges(item), LEAST_M)
        edges.append(float(np.abs(np.log(ratio)).mean()))
        turn = heading_deg(item, ends[item.name], starts[item.name])
        if turn is not None:
            turns.append(turn)
    offs = offsets(scene, truth, [item.name for item in items])
    shift = offs - np.median(offs, axis=0)
    return {
        "xy_error_m": float(np.mean(np.linalg.norm(shift, axis=1))),
        "yaw_error_deg": float(np.mean(turns)) if turns else 0.0,
        "scale_error": float(np.mean(scales)),
        "edge_error": float(np.mean(edges)),
    }


def camera_errors(scene: SceneSpec, truth: SceneSpec) -> Float[np.ndarray, " object"]:
    """Return the distances of objects' centers from the truth in the camera's frame [m].

    No offset, scale or rotation is removed: this is the error of a robot that is calibrated to the
    camera. The objects are the movable ones that both scenes contain.

    Raises:
        SpecError: a scene has no camera.
    """
    ends, starts = world_poses(scene), world_poses(truth)
    names = [item.name for item in truth.objects if not item.static and item.name in ends]
    seen = []
    for which, poses in ((scene, ends), (truth, starts)):
        camera = which.camera
        if camera is None:
            raise SpecError(f"scene {which.name} has no camera")
        middles = np.array([_middle(which.object(name), poses[name]) for name in names])
        seen.append((middles.reshape(-1, 3) - camera.position()) @ camera.axes())
    return np.linalg.norm(seen[0] - seen[1], axis=1)


def offsets(
    scene: SceneSpec, truth: SceneSpec, names: Sequence[str]
) -> Float[np.ndarray, "object 2"]:
    """Return the horizontal offsets of the objects' centers from the ground truth [m], [n, 2]."""
    ends, starts = world_poses(scene), world_poses(truth)
    middles = [
        [_middle(s.object(name), at[name]) for name in names]
        for s, at in ((scene, ends), (truth, starts))
    ]
    return (np.array(middles[0]) - np.array(middles[1])).reshape(-1, 3)[:, :2]


def unmatched(scene: SceneSpec, truth: SceneSpec) -> tuple[list[str], list[str]]:
    """Return the names of missed and of extra movable objects.

    Missed objects are those that the scene lacks. Extra objects are those that the ground truth
    lacks. No search can correct them, so they are counted separately and affect no error. Held
    objects count as movable.
    """
    free = lambda item: item.held or not item.static
    true_items, items = ([item for item in s.objects if free(item)] for s in (truth, scene))
    names, all_names = {item.name for item in items}, {item.name for item in truth.objects}
    missed = [item.name for item in true_items if item.name not in names]
    return missed, [item.name for item in items if item.name not in all_names]


def displaced(scene: SceneSpec, truth: SceneSpec) -> list[str]:
    """Return the objects that toppled or fell, compared with the ground truth.

    A toppled book is stable, so stability does not reveal it. An object is displaced if

    - its tilt differs from the ground truth by more than MOST_TILT_DEG, see `tilt_deg`, or
    - its lowest point and its center are both higher or lower than expected by more than
      MOST_HEIGHT times its diagonal plus MOST_HEIGHT_M.

    The expected heights are the heights in the ground truth, transferred to the pose and size that
    the object below has in the scene. Missed objects and the objects on them are not considered.
    """
    ends, starts = world_poses(scene), world_poses(truth)
    names, without = [], {item.name for item in truth.objects if item.name not in ends}
    for item in truth.objects:
        if item.parent in without:
            without.add(item.name)
        if item.static or item.name in without:
            continue
        other, end, start = scene.object(item.name), ends[item.name], starts[item.name]
        expected = _heights(item, start)
        if item.parent is not None:
            below = item.parent
            boxes = [bounds(s.object(below).spec) for s in (truth, scene)]
            expected = ends[below].apply(
                _mapped_between_boxes(starts[below].inverse().apply(expected), *boxes)
            )
        rises = np.abs(_heights(other, end) - expected)[:, 2]
        fallen = rises.min() > MOST_HEIGHT * _size(item) + MOST_HEIGHT_M
        if fallen or tilt_deg(item, end, start) > MOST_TILT_DEG:
            names.append(item.name)
    return names


class Validity(NamedTuple):
    """Components of the validity of a final scene."""

    check_passed: bool
    """True if the final check passes."""
    displaced: tuple[str, ...]
    """Objects that have toppled or fallen compared with the ground truth."""
    missed: tuple[str, ...]
    """Movable objects of the ground truth that the scene lacks."""
    extra: tuple[str, ...]
    """Movable objects of the scene that the ground truth lacks."""
    lost: tuple[str, ...]
    """Missed objects that the method was given: in its initial scene, or in the photograph."""

    @property
    def valid(self) -> bool:
        """True if the final check passes and no object is displaced or lost."""
        return self.check_passed and not self.displaced and not self.lost


def validity(
    scene: SceneSpec,
    measure: SceneMeasure,
    truth: SceneSpec,
    o: RefineOptions,
    *,
    given: SceneSpec | None = None,
) -> Validity:
    """Return the validity of a method's final scene, regardless of the method's verdict.

    Args:
        scene: the final scene.
        measure: measure of the final scene by the final check.
        truth: ground truth of the scene.
        o: options with the bounds of the final check.
        given: initial scene that the method was given. If None, the method was given the
            photograph, which shows every object of the ground truth.
    """
    missed, extra = unmatched(scene, truth)
    had = {item.name for item in (given or truth).objects if not item.static}
    lost = tuple(name for name in missed if name in had)
    away = tuple(displaced(scene, truth))
    return Validity(passes(measure, o), away, tuple(missed), tuple(extra), lost)


def tilt_deg(item: SceneObject, end: Pose, start: Pose) -> float:
    """Return the difference of the tilts of an object at two poses, regardless of heading [deg].

    It is the angle between the two vertical directions in the object's frame, up to the object's
    symmetry. A pencil that leans equally far to another side is turned, not tilted. A ball has no
    tilt.
    """
    if _is_ball(item):
        return 0.0
    up, true = (rotate(conjugate(at.quat), [0.0, 0.0, 1.0]) for at in (end, start))
    period = symmetry(item.model_copy(update={"base_tilt": IDENTITY}))
    if period == 0.0:
        polar = [math.atan2(math.hypot(v[0], v[1]), v[2]) for v in (up, true)]
        return math.degrees(abs(polar[0] - polar[1]))
    turns = np.arange(0.0, 2 * math.pi - 1e-9, period)
    cosines = [float(rotate(from_yaw(turn), up) @ true) for turn in turns]
    return math.degrees(math.acos(min(1.0, max(-1.0, *cosines))))


def heading_deg(item: SceneObject, end: Pose, start: Pose) -> float | None:
    """Return the rotation about the vertical between two poses of an object [deg].

    The rotation is reduced by the object's symmetry. For a round object that leans or lies, it is
    the rotation of its axis: a leaning pencil that has rolled about its axis has not turned. The
    result is None for an object that looks the same from every side, such as a ball, and for a
    round object whose axis leans by less than MOST_TILT_DEG.
    """
    period = symmetry(item)
    if period == 0.0:
        return None
    upright_period = symmetry(item.model_copy(update={"base_tilt": IDENTITY}))
    if upright_period == 0.0:
        (x, y, _), (true_x, true_y, up) = (rotate(at.quat, [0.0, 0.0, 1.0]) for at in (end, start))
        if abs(up) > math.cos(math.radians(MOST_TILT_DEG)):
            return None
        yaw = math.atan2(y, x) - math.atan2(true_y, true_x)
    else:
        spins = np.arange(0.0, 2 * math.pi - 1e-9, upright_period)
        rolled = [quat_mul(end.quat, from_yaw(spin)) for spin in spins]
        nearest = max(rolled, key=lambda quat: abs(float(quat @ start.quat)))
        yaw = yaw_of(quat_mul(nearest, conjugate(start.quat)))
    return math.degrees(abs(math.remainder(yaw, period)))


def _mapped_between_boxes(
    points: Float[np.ndarray, "n 3"], source: Bounds, target: Bounds
) -> Float[np.ndarray, "n 3"]:
    """Map points from the frame of one object to that of another, from box to box."""
    source_size, target_size = (np.subtract(high, low) for low, high in (source, target))
    ratio = target_size / np.maximum(source_size, LEAST_M)
    return np.asarray(target[0]) + (points - np.asarray(source[0])) * ratio


def _heights(item: SceneObject, at: Pose) -> Float[np.ndarray, "2 3"]:
    """Return two points of an object: below its center at the lowest height, and its center."""
    low, high = bounds(item.spec, item.joint_state, tuple(at.quat.tolist()))
    middle = (low + high) / 2
    return at.pos + np.array([[*middle[:2], low[2]], middle])


def _middle(item: SceneObject, at: Pose) -> Float[np.ndarray, " 3"]:
    low, high = bounds(item.spec, item.joint_state)
    return at.apply((low + high) / 2)


def _is_ball(item: SceneObject) -> bool:
    sides = np.subtract(*bounds(item.spec)[::-1])
    return symmetry(item) == 0 and float(np.ptp(sides)) < BALL_EXTENT * float(sides.max())


def _edges(item: SceneObject) -> Float[np.ndarray, " 3"]:
    low, high = bounds(item.spec)
    return high - low


def _size(item: SceneObject) -> float:
    return float(np.linalg.norm(_edges(item)))
