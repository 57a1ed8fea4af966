"""Patches: the restricted edits that Step 3 may make to an object (paper Section 3.2).

A patch can edit masses and inertias, positions of parts, joint limits, damping and friction,
origins of joints, collision geometry, and the friction of surfaces. It cannot add or remove parts
or joints, and cannot change axes, types or visual geometry. The patch of a program is a file next
to the program, and is applied to the object that the program builds. It therefore still applies
after the program has been built again.
"""

from pathlib import Path
from typing import Annotated, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from ..errors import SpecError
from ..io import read_model
from ..io.files import write_output
from ..io.text_files import validation_message
from ..spec import (
    AuthoredInertia,
    GeomSpec,
    JointSpec,
    Material,
    Name,
    Number,
    ObjectSpec,
    PartSpec,
    Site,
    Vec3,
)

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False, le=1e6)]
Movable = TypeVar("Movable", AuthoredInertia, GeomSpec, Site)
SUFFIX = ".patch.json"


# Docstrings of the edit classes and of their fields are part of the schema that models receive.
# Recorded responses (tapes) match only requests that are exactly equal.


class Edit(BaseModel):
    """Edit that leaves unset fields unchanged."""

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)


class PartEdit(Edit):
    """Edit of a part."""

    mass: Positive | Literal["derived"] | None = None
    """Mass [kg], or "derived": volume times density."""
    inertia: AuthoredInertia | Literal["derived"] | None = None
    """Centre of mass [m] and inertia about it [kg m^2] in the object's frame, or "derived"."""
    shift: Vec3 | None = None
    """Translation [m] of the part and of all parts on it; its own joint stays."""


class JointEdit(Edit):
    """Edit of a joint."""

    lower: Number | None = None
    """Lower limit [rad or m]."""
    upper: Number | None = None
    """Upper limit [rad or m]."""
    damping: Annotated[float, Field(ge=0, le=1e6)] | None = None
    """Damping [N m s/rad or N s/m]."""
    friction: Annotated[float, Field(ge=0, le=1e6)] | None = None
    """Dry friction [N m or N]."""
    origin: Vec3 | None = None
    """Point [m] that its axis passes through."""


class MaterialEdit(Edit):
    """Edit of a material, on all surfaces that have it."""

    friction: Annotated[float, Field(ge=0, le=10)] | None = None
    """Sliding friction coefficient of the surface."""


class GeomEdit(Edit):
    """Edit of a geom's collision shape; its visible shape stays."""

    shrink: Annotated[float, Field(ge=0.5, le=1.0)] | None = None
    """Scale of the collider relative to the shape, about the collider's origin."""
    as_seen: bool = False
    """Whether the visible shape collides, instead of other colliders of the part."""

    @model_validator(mode="after")
    def _exclusive(self) -> "GeomEdit":
        if self.as_seen and self.shrink is not None:
            raise ValueError("a collider is as seen or shrunk, not both")
        return self


class Patch(Edit):
    """All edits of one object, by name."""

    parts: dict[Name, PartEdit] = {}
    joints: dict[Name, JointEdit] = {}
    geoms: dict[Name, GeomEdit] = {}
    materials: dict[Name, MaterialEdit] = {}

    @property
    def empty(self) -> bool:
        """True if the patch changes nothing."""
        return not (self.parts or self.joints or self.geoms or self.materials)

    def merged_with(self, other: "Patch") -> "Patch":
        """Return the merger of this patch with another patch.

        Shifts add up. In all other fields, values of the other patch replace those of this patch.
        """
        merged, later = self.model_dump(exclude_none=True), other.model_dump(exclude_none=True)
        for kind, edits in later.items():
            for name, edit in edits.items():
                old = merged[kind].setdefault(name, {})
                if "shift" in edit and "shift" in old:
                    sum_ = np.add(old["shift"], edit["shift"])
                    edit = {**edit, "shift": tuple(sum_.tolist())}
                old.update(edit)
        return Patch.model_validate(merged)

    def changes(self) -> tuple[str, ...]:
        """Return a description of each change."""
        edits = self.model_dump(exclude_none=True, exclude_defaults=True)
        return tuple(
            f"{kind[:-1]} {name}: {key} = {_short(value)}"
            for kind in ("parts", "joints", "geoms", "materials")
            for name, edit in edits.get(kind, {}).items()
            for key, value in edit.items()
        )

    def to_json(self) -> str:
        """Return the fields that the patch sets as JSON text."""
        return self.model_dump_json(indent=1, exclude_none=True, exclude_defaults=True) + "\n"


def apply(patch: Patch, spec: ObjectSpec) -> tuple[ObjectSpec, tuple[str, ...]]:
    """Apply a patch to an object.

    Returns:
        The patched object, and the parts, joints, geoms and materials that the patch edits but the
        object lacks, for example after a change of the object's program.

    Raises:
        SpecError: the patched object is invalid.
    """
    geoms = [geom for part in spec.parts for geom in part.geoms]
    stale = [
        f"{kind} {name}"
        for kind, edits, items in (
            ("part", patch.parts, spec.parts),
            ("joint", patch.joints, spec.joints),
            ("geom", patch.geoms, geoms),
            ("material", patch.materials, spec.materials),
        )
        for name in edits
        if name not in {item.name for item in items}
    ]
    # The shift of a part also moves all parts that it carries.
    shifts: dict[str, NDArray] = {}
    for part, joint in spec.ordered:
        parent_shift = np.zeros(3) if joint is None else shifts[joint.parent]
        edit = patch.parts.get(part.name, PartEdit())
        shifts[part.name] = parent_shift + np.array(edit.shift or (0.0, 0.0, 0.0))
    joints = [_joint(joint, patch, shifts[joint.parent]) for joint in spec.joints]
    try:
        patched = ObjectSpec(
            name=spec.name,
            label=spec.label,
            materials=tuple(_material(material, patch) for material in spec.materials),
            parts=tuple(_part(part, patch, shifts[part.name]) for part in spec.parts),
            joints=tuple(JointSpec.model_validate(joint.model_dump()) for joint in joints),
            sites=tuple(_translated(site, shifts[site.part]) for site in spec.sites),
        )
    except ValidationError as error:
        raise SpecError(
            f"the patch of {spec.name}: {validation_message(error, ObjectSpec)}"
        ) from None
    return patched, tuple(stale)


def _translated(item: Movable, shift: NDArray) -> Movable:
    """Return a geom, site or inertia, translated by `shift` [m]."""
    if not np.any(shift):
        return item
    return item.model_copy(update={"pos": tuple(np.add(item.pos, shift).tolist())})


def _part(part: PartSpec, patch: Patch, shift: NDArray) -> PartSpec:
    edit = patch.parts.get(part.name, PartEdit())
    mass, inertia = part.mass, part.inertia
    if edit.mass is not None:
        mass = None if edit.mass == "derived" else edit.mass
        inertia = None
    if edit.inertia is not None:
        inertia = None if edit.inertia == "derived" else edit.inertia
    if inertia is not None:
        inertia = _translated(inertia, shift)
    geoms = [_translated(geom, shift) for old in part.geoms for geom in _geom(old, part, patch)]
    return part.model_copy(update={"geoms": tuple(geoms), "mass": mass, "inertia": inertia})


def _geom(geom: GeomSpec, part: PartSpec, patch: Patch) -> list[GeomSpec]:
    edit = patch.geoms.get(geom.name, GeomEdit())
    visual_collides = any(
        g.role != "collision" and patch.geoms.get(g.name, GeomEdit()).as_seen for g in part.geoms
    )
    if visual_collides and geom.role == "collision":
        return []  # The visible shape replaces the collider.
    if edit.as_seen and geom.role != "collision":
        return [geom.model_copy(update={"role": "both"})]
    if edit.shrink is None or geom.role == "visual":
        return [geom]
    shrunk = {"shape": geom.shape.scaled(edit.shrink), "role": "collision"}
    if geom.role == "collision":
        return [geom.model_copy(update=shrunk)]
    collider = geom.model_copy(update={**shrunk, "name": f"{geom.name[:40]}_shrunk"})
    return [geom.model_copy(update={"role": "visual"}), collider]


def _joint(joint: JointSpec, patch: Patch, shift: NDArray) -> JointSpec:
    edit = patch.joints.get(joint.name, JointEdit())
    # Only the upper limit of a ball joint can change. Continuous and fixed joints have no range.
    limits = {"revolute": {"lower", "upper"}, "prismatic": {"lower", "upper"}, "ball": {"upper"}}
    fields = {"damping", "friction", *limits.get(joint.type, ())}
    update = edit.model_dump(include=fields, exclude_none=True)
    update["pos"] = tuple(np.add(edit.origin or joint.pos, shift).tolist())
    return joint.model_copy(update=update)


def _material(material: Material, patch: Patch) -> Material:
    edit = patch.materials.get(material.name, MaterialEdit())
    return material.model_copy(update=edit.model_dump(exclude_none=True))


def patch_path(program: Path) -> Path:
    """Return the path of the patch of a program."""
    return program.with_name(program.stem + SUFFIX)


def read_patch(program: Path) -> Patch | None:
    """Read the patch of a program; return None if the program has no patch.

    Raises:
        SpecError: the file cannot be read or is not a patch.
    """
    path = patch_path(program)
    return read_model(path, Patch, SpecError, "a patch") if path.exists() else None


def write_patch(program: Path, patch: Patch) -> Path:
    """Write the patch of a program, and return its path.

    Raises:
        SpecError: the file cannot be written.
    """
    path = patch_path(program)
    write_output(path, patch.to_json(), SpecError)
    return path


def _short(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.5g}"
    if isinstance(value, tuple | list):
        return "(" + ", ".join(_short(v) for v in value) + ")"
    if isinstance(value, dict):
        return ", ".join(f"{k} {_short(v)}" for k, v in value.items())
    return str(value)
