"""Ground truth of an object: the joints that move, and boxes of the parts that they move.

Units are meters and radians. All positions are in one frame with +z up, with all joints at zero.
"""

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

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
    turn = quarter_turn(_TURNS[truth.front])
    box = _turned(truth.box, turn)
    origin = np.array([(box[0, 0] + box[1, 0]) / 2, (box[0, 1] + box[1, 1]) / 2, box[0, 2]])
    joints = tuple(
        joint.model_copy(
            update={
                "axis": triple(turn @ np.array(joint.axis)),
                "pivot": triple(turn @ np.array(joint.pivot) - origin),
                "moving_box": _pair(_turned(joint.moving_box, turn) - origin),
            }
        )
        for joint in truth.joints
    )
    return truth.model_copy(update={"front": "+x", "box": _pair(box - origin), "joints": joints})


def canonical_points(points: NDArray, truth: ObjectTruth) -> NDArray:
    """Transform points from a ground truth's frame to its canonical frame [m], shape [n, 3]."""
    turn = quarter_turn(_TURNS[truth.front])
    box = _turned(truth.box, turn)
    origin = np.array([(box[0, 0] + box[1, 0]) / 2, (box[0, 1] + box[1, 1]) / 2, box[0, 2]])
    return np.asarray(points, float) @ turn.T - origin


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


def _pair(box: NDArray) -> Box:
    return triple(box[0]), triple(box[1])


def _ordered(box: Box, name: str) -> None:
    if not all(a <= b for a, b in zip(*box, strict=True)):
        raise ValueError(f"{name}: low corner first, got {box}")
