"""Agreement of an object's joints with the ground truth: matches, missed and extra joints, errors.

Joints are matched by the parts that they move and by their motion, not by name. Both objects are in
the canonical frame (origin at the center of the box's bottom face, front along +x), and each object
is divided by its diagonal, so that size has no effect. Means of axis, pivot and limits exclude
missed joints. Every mean is given with the number of its values.

The ground truth of an object is the joints that move, and boxes of the parts that they move, in
meters and radians. All positions are in one frame with +z up, with all joints at zero.
"""

import math
from collections.abc import Sequence
from itertools import product
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator
from scipy.optimize import linear_sum_assignment

from neoworld_mjx.spec import Number, ObjectSpec, Spec, Vec3, bounds, pieces
from neoworld_mjx.spec.convex import box_around
from neoworld_mjx.spec.pose import triple

Front = Literal["+x", "-x", "+y", "-y"]
Box = tuple[Vec3, Vec3]
Motion = Literal["revolute", "continuous", "prismatic", "ball"]

_TURNS = {"+x": 0, "-y": 1, "-x": 2, "+y": 3}
"""Number of quarter turns about +z that rotate each front to +x."""


class TrueJoint(Spec):
    """A joint that moves."""

    name: str
    type: Motion
    axis: Vec3 = (0.0, 0.0, 1.0)
    """Direction of the axis, of any nonzero length; ignored for ball joints."""
    pivot: Vec3 = (0.0, 0.0, 0.0)
    """Point on the axis [m]; ignored for prismatic joints."""
    limits: tuple[Number, Number] | None = None
    """Range relative to the zero position [rad or m]; None if unlimited or unknown."""
    parent: str = ""
    child: str = ""
    moving_box: Box
    """Low and high corner of the parts that the joint moves, with all joints at zero [m]."""

    @model_validator(mode="after")
    def _valid(self) -> "TrueJoint":
        if self.type != "ball" and not np.linalg.norm(self.axis) > 0:
            raise ValueError(f"joint {self.name}: the axis must not be zero")
        _ordered(self.moving_box, f"joint {self.name}: moving_box")
        return self


class ObjectTruth(Spec):
    """Ground truth of an object."""

    name: str
    front: Front = "+x"
    box: Box
    """Low and high corner of the whole object, with all joints at zero [m]."""
    joints: tuple[TrueJoint, ...] = ()

    @model_validator(mode="after")
    def _valid(self) -> "ObjectTruth":
        _ordered(self.box, "box")
        if not np.ptp(np.array(self.box), axis=0).any():
            raise ValueError("box: the object has no size")
        return self


def truth_of(spec: ObjectSpec) -> ObjectTruth:
    """Return the joints of an object that move, and its box."""
    low, high = bounds(spec)
    joints = []
    for joint in spec.joints:
        if joint.type == "fixed":
            continue
        limited = joint.type in ("revolute", "prismatic")
        joints.append(
            TrueJoint(
                name=joint.name,
                type=joint.type,
                axis=joint.axis,
                pivot=joint.pos,
                limits=(joint.lower, joint.upper) if limited else None,
                parent=joint.parent,
                child=joint.child,
                moving_box=moving_box_of(spec, joint.child),
            )
        )
    box: Box = (triple(low), triple(high))
    return ObjectTruth(name=spec.name, box=box, joints=tuple(joints))


def moving_box_of(spec: ObjectSpec, child: str) -> Box:
    """Return the box (low, high) of a part and its descendants, with all joints at zero [m]."""
    moving = {child}
    for part, joint in spec.ordered:
        if joint is not None and joint.parent in moving:
            moving.add(part.name)
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for name in moving:
        for role in ("collision", "visual"):
            for _, piece, pose in pieces(spec.part(name), role):
                lowest, highest = box_around(piece, pose)
                low, high = np.minimum(low, lowest), np.maximum(high, highest)
    return triple(low), triple(high)


def canonical(truth: ObjectTruth) -> ObjectTruth:
    """Rotate the front to +x, and move the origin to the center of the box's bottom face."""
    turn, box, origin = _canonical_frame(truth)
    joints = tuple(
        joint.model_copy(
            update={
                "axis": triple(turn @ np.array(joint.axis)),
                "pivot": triple(turn @ np.array(joint.pivot) - origin),
                "moving_box": _truth_pair(_turned(joint.moving_box, turn) - origin),
            }
        )
        for joint in truth.joints
    )
    return truth.model_copy(
        update={"front": "+x", "box": _truth_pair(box - origin), "joints": joints}
    )


def canonical_points(points: NDArray, truth: ObjectTruth) -> NDArray:
    """Transform points from a ground truth's frame to its canonical frame [m], shape [n, 3]."""
    turn, _, origin = _canonical_frame(truth)
    return np.asarray(points, float) @ turn.T - origin


def _canonical_frame(truth: ObjectTruth) -> tuple[NDArray, NDArray, NDArray]:
    """Return the rotation to the canonical frame, the rotated box [2, 3] and its origin [m]."""
    turn = quarter_turn(_TURNS[truth.front])
    box = _turned(truth.box, turn)
    origin = np.array([(box[0, 0] + box[1, 0]) / 2, (box[0, 1] + box[1, 1]) / 2, box[0, 2]])
    return turn, box, origin


def diagonal(truth: ObjectTruth) -> float:
    """Return the diagonal of an object's box [m]."""
    return float(np.linalg.norm(np.ptp(np.array(truth.box), axis=0)))


def quarter_turn(count: int) -> NDArray:
    """Return the rotation matrix [3, 3] of a number of quarter turns about +z."""
    c, s = ((1, 0), (0, 1), (-1, 0), (0, -1))[count % 4]
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _turned(box: Box, turn: NDArray) -> NDArray:
    corners = np.array(box) @ turn.T
    return np.array([corners.min(axis=0), corners.max(axis=0)])


def _truth_pair(box: NDArray) -> Box:
    return triple(box[0]), triple(box[1])


def _ordered(box: Box, name: str) -> None:
    if not all(a <= b for a, b in zip(*box, strict=True)):
        raise ValueError(f"{name}: low corner first, got {box}")


class Mean(Spec):
    """A mean and the number of its values. A mean without values is None, because an error that
    was not measured is not an error of zero.
    """

    value: float | None
    n: int


def mean_of_known(values: Sequence[float | None]) -> Mean:
    """Return the mean of the values that are not None."""
    known = [value for value in values if value is not None]
    return Mean(value=float(np.mean(known)) if known else None, n=len(known))


MARGIN = 0.02
"""Margin on each side of the compared boxes, as a fraction of the diagonal, so that thin fronts
with a small gap still overlap."""
MIN_AGREEMENT = 0.5
"""Minimum overlap of the boxes of two parts that match: geometric mean of the overlaps in the two
better directions."""
PARALLEL_DEG = 5.0
"""Angle below which two axes count as parallel [deg]."""
CORRECT_AXIS_DEG, CORRECT_PIVOT = 10.0, 0.1
"""Maximum errors of a correct joint: angle of the axis [deg], and distance of the pivot as a
fraction of the diagonal. A correct joint also has the true type."""


class JointPair(Spec):
    """A ground-truth joint and the predicted joint that matches it."""

    true: str
    predicted: str
    true_type: str
    predicted_type: str
    agreement: float
    """Overlap of the boxes of the parts that the joints move, 0 to 1."""
    motion: float
    """Similarity of the joints' motions, 0 to 1."""
    axis_deg: float | None
    """Angle between the two axes, 0 to 90 [deg]; None if a joint is a ball joint."""
    pivot: float | None
    """Distance of the two axes as a fraction of the diagonal; None unless both joints rotate about
    an axis."""
    limits: float | None
    """Intersection over union of the ranges, both measured in the same direction of motion. None if
    one joint rotates and the other slides, or if a range is unknown."""

    @property
    def correct(self) -> bool:
        """True if type, axis and pivot are correct."""
        return (
            self.true_type == self.predicted_type
            and (self.axis_deg is None or self.axis_deg <= CORRECT_AXIS_DEG)
            and (self.pivot is None or self.pivot <= CORRECT_PIVOT)
        )


class JointMeasure(Spec):
    """Comparison of the joints of an object with the ground truth."""

    name: str
    total: int
    """Number of ground-truth joints."""
    predicted: int
    hits: int
    missed: tuple[str, ...]
    extra: tuple[str, ...]
    correct: int
    """Number of hits with the true type, with an error of the axis of at most 10 degrees, and with
    an error of the pivot of at most a tenth of the diagonal."""
    axis_deg: Mean
    """Mean of `JointPair.axis_deg` over hits in which both joints have an axis."""
    pivot: Mean
    """Mean of `JointPair.pivot` over hits in which both joints rotate about an axis."""
    limits: Mean
    """Mean of `JointPair.limits` over hits whose ranges can be compared."""
    pairs: tuple[JointPair, ...]


def joint_measure(predicted: ObjectSpec | ObjectTruth, truth: ObjectTruth) -> JointMeasure:
    """Compare an object's joints with those of the ground truth (paper Section 4, articulation).

    The boxes of the parts that two joints move are compared, with a margin of 2 % of the diagonal.
    Two joints can match if these boxes overlap in all three directions and agree in the better two,
    because an image does not show the depth behind a front. The Hungarian method maximizes the sum
    of the overlap in the better two directions, the mean overlap in all three, and motion
    similarity. Motion similarity is the cosine between the velocity fields of the two joints over
    the true joint's box; it depends on type, axis and pivot.

    Args:
        predicted: the reconstructed object, or its joints as an `ObjectTruth`.
        truth: the ground truth.
    """
    estimate = truth_of(predicted) if isinstance(predicted, ObjectSpec) else predicted
    estimated_joints, true_joints = _normalised(estimate), _normalised(truth)
    pairs = tuple(
        _pair(estimated_joints[j], true_joints[i])
        for i, j in _assigned(estimated_joints, true_joints)
    )
    matched, used = {p.true for p in pairs}, {p.predicted for p in pairs}
    missed = tuple(joint.name for joint in true_joints if joint.name not in matched)
    extra = tuple(joint.name for joint in estimated_joints if joint.name not in used)
    return JointMeasure(
        name=truth.name,
        total=len(true_joints),
        predicted=len(estimated_joints),
        hits=len(pairs),
        missed=missed,
        extra=extra,
        correct=sum(pair.correct for pair in pairs),
        axis_deg=mean_of_known([pair.axis_deg for pair in pairs]),
        pivot=mean_of_known([pair.pivot for pair in pairs]),
        limits=mean_of_known([pair.limits for pair in pairs]),
        pairs=pairs,
    )


def box_agreement(a: TrueJoint, b: TrueJoint) -> float:
    """Return the geometric mean of the two best overlaps of two moved boxes; 0 if disjoint."""
    best = sorted(overlaps(a, b))
    return math.sqrt(best[1] * best[2]) if best[0] > 0 else 0.0


def motion_similarity(estimate: TrueJoint, true: TrueJoint) -> float:
    """Return the absolute cosine between the velocities of the true box's corners, 0 to 1."""
    if "ball" in (estimate.type, true.type):
        return float(estimate.type == true.type)
    corners = np.array(list(product(*zip(*true.moving_box, strict=True))))
    estimated, expected = _velocities(estimate, corners), _velocities(true, corners)
    size = math.sqrt(float((estimated**2).sum() * (expected**2).sum()))
    return abs(float((estimated * expected).sum())) / size if size > 0 else 0.0


def line_angle_deg(a: NDArray, b: NDArray) -> float:
    """Return the angle between two lines with these directions, 0 to 90 [deg]."""
    sine = np.linalg.norm(np.cross(a, b))
    return math.degrees(math.atan2(float(sine), abs(float(a @ b))))


def line_distance(p: NDArray, a: NDArray, q: NDArray, b: NDArray, near: NDArray) -> float:
    """Return the distance between the lines p + s a and q + t b.

    Lines within 5 degrees of each other count as parallel, because their closest points may be far
    away. The result is then the distance of a point on the second line from the first line; it is
    the point nearest to `near`.
    """
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    if line_angle_deg(a, b) < PARALLEL_DEG:
        point = q + b * float((near - q) @ b)
        return float(np.linalg.norm(np.cross(point - p, a)))
    normal = np.cross(a, b)
    return abs(float((q - p) @ normal)) / float(np.linalg.norm(normal))


def _assigned(
    estimated_joints: Sequence[TrueJoint], true_joints: Sequence[TrueJoint]
) -> list[tuple[int, int]]:
    """Return the pairs (true index, estimated index) with the largest sum of similarities."""
    worth = np.zeros((len(true_joints), len(estimated_joints)))
    allowed = np.zeros(worth.shape, bool)
    for i, true in enumerate(true_joints):
        for j, estimate in enumerate(estimated_joints):
            agreement = box_agreement(estimate, true)
            if agreement >= MIN_AGREEMENT:
                allowed[i, j] = True
                worth[i, j] = (
                    agreement
                    + motion_similarity(estimate, true)
                    + float(np.mean(overlaps(estimate, true)))
                )
    rows, columns = linear_sum_assignment(worth, maximize=True)
    return [(i, j) for i, j in zip(rows.tolist(), columns.tolist(), strict=True) if allowed[i, j]]


def _normalised(truth: ObjectTruth) -> list[TrueJoint]:
    """Return the joints in the canonical frame, with lengths divided by the diagonal."""
    size = diagonal(truth)

    def relative(v: Sequence[float]) -> tuple[float, float, float]:
        x, y, z = v
        return x / size, y / size, z / size

    joints = []
    for joint in canonical(truth).joints:
        limits = joint.limits
        if limits is not None and joint.type == "prismatic":
            limits = (limits[0] / size, limits[1] / size)
        update = {
            "pivot": relative(joint.pivot),
            "limits": limits,
            "moving_box": (relative(joint.moving_box[0]), relative(joint.moving_box[1])),
        }
        joints.append(joint.model_copy(update=update))
    return joints


def overlaps(a: TrueJoint, b: TrueJoint) -> list[float]:
    """Return the intersection over union of two enlarged boxes along each axis."""
    low, high = np.array(a.moving_box[0]) - MARGIN, np.array(a.moving_box[1]) + MARGIN
    low2, high2 = np.array(b.moving_box[0]) - MARGIN, np.array(b.moving_box[1]) + MARGIN
    common = np.maximum(np.minimum(high, high2) - np.maximum(low, low2), 0.0)
    return (common / (np.maximum(high, high2) - np.minimum(low, low2))).tolist()


def _velocities(joint: TrueJoint, points: NDArray) -> NDArray:
    axis = np.array(joint.axis) / np.linalg.norm(joint.axis)
    if joint.type == "prismatic":
        return np.tile(axis, (len(points), 1))
    return np.cross(axis, points - np.array(joint.pivot))


def _pair(estimate: TrueJoint, true: TrueJoint) -> JointPair:
    a, b = np.array(estimate.axis), np.array(true.axis)
    balls = "ball" in (estimate.type, true.type)
    turn = not balls and "prismatic" not in (estimate.type, true.type)
    middle = np.mean(np.array(true.moving_box), axis=0)
    distance = line_distance(np.array(estimate.pivot), a, np.array(true.pivot), b, middle)
    return JointPair(
        true=true.name,
        predicted=estimate.name,
        true_type=true.type,
        predicted_type=estimate.type,
        agreement=box_agreement(estimate, true),
        motion=motion_similarity(estimate, true),
        axis_deg=None if balls else line_angle_deg(a, b),
        pivot=distance if turn else None,
        limits=_range_overlap(estimate, true, flipped=float(a @ b) < 0),
    )


def _range_overlap(estimate: TrueJoint, true: TrueJoint, *, flipped: bool) -> float | None:
    if "ball" in (estimate.type, true.type):
        return None
    if (estimate.type == "prismatic") != (true.type == "prismatic"):
        return None
    endless = [joint.type == "continuous" for joint in (estimate, true)]
    if all(endless):
        return 1.0
    if any(endless):
        limits = true.limits if endless[0] else estimate.limits
        return None if limits is None else min(1.0, (limits[1] - limits[0]) / (2 * math.pi))
    if estimate.limits is None or true.limits is None:
        return None
    low, high = (-estimate.limits[1], -estimate.limits[0]) if flipped else estimate.limits
    common = min(high, true.limits[1]) - max(low, true.limits[0])
    union = max(high, true.limits[1]) - min(low, true.limits[0])
    return max(common, 0.0) / union if union > 0 else 1.0
