"""ObjectSpec: one object as parts, joints and materials; what a program compiles to.

Everything is written in the object's frame at rest (all joints at 0): origin at the centre of the
bounding box's bottom face, +x its front, +z up. Part geometry, joint anchors and axes share that
one frame, so a reader needs no chain of transforms.
"""

import math
from collections.abc import Mapping
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from .convex import Piece, box_around, mass_properties
from .pose import IDENTITY, Pose, from_axis_angle, pose, quat_mul, rotate
from .shapes import Number, Shape

Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$", max_length=48)]
JointKey = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*(\.[xyz])?$", max_length=50)]
"""A joint's name, or that of one of a ball's three values."""
Vec3 = tuple[Number, Number, Number]
Quat = tuple[Number, Number, Number, Number]
JointType = Literal["fixed", "revolute", "continuous", "prismatic", "ball"]
Role = Literal["both", "visual", "collision"]


class Spec(BaseModel):
    """Base of all host-side descriptions: frozen, closed against unknown keys, JSON both ways."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def _is_none(value: object) -> bool:
    return value is None


def _is_empty(value: tuple[str, ...]) -> bool:
    return not value


class Material(Spec):
    """What a geom is made of."""

    name: Name
    density: Annotated[float, Field(gt=0, le=30000)]
    """[kg/m^3]"""
    friction: Annotated[float, Field(ge=0, le=10)] = 0.5
    """Sliding friction coefficient."""
    rgba: tuple[
        Annotated[float, Field(ge=0, le=1)],
        Annotated[float, Field(ge=0, le=1)],
        Annotated[float, Field(ge=0, le=1)],
        Annotated[float, Field(ge=0, le=1)],
    ] = (0.7, 0.7, 0.7, 1.0)


class GeomSpec(Spec):
    """A shape of one material, placed in the object's frame."""

    name: Name
    shape: Shape
    pos: Vec3 = (0.0, 0.0, 0.0)
    quat: Quat = IDENTITY
    material: Name
    role: Role = "both"
    """Whether it is seen, collides, or both; only "both" and "collision" geoms have mass."""

    @field_validator("quat")
    @classmethod
    def _unit(cls, value: Quat) -> Quat:
        return _normalised(value, "quat")

    def pose(self) -> Pose:
        """Return the shape's pose in the object's frame."""
        return pose(self.pos, self.quat)


class AuthoredInertia(Spec):
    """Where a part's mass is and how it is spread, where that is known better than by volume.

    Nothing is asked of the numbers here: whether a body can have them is for the checks to say.
    """

    pos: Vec3
    """Centre of mass in the object's frame at rest [m]."""
    moments: Vec3
    """ixx, iyy, izz about it, along the object's axes [kg m^2]."""
    products: Vec3 = (0.0, 0.0, 0.0)
    """ixy, ixz, iyz [kg m^2]."""

    def tensor(self) -> NDArray:
        """Return the inertia about the centre of mass [3, 3] kg m^2."""
        (a, b, c), (d, e, f) = self.moments, self.products
        return np.array([[a, d, e], [d, b, f], [e, f, c]])


class PartSpec(Spec):
    """A rigid link."""

    name: Name
    geoms: tuple[GeomSpec, ...] = Field(min_length=1)
    mass: Annotated[float, Field(gt=0)] | None = None
    """Authored mass [kg]; None derives it from volume and density. It survives rescaling."""
    inertia: AuthoredInertia | None = Field(default=None, exclude_if=_is_none)
    """Authored centre of mass and inertia, with an authored mass; None derives them from volume."""

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if self.inertia is not None and self.mass is None:
            raise ValueError(f"part {self.name}: an authored inertia needs an authored mass")
        return self


class Mimic(Spec):
    """A joint that follows another: q = multiplier * q_other + offset."""

    joint: Name
    multiplier: Number = 1.0
    offset: Number = 0.0


class Intent(Spec):
    """What a joint is meant to do, for checks to hold it against; physics does not heed it."""

    type: JointType | None = None
    opens: Vec3 | None = None
    """Direction in which the child sets out when the joint leaves 0 in the positive sense."""
    travel: Annotated[float, Field(gt=0)] | None = None
    """Least range that it must have to be of use [rad or m]."""


class JointSpec(Spec):
    """A joint from `parent` to `child`, with anchor and axis in the object's frame at rest.

    Units are rad, N m for turning joints and m, N for sliding ones. Positive motion turns or moves
    the child by the right-hand rule about, or along, `axis`; by convention positive opens.

    A ball joint turns about `pos` in any direction, by at most `upper` away from rest; 0 is no limit.
    Its axis, lower limit, effort, velocity and mimic mean nothing. Where it stands is a rotation
    vector in the object's axes, told as three values named `<joint>.x`, `.y` and `.z` [rad].
    """

    name: Name
    type: JointType
    parent: Name
    child: Name
    pos: Vec3 = (0.0, 0.0, 0.0)
    axis: Vec3 = (0.0, 0.0, 1.0)
    lower: Number = 0.0
    upper: Number = 0.0
    damping: Annotated[float, Field(ge=0)] = 0.0
    friction: Annotated[float, Field(ge=0)] = 0.0
    """Dry friction (MuJoCo's frictionloss)."""
    stiffness: Annotated[float, Field(ge=0)] = 0.0
    armature: Annotated[float, Field(ge=0)] = 0.0
    effort: Annotated[float, Field(gt=0)] | None = None
    velocity: Annotated[float, Field(gt=0)] | None = None
    mimic: Mimic | None = None
    after: tuple[Name, ...] = Field(default=(), exclude_if=_is_empty)
    """Joints that stand at their far end whenever this one is away from 0: a rack's, its door.

    Checks hold it against that; physics does not heed it."""
    intent: Intent | None = Field(default=None, exclude_if=_is_none)

    @field_validator("axis")
    @classmethod
    def _unit(cls, value: Vec3) -> Vec3:
        return _normalised(value, "axis")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.type in ("revolute", "prismatic") and not self.lower < self.upper:
            raise ValueError(
                f"joint {self.name}: lower {self.lower} must be below upper {self.upper}"
            )
        if self.type == "ball":
            if self.lower != 0.0 or not 0.0 <= self.upper <= math.pi:
                raise ValueError(
                    f"joint {self.name}: a ball turns from 0 to at most pi (upper 0: no limit), got "
                    f"{self.lower} to {self.upper}"
                )
            if (self.mimic, self.effort, self.velocity) != (None, None, None):
                raise ValueError(f"joint {self.name}: a ball has no mimic, effort or velocity")
        return self


class Site(Spec):
    """A named point on a part, in the object's frame [m]."""

    name: Name
    part: Name
    pos: Vec3


class ObjectSpec(Spec):
    """An object: a tree of parts."""

    name: Name
    label: str = ""
    """What it is, in words."""
    materials: tuple[Material, ...]
    parts: tuple[PartSpec, ...] = Field(min_length=1)
    joints: tuple[JointSpec, ...] = ()
    sites: tuple[Site, ...] = ()

    @model_validator(mode="after")
    def _tree(self) -> Self:
        parts = _unique("part", [part.name for part in self.parts])
        materials = _unique("material", [material.name for material in self.materials])
        _unique("geom", [geom.name for part in self.parts for geom in part.geoms])
        joints = _unique("joint", [joint.name for joint in self.joints])
        _unique("site", [site.name for site in self.sites])
        for part in self.parts:
            for geom in part.geoms:
                _known(f"geom {geom.name}: material", geom.material, materials)
            if all(geom.role == "visual" for geom in part.geoms):
                raise ValueError(f"part {part.name} has no geom that collides")
        parents: dict[str, str] = {}
        for joint in self.joints:
            _known(f"joint {joint.name}: parent", joint.parent, parts)
            _known(f"joint {joint.name}: child", joint.child, parts)
            if joint.child in parents:
                raise ValueError(f"part {joint.child} is the child of two joints")
            parents[joint.child] = joint.parent
            _waits(joint, self.joints)
            if joint.mimic is not None:
                _known(f"joint {joint.name}: mimic", joint.mimic.joint, joints)
                if any(o.name == joint.mimic.joint and o.type == "ball" for o in self.joints):
                    raise ValueError(
                        f"joint {joint.name}: cannot follow {joint.mimic.joint}, a ball"
                    )
        for site in self.sites:
            _known(f"site {site.name}: part", site.part, parts)
        roots = [part.name for part in self.parts if part.name not in parents]
        if len(roots) != 1:
            raise ValueError(f"an object needs one root part, got {', '.join(roots) or 'none'}")
        for start in parents:
            seen, at = {start}, start
            while at in parents:
                at = parents[at]
                if at in seen:
                    raise ValueError(f"joints form a cycle through part {at}")
                seen.add(at)
        return self

    @property
    def root(self) -> str:
        """Name of the part without a parent."""
        children = {joint.child for joint in self.joints}
        return next(part.name for part in self.parts if part.name not in children)

    @property
    def ordered(self) -> tuple[tuple[PartSpec, JointSpec | None], ...]:
        """Parts with the joint that carries each, parents before children, else in given order."""
        by_child = {joint.child: joint for joint in self.joints}
        done: list[tuple[PartSpec, JointSpec | None]] = []
        placed: set[str] = set()
        while len(done) < len(self.parts):
            for part in self.parts:
                joint = by_child.get(part.name)
                if part.name not in placed and (joint is None or joint.parent in placed):
                    done.append((part, joint))
                    placed.add(part.name)
        return tuple(done)

    def part(self, name: str) -> PartSpec:
        """Return a part by name."""
        return next(part for part in self.parts if part.name == name)

    def material(self, name: str) -> Material:
        """Return a material by name."""
        return next(material for material in self.materials if material.name == name)

    def to_json(self) -> str:
        """Serialise, the same bytes for the same object."""
        return self.model_dump_json(indent=1) + "\n"


def pieces(part: PartSpec, role: Role = "collision") -> list[tuple[GeomSpec, Piece, Pose]]:
    """List a part's convex pieces with their poses in the object's frame.

    Args:
        part: the part.
        role: "collision" or "visual"; geoms of role "both" belong to either.
    """
    found = []
    for geom in part.geoms:
        if geom.role in (role, "both"):
            for piece in geom.shape.pieces():
                found.append((geom, piece, geom.pose().then(pose(piece.pos, piece.quat))))
    return found


class Inertial(Spec):
    """Mass properties of a part in the object's frame."""

    mass: float
    """[kg]"""
    pos: Vec3
    """Centre of mass [m]."""
    quat: Quat
    """Principal axes."""
    diagonal: Vec3
    """Principal moments [kg m^2]."""


def inertial(spec: ObjectSpec, part: PartSpec) -> Inertial:
    """Sum a part's mass properties over its colliding pieces (MuJoCo's body inertial).

    What is authored is taken as it is.
    """
    if part.inertia is not None and part.mass is not None:
        diagonal, quat = _principal(part.inertia.tensor())
        return Inertial(
            mass=part.mass, pos=part.inertia.pos, quat=quat, diagonal=tuple(diagonal.tolist())
        )
    mass, moment = 0.0, np.zeros(3)
    bodies = []
    for geom, piece, _ in pieces(part):
        volume, centre, unit = mass_properties(piece)
        m = volume * spec.material(geom.material).density
        rotation = rotate(geom.pose().quat, np.eye(3)).T
        bodies.append((m, geom.pose().apply(centre), rotation @ unit @ rotation.T * (m / volume)))
        mass += m
        moment += m * bodies[-1][1]
    com = moment / mass
    total = np.zeros((3, 3))
    for m, centre, tensor in bodies:
        d = centre - com
        total += tensor + m * (d @ d * np.eye(3) - np.outer(d, d))
    if part.mass is not None:
        total *= part.mass / mass
        mass = part.mass
    diagonal, quat = _principal(total)
    return Inertial(
        mass=mass, pos=tuple(com.tolist()), quat=quat, diagonal=tuple(diagonal.tolist())
    )


def _principal(tensor: NDArray) -> tuple[NDArray, Quat]:
    from .pose import from_matrix

    size = float(np.trace(tensor)) or 1.0
    # Rounded, so that a scaled copy of the object gets the very same axes although its tensor
    # differs in the last bits; symmetric objects would otherwise get arbitrary ones.
    unit = np.round(tensor / size, 10)
    if np.allclose(unit, np.diag(np.diag(unit)), atol=1e-9):
        return np.diag(tensor).copy(), IDENTITY
    _, axes = np.linalg.eigh(unit)
    # Eigenvectors have no sign of their own: let the largest component of each be positive.
    for k in (0, 1):
        axes[:, k] *= np.sign(axes[np.argmax(np.abs(np.round(axes[:, k], 6))), k])
    axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
    quat = from_matrix(axes)
    return np.diag(axes.T @ tensor @ axes).copy(), tuple(quat.tolist())


_AT_REST = pose()


def link_poses(spec: ObjectSpec, joint_state: dict[str, float]) -> dict[str, Pose]:
    """Return how each part is displaced from rest when joints stand at `joint_state` [rad or m].

    A joint not named stands at 0; a mimic joint follows its leader. The result maps the object's
    frame at rest to the object's frame as posed.
    """
    values = {joint.name: joint_position(spec, joint, joint_state) for joint in spec.joints}
    moved: dict[str, Pose] = {}
    for part, joint in spec.ordered:
        if joint is None:
            moved[part.name] = pose()
            continue
        motion = joint_motion(joint, values[joint.name])
        above = moved[joint.parent]
        moved[part.name] = above if motion is _AT_REST else above.then(motion)
    return moved


def joint_value(spec: ObjectSpec, joint: JointSpec, joint_state: dict[str, float]) -> float:
    """Return where a joint stands, following mimics [rad or m]."""
    seen = set()
    scale, offset = 1.0, 0.0
    while joint.mimic is not None and joint.name not in seen:
        seen.add(joint.name)
        offset += scale * joint.mimic.offset
        scale *= joint.mimic.multiplier
        leader = joint.mimic.joint
        joint = next(other for other in spec.joints if other.name == leader)
    return scale * joint_state.get(joint.name, 0.0) + offset


def ball_vector(joint: JointSpec, joint_state: Mapping[str, float]) -> Vec3:
    """Return the rotation vector [rad] of a ball joint."""
    x, y, z = (joint_state.get(f"{joint.name}.{axis}", 0.0) for axis in "xyz")
    return x, y, z


def joint_position(
    spec: ObjectSpec, joint: JointSpec, joint_state: dict[str, float]
) -> float | Vec3:
    """Return where a joint stands, following mimics: one value, or a ball's rotation vector."""
    if joint.type == "ball":
        return ball_vector(joint, joint_state)
    return joint_value(spec, joint, joint_state)


def joint_motion(joint: JointSpec, value: float | Vec3) -> Pose:
    """Return the displacement of the child by a joint at `value`, in the object's rest frame."""
    if isinstance(value, tuple):
        angle = float(np.linalg.norm(value))
        turn = from_axis_angle(value, angle) if angle > 0.0 else None
    elif joint.type == "prismatic":
        return pose(np.array(joint.axis) * value)
    else:
        moves = joint.type != "fixed" and value != 0.0
        turn = from_axis_angle(joint.axis, value) if moves else None
    if turn is None:
        return _AT_REST
    anchor = np.array(joint.pos)
    return pose(anchor - rotate(turn, anchor), turn)


def bounds(
    spec: ObjectSpec,
    joint_state: dict[str, float] | None = None,
    tilt: Quat = IDENTITY,
    role: Role = "collision",
) -> tuple[NDArray, NDArray]:
    """Return the exact axis-aligned bounds (low [3], high [3]) [m] of an object as posed.

    Args:
        spec: the object.
        joint_state: joint values; at rest by default.
        tilt: rotation of the whole object before measuring.
        role: whose extent to take.
    """
    moved = link_poses(spec, joint_state or {})
    base = pose((0, 0, 0), tilt)
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for part in spec.parts:
        for _, piece, at in pieces(part, role):
            one, other = box_around(piece, base.then(moved[part.name]).then(at))
            low, high = np.minimum(low, one), np.maximum(high, other)
    return low, high


def translated(spec: ObjectSpec, offset: NDArray) -> ObjectSpec:
    """Move everything in the object's frame by `offset` [3] m."""

    def move(at: Vec3) -> Vec3:
        return tuple((np.array(at) + offset).tolist())

    return spec.model_copy(
        update={
            "parts": tuple(
                part.model_copy(
                    update={
                        "geoms": tuple(
                            geom.model_copy(update={"pos": move(geom.pos)}) for geom in part.geoms
                        ),
                        "inertia": part.inertia
                        and part.inertia.model_copy(update={"pos": move(part.inertia.pos)}),
                    }
                )
                for part in spec.parts
            ),
            "joints": tuple(j.model_copy(update={"pos": move(j.pos)}) for j in spec.joints),
            "sites": tuple(s.model_copy(update={"pos": move(s.pos)}) for s in spec.sites),
        }
    )


def recentred(spec: ObjectSpec) -> ObjectSpec:
    """Move the origin to the centre of the bounding box's bottom face."""
    low, high = bounds(spec)
    return translated(spec, -np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]]))


def part_bounds(spec: ObjectSpec, part: PartSpec) -> tuple[NDArray, NDArray]:
    """Return the bounds (low [3], high [3]) [m] of a part's colliders at rest."""
    alone = spec.model_copy(update={"parts": (part,), "joints": (), "sites": ()})
    return bounds(alone)


def _waits(joint: JointSpec, joints: tuple[JointSpec, ...]) -> None:
    """Refuse a joint that waits for what has no far end, for itself, or that is led."""
    by_name = {other.name: other for other in joints}
    if joint.after and (joint.type == "fixed" or joint.mimic is not None):
        raise ValueError(f"joint {joint.name}: what is fixed or follows another cannot wait")
    waiting, seen = list(joint.after), set()
    while waiting:
        name = waiting.pop()
        _known(f"joint {joint.name}: after", name, set(by_name))
        if name == joint.name:
            raise ValueError(f"joint {joint.name}: waits for itself")
        if by_name[name].type not in ("revolute", "prismatic") or by_name[name].mimic is not None:
            raise ValueError(
                f"joint {joint.name}: after takes revolute and prismatic joints that follow no other, "
                f"got {name}"
            )
        if name not in seen:
            seen.add(name)
            waiting += by_name[name].after


def _normalised(value: tuple[float, ...], what: str) -> tuple:
    length = math.sqrt(sum(v * v for v in value))
    if length < 1e-9:
        raise ValueError(f"{what} must not be zero")
    if abs(length - 1.0) < 1e-12:
        return value
    return tuple(v / length for v in value)


def _unique(what: str, names: list[str]) -> set[str]:
    twice = {name for name in names if names.count(name) > 1}
    if twice:
        raise ValueError(f"{what} names must be unique, repeated: {', '.join(sorted(twice))}")
    return set(names)


def _known(what: str, name: str, valid: set[str]) -> None:
    from ..errors import choices

    if name not in valid:
        raise ValueError(f"{what}: {choices(name, sorted(valid))}")


__all__ = [
    "AuthoredInertia",
    "GeomSpec",
    "Inertial",
    "Intent",
    "JointSpec",
    "Material",
    "Mimic",
    "ObjectSpec",
    "PartSpec",
    "Site",
    "Spec",
    "ball_vector",
    "bounds",
    "inertial",
    "joint_motion",
    "joint_position",
    "link_poses",
    "part_bounds",
    "pieces",
    "quat_mul",
    "recentred",
    "translated",
]
