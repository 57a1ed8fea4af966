"""Ground truth of a real or published object: its joints and its surface, read from a file.

    {"name": "cabinet", "front": "+x", "box": [[x, y, z], [x, y, z]],
     "joints": [{"name": "hinge", "type": "revolute", "axis": [0, 0, 1], "pivot": [0.2, 0.3, 0],
                 "limits": [0, 1.6], "parent": "body", "child": "door",
                 "moving_box": [[0.2, -0.3, 0], [0.22, 0.3, 0.7]]}]}

Metres and radians, in one frame with +z up, at rest (all joints at 0). `front` is the direction in
that frame in which the object's front faces. `moving_box` is the box (low, high) of all that the
joint carries; a joint that carries nothing visible is left out of the file by whoever writes it.
Samples of the surface may lie beside it, as an .npz with `points` [n, 3] in the same frame.
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

Front = Literal["+x", "-x", "+y", "-y"]
Box = tuple[Vec3, Vec3]
Motion = Literal["revolute", "continuous", "prismatic", "ball"]

_TURNS = {"+x": 0, "-y": 1, "-x": 2, "+y": 3}
"""Quarter turns about +z that bring a front to +x."""


class TrueJoint(Spec):
    """A joint that moves something."""

    name: str
    type: Motion
    axis: Vec3 = (0.0, 0.0, 1.0)
    """Direction, of any length but zero; a ball joint ignores it."""
    pivot: Vec3 = (0.0, 0.0, 0.0)
    """A point of the axis [m]; a prismatic joint ignores it."""
    limits: tuple[Number, Number] | None = None
    """Range [rad or m] from rest; None where there is none or it is not known."""
    parent: str = ""
    child: str = ""
    moving_box: Box
    """Low and high corner [m] of the parts that it moves, at rest."""

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
    """Low and high corner [m] of the whole object at rest."""
    joints: tuple[TrueJoint, ...] = ()
    source: str = Field(default="", description="Where it comes from, and its licence.")

    @model_validator(mode="after")
    def _valid(self) -> "ObjectTruth":
        _ordered(self.box, "box")
        if not np.ptp(np.array(self.box), axis=0).any():
            raise ValueError("box: the object has no size")
        return self


def read_truth(path: Path) -> ObjectTruth:
    """Read a truth file.

    Raises:
        SpecError: it cannot be read, or is no truth of this form.
    """
    return truth_from(read_json(path, SpecError), str(path))


def truth_from(data: Any, name: str = "truth") -> ObjectTruth:
    """Check a truth that is given as a mapping.

    Raises:
        SpecError: it is no truth of this form; names each field that is wrong.
    """
    try:
        return ObjectTruth.model_validate(data)
    except ValidationError as error:
        wrong = "; ".join(
            f"{'.'.join(map(str, e['loc'])) or 'truth'}: {e['msg']}" for e in error.errors()[:4]
        )
        raise SpecError(f"{name}: {wrong}") from None


def truth_of(spec: ObjectSpec) -> ObjectTruth:
    """Describe a reconstructed object as if it were the ground truth; fixed joints are left out."""
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
                moving_box=carried_box(spec, joint.child),
            )
        )
    box: Box = (_vec3(low), _vec3(high))
    return ObjectTruth(name=spec.name, box=box, joints=tuple(joints))


def carried_box(spec: ObjectSpec, child: str) -> Box:
    """Return the box (low, high) [m] at rest of a part and all parts that hang on it."""
    carried = {child}
    for part, joint in spec.ordered:
        if joint is not None and joint.parent in carried:
            carried.add(part.name)
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for name in carried:
        for role in ("collision", "visual"):
            for _, piece, at in pieces(spec.part(name), role):
                lowest, highest = box_around(piece, at)
                low, high = np.minimum(low, lowest), np.maximum(high, highest)
    return _vec3(low), _vec3(high)


def canonical(truth: ObjectTruth) -> ObjectTruth:
    """Turn the front to +x and put the origin under the box's centre, at its bottom [m]."""
    turn = quarter_turn(_TURNS[truth.front])
    box = _turned(truth.box, turn)
    origin = np.array([(box[0, 0] + box[1, 0]) / 2, (box[0, 1] + box[1, 1]) / 2, box[0, 2]])
    joints = tuple(
        joint.model_copy(
            update={
                "axis": _vec3(turn @ np.array(joint.axis)),
                "pivot": _vec3(turn @ np.array(joint.pivot) - origin),
                "moving_box": _pair(_turned(joint.moving_box, turn) - origin),
            }
        )
        for joint in truth.joints
    )
    return truth.model_copy(update={"front": "+x", "box": _pair(box - origin), "joints": joints})


def canonical_points(points: NDArray, truth: ObjectTruth) -> NDArray:
    """Move points [n, 3] m of a truth's frame as `canonical` moves the ground truth."""
    turn = quarter_turn(_TURNS[truth.front])
    box = _turned(truth.box, turn)
    origin = np.array([(box[0, 0] + box[1, 0]) / 2, (box[0, 1] + box[1, 1]) / 2, box[0, 2]])
    return np.asarray(points, float) @ turn.T - origin


def diagonal(truth: ObjectTruth) -> float:
    """Return the diagonal [m] of an object's box."""
    return float(np.linalg.norm(np.ptp(np.array(truth.box), axis=0)))


def quarter_turns(front: Front) -> int:
    """Return how many quarter turns about +z bring a front to +x."""
    return _TURNS[front]


def quarter_turn(count: int) -> NDArray:
    """Return the matrix [3, 3] of so many quarter turns about +z."""
    c, s = ((1, 0), (0, 1), (-1, 0), (0, -1))[count % 4]
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _turned(box: Box, turn: NDArray) -> NDArray:
    corners = np.array(box) @ turn.T
    return np.array([corners.min(axis=0), corners.max(axis=0)])


def _pair(box: NDArray) -> Box:
    return _vec3(box[0]), _vec3(box[1])


def _vec3(v: NDArray) -> Vec3:
    x, y, z = v.tolist()
    return x, y, z


def _ordered(box: Box, name: str) -> None:
    if not all(a <= b for a, b in zip(*box, strict=True)):
        raise ValueError(f"{name}: low corner first, got {box}")
