"""Converts mechanisms, which readers of files return, to objects, with notes on omissions."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from pydantic import ValidationError

from ..errors import SpecError
from ..io.names import RESERVED, identifier
from ..io.text_files import validation_message
from ..physics.decompose import Budget, Decomposition, convex_pieces, hull_points, outward
from ..spec import (
    AuthoredInertia,
    GeomSpec,
    JointSpec,
    Material,
    Mesh,
    ObjectSpec,
    PartSpec,
    SceneObject,
    SceneSpec,
    Site,
    Sphere,
    bounds,
    inertial,
    recentred,
)
from ..spec.base import Vec3
from ..spec.mass import inertia_fault
from ..spec.pose import from_matrix, matrix, triple
from ..spec.primitives import BaseShape
from ..spec.shapes import HELPER, UNKNOWN
from ..spec.tree import name_on_cycle
from .load_mesh import joined
from .mechanism import (
    GRAVITY,
    Link,
    LinkShape,
    Mechanism,
    StatedMass,
    Triangles,
)
from .mesh_colors import Surface

DENSITY = 400.0
"""Density of links without a stated mass [kg/m^3]; the value is typical of furniture."""
PLACEHOLDER_M, PLACEHOLDER_KG, PLACEHOLDER_KG_M2 = 1e-3, 1e-6, 1e-9
"""Radius [m], mass and moments of inertia of the sphere that replaces a link without geometry."""
MAX_LINKS, MAX_SHAPES, MAX_SITES = 400, 2000, 2000
MAX_CHANGED = 5
"""Largest number of changed names in a note."""


@dataclass(frozen=True)
class Imported:
    """Object imported from a file of another program."""

    spec: ObjectSpec
    notes: tuple[str, ...]
    """Notes on data that the import omits, and on assumptions that it makes."""
    file_notes: tuple[str, ...] = ()
    """Those of `notes` that concern the whole file, which may contain other objects."""
    origin: Vec3 = (0.0, 0.0, 0.0)
    """Origin of the object's frame, in the frame of the file [m]."""
    joints: dict[str, str] = field(default_factory=dict)
    """Name of each joint in `spec`, by the joint's name in the file."""
    fixed_base: bool = False
    """True if the file fixes the object to the world."""
    gravity: Vec3 = GRAVITY
    """Gravitational acceleration in the file [m/s^2]."""

    @property
    def scene(self) -> SceneSpec:
        """The object where it stands in the file, as a scene."""
        x, y, z = self.origin
        item = SceneObject(
            name=self.spec.name, spec=self.spec, fixed_base=self.fixed_base, xy=(x, y), z=z
        )
        return SceneSpec(name=item.name, objects=(item,), gravity=self.gravity)


def to_object(mechanism: Mechanism, budget: Budget | None = None) -> Imported:
    """Convert a mechanism to an object.

    A link that has no geometry, or only visual geometry, is merged into the link to which it is
    fixed. A moving link without geometry gets a small sphere. Names are converted to valid
    identifiers, with a note.

    Args:
        mechanism: result of a reader; this function modifies the mechanism's links and notes.
        budget: time in which meshes are decomposed; by default, that of the object's meshes.

    Raises:
        SpecError: the mechanism has too many links, shapes or sites, its mimic joints form a cycle,
            or a number is out of bounds.
    """
    name, by_name, notes = mechanism.name, mechanism.links, mechanism.notes
    if len(by_name) > MAX_LINKS:
        raise SpecError(f"{name} has {len(by_name)} links; the limit is {MAX_LINKS}")
    if (shapes := sum(len(link.shapes) for link in by_name.values())) > MAX_SHAPES:
        raise SpecError(f"{name} has {shapes} shapes; the limit is {MAX_SHAPES}")
    if len(mechanism.sites) > MAX_SITES:
        raise SpecError(f"{name} has {len(mechanism.sites)} sites; the limit is {MAX_SITES}")
    moving, owner = _without_empty(by_name, mechanism.joints, notes)
    names = _Names()
    materials: dict[tuple, Material] = {}
    budget = budget or budget_of([mechanism])
    parts = []
    for link in by_name.values():
        try:
            parts.append(_part(link, names, materials, notes, budget))
        except ValidationError as error:
            raise SpecError(
                f"link {link.name} of {name}: {validation_message(error, PartSpec)}"
            ) from None
    part_names = {link.name: part.name for link, part in zip(by_name.values(), parts, strict=True)}
    leaders = {joint.name: joint.mimic.joint for joint in moving if joint.mimic is not None}
    if (looped := name_on_cycle(leaders)) is not None:
        raise SpecError(f"joint {looped!r} mimics itself through other joints")
    joint_names = {joint.name: names.take(joint.name, "joint") for joint in moving}
    changed = [
        f"{old!r} is {new}"
        for old, new in (*part_names.items(), *joint_names.items())
        if old != new
    ]
    if changed:
        more = ", ..." if len(changed) > MAX_CHANGED else ""
        notes.append(f"names are changed: {', '.join(changed[:MAX_CHANGED])}{more}")
    joints = []
    for joint in moving:
        update: dict[str, Any] = {
            "name": joint_names[joint.name],
            "parent": part_names[joint.parent],
            "child": part_names[joint.child],
        }
        if joint.mimic is not None:
            if joint.mimic.joint in joint_names:
                leader = joint_names[joint.mimic.joint]
                update["mimic"] = joint.mimic.model_copy(update={"joint": leader})
            else:
                update["mimic"] = None
                notes.append(
                    f"joint {joint.name} does not mimic {joint.mimic.joint} here, which is not a "
                    "joint of the object"
                )
        joints.append(joint.model_copy(update=update).model_dump())
    label = _Names().take(name, "object")
    if name in RESERVED:
        notes.append(f"the object is named {label} because MuJoCo reserves {name!r}")
    try:
        spec = ObjectSpec(
            name=label,
            materials=tuple(materials.values()),
            parts=tuple(parts),
            joints=tuple(map(JointSpec.model_validate, joints)),
            sites=tuple(
                Site(
                    name=names.take(site.name, "site"),
                    part=part_names[owner[site.part]],
                    pos=site.pos,
                )
                for site in mechanism.sites
            ),
        )
    except ValidationError as error:
        raise SpecError(f"{name}: {validation_message(error, ObjectSpec)}") from None
    low, high = bounds(spec)
    origin = ((low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2])
    return Imported(
        recentred(spec),
        tuple(dict.fromkeys([*mechanism.file_notes, *notes])),
        tuple(dict.fromkeys(mechanism.file_notes)),
        triple(np.array(origin)),
        joint_names,
        mechanism.fixed,
    )


def budget_of(mechanisms: Sequence[Mechanism]) -> Budget:
    """Return the time for splitting the meshes of mechanisms."""
    links = [link for mechanism in mechanisms for link in mechanism.links.values()]
    return Budget.of(sum(map(_splits, links)))


def _without_empty(
    links: dict[str, Link], joints: list[JointSpec], notes: list[str]
) -> tuple[list[JointSpec], dict[str, str]]:
    """Merge links without colliders into links to which they are fixed; add a sphere to the others.

    Returns:
        The remaining joints, and the name of the link into which each link is merged, by link name.
    """
    owner = {name: name for name in links}
    while True:
        ends = [(j, links[j.parent], links[j.child]) for j in joints if j.type == "fixed"]
        bare = [
            (joint, parent, child)
            for joint, parent, child in ends
            if not child.shapes or child.visual_only or not parent.shapes
        ]
        if not bare:
            break
        joint, parent, child = bare[0]
        target, merged = (parent, child) if parent.shapes else (child, parent)
        target.shapes += merged.shapes
        target.visual_only &= merged.visual_only or not merged.shapes
        target.static |= merged.static
        target.masses += merged.masses
        if merged.mass is not None and merged.mass > 0 and merged.com is not None:
            inertia = np.zeros((3, 3)) if merged.inertia is None else merged.inertia
            target.masses.append(StatedMass(merged.mass, merged.com, inertia))
        del links[merged.name]
        owner = {k: target.name if v == merged.name else v for k, v in owner.items()}
        joints.remove(joint)
        joints[:] = [_renamed(j, merged.name, target.name) for j in joints]
    for link in links.values():
        if link.shapes and not link.visual_only:
            continue
        frame = np.eye(4)
        joint = next((j for j in joints if j.child == link.name), None)
        joint = joint or next((j for j in joints if j.parent == link.name), None)
        if joint is not None:
            frame[:3, 3] = joint.pos
        if not link.masses and (link.mass is None or link.mass <= 0):
            link.mass, link.com = PLACEHOLDER_KG, frame[:3, 3].copy()
            link.inertia = np.eye(3) * PLACEHOLDER_KG_M2
        elif link.com is not None:
            frame[:3, 3] = link.com
        sphere = Sphere(radius=PLACEHOLDER_M)
        shape = LinkShape(sphere, frame, "collision", hull=True, placeholder=True)
        missing = "collider" if link.shapes else "geometry"
        link.shapes.append(shape)
        if not link.static:
            radius = f"{PLACEHOLDER_M * 1e3:g} mm"
            notes.append(f"link {link.name} has no {missing}: a sphere of radius {radius} is used")
    return joints, owner


def _renamed(joint: JointSpec, old: str, new: str) -> JointSpec:
    swap = {k: new for k in ("parent", "child") if getattr(joint, k) == old}
    return joint.model_copy(update=swap) if swap else joint


def _part(
    link: Link,
    names: "_Names",
    materials: dict[tuple, Material],
    notes: list[str],
    budget: Budget,
) -> PartSpec:
    label = names.take(link.name, "part")
    derived = all(item.role == "visual" for item in link.shapes)
    geoms, methods = [], list[str]()
    for k, item in enumerate(_with_colliders(link.shapes)):
        shape, split = item.shape, item.role != "visual" and not item.hull
        if not isinstance(shape, BaseShape):
            shape, method = _mesh(shape, budget if split else None, link.name, notes)
            methods += [method or "the convex hull"] if split and (method or derived) else []
        elif derived:
            methods.append("the same shapes")
        if shape is None:
            continue
        geoms.append(
            GeomSpec(
                name=names.take(f"{label[:40]}_{k}", "geom"),
                shape=shape,  # pyright: ignore[reportArgumentType] pydantic checks the union
                pos=tuple(item.frame[:3, 3].tolist()),
                quat=tuple(from_matrix(item.frame[:3, :3]).tolist()),
                material=_material(item, materials),
                role=item.role,
            )
        )
    if all(geom.role == "visual" for geom in geoms):
        raise SpecError(f"link {link.name} has no geometry that can collide")
    if methods:
        source = "has no colliders: derived from its visuals" if derived else "collides by"
        notes.append(f"link {link.name} {source}: {'; '.join(dict.fromkeys(methods))}")
    part = PartSpec(name=label, geoms=tuple(geoms))
    return _with_mass(part, link, tuple(materials.values()), notes)


def _with_mass(
    part: PartSpec, link: Link, materials: tuple[Material, ...], notes: list[str]
) -> PartSpec:
    """Return a part with the mass and inertia that the file states for its link and merged links.

    If the file states a mass without an inertia for the link, the inertia is that of its colliders.
    If it states none, but a mass for a merged link, this is the mass of the part.
    """
    mass, masses = link.mass, list(link.masses)
    if mass is not None and mass <= 0:
        notes.append(f"link {link.name} states a mass of {mass:g} kg")
        mass = None if masses else 1e-9
    if mass is not None and link.com is not None and link.inertia is not None:
        masses.append(StatedMass(mass, link.com, link.inertia))
    elif mass is not None and not masses:
        return part.model_copy(update={"mass": mass})
    elif mass is not None:
        own = inertial(
            ObjectSpec.model_construct(materials=materials), part.model_copy(update={"mass": mass})
        )
        turn = matrix(own.quat)
        tensor = turn @ np.diag(own.diagonal) @ turn.T
        masses.append(StatedMass(mass, np.array(own.pos), tensor))
    elif masses:
        stated = sum(item.mass for item in masses)
        notes.append(
            f"link {link.name} states no mass: {stated:g} kg, stated for links that are fixed to "
            "it, is its mass"
        )
    else:
        if not link.static:
            notes.append(
                f"link {link.name} states no mass: a density of {DENSITY:g} kg/m^3 is assumed"
            )
        return part
    total = sum(item.mass for item in masses)
    com = sum((item.mass * item.com for item in masses), np.zeros(3)) / total
    tensor = np.zeros((3, 3))
    for item in masses:
        d = item.com - com
        tensor += item.inertia + item.mass * (d @ d * np.eye(3) - np.outer(d, d))
    authored = AuthoredInertia(
        pos=triple(com),
        moments=(float(tensor[0, 0]), float(tensor[1, 1]), float(tensor[2, 2])),
        products=(float(tensor[0, 1]), float(tensor[0, 2]), float(tensor[1, 2])),
    )
    result = part.model_copy(update={"mass": total, "inertia": authored})
    own = inertial(ObjectSpec.model_construct(materials=materials), result)
    if (fault := inertia_fault(result, own)) is not None:
        notes.append(fault)
    return result


def _mesh(
    triangles: Triangles, budget: Budget | None, link: str, notes: list[str]
) -> tuple[Mesh | None, str | None]:
    """Return a mesh with the convex pieces of its collider, and how these approximate the mesh.

    The mesh is None if it has no extent. If `budget` is None, the collider is the convex hull.
    """
    vertices, faces = (np.asarray(v) for v in triangles)
    if not np.isfinite(vertices).all():
        raise SpecError(f"link {link}: a mesh has vertices that are not finite")
    if len(vertices) < 3 or len(faces) < 1 or np.ptp(vertices, axis=0).max() < 1e-6:
        notes.append(f"link {link}: a mesh without extent is skipped")
        return None, None
    if len(vertices) == 3:
        vertices = np.vstack([vertices, vertices.mean(axis=0)])
    turned = outward(vertices, faces)
    if np.any(turned != faces):
        wrong = np.any(turned != faces, axis=1).sum()
        notes.append(f"link {link}: {wrong} of {len(faces)} triangles faced inwards: turned")
    split = Decomposition([hull_points(vertices)])
    if budget is not None:
        with budget.share() as share_s:
            split = convex_pieces(vertices, turned, share_s)
    shape = Mesh(
        vertices=tuple(map(tuple, vertices.astype(float).tolist())),
        faces=tuple(map(tuple, turned.astype(int).tolist())),
        hulls=tuple(tuple(map(tuple, points.tolist())) for points in split.pieces),
    )
    return shape, split.method


def _splits(link: Link) -> int:
    """Return the number of meshes of a link that are to be split into convex pieces."""
    derived = all(item.role == "visual" for item in link.shapes)
    return len(
        {
            k if item.mesh is None else -1 - item.mesh
            for k, item in enumerate(link.shapes)
            if (derived or item.role != "visual")
            and not (item.hull or isinstance(item.shape, BaseShape))
        }
    )


def _with_colliders(shapes: list[LinkShape]) -> list[LinkShape]:
    """Return the shapes of a link without colliders, which also collide.

    Several surfaces of one mesh remain visual, and the whole mesh collides.
    """
    if any(item.role != "visual" for item in shapes):
        return shapes
    meshes: dict[int, list[LinkShape]] = {}
    for item in shapes:
        if item.mesh is not None:
            meshes.setdefault(item.mesh, []).append(item)
    whole = []
    for items in meshes.values():
        surfaces = [Surface(*item.shape[:2]) for item in items if isinstance(item.shape, tuple)]
        whole.append(replace(items[0], shape=joined(surfaces), role="collision"))
    return [
        item if item.mesh is not None else replace(item, role="both") for item in shapes
    ] + whole


def _material(item: LinkShape, materials: dict[tuple, Material]) -> str:
    gloss = {
        key: round(min(max(value, 0.0), 1.0), 6)
        for key in ("metallic", "roughness")
        if (value := getattr(item, key)) is not None
    }
    key = (item.rgba, item.friction, item.placeholder, *gloss.items())
    if key not in materials:
        names = {material.name for material in materials.values()}
        materials[key] = Material(
            name=identifier(HELPER if item.placeholder else UNKNOWN, "material", names),
            density=DENSITY,
            friction=min(max(item.friction, 0.0), 10.0),
            rgba=tuple(min(max(v, 0.0), 1.0) for v in item.rgba),  # pyright: ignore[reportArgumentType]
            **gloss,
        )
    return materials[key].name


class _Names:
    """Generator of identifiers that are unique among the elements of a kind."""

    def __init__(self) -> None:
        self.taken: dict[str, set[str]] = {}

    def take(self, name: str, kind: str) -> str:
        """Return an unused identifier that resembles a name."""
        taken = self.taken.setdefault(kind, set())
        label = identifier(name, kind, taken)
        taken.add(label)
        return label
