"""Turn mechanisms read from URDF, MJCF and USD files into ObjectSpecs, and note what was lost."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from ..errors import SpecError
from ..io.names import identifier
from ..io.validation_message import validation_message
from ..physics.decompose import convex_pieces, hull_points, installed
from ..spec import (
    AuthoredInertia,
    GeomSpec,
    JointSpec,
    Material,
    Mesh,
    ObjectSpec,
    PartSpec,
    Site,
    Sphere,
    bounds,
    recentred,
)
from ..spec.base import Vec3
from ..spec.base_shape import BaseShape
from ..spec.forest import name_on_cycle
from ..spec.mesh import HELPER, UNKNOWN
from ..spec.pose import from_matrix
from .checked_usd import open_usd
from .mechanism import Link, LinkShape, Mechanism, Triangles, triple
from .read_mjcf import read_mjcf
from .read_urdf import read_urdf
from .read_usd import one_object

DENSITY = 400.0
"""Density [kg/m^3] assumed of links that state no mass: furniture's."""
PLACEHOLDER_M = 0.001
"""Radius of the ball that stands for a link without geometry."""
MAX_LINKS = 400
MAX_DENSITY = 30000.0
"""Largest density that a material of a description has [kg/m^3]."""


@dataclass(frozen=True)
class Imported:
    """An object read from a file of another program."""

    spec: ObjectSpec
    notes: tuple[str, ...]
    """Omissions and assumptions, in words."""
    origin: Vec3 = (0.0, 0.0, 0.0)
    """Where the object's origin is in the file's frame [m]."""
    joints: dict[str, str] = field(default_factory=dict)
    """Names of the spec's joints by those of the file."""


def import_urdf(path: Path) -> Imported:
    """Read a URDF file and the meshes beside it as an object.

    Raises:
        SpecError: the file is broken or hostile, names a mesh that is not there or lies outside its
            folder, or is no tree.
    """
    return to_object(read_urdf(path))


def import_mjcf(path: Path) -> Imported:
    """Read an MJCF file with one object.

    Raises:
        SpecError: the file is broken or hostile, names a file that is not there or lies outside its
            folder, MuJoCo refuses it, or it holds several objects.
    """
    return to_object(read_mjcf(path))


def import_usd(path: Path, object_path: str | None = None) -> Imported:
    """Read a USD file with one object, or one prim of it.

    Raises:
        SpecError: the file is broken or hostile, names a layer that is not there or lies outside
            its folder, there is no such prim, or it holds several objects.
    """
    return to_object(one_object(path, open_usd(Path(path)), object_path))


def to_object(mechanism: Mechanism) -> Imported:
    """Make an object of links and joints.

    Links without geometry, or that are only seen, are merged with what they are fixed to; a link
    without geometry that moves on its own gets a small ball. Names are made such as the spec takes.

    Args:
        mechanism: what a reader gave; its links and notes are changed.

    Raises:
        SpecError: the links are too many, or a number is out of bounds.
    """
    name, by_name, notes = mechanism.name, mechanism.links, mechanism.notes
    if len(by_name) > MAX_LINKS:
        raise SpecError(f"{name} has {len(by_name)} links; at most {MAX_LINKS} are read")
    kept, owner = _without_empty(by_name, mechanism.joints, notes)
    names = _Names()
    materials: dict[tuple, Material] = {}
    parts = []
    for link in by_name.values():
        try:
            parts.append(_part(link, names, materials, notes))
        except ValidationError as error:
            raise SpecError(
                f"link {link.name} of {name}: {validation_message(error, PartSpec)}"
            ) from None
    labels = {link.name: part.name for link, part in zip(by_name.values(), parts, strict=True)}
    _check_follow(kept)
    titles = {joint.name: names.take(joint.name, "joint") for joint in kept}
    joints = []
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
                notes.append(f"joint {joint.name}: the joint that it follows is not imported")
        joints.append(joint.model_copy(update=update).model_dump())
    try:
        spec = ObjectSpec(
            name=_Names().take(name, "object"),
            materials=tuple(materials.values()),
            parts=tuple(parts),
            joints=tuple(map(JointSpec.model_validate, joints)),
            sites=tuple(
                Site(
                    name=names.take(site.name, "site"),
                    part=labels[owner[site.part]],
                    pos=site.pos,
                )
                for site in mechanism.sites
            ),
        )
    except ValidationError as error:
        raise SpecError(f"{name}: {validation_message(error, ObjectSpec)}") from None
    low, high = bounds(spec)
    origin = ((low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2])
    return Imported(recentred(spec), tuple(dict.fromkeys(notes)), triple(np.array(origin)), titles)


def _without_empty(
    links: dict[str, Link], joints: list[JointSpec], notes: list[str]
) -> tuple[list[JointSpec], dict[str, str]]:
    """Merge links without geometry with what they are fixed to; give the others a ball.

    Returns:
        The joints that are left, and for every link the one that it is part of now.
    """
    changed = True
    owner = {name: name for name in links}
    while changed:
        changed = False
        for joint in joints:
            if joint.type != "fixed":
                continue
            parent, child = links[joint.parent], links[joint.child]
            if child.shapes and parent.shapes and not child.visual_only:
                continue
            # The link without geometry, or that is only seen, goes into the other with its mass.
            kept, merged = (parent, child) if parent.shapes else (child, parent)
            _merge(kept, merged)
            del links[merged.name]
            owner = {k: kept.name if v == merged.name else v for k, v in owner.items()}
            joints.remove(joint)
            joints[:] = [_renamed(j, merged.name, kept.name) for j in joints]
            changed = True
            break
    for link in links.values():
        if not link.shapes:
            joint = next((j for j in joints if j.child == link.name), None)
            at = np.eye(4)
            at[:3, 3] = (0, 0, 0) if joint is None else joint.pos
            link.shapes = [LinkShape(Sphere(radius=PLACEHOLDER_M), at, "collision", hull=True)]
            if link.mass is None or link.mass <= 0:
                link.mass, link.com, link.inertia = 1e-3, at[:3, 3], np.eye(3) * 1e-6
            radius = f"{PLACEHOLDER_M * 1e3:g} mm"
            notes.append(f"link {link.name} has no geometry: a ball of {radius} stands for it")
    return joints, owner


def _merge(kept: Link, merged: Link) -> None:
    kept.shapes += merged.shapes
    if merged.mass is None or merged.mass <= 0 or merged.com is None:
        return
    if kept.mass is None or kept.com is None or kept.inertia is None:
        return  # Its mass is derived from its geometry, beside which a frame's is negligible.
    total = kept.mass + merged.mass
    com = (kept.mass * kept.com + merged.mass * merged.com) / total
    inertia = np.zeros((3, 3))
    for link in (kept, merged):
        assert link.mass is not None and link.com is not None
        d = link.com - com
        own = np.zeros((3, 3)) if link.inertia is None else link.inertia
        inertia += own + link.mass * (d @ d * np.eye(3) - np.outer(d, d))
    kept.mass, kept.com, kept.inertia = total, com, inertia


def _renamed(joint: JointSpec, old: str, new: str) -> JointSpec:
    swap = {k: new for k in ("parent", "child") if getattr(joint, k) == old}
    return joint.model_copy(update=swap) if swap else joint


def _part(
    link: Link, names: "_Names", materials: dict[tuple, Material], notes: list[str]
) -> PartSpec:
    label = names.take(link.name, "part")
    bare = all(item.role == "visual" for item in link.shapes)
    helper = len(link.shapes) == 1 and link.shapes[0].shape == Sphere(radius=PLACEHOLDER_M)
    if bare and not all(isinstance(item.shape, BaseShape) for item in link.shapes):
        method = "CoACD" if installed() else "their convex hull, as CoACD is not installed"
        notes.append(f"link {link.name} has no colliders: made from its visuals, by {method}")
    geoms = []
    for k, item in enumerate(link.shapes):
        role = "both" if bare else item.role
        shape = item.shape
        if not isinstance(shape, BaseShape):
            shape = _mesh(shape, role == "visual" or item.hull, link.name, notes)
        if shape is None:
            continue
        geoms.append(
            GeomSpec(
                name=names.take(f"{label[:40]}_{k}", "geom"),
                shape=shape,  # pyright: ignore[reportArgumentType] pydantic checks the union
                pos=tuple(item.at[:3, 3].tolist()),
                quat=tuple(from_matrix(item.at[:3, :3]).tolist()),
                material=_material(item, materials, helper),
                role=role,
            )
        )
    if all(geom.role == "visual" for geom in geoms):
        raise SpecError(f"link {link.name} has no geometry that could collide")
    mass, inertia = link.mass, None
    if mass is None:
        if not any(item.density for item in link.shapes if item.role != "visual"):
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


def _mesh(triangles: Triangles, hull: bool, link: str, notes: list[str]) -> Mesh | None:
    vertices, faces = (np.asarray(v) for v in triangles)
    if not np.isfinite(vertices).all():
        raise SpecError(f"link {link}: a mesh holds vertices that are not finite numbers")
    if len(vertices) < 3 or len(faces) < 1 or np.ptp(vertices, axis=0).max() < 1e-6:
        notes.append(f"link {link}: a mesh without extent is left out")
        return None
    if len(vertices) == 3:
        vertices = np.vstack([vertices, vertices.mean(axis=0)])
    hulls = [hull_points(vertices)] if hull else convex_pieces(vertices, faces)
    return Mesh(
        vertices=tuple(map(tuple, vertices.astype(float).tolist())),
        faces=tuple(map(tuple, faces.astype(int).tolist())),
        hulls=tuple(tuple(map(tuple, points.tolist())) for points in hulls),
    )


def _material(item: LinkShape, materials: dict[tuple, Material], helper: bool) -> str:
    shine = {
        key: round(min(max(value, 0.0), 1.0), 6)
        for key in ("metallic", "roughness")
        if (value := getattr(item, key)) is not None
    }
    key = (item.rgba, item.friction, helper, item.name, item.density, *shine.items())
    if key not in materials:
        # A name of the file stays only with a density: what is "unknown" has an assumed one.
        known = item.name and item.density is not None and 0 < item.density <= MAX_DENSITY
        stem = HELPER if helper else item.name if known else UNKNOWN
        materials[key] = Material(
            name=identifier(stem, "material", {m.name for m in materials.values()}),
            density=item.density if known and item.density is not None else DENSITY,
            friction=min(max(item.friction, 0.0), 10.0),
            rgba=tuple(min(max(v, 0.0), 1.0) for v in item.rgba),  # pyright: ignore[reportArgumentType]
            **shine,
        )
    return materials[key].name


class _Names:
    """Names that the spec takes, each once."""

    def __init__(self) -> None:
        self.taken: dict[str, set[str]] = {}

    def take(self, name: str, kind: str) -> str:
        """Return a name made of letters, digits and underscores that is not taken yet."""
        taken = self.taken.setdefault(kind, set())
        label = identifier(name, kind, taken)
        taken.add(label)
        return label


def _check_follow(joints: Sequence[JointSpec]) -> None:
    leaders = {joint.name: joint.mimic.joint for joint in joints if joint.mimic is not None}
    looped = name_on_cycle(leaders)
    if looped is not None:
        raise SpecError(f"joint {looped!r} follows itself through other joints")
