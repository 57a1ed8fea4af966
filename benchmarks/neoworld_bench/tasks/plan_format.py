"""The plan of a free gripper: a start pose, and displacements with a grip.

Section 4.4 of the paper: for a task, a model "specifies the initial end-effector position and
displacement". A plan with one move is that; several moves in a row, turns, and the opening of the
fingers let one format serve doors, knobs and objects that are picked up.

The tool frame lies between the pads of the fingers: `approach` points out of the palm, `closing`
is the line along which the fingers close.
"""

import math
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from neoworld_mjx.spec import Spec, Vec3
from neoworld_mjx.spec.base import Number
from neoworld_mjx.spec.pose import from_matrix, quat_mul

MAX_OPENING = 0.12
"""Farthest distance of the pads [m]; that of a Robotiq 2F-140 is 0.14."""
MAX_TURN = 2.9
"""Largest angle of the tool from its start [rad]: the actuators of its ball joint follow a rotation
vector, which is unique below pi."""
MOST_MOVES = 12
REACH = 3.0
"""Bound of coordinates [m]."""

Coordinate = Annotated[Number, Field(ge=-REACH, le=REACH)]
Angle = Annotated[Number, Field(ge=-math.pi, le=math.pi)]
Opening = Annotated[float, Field(ge=0, le=MAX_OPENING)]


class ToolMove(Spec):
    """One movement of the tool at an even pace, and where the fingers are at its end."""

    displacement: tuple[Coordinate, Coordinate, Coordinate] = (0.0, 0.0, 0.0)
    """By how much the tool moves in the world [m]."""
    turn: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)
    """Rotation vector of its turn, in the world's axes [rad]."""
    about: tuple[Coordinate, Coordinate, Coordinate] | None = None
    """A point of the axis of the turn, which the tool goes round [m]; None turns it in place."""
    opening: Opening
    """Distance of the pads at the end [m]; 0 closes them with all their force."""
    seconds: Annotated[float, Field(ge=0.1, le=6)] = 1.0


class TaskPlan(Spec):
    """What a gripper does for one task."""

    position: tuple[Coordinate, Coordinate, Coordinate]
    """Start of the tool in the world [m]."""
    approach: Vec3 = (0.0, 0.0, -1.0)
    """Direction in which the fingers point."""
    closing: Vec3 = (0.0, 1.0, 0.0)
    """Direction along which the fingers close; what lies along `approach` is taken out."""
    opening: Opening
    """Distance of the pads at the start [m]."""
    moves: tuple[ToolMove, ...] = Field(min_length=1, max_length=MOST_MOVES)

    @model_validator(mode="after")
    def _directions(self) -> "TaskPlan":
        approach, closing = np.array(self.approach), np.array(self.closing)
        across = np.linalg.norm(np.cross(approach, closing))
        if across < 0.1 * np.linalg.norm(approach) * np.linalg.norm(closing) or across < 1e-9:
            raise ValueError("approach and closing must not be zero, nor parallel")
        orientation = np.array([1.0, 0.0, 0.0, 0.0])
        for k, move in enumerate(self.moves):
            orientation = quat_mul(rotation(move.turn), orientation)
            if 2 * math.acos(min(1.0, abs(orientation[0]))) > MAX_TURN:
                raise ValueError(
                    f"moves.{k}.turn: the tool may turn {MAX_TURN} rad away from its start, no more"
                )
        return self

    @property
    def quat(self) -> NDArray:
        """Rotation of the tool at the start: its +z is `approach`, its +y along `closing`."""
        z = np.array(self.approach) / np.linalg.norm(self.approach)
        y = np.array(self.closing) - (np.array(self.closing) @ z) * z
        y /= np.linalg.norm(y)
        return from_matrix(np.stack([np.cross(y, z), y, z], axis=1))

    @property
    def seconds(self) -> float:
        """Duration of all moves [s]."""
        return sum(move.seconds for move in self.moves)

    def shifted(self, by: Vec3) -> "TaskPlan":
        """Return the same plan elsewhere: its start and the axes of its turns moved by this [m]."""
        moves = [
            move if move.about is None else move.model_copy(update={"about": _sum(move.about, by)})
            for move in self.moves
        ]
        return self.model_copy(update={"position": _sum(self.position, by), "moves": tuple(moves)})


def _sum(a: Vec3, b: Vec3) -> Vec3:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def rotation(vector: Vec3 | NDArray) -> NDArray:
    """Return the quaternion of a rotation vector [rad]."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:
        return np.array([1.0, 0.0, 0.0, 0.0])
    axis = np.asarray(vector, float) / angle
    return np.concatenate([[math.cos(angle / 2)], math.sin(angle / 2) * axis])
