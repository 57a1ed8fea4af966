"""Mechanisms: links with shapes and masses, and joints, as files describe them.

Every reader returns mechanisms in the root frame of the file with all joints at 0; `importing`
converts them to ObjectSpecs.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import SpecError
from ..spec import JointSpec, Mimic, ObjectSpec, Site, inertial
from ..spec.base_shape import BaseShape
from ..spec.forest import name_on_cycle
from ..spec.object import Role
from ..spec.pose import ArrayLike
from .link_frames import inertia_tensor, link_origins

GRAY = (0.7, 0.7, 0.7, 1.0)
"""Color of shapes whose file states none."""
Triangles = tuple[NDArray, NDArray]
"""Vertices [v, 3] m and faces [f, 3] of a mesh."""


@dataclass
class LinkShape:
    """A shape of a link; `frame` [4, 4] is its pose in the root frame with all joints at 0."""

    shape: BaseShape | Triangles
    frame: NDArray
    role: Role
    rgba: tuple[float, float, float, float] = GRAY
    friction: float = 0.5
    hull: bool = False
    """True if the mesh collides as its convex hull."""
    name: str = ""
    """Name of the material; empty if the file states none."""
    density: float | None = None
    """Density of the material [kg/m^3]; None if the file states none."""
    metallic: float | None = None
    """Metallic fraction of the material, from 0 to 1."""
    roughness: float | None = None
    """Roughness of the material, from 0 to 1."""


@dataclass
class Link:
    """A rigid body; positions are in the root frame with all joints at 0."""

    name: str
    shapes: list[LinkShape] = field(default_factory=list)
    mass: float | None = None
    """[kg]; None if the file states none."""
    com: NDArray | None = None
    """Center of mass [m], [3]."""
    inertia: NDArray | None = None
    """Inertia about the center of mass, in the axes of the root frame [kg m^2], [3, 3]."""
    origin: NDArray = field(default_factory=lambda: np.zeros(3))
    """Origin of the link's frame [m], [3]."""
    visual_only: bool = False
    """True if it has neither mass nor colliders."""


@dataclass
class Mechanism:
    """A tree of links; names are those of the file."""

    name: str
    links: dict[str, Link]
    joints: list[JointSpec]
    sites: list[Site] = field(default_factory=list)
    """Named points of links."""
    notes: list[str] = field(default_factory=list)
    """Omissions and assumptions of the reader."""

    @property
    def root(self) -> str:
        """Name of the link without a parent."""
        children = {joint.child for joint in self.joints}
        return next(name for name in self.links if name not in children)


@dataclass
class Assembly:
    """One object of a file: its mechanism and its pose."""

    path: str
    """Name of the object in the file."""
    mechanism: Mechanism
    frame: NDArray
    """Rigid transform from the mechanism's frame to the world [4, 4] m, Z up."""
    fixed: bool
    """True if the root cannot move."""
    state: dict[str, float] = field(default_factory=dict)
    """Joint values in the file [rad or m]; those of a ball have .x, .y and .z."""
    bare: bool = False
    """True if it is geometry without a rigid body."""


def mechanism(spec: ObjectSpec) -> Mechanism:
    """Describe an object, without its shapes."""
    origins = link_origins(spec)
    links = {}
    for part in spec.parts:
        mass = inertial(spec, part)
        links[part.name] = Link(
            part.name,
            mass=mass.mass,
            com=np.array(mass.pos),
            inertia=inertia_tensor(spec, part),
            origin=origins[part.name],
        )
    return Mechanism(spec.name, links, list(spec.joints), list(spec.sites))


def transformed(mechanism: Mechanism, into: NDArray) -> Mechanism:
    """Return a mechanism in another frame, to which `into` [4, 4] transforms rigidly."""
    turn, shift = into[:3, :3], into[:3, 3]

    def place(point: ArrayLike) -> NDArray:
        return turn @ np.asarray(point) + shift

    links = {
        name: replace(
            link,
            shapes=[replace(shape, frame=into @ shape.frame) for shape in link.shapes],
            com=None if link.com is None else place(link.com),
            inertia=None if link.inertia is None else turn @ link.inertia @ turn.T,
            origin=place(link.origin),
        )
        for name, link in mechanism.links.items()
    }
    joints = [
        joint.model_copy(
            update={"pos": triple(place(joint.pos)), "axis": triple(turn @ np.array(joint.axis))}
        )
        for joint in mechanism.joints
    ]
    sites = [unchecked_site(site.name, site.part, place(site.pos)) for site in mechanism.sites]
    return Mechanism(mechanism.name, links, joints, sites, mechanism.notes)


def check_tree(path: Path, links: Sequence[str], joints: Sequence[tuple[str, str, str]]) -> str:
    """Return the root of a tree of links.

    Args:
        path: the file, for messages.
        links: names of the links.
        joints: name, parent and child of every joint.

    Raises:
        SpecError: a name is unknown or repeated, a link has two parents, links form a cycle, or
            there are several roots.
    """
    known = set(links)
    if len(known) < len(links):
        twice = sorted(link for link, count in Counter(links).items() if count > 1)
        raise SpecError(f"{path}: link {twice[0]!r} is defined twice")
    parents: dict[str, str] = {}
    for name, parent, child in joints:
        for end in (parent, child):
            if end not in known:
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
            f"{path}: an object has one root link; the file has {', '.join(roots) or 'none'}"
        )
    return roots[0]


def unchecked_mimic(joint: str, multiplier: float, offset: float) -> Mimic:
    """Return an unvalidated mimic of a joint, by its name in the file."""
    return Mimic.model_construct(joint=joint, multiplier=multiplier, offset=offset)


def unchecked_joint(**fields: Any) -> JointSpec:
    """Return an unvalidated joint with the names of the file, which `importing` replaces."""
    return JointSpec.model_construct(**fields)


def unchecked_site(name: str, part: str, pos: NDArray) -> Site:
    """Return an unvalidated site with the names of the file, which `importing` replaces."""
    return Site.model_construct(name=name, part=part, pos=triple(pos))


def triple(values: NDArray) -> tuple[float, float, float]:
    """Convert an array of three numbers to a tuple of floats."""
    x, y, z = (float(v) for v in values)
    return x, y, z
