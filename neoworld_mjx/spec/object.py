"""The description of one object as parts, joints and materials, which object programs return.

All coordinates, including part geometry, joint anchors and joint axes, are in the object's frame
with all joints at zero. The origin is the center of the bounding box's bottom face; +x points to
the front, and +z points up.
"""

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from ..io.names import UNIQUE, repeated
from .base import Name, ObjectName, Point3, Positive, Rotation, ScalableSpec, Vec3
from .dimensions import (
    AUTHORED_MASS,
    DERIVED_MASS,
    INERTIA,
    NO_JOINT,
    UNSCALED,
    Motion,
)
from .joint import JointSpec, check_prerequisites, require_known
from .pose import IDENTITY, Pose, pose
from .room import PhotoPrint, Share, SurfacePattern
from .shapes import Shape
from .tree import name_on_cycle, parents_first

OPAQUE_ALPHA = 0.99
"""Smallest opacity of an opaque material."""

Role = Literal["both", "visual", "collision"]


class Material(ScalableSpec):
    """Material of a geom: density, friction and appearance."""

    name: Name
    density: Annotated[float, Field(gt=0, le=30000), UNSCALED]
    """Density [kg/m^3]."""
    friction: Annotated[float, Field(ge=0, le=10), UNSCALED] = 0.5
    """Sliding friction coefficient."""
    rgba: Annotated[tuple[Share, Share, Share, Share], UNSCALED] = (0.7, 0.7, 0.7, 1.0)
    pattern: SurfacePattern | None = Field(default=None, exclude_if=lambda value: value is None)
    """Pattern; if None, `finish` derives the pattern from the name (grain for wood, and plain for
    most other materials)."""
    metallic: Annotated[Share, UNSCALED] | None = Field(
        default=None, exclude_if=lambda value: value is None
    )
    """Metallic value from 0 to 1; if None, it is derived from the name."""
    roughness: Annotated[Share, UNSCALED] | None = Field(
        default=None, exclude_if=lambda value: value is None
    )
    """Roughness from 0 to 1; if None, it is derived from the name."""
    photo: PhotoPrint | None = Field(default=None, exclude_if=lambda value: value is None)
    """Print of the photograph, which replaces the pattern."""

    @property
    def see_through(self) -> bool:
        """True if the material is transparent."""
        return self.rgba[3] < OPAQUE_ALPHA


class GeomSpec(ScalableSpec):
    """A shape of one material, placed in the object's frame."""

    name: Name
    shape: Shape
    pos: Point3 = (0.0, 0.0, 0.0)
    quat: Rotation = IDENTITY
    material: Name
    role: Role = "both"
    """Use of the geom: visible, colliding, or both. Only geoms that collide have mass."""

    def pose(self) -> Pose:
        """Return the shape's pose in the object's frame."""
        return pose(self.pos, self.quat)


class AuthoredInertia(ScalableSpec):
    """Centre of mass and inertia of a part, in place of those that follow from its volume."""

    # The docstring is part of a request schema (verify.critic), to which recorded responses (tapes)
    # are bound. Checks report moments that no rigid body can have. The mass is authored, so moments
    # scale with s^2.

    pos: Point3
    """Center of mass in the object's frame with all joints at zero [m]."""
    moments: Annotated[Vec3, INERTIA]
    """Moments ixx, iyy, izz about the center of mass, along the object's axes [kg m^2]."""
    products: Annotated[Vec3, INERTIA] = (0.0, 0.0, 0.0)
    """Products ixy, ixz, iyz about the center of mass [kg m^2]."""

    def tensor(self) -> NDArray:
        """Return the inertia tensor about the center of mass [kg m^2], shape [3, 3]."""
        (a, b, c), (d, e, f) = self.moments, self.products
        return np.array([[a, d, e], [d, b, f], [e, f, c]])


class PartSpec(ScalableSpec):
    """A rigid link."""

    name: Name
    geoms: tuple[GeomSpec, ...] = Field(min_length=1)
    mass: Annotated[Positive, UNSCALED] | None = None
    """Authored mass [kg], which does not change with scale; if None, the mass is derived from
    volume and density."""
    inertia: AuthoredInertia | None = Field(default=None, exclude_if=lambda value: value is None)
    """Authored center of mass and inertia, which require an authored mass; if None, both are
    derived from the geoms."""

    @model_validator(mode="after")
    def _whole(self) -> "PartSpec":
        if self.inertia is not None and self.mass is None:
            raise ValueError(f"part {self.name}: an authored inertia needs an authored mass")
        return self


class Site(ScalableSpec):
    """A named point on a part, in the object's frame [m]."""

    name: Name
    part: Name
    pos: Point3


class ObjectSpec(ScalableSpec):
    """An object: a tree of parts."""

    name: ObjectName
    label: str = ""
    """Kind of object, in words."""
    materials: tuple[Material, ...]
    parts: tuple[PartSpec, ...] = Field(min_length=1)
    joints: tuple[JointSpec, ...] = ()
    sites: tuple[Site, ...] = ()

    @model_validator(mode="after")
    def _tree(self) -> "ObjectSpec":
        parts = _unique("part", [part.name for part in self.parts])
        materials = _unique("material", [material.name for material in self.materials])
        _unique("geom", [geom.name for part in self.parts for geom in part.geoms])
        _unique("joint", [joint.name for joint in self.joints])
        _unique("site", [site.name for site in self.sites])
        for part in self.parts:
            for geom in part.geoms:
                require_known(f"geom {geom.name}: material", geom.material, materials)
            if all(geom.role == "visual" for geom in part.geoms):
                raise ValueError(f"part {part.name} has no collision geom")
        by_name = {joint.name: joint for joint in self.joints}
        parents: dict[str, str] = {}
        for joint in self.joints:
            require_known(f"joint {joint.name}: parent", joint.parent, parts)
            require_known(f"joint {joint.name}: child", joint.child, parts)
            if joint.child in parents:
                raise ValueError(f"part {joint.child} is the child of two joints")
            parents[joint.child] = joint.parent
            check_prerequisites(joint, by_name)
            if joint.mimic is not None:
                require_known(f"joint {joint.name}: mimic", joint.mimic.joint, by_name)
                if by_name[joint.mimic.joint].type == "ball":
                    raise ValueError(
                        f"joint {joint.name}: cannot follow {joint.mimic.joint}, a ball"
                    )
        for site in self.sites:
            require_known(f"site {site.name}: part", site.part, parts)
        roots = [part.name for part in self.parts if part.name not in parents]
        if len(roots) != 1:
            raise ValueError(f"an object needs one root part, got {', '.join(roots) or 'none'}")
        looped = name_on_cycle(parents)
        if looped is not None:
            raise ValueError(f"joints form a cycle through part {looped}")
        return self

    @property
    def root(self) -> str:
        """Name of the part without a parent."""
        children = {joint.child for joint in self.joints}
        return next(part.name for part in self.parts if part.name not in children)

    @property
    def ordered(self) -> tuple[tuple[PartSpec, JointSpec | None], ...]:
        """Parts, each with the joint to its parent, or None for the root.

        Parents come before their children. Otherwise, parts keep the given order.
        """
        parts = {part.name: part for part in self.parts}
        joints = {joint.child: joint for joint in self.joints}
        parents = {name: joints[name].parent if name in joints else None for name in parts}
        return tuple((parts[name], joints.get(name)) for name in parents_first(parents))

    def part(self, name: str) -> PartSpec:
        """Return a part by name."""
        return next(part for part in self.parts if part.name == name)

    def material(self, name: str) -> Material:
        """Return a material by name."""
        return next(material for material in self.materials if material.name == name)

    def joint(self, name: str) -> JointSpec:
        """Return a joint by name."""
        return next(joint for joint in self.joints if joint.name == name)

    def joint_motion_scaling(self, joint: JointSpec) -> Motion:
        """Return the properties that determine how a joint's quantities scale."""
        leader = joint if joint.mimic is None else self.joint(joint.mimic.joint)
        return Motion(
            mass=mass_exponent(self.part(joint.child)),
            slides=joint.type == "prismatic",
            leader_slides=leader.type == "prismatic",
        )

    def scaled(self, s: float, motion: Motion = NO_JOINT) -> "ObjectSpec":
        """Return the object scaled by `s` about its origin; see `spec.scale`."""
        joints = tuple(j.scaled(s, self.joint_motion_scaling(j)) for j in self.joints)
        return super().scaled(s, motion).model_copy(update={"joints": joints})

    def to_json(self) -> str:
        """Return the object as JSON; equal objects give equal strings."""
        return self.model_dump_json(indent=1) + "\n"


def mass_exponent(part: PartSpec) -> float:
    """Return the mass exponent of a part: the power of s with which its mass scales."""
    return DERIVED_MASS if part.mass is None else AUTHORED_MASS


def _unique(kind: str, names: list[str]) -> set[str]:
    if twice := repeated(names):
        raise ValueError(f"{kind} {UNIQUE}: {', '.join(twice)}")
    return set(names)
