"""SceneTree: what Step 1 sees in the photograph (paper Section 3.2, "Scene parsing")."""

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from .base import Length, Name, Number, Quat, Spec, Vec3
from .camera import Camera
from .forest import name_on_cycle, parents_first
from .pose import IDENTITY, from_yaw, rotate
from .room import RECTANGLE, SupportOutline, SupportSurface

Relation = Literal["on", "in", "attached", "leaning"]


class Box2D(Spec):
    """A box in original pixels: x to the right, y down; x1 and y1 are outer edges."""

    x0: Number
    y0: Number
    x1: Number
    y1: Number

    @model_validator(mode="after")
    def _ordered(self) -> "Box2D":
        if not (self.x0 < self.x1 and self.y0 < self.y1):
            raise ValueError(f"box2d needs x0 < x1 and y0 < y1, got {self.as_tuple()}")
        return self

    def as_tuple(self) -> tuple[float, float, float, float]:
        """Return (x0, y0, x1, y1)."""
        return self.x0, self.y0, self.x1, self.y1


class Box3D(Spec):
    """An upright box in the world: the object's bounding box when it stands untilted."""

    position: Vec3
    """Centre of the bottom face [m]."""
    size: tuple[Length, Length, Length]
    """Edge lengths [m] along the object's own x (front to back), y and z."""
    yaw: Number = 0.0
    """Direction [rad] of the object's front (+x) about +z."""

    def corners(self, tilt: Quat = IDENTITY) -> NDArray:
        """Return the eight corners [8, 3] m in the world, of the box turned by `tilt` first.

        A tilted box is raised so that its lowest corner stands at `position`'s height.
        """
        unit = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0.0, 1.0)])
        local = rotate(tilt, unit * np.array(self.size))
        local[:, 2] -= local[:, 2].min()
        return rotate(from_yaw(self.yaw), local) + np.array(self.position)


class PartState(Spec):
    """State of a movable part of an object in the photograph."""

    part: Name
    type: Literal["revolute", "continuous", "prismatic"]
    opening: Annotated[float, Field(ge=0, le=1)] = 0.0
    """0 closed, 1 fully open."""


Spread = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class Cues(Spec):
    """What an answer says about how well its numbers are known, and what pins them."""

    contact: tuple[Number, Number] | None = None
    """Original pixel (x to the right, y down) of the visible contact with the support that is
    nearest to the camera; None if no contact is seen."""
    cut_sides: tuple[Literal["left", "top", "right", "bottom"], ...] | None = None
    """Sides of `box2d` at which the object goes on, hidden or outside the picture; None if the
    answer does not tell."""
    known_size: tuple[Literal["x", "y", "z"], ...] = ()
    """Edges of `box3d` that all such things have, not judged from the photograph."""
    position_sd: Spread | None = None
    """Standard deviation of the position over the ground, by the answer's own judgement [m]."""
    size_sd: Spread | None = None
    """The same of the size, as a share of it."""
    yaw_sd: Spread | None = None
    """The same of the heading [rad]."""


class TreeNode(Spec):
    """One object of the scene."""

    name: Name
    label: str
    """Kind of object, in a few words."""
    description: str = ""
    """Shape, material and colours, for whoever programs it."""
    parent: Name | None = None
    """Node that carries it; None for the world."""
    relation: Relation = "on"
    parent_link: Name | None = None
    """The parent's movable part that carries it, such as an open drawer."""
    environment: bool = False
    """Whether it is a support of the environment (table, floor, shelf, wall): static."""
    fixed_base: bool = False
    """Whether it is built in or mounted; see `fastened`."""
    occluded: bool = False
    occluded_by: tuple[Name, ...] = ()
    box2d: Box2D
    """Tight box of what is visible."""
    box3d: Box3D
    base_tilt: Quat = IDENTITY
    """Rotation before yaw, for things that lean or lie."""
    articulation: tuple[PartState, ...] = ()
    held_by: str | None = None
    """What holds an attached object that may come off; None if it is fastened."""
    cues: Cues = Cues()
    outline: SupportOutline = RECTANGLE
    """Outline of an environment support within `box3d`, seen from above."""
    furniture: bool = False
    """Whether an environment support is programmed from its picture, as objects are."""
    surface: SupportSurface | None = None
    """Surface of an environment support; None takes its material from words and a plain pattern."""

    @property
    def slab(self) -> bool:
        """Whether it is an environment support that is made from its box, so flat on top."""
        return self.environment and not self.furniture

    @property
    def fastened(self) -> bool:
        """Whether it is fast to what carries it: fixed, or attached by what does not come off."""
        return self.fixed_base or (self.relation == "attached" and self.held_by is None)


class SceneTree(Spec):
    """The hierarchy of a scene with its camera."""

    camera: Camera
    camera_measured: tuple[Literal["pitch", "height", "fovy", "roll"], ...] = ()
    """Numbers of the camera that the answer measured in the picture; the others are guesses."""
    nodes: tuple[TreeNode, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _hierarchy(self) -> "SceneTree":
        names = [node.name for node in self.nodes]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"node names must be unique, repeated: {', '.join(twice)}")
        parents = {node.name: node.parent for node in self.nodes}
        for node in self.nodes:
            for field, other in [
                ("parent", node.parent),
                *(("occluded_by", o) for o in node.occluded_by),
            ]:
                if other is not None and other not in parents:
                    raise ValueError(
                        f"node {node.name}: {field} {other!r} is not a node; nodes are "
                        f"{', '.join(names)}"
                    )
            own = {
                "an outline": node.outline.shape != "rectangle",
                "a surface": node.surface is not None,
                "furniture": node.furniture,
            }
            for what in (what for what, has in own.items() if has and not node.environment):
                raise ValueError(
                    f"node {node.name} has {what}, which only environment supports have"
                )
            parent = next((p for p in self.nodes if p.name == node.parent), None)
            if node.environment and parent is not None and not parent.environment:
                raise ValueError(
                    f"node {node.name} is environment but stands on {parent.name}, which is not"
                )
            if node.parent is None and not node.environment:
                raise ValueError(
                    f"node {node.name} has no parent; only environment supports stand on nothing"
                )
        looped = name_on_cycle(parents)
        if looped is not None:
            raise ValueError(f"nodes form a cycle through {looped}")
        return self

    def node(self, name: str) -> TreeNode:
        """Return a node by name."""
        return next(node for node in self.nodes if node.name == name)

    def top_down(self) -> tuple[TreeNode, ...]:
        """Return the nodes, parents before children, else in given order."""
        return tuple(map(self.node, parents_first({n.name: n.parent for n in self.nodes})))

    def to_json(self) -> str:
        """Serialise, the same bytes for the same tree."""
        return self.model_dump_json(indent=1) + "\n"
