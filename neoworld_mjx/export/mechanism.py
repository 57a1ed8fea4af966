"""A mechanism as files describe it: links with their shapes and masses, and joints between them.

Every reader gives one, in the file's root frame with all joints at 0; `importing` makes an
ObjectSpec of it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import SpecError
from ..spec import JointSpec, Mimic, ObjectSpec, inertial
from ..spec.base_shape import BaseShape
from ..spec.object import Role
from ..spec.pose import matrix

Triangles = tuple[NDArray, NDArray]
"""Vertices [v, 3] m and faces [f, 3] of a mesh."""


@dataclass
class LinkShape:
    """A shape of a link; `at` [4, 4] takes its frame to the file's root frame at rest."""

    shape: BaseShape | Triangles
    at: NDArray
    role: Role
    rgba: tuple[float, float, float, float] = (0.7, 0.7, 0.7, 1.0)
    friction: float = 0.5
    hull: bool = False
    """Whether the mesh collides as its convex hull, whatever its form."""


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
    """About it, along the root frame's axes [kg m^2], [3, 3]."""
    origin: NDArray = field(default_factory=lambda: np.zeros(3))
    """Of the link's own frame in the file [m], [3]."""
    visual_only: bool = False
    """Whether it is there to be seen only, without mass or colliders."""


@dataclass
class Mechanism:
    """A tree of links; joints have the names, anchors and axes of the file."""

    name: str
    links: dict[str, Link]
    joints: list[JointSpec]
    notes: list[str] = field(default_factory=list)
    """What the reader left out or assumed."""

    @property
    def root(self) -> str:
        """Name of the link without a parent."""
        children = {joint.child for joint in self.joints}
        return next(name for name in self.links if name not in children)


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
    return Mechanism(spec.name, links, list(spec.joints))


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
    twice = {link for link in links if list(links).count(link) > 1}
    if twice:
        raise SpecError(f"{path}: link {sorted(twice)[0]!r} is there twice")
    parents: dict[str, str] = {}
    for name, parent, child in joints:
        for end in (parent, child):
            if end not in links:
                raise SpecError(f"{path}: joint {name!r} names link {end!r}, which is not there")
        if child in parents:
            raise SpecError(f"{path}: link {child!r} is the child of two joints")
        parents[child] = parent
    for start in parents:
        visited, at = {start}, start
        while at in parents:
            at = parents[at]
            if at in visited:
                raise SpecError(f"{path}: joints go in a circle through link {at!r}")
            visited.add(at)
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


def triple(values: NDArray) -> tuple[float, float, float]:
    """Turn three numbers of NumPy into plain ones."""
    x, y, z = (float(v) for v in values)
    return x, y, z


__all__ = [
    "Link",
    "LinkShape",
    "Mechanism",
    "check_tree",
    "mechanism",
    "triple",
    "unchecked_joint",
    "unchecked_mimic",
]
