"""Scene tree of Step 1 (paper Section 3.2, "Scene parsing"), and the order and cycles of forests.

A forest is a map from each name to the name of its parent.
"""

from collections.abc import Mapping
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from ..io.names import UNIQUE, repeated
from .base import Length, Meters, Name, Number, ObjectName, Quat, Spec, Vec3
from .camera import Camera
from .pose import IDENTITY, from_yaw, rotate
from .room import RECTANGLE, SupportOutline, SupportSurface


def parents_first(parents: Mapping[str, str | None]) -> list[str]:
    """Return the names of an acyclic forest, parents before children.

    Otherwise, names keep the order of `parents`.
    """
    ordered: dict[str | None, None] = {None: None}
    while len(ordered) <= len(parents):
        for name, parent in parents.items():
            if parent in ordered:
                ordered.setdefault(name)
    return [name for name in ordered if name is not None]


def name_on_cycle(parents: Mapping[str, str | None]) -> str | None:
    """Return a name on a cycle (a name that is its own ancestor), or None if there is no cycle.

    Names that are not in `parents` have no parent.
    """
    for start in parents:
        visited, name = {start}, parents[start]
        while name is not None:
            if name in visited:
                return name
            visited.add(name)
            name = parents.get(name)
    return None


Relation = Literal["on", "in", "attached", "leaning"]


class Box2D(Spec):
    """A box in pixels of the original image: x to the right, y down; x1 and y1 are outer edges."""

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
    """An upright box in the world: the bounding box of an object before it is tilted."""

    position: tuple[Meters, Meters, Meters]
    """Center of the bottom face [m]."""
    size: tuple[Length, Length, Length]
    """Edge lengths [m] along the x (front to back), y and z axes of the object."""
    yaw: Number = 0.0
    """Direction [rad] of the object's front (+x) about +z."""

    def corners(self, tilt: Quat = IDENTITY) -> NDArray:
        """Return the eight corners in the world frame [m], shape [8, 3].

        `tilt` rotates the box before `yaw` does. A tilted box is raised, so that its lowest corner
        is at the height of `position`.
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
    """Opening from 0 (closed) to 1 (fully open)."""


Spread = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class Cues(Spec):
    """Uncertainties of a node's parsed values, and cues that constrain the values."""

    contact: tuple[Number, Number] | None = None
    """Pixel of the original image (x to the right, y down) at which the visible contact with the
    support is nearest to the camera; None if no contact is visible. The estimate does not use
    it."""
    cut_sides: tuple[Literal["left", "top", "right", "bottom"], ...] | None = None
    """Sides of `box2d` beyond which the object continues, either occluded or outside the image;
    None if not stated."""
    known_size: tuple[Literal["x", "y", "z"], ...] = ()
    """Edges of `box3d` that have a standard size, which is known without the photograph."""
    position_sd: Spread | None = None
    """Standard deviation of the horizontal position [m], as estimated by the parse."""
    size_sd: Spread | None = None
    """Standard deviation of the size, relative to the size."""
    yaw_sd: Spread | None = None
    """Standard deviation of the yaw [rad]."""
    kept: bool = Field(default=False, exclude_if=lambda value: not value)
    """True if the user placed the object, whose box no stage changes."""


class TreeNode(Spec):
    """One object of the scene."""

    name: ObjectName
    label: str
    """Kind of object, in a few words."""
    description: str = ""
    """Shape, material and colors, for the object program."""
    parent: Name | None = None
    """Node that supports this node; None for the world."""
    relation: Relation = "on"
    leans_on: Name | None = Field(default=None, exclude_if=lambda value: value is None)
    """Node against which a leaning object leans; None if not stated."""
    parent_link: Name | None = None
    """Movable part of the parent that supports this node, such as an open drawer."""
    environment: bool = False
    """True if the node is a static support of the environment (table, floor, shelf, wall)."""
    fixed_base: bool = False
    """True if the object is built in or mounted; see `fastened`."""
    occluded: bool = False
    occluded_by: tuple[Name, ...] = ()
    box2d: Box2D
    """Tight box around the visible part of the object."""
    box3d: Box3D
    base_tilt: Quat = IDENTITY
    """Rotation that is applied before the yaw, for objects that lean or lie."""
    articulation: tuple[PartState, ...] = ()
    held_by: str | None = None
    """Means by which a removable object is attached; None if the object is fastened."""
    cues: Cues = Cues()
    outline: SupportOutline = RECTANGLE
    """Outline of an environment support within `box3d`, seen from above."""
    furniture: bool = False
    """True if the node is an environment support with an object program."""
    surface: SupportSurface | None = None
    """Surface of an environment support; if None, it follows from the description, without
    pattern."""

    @property
    def slab(self) -> bool:
        """True if the node is an environment support without a program: a box with a flat top."""
        return self.environment and not self.furniture

    @property
    def fastened(self) -> bool:
        """True if the object is fixed to its parent, or attached permanently."""
        return self.fixed_base or (self.relation == "attached" and self.held_by is None)


class SceneTree(Spec):
    """The hierarchy of a scene, and its camera."""

    camera: Camera
    camera_measured: tuple[Literal["pitch", "height", "fovy", "roll"], ...] = ()
    """Camera parameters that the parse measured in the image; the others are rough estimates."""
    pitch_sd: float | None = Field(default=None, ge=0, le=1, exclude_if=lambda value: value is None)
    """Standard deviation of the camera's pitch [rad], as stated by the parse."""
    height_sd: float | None = Field(
        default=None, ge=0, le=1, exclude_if=lambda value: value is None
    )
    """Standard deviation of the camera's height, relative to the height, as stated by the parse."""
    nodes: tuple[TreeNode, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _hierarchy(self) -> "SceneTree":
        names = [node.name for node in self.nodes]
        if twice := repeated(names):
            raise ValueError(f"node {UNIQUE}: {', '.join(twice)}")
        parents = {node.name: node.parent for node in self.nodes}
        for node in self.nodes:
            for field, other in [
                ("parent", node.parent),
                ("leans_on", node.leans_on),
                *(("occluded_by", o) for o in node.occluded_by),
            ]:
                if other is not None and other not in parents:
                    raise ValueError(
                        f"node {node.name}: {field} {other!r} is not a node; nodes are "
                        f"{', '.join(names)}"
                    )
            given = {
                "an outline": node.outline.shape != "rectangle",
                "a surface": node.surface is not None,
                "furniture": node.furniture,
            }
            for attribute in (name for name, has in given.items() if has and not node.environment):
                raise ValueError(
                    f"node {node.name} has {attribute}, which only an environment support may have"
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

    @property
    def camera_deviations(self) -> dict[str, float]:
        """Standard deviations of pitch [rad] and log height, those that the parse states."""
        stated = {"pitch": self.pitch_sd, "height": self.height_sd}
        return {name: value for name, value in stated.items() if value is not None}

    def with_sizes(self, sizes: Mapping[str, Vec3]) -> "SceneTree":
        """Return the tree with other sizes of the 3D boxes of some nodes, by name [m]."""
        nodes = []
        for node in self.nodes:
            if node.name in sizes:
                box = node.box3d.model_copy(update={"size": sizes[node.name]})
                node = node.model_copy(update={"box3d": box})
            nodes.append(node)
        return self.model_copy(update={"nodes": tuple(nodes)})

    def node(self, name: str) -> TreeNode:
        """Return a node by name."""
        return next(node for node in self.nodes if node.name == name)

    def top_down(self) -> tuple[TreeNode, ...]:
        """Return the nodes, parents before children; otherwise, nodes keep the given order."""
        return tuple(map(self.node, parents_first({n.name: n.parent for n in self.nodes})))

    def to_json(self) -> str:
        """Return the tree as JSON; equal trees give equal strings."""
        return self.model_dump_json(indent=1) + "\n"
