"""Mechanisms (links with shapes and masses, and joints) as described in files.

Each reader returns mechanisms in the root frame of the file, with all joints at zero. Their joints
and sites are not validated, and have the names that the file states. `importing` converts
mechanisms to ObjectSpecs.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import SpecError
from ..evidence.file_camera import FileCamera
from ..spec import JointSpec, Site
from ..spec.base import Vec3
from ..spec.object import Role
from ..spec.pose import ArrayLike, triple
from ..spec.primitives import BaseShape
from ..spec.tree import name_on_cycle
from .mesh_colors import Color, Surface

GRAVITY = (0.0, 0.0, -9.81)
"""Gravitational acceleration of scenes by default [m/s^2]."""
GRAY = (0.7, 0.7, 0.7, 1.0)
"""Color of a shape if the file states no color."""
SLIDE_M = 10.0
"""Largest displacement of a slide joint without limits, which objects cannot have [m]."""
WORLD = "world"
"""Name of the root link of an object that joints connect to the world."""
Triangles = tuple[NDArray, NDArray]
"""Vertices of a mesh [m], shape [v, 3], and faces, shape [f, 3]."""


@dataclass
class LinkShape:
    """Shape of a link."""

    shape: BaseShape | Triangles
    frame: NDArray
    """Pose of the shape in the root frame with all joints at zero [m], shape [4, 4]."""
    role: Role
    rgba: Color = GRAY
    friction: float = 0.5
    hull: bool = False
    """If True, the convex hull of the mesh is the collider."""
    mesh: int | None = None
    """Number of the mesh that this is a surface of, if the surfaces of a mesh have several colors;
    if the link has no colliders, its collider is derived from the whole mesh."""
    placeholder: bool = False
    """True for the small sphere that replaces the colliders of a link without any."""
    metallic: float | None = None
    """Metallic fraction of the material, from 0 to 1."""
    roughness: float | None = None
    """Roughness of the material, from 0 to 1."""


class StatedMass(NamedTuple):
    """Mass that a file states for a link, as in `Link`."""

    mass: float
    com: NDArray
    inertia: NDArray


@dataclass
class Link:
    """Rigid body. Positions are in the root frame, with all joints at zero."""

    name: str
    shapes: list[LinkShape] = field(default_factory=list)
    mass: float | None = None
    """Mass [kg]; None if the file states no mass."""
    com: NDArray | None = None
    """Center of mass [m], shape [3]."""
    inertia: NDArray | None = None
    """Inertia about the center of mass, in the axes of the root frame [kg m^2], shape [3, 3]."""
    visual_only: bool = False
    """True if the file states that the link collides with nothing."""
    static: bool = False
    """True if the link belongs to the world, so that its mass has no effect."""
    masses: list["StatedMass"] = field(default_factory=list)
    """Masses of the links that are merged into this one."""


@dataclass
class Mechanism:
    """Tree of links, with names as in the file."""

    name: str
    links: dict[str, Link]
    joints: list[JointSpec]
    sites: list[Site] = field(default_factory=list)
    """Named points of links."""
    notes: list[str] = field(default_factory=list)
    """Notes on data of the object that the reader omits, and on assumptions that it makes."""
    file_notes: list[str] = field(default_factory=list)
    """The same for the whole file; mechanisms from one file may share this list."""
    fixed: bool = False
    """True if the root link cannot move."""

    @property
    def root(self) -> str:
        """Name of the link without a parent."""
        children = {joint.child for joint in self.joints}
        return next(name for name in self.links if name not in children)


@dataclass
class Assembly:
    """Object of a file: its mechanism and its pose."""

    path: str
    """Name of the object in the file."""
    mechanism: Mechanism
    frame: NDArray
    """Rigid transform from the mechanism's frame to the world frame (Z up) [m], shape [4, 4]."""
    fixed: bool = False
    """True if the root link cannot move although the mechanism itself does not state it."""
    world: bool = False
    """True if the object consists of geoms of the world body."""
    state: dict[str, float] = field(default_factory=dict)
    """Joint positions in the file [rad or m], by joint name. A ball joint has three entries, whose
    names end in .x, .y and .z."""


@dataclass(frozen=True)
class FileScene:
    """Objects of a file, with their poses in the world frame (Z up)."""

    objects: list[Assembly]
    gravity: Vec3 | None = None
    """Gravitational acceleration [m/s^2]; None for meshes, whose files state none."""
    camera: FileCamera | None = None
    """Camera of the photograph; None if the file states no camera."""
    in_camera: bool = False
    """True if the poses in the file are in the camera's frame. The world frame is then the result
    of `level_transform`."""


def gravity_notes(gravity: Vec3 | None) -> list[str]:
    """Return a note for an object if the gravity of its file is not that of scenes by default."""
    if gravity is None or np.allclose(gravity, GRAVITY, atol=0.01):
        return []
    stated = " ".join(f"{v:g}" for v in gravity)
    return [f"gravity {stated} m/s^2 is not kept by an object, only by a scene"]


def visual_shapes(
    surfaces: Sequence[Surface], frame: NDArray, groups: Sequence[int], rgba: Color | None = None
) -> list[LinkShape]:
    """Return the surfaces of meshes as visual shapes.

    Args:
        surfaces: surfaces of one or several meshes, in the frame of the shapes.
        frame: pose of the shapes in the root frame [m], shape [4, 4].
        groups: number of the mesh that each surface is a part of.
        rgba: color of all surfaces; by default, each has its own, or is gray.
    """
    return [
        LinkShape(
            (surface.vertices, surface.faces),
            frame,
            "visual",
            rgba or surface.rgba or GRAY,
            metallic=surface.metallic,
            roughness=surface.roughness,
            mesh=group if groups.count(group) > 1 else None,
        )
        for surface, group in zip(surfaces, groups, strict=True)
    ]


def transformed(mechanism: Mechanism, transform: NDArray) -> Mechanism:
    """Return a mechanism in another frame.

    Args:
        mechanism: the mechanism.
        transform: rigid transform from the mechanism's frame to the other frame, shape [4, 4].
    """
    turn, shift = transform[:3, :3], transform[:3, 3]

    def place(point: ArrayLike) -> NDArray:
        return turn @ np.asarray(point) + shift

    links = {
        name: replace(
            link,
            shapes=[replace(shape, frame=transform @ shape.frame) for shape in link.shapes],
            com=None if link.com is None else place(link.com),
            inertia=None if link.inertia is None else turn @ link.inertia @ turn.T,
        )
        for name, link in mechanism.links.items()
    }
    joints = [
        joint.model_copy(
            update={"pos": triple(place(joint.pos)), "axis": triple(turn @ np.array(joint.axis))}
        )
        for joint in mechanism.joints
    ]
    sites = [site.model_copy(update={"pos": triple(place(site.pos))}) for site in mechanism.sites]
    return replace(mechanism, links=links, joints=joints, sites=sites)


def check_tree(path: Path, links: Sequence[str], joints: Sequence[tuple[str, str, str]]) -> str:
    """Check that links and joints form a tree, and return the name of the root link.

    Args:
        path: the file, for messages.
        links: names of the links.
        joints: name, parent and child of each joint.

    Raises:
        SpecError: a name is unknown or repeated, a link has two parents, links form a cycle, or
            there are several roots.
    """
    names = set(links)
    if len(names) < len(links):
        repeated = sorted(link for link, count in Counter(links).items() if count > 1)
        raise SpecError(f"{path}: link {repeated[0]!r} is defined twice")
    parents: dict[str, str] = {}
    for name, parent, child in joints:
        for end in (parent, child):
            if end not in names:
                raise SpecError(f"{path}: joint {name!r} names link {end!r}, which does not exist")
        if child in parents:
            raise SpecError(f"{path}: link {child!r} is the child of two joints")
        parents[child] = parent
    looped = name_on_cycle(parents)
    if looped is not None:
        raise SpecError(f"{path}: joints form a cycle through link {looped!r}")
    roots = [link for link in links if link not in parents]
    if len(roots) != 1:
        raise SpecError(
            f"{path}: expected one root link, but the file has {', '.join(roots) or 'none'}"
        )
    return roots[0]
