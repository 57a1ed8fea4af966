"""From links and joints of a file from elsewhere to an ObjectSpec, and what could not be carried."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from ..config import describe
from ..errors import SpecError
from ..spec import (
    AuthoredInertia,
    GeomSpec,
    JointSpec,
    Material,
    Mesh,
    Mimic,
    ObjectSpec,
    PartSpec,
    Sphere,
    recentred,
)
from ..spec.mesh import HELPER, UNKNOWN
from ..spec.pose import from_matrix
from .decompose import convex_pieces, hull_points, installed

DENSITY = 400.0
"""Of links that state no mass [kg/m^3]: furniture's."""
BEAD_M = 0.001
"""Radius of the bead that stands for a link without geometry."""
MAX_LINKS = 400


@dataclass(frozen=True)
class Imported:
    """An object from elsewhere."""

    spec: ObjectSpec
    notes: tuple[str, ...]
    """What could not be carried, and what was assumed."""


@dataclass
class Solid:
    """A shape of a link; `at` [4, 4] takes its frame to the file's root frame at rest."""

    shape: Any
    """A shape of the spec, or (vertices, faces) of a mesh."""
    at: NDArray
    role: str
    rgba: tuple[float, float, float, float] = (0.7, 0.7, 0.7, 1.0)
    friction: float = 0.5
    hull: bool = False
    """Whether the mesh collides as its convex hull, whatever its form."""


@dataclass
class Link:
    """A rigid body; poses in the file's root frame at rest."""

    name: str
    solids: list[Solid] = field(default_factory=list)
    mass: float | None = None
    com: NDArray | None = None
    inertia: NDArray | None = None
    """About the centre of mass, along the root frame's axes [3, 3]."""
    decoration: bool = False
    """Whether it is there to be seen only, without mass or colliders."""


def assemble(
    name: str, links: Sequence[Link], joints: Sequence[JointSpec], notes: list[str]
) -> Imported:
    """Make an object of links and joints.

    Links without geometry, or that are only seen, are joined with what they are fixed to; a link without
    geometry that moves on its own becomes a bead. Names are made such as the spec takes them.

    Args:
        name: of the object.
        links: all links, in any order.
        joints: joints that name links, anchors and axes in the file's root frame at rest.
        notes: what was noted so far; more is added.

    Raises:
        SpecError: the links are no tree, or a number is out of bounds.
    """
    if len(links) > MAX_LINKS:
        raise SpecError(f"{name} has {len(links)} links; at most {MAX_LINKS} are read")
    by_name = {link.name: link for link in links}
    kept = _without_empty(by_name, list(joints), notes)
    names = _Names()
    materials: dict[tuple, Material] = {}
    parts = []
    for link in by_name.values():
        try:
            parts.append(_part(link, names, materials, notes))
        except ValidationError as error:
            raise SpecError(f"link {link.name} of {name}: {describe(error, PartSpec)}") from None
    labels = {link.name: part.name for link, part in zip(by_name.values(), parts, strict=True)}
    _check_follow(kept)
    titles = {joint.name: names.take(joint.name, "joint") for joint in kept}
    made = []
    for joint in kept:
        update: dict[str, Any] = {
            "name": titles[joint.name],
            "parent": labels[joint.parent],
            "child": labels[joint.child],
        }
        if joint.mimic is not None:
            if joint.mimic.joint in titles:
                leader = titles[joint.mimic.joint]
                update["mimic"] = joint.mimic.model_copy(update={"joint": leader})
            else:
                update["mimic"] = None
                notes.append(f"joint {joint.name}: what it follows is not carried")
        made.append(joint.model_copy(update=update).model_dump())
    try:
        spec = ObjectSpec(
            name=_Names().take(name, "object"),
            materials=tuple(materials.values()),
            parts=tuple(parts),
            joints=tuple(map(JointSpec.model_validate, made)),
        )
    except ValidationError as error:
        raise SpecError(f"{name}: {describe(error, ObjectSpec)}") from None
    return Imported(recentred(spec), tuple(dict.fromkeys(notes)))


def _without_empty(
    links: dict[str, Link], joints: list[JointSpec], notes: list[str]
) -> list[JointSpec]:
    """Join links without geometry with what they are fixed to; give the others a bead."""
    changed = True
    while changed:
        changed = False
        for joint in joints:
            if joint.type != "fixed":
                continue
            parent, child = links[joint.parent], links[joint.child]
            if _solid(child) and _solid(parent) and not child.decoration:
                continue
            # The one without geometry goes; its mass is the other's. So does what is only seen.
            stays, goes = (child, parent) if not _solid(parent) else (parent, child)
            _merge(stays, goes)
            del links[goes.name]
            joints.remove(joint)
            joints[:] = [_renamed(j, goes.name, stays.name) for j in joints]
            changed = True
            break
    for link in links.values():
        if not _solid(link):
            joint = next((j for j in joints if j.child == link.name), None)
            at = np.eye(4)
            at[:3, 3] = (0, 0, 0) if joint is None else joint.pos
            link.solids = [Solid(Sphere(radius=BEAD_M), at, "collision", hull=True)]
            if link.mass is None or link.mass <= 0:
                link.mass, link.com, link.inertia = 1e-3, at[:3, 3], np.eye(3) * 1e-6
            notes.append(f"link {link.name} has no geometry: a bead of {BEAD_M * 1e3:g} mm is its")
    return joints


def _solid(link: Link) -> bool:
    return bool(link.solids)


def _merge(stays: Link, goes: Link) -> None:
    stays.solids += goes.solids
    if goes.mass is None or goes.mass <= 0 or goes.com is None:
        return
    if stays.mass is None or stays.com is None or stays.inertia is None:
        return  # Its own is derived from its geometry, beside which a frame's is nothing.
    total = stays.mass + goes.mass
    com = (stays.mass * stays.com + goes.mass * goes.com) / total
    inertia = np.zeros((3, 3))
    for link in (stays, goes):
        assert link.mass is not None and link.com is not None
        d = link.com - com
        own = np.zeros((3, 3)) if link.inertia is None else link.inertia
        inertia += own + link.mass * (d @ d * np.eye(3) - np.outer(d, d))
    stays.mass, stays.com, stays.inertia = total, com, inertia


def _renamed(joint: JointSpec, old: str, new: str) -> JointSpec:
    swap = {k: new for k in ("parent", "child") if getattr(joint, k) == old}
    return joint.model_copy(update=swap) if swap else joint


def _part(
    link: Link, names: "_Names", materials: dict[tuple, Material], notes: list[str]
) -> PartSpec:
    label = names.take(link.name, "part")
    bare = all(solid.role == "visual" for solid in link.solids)
    helper = len(link.solids) == 1 and link.solids[0].shape == Sphere(radius=BEAD_M)
    if bare and not all(hasattr(solid.shape, "pieces") for solid in link.solids):
        how = "CoACD" if installed() else "their convex hull, as CoACD is not installed"
        notes.append(f"link {link.name} has no colliders: made of what is seen, by {how}")
    geoms = []
    for k, solid in enumerate(link.solids):
        role = "both" if bare else solid.role
        shape = solid.shape if hasattr(solid.shape, "pieces") else _mesh(solid, role, link, notes)
        if shape is None:
            continue
        geoms.append(
            GeomSpec(
                name=names.take(f"{label[:40]}_{k}", "geom"),
                shape=shape,
                pos=tuple(solid.at[:3, 3].tolist()),
                quat=tuple(from_matrix(solid.at[:3, :3]).tolist()),
                material=_material(solid, materials, helper),
                role=role,  # pyright: ignore[reportArgumentType]
            )
        )
    if all(geom.role == "visual" for geom in geoms):
        raise SpecError(f"link {link.name} has no geometry that could collide")
    mass, inertia = link.mass, None
    if mass is None:
        notes.append(f"link {link.name} states no mass: {DENSITY:g} kg/m^3 is assumed")
    elif mass <= 0:
        notes.append(f"link {link.name} states a mass of {mass:g} kg")
        mass = 1e-9
    if mass is not None and link.com is not None and link.inertia is not None:
        t = link.inertia
        inertia = AuthoredInertia(
            pos=tuple(link.com.tolist()),
            moments=(float(t[0, 0]), float(t[1, 1]), float(t[2, 2])),
            products=(float(t[0, 1]), float(t[0, 2]), float(t[1, 2])),
        )
    return PartSpec(name=label, geoms=tuple(geoms), mass=mass, inertia=inertia)


def _mesh(solid: Solid, role: str, link: Link, notes: list[str]) -> Mesh | None:
    vertices, faces = (np.asarray(v) for v in solid.shape)
    if not np.isfinite(vertices).all():
        raise SpecError(f"link {link.name}: a mesh holds numbers that are none")
    if len(vertices) < 3 or len(faces) < 1 or np.ptp(vertices, axis=0).max() < 1e-6:
        notes.append(f"link {link.name}: a mesh without extent is left out")
        return None
    if len(vertices) == 3:
        vertices = np.vstack([vertices, vertices.mean(axis=0)])
    if role == "visual" or solid.hull:
        hulls = [hull_points(vertices)]
    else:
        hulls = convex_pieces(vertices, faces)
    return Mesh(
        vertices=tuple(map(tuple, vertices.astype(float).tolist())),
        faces=tuple(map(tuple, faces.astype(int).tolist())),
        hulls=tuple(tuple(map(tuple, points.tolist())) for points in hulls),
    )


def _material(solid: Solid, materials: dict[tuple, Material], helper: bool) -> str:
    key = (solid.rgba, solid.friction, helper)
    if key not in materials:
        stem = HELPER if helper else UNKNOWN
        same = sum(material.name.startswith(stem) for material in materials.values())
        materials[key] = Material(
            name=stem if same == 0 else f"{stem}_{same}",
            density=DENSITY,
            friction=min(max(solid.friction, 0.0), 10.0),
            rgba=tuple(min(max(v, 0.0), 1.0) for v in solid.rgba),  # pyright: ignore[reportArgumentType]
        )
    return materials[key].name


class _Names:
    """Names that the spec takes, each once."""

    def __init__(self) -> None:
        self.taken: dict[str, set[str]] = {}

    def take(self, name: str, kind: str) -> str:
        """Return a name made of letters, digits and underscores that is not taken yet."""
        taken = self.taken.setdefault(kind, set())
        plain = re.sub(r"[^A-Za-z0-9_]", "_", name)[:44] or kind
        plain = plain if plain[0].isalpha() else f"{kind[0]}_{plain}"[:44]
        label, k = plain, 1
        while label in taken:
            label, k = f"{plain}_{k}", k + 1
        taken.add(label)
        return label


def check_tree(path: Any, links: Sequence[str], joints: Sequence[tuple[str, str, str]]) -> str:
    """Return the root of a tree of links.

    Args:
        path: the file, for messages.
        links: names.
        joints: (name, parent, child).

    Raises:
        SpecError: a name is unknown or twice, a link hangs on two, goes in a circle, or there are
            several roots.
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
        seen, at = {start}, start
        while at in parents:
            at = parents[at]
            if at in seen:
                raise SpecError(f"{path}: joints go in a circle through link {at!r}")
            seen.add(at)
    roots = [link for link in links if link not in parents]
    if len(roots) != 1:
        raise SpecError(
            f"{path}: an object has one root link, this has {', '.join(roots) or 'none'}"
        )
    return roots[0]


def _check_follow(joints: Sequence[JointSpec]) -> None:
    leaders = {joint.name: joint.mimic.joint for joint in joints if joint.mimic is not None}
    for start in leaders:
        at, seen = start, set()
        while at in leaders:
            if at in seen:
                raise SpecError(f"joint {at!r} follows itself in a circle")
            seen.add(at)
            at = leaders[at]


def follow(joint: str, multiplier: float, offset: float) -> Mimic:
    """Make a joint follow another, by the name that it has in its file."""
    return Mimic.model_construct(joint=joint, multiplier=multiplier, offset=offset)


def foreign(**fields: Any) -> JointSpec:
    """Make a joint whose names are those of its file; `assemble` gives it valid ones and checks it."""
    return JointSpec.model_construct(**fields)


__all__ = ["Imported", "Link", "Solid", "assemble", "check_tree", "follow", "foreign"]
