"""SceneTree: what Step 1 sees in the photograph (paper Section 3.2, "Scene parsing")."""

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from .base import Length, Name, Number, Quat, Spec, Vec3
from .camera import Camera
from .pose import IDENTITY, from_yaw, rotate

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
    """How a movable part of an object stands in the photograph."""

    part: Name
    type: Literal["revolute", "continuous", "prismatic"]
    opening: Annotated[float, Field(ge=0, le=1)] = 0.0
    """0 closed, 1 fully open."""


class TreeNode(Spec):
    """One object of the scene."""

    name: Name
    label: str
    """What it is, in a few words."""
    description: str = ""
    """Shape, material and colours, for whoever programs it."""
    parent: Name | None = None
    """What it stands on, in, at; None for the world."""
    relation: Relation = "on"
    parent_link: Name | None = None
    """The parent's movable part that carries it, such as an open drawer."""
    environment: bool = False
    """Whether it is a support of the environment (table, floor, shelf, wall): static."""
    fixed_base: bool = False
    """Whether it is fastened to what carries it."""
    occluded: bool = False
    occluded_by: tuple[Name, ...] = ()
    box2d: Box2D
    """Tight box of what is visible."""
    box3d: Box3D
    base_tilt: Quat = IDENTITY
    """Rotation before yaw, for things that lean or lie."""
    articulation: tuple[PartState, ...] = ()


class SceneTree(Spec):
    """The hierarchy of a scene with its camera."""

    camera: Camera
    nodes: tuple[TreeNode, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _hierarchy(self) -> "SceneTree":
        names = [node.name for node in self.nodes]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"node names must be unique, repeated: {', '.join(twice)}")
        parents = {node.name: node.parent for node in self.nodes}
        for node in self.nodes:
            for what, other in [
                ("parent", node.parent),
                *(("occluded_by", o) for o in node.occluded_by),
            ]:
                if other is not None and other not in parents:
                    raise ValueError(
                        f"node {node.name}: {what} {other!r} is not a node; nodes are "
                        f"{', '.join(names)}"
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
        for name in names:
            at, visited = parents[name], {name}
            while at is not None:
                if at in visited:
                    raise ValueError(f"nodes form a cycle through {name}")
                visited.add(at)
                at = parents[at]
        return self

    def node(self, name: str) -> TreeNode:
        """Return a node by name."""
        return next(node for node in self.nodes if node.name == name)

    def top_down(self) -> tuple[TreeNode, ...]:
        """Return the nodes, parents before children, else in given order."""
        done: list[TreeNode] = []
        placed: set[str | None] = {None}
        while len(done) < len(self.nodes):
            for node in self.nodes:
                if node.name not in placed and node.parent in placed:
                    done.append(node)
                    placed.add(node.name)
        return tuple(done)

    def to_json(self) -> str:
        """Serialise, the same bytes for the same tree."""
        return self.model_dump_json(indent=1) + "\n"
