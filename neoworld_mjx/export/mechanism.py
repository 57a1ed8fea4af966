"""A mechanism as files describe it: links with their shapes and masses, and joints between them.

Every reader gives one, in the file's root frame with all joints at 0; `importing` makes an
ObjectSpec of it.
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
from ..spec.pose import matrix

GRAY = (0.7, 0.7, 0.7, 1.0)
"""Color of shapes whose file states none."""
Triangles = tuple[NDArray, NDArray]
"""Vertices [v, 3] m and faces [f, 3] of a mesh."""


@dataclass
class LinkShape:
    """A shape of a link; `at` [4, 4] takes its frame to the file's root frame at rest."""

    shape: BaseShape | Triangles
    at: NDArray
    role: Role
    rgba: tuple[float, float, float, float] = GRAY
    friction: float = 0.5
    hull: bool = False
    """Whether the mesh collides as its convex hull, whatever its form."""
    name: str = ""
    """Name of the material, where the file gives one."""
    density: float | None = None
    """Density of the material [kg/m^3], where the file states it."""
    metallic: float | None = None
    """Of the material, from 0 to 1, where the file states it; so is roughness."""
    roughness: float | None = None


@dataclass
class Link:
    """A rigid body; positions are in the file's root frame at rest."""

    name: str
    shapes: list[LinkShape] = field(default_factory=list)
    mass: float | None = None
    """[kg]; None where the file states none."""
    com: NDArray | None = None
    """Centre of mass [m], [3]."""
    inertia: NDArray | None = None
    """Inertia about it, along the root frame's axes [kg m^2], [3, 3]."""
    origin: NDArray = field(default_factory=lambda: np.zeros(3))
    """Origin of the link's own frame in the file [m], [3]."""
    visual_only: bool = False
    """Whether it is only visible, without mass or colliders."""


@dataclass
class Mechanism:
    """A tree of links; joints have the names, anchors and axes of the file."""

    name: str
    links: dict[str, Link]
    joints: list[JointSpec]
    sites: list[Site] = field(default_factory=list)
    """Named points of links, with the names of the file."""
    notes: list[str] = field(default_factory=list)
    """Omissions and assumptions of the reader, in words."""

    @property
    def root(self) -> str:
        """Name of the link without a parent."""
        children = {joint.child for joint in self.joints}
        return next(name for name in self.links if name not in children)


@dataclass
class Assembly:
    """One object of a file that may hold several: its mechanism, and where it is."""

    path: str
    """Its name in the file."""
    mechanism: Mechanism
    frame: NDArray
    """Rigid transform from the mechanism's frame to the world [4, 4] m, Z up."""
    fixed: bool
    """Whether it cannot move as a whole."""
    state: dict[str, float] = field(default_factory=dict)
    """Values of its joints in the file's scene [rad or m]; a ball's have .x, .y and .z."""
    bare: bool = False
    """Whether it is geometry without a rigid body."""


def mechanism(spec: ObjectSpec) -> Mechanism:
    """Describe an object, without its shapes."""
    origins = {joint.child: np.array(joint.pos) for joint in spec.joints}
    links = {}
    for part in spec.parts:
        mass = inertial(spec, part)
        turn = matrix(mass.quat)
        links[part.name] = Link(
            part.name,
            mass=mass.mass,
            com=np.array(mass.pos),
            inertia=turn @ np.diag(mass.diagonal) @ turn.T,
            origin=origins.get(part.name, np.zeros(3)),
        )
    return Mechanism(spec.name, links, list(spec.joints), list(spec.sites))


def transformed(own: Mechanism, into: NDArray) -> Mechanism:
    """Return a mechanism in another frame, `into` [4, 4] being the rigid transform to it."""
    turn, shift = into[:3, :3], into[:3, 3]
    place = lambda point: turn @ np.asarray(point) + shift
    links = {
        name: replace(
            link,
            shapes=[replace(shape, at=into @ shape.at) for shape in link.shapes],
            com=None if link.com is None else place(link.com),
            inertia=None if link.inertia is None else turn @ link.inertia @ turn.T,
            origin=place(link.origin),
        )
        for name, link in own.links.items()
    }
    joints = [
        joint.model_copy(
            update={"pos": triple(place(joint.pos)), "axis": triple(turn @ np.array(joint.axis))}
        )
        for joint in own.joints
    ]
    sites = [unchecked_site(site.name, site.part, place(site.pos)) for site in own.sites]
    return Mechanism(own.name, links, joints, sites, own.notes)


def check_tree(path: Path, links: Sequence[str], joints: Sequence[tuple[str, str, str]]) -> str:
    """Return the root of a tree of links.

    Args:
        path: the file, for messages.
        links: names.
        joints: (name, parent, child).

    Raises:
        SpecError: a name is unknown or repeated, a link has two parents, links form a cycle, or
            there are several roots.
    """
    known = set(links)
    if len(known) < len(links):
        twice = sorted(link for link, count in Counter(links).items() if count > 1)
        raise SpecError(f"{path}: link {twice[0]!r} is there twice")
    parents: dict[str, str] = {}
    for name, parent, child in joints:
        for end in (parent, child):
            if end not in known:
                raise SpecError(f"{path}: joint {name!r} names link {end!r}, which is not there")
        if child in parents:
            raise SpecError(f"{path}: link {child!r} is the child of two joints")
        parents[child] = parent
    looped = name_on_cycle(parents)
    if looped is not None:
        raise SpecError(f"{path}: joints go in a circle through link {looped!r}")
    roots = [link for link in links if link not in parents]
    if len(roots) != 1:
        raise SpecError(
            f"{path}: an object has one root link, this has {', '.join(roots) or 'none'}"
        )
    return roots[0]


def unchecked_mimic(joint: str, multiplier: float, offset: float) -> Mimic:
    """Make a joint follow another, whose name is that of its file."""
    return Mimic.model_construct(joint=joint, multiplier=multiplier, offset=offset)


def unchecked_joint(**fields: Any) -> JointSpec:
    """Make a joint with the names of its file, unchecked; importing renames and checks it."""
    return JointSpec.model_construct(**fields)


def unchecked_site(name: str, part: str, pos: NDArray) -> Site:
    """Make a site with the names of its file, unchecked; importing renames and checks it."""
    return Site.model_construct(name=name, part=part, pos=triple(pos))


def triple(values: NDArray) -> tuple[float, float, float]:
    """Turn three numbers of NumPy into plain ones."""
    x, y, z = (float(v) for v in values)
    return x, y, z
