"""Ground truth of an object, read from a file: its joints and its surface.

    {"name": "cabinet", "front": "+x", "box": [[x, y, z], [x, y, z]],
     "joints": [{"name": "hinge", "type": "revolute", "axis": [0, 0, 1], "pivot": [0.2, 0.3, 0],
                 "limits": [0, 1.6], "parent": "body", "child": "door",
                 "moving_box": [[0.2, -0.3, 0], [0.22, 0.3, 0.7]]}]}

Units are meters and radians. All positions are in one frame with +z up, with all joints at zero.
`front` is the direction in which the object's front faces. `moving_box` is the box (low, high) of
all parts that the joint moves. Files omit joints that move nothing visible. Samples of the surface
may be in an .npz file of the same name, as `points` [n, 3] in the same frame.
"""

from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError, model_validator

from neoworld_mjx.errors import SpecError
from neoworld_mjx.io import read_json
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
    source: str = Field(default="", description="Source and licence.")

    @model_validator(mode="after")
    def _valid(self) -> "ObjectTruth":
        _ordered(self.box, "box")
        if not np.ptp(np.array(self.box), axis=0).any():
            raise ValueError("box: the object has no size")
        return self


def read_truth(path: Path) -> ObjectTruth:
    """Read a ground-truth file.

    Raises:
        SpecError: the file cannot be read or is invalid.
    """
    return truth_from(read_json(path, SpecError), str(path))


def truth_from(data: Any, name: str = "truth") -> ObjectTruth:
    """Validate a ground truth given as a mapping.

    Raises:
        SpecError: the mapping is invalid; the message names up to four invalid fields.
    """
    try:
        return ObjectTruth.model_validate(data)
    except ValidationError as error:
        wrong = "; ".join(
            f"{'.'.join(map(str, e['loc'])) or 'truth'}: {e['msg']}" for e in error.errors()[:4]
        )
        raise SpecError(f"{name}: {wrong}") from None


def truth_of(spec: ObjectSpec) -> ObjectTruth:
    """Convert a reconstructed object to an `ObjectTruth`, without fixed joints."""
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


def quarter_turns(front: Front) -> int:
    """Return the number of quarter turns about +z that rotate a front to +x."""
    return _TURNS[front]


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
