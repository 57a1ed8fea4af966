"""Patches: the restricted edits that Step 3 may make to an object (paper Section 3.2).

A patch edits masses and inertias, joint limits, damping and friction, origins, and collision
geometry. It cannot express parts, joints, axes, types, or visual geometry. The patch of a program
is a file beside it, applied to the object that the program makes, so it survives a rebuild.
"""

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from ..errors import SpecError
from ..io import read_model
from ..io.files import write_atomic
from ..io.validation_message import validation_message
from ..spec import AuthoredInertia, GeomSpec, JointSpec, Name, ObjectSpec, PartSpec, Vec3

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False, le=1e6)]
SUFFIX = ".patch.json"


class Edit(BaseModel):
    """Base of all edits: closed."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class PartEdit(Edit):
    """Edit of a part."""

    mass: Positive | Literal["derived"] | None = None
    """[kg], or by volume and density."""
    inertia: AuthoredInertia | Literal["derived"] | None = None
    shift: Vec3 | None = None
    """Translation [m] of the part and all parts below it; its own joint stays."""


class JointEdit(Edit):
    """Edit of a joint."""

    lower: Finite | None = None
    upper: Finite | None = None
    damping: Annotated[float, Field(ge=0, le=1e6)] | None = None
    friction: Annotated[float, Field(ge=0, le=1e6)] | None = None
    origin: Vec3 | None = None
    """Point [m] that its axis passes through."""


class GeomEdit(Edit):
    """Edit of a geom's collision shape; its visible shape stays."""

    shrink: Annotated[float, Field(ge=0.5, le=1.0)] | None = None
    """Scale of the collider relative to the shape, about the collider's origin."""
    as_seen: bool = False
    """Whether the visible shape collides, instead of other colliders of the part."""

    @model_validator(mode="after")
    def _one(self) -> "GeomEdit":
        if self.as_seen and self.shrink is not None:
            raise ValueError("a collider is as seen or shrunk, not both")
        return self


class Patch(Edit):
    """All edits of one object, by name."""

    parts: dict[Name, PartEdit] = {}
    joints: dict[Name, JointEdit] = {}
    geoms: dict[Name, GeomEdit] = {}

    @property
    def empty(self) -> bool:
        """Whether it changes nothing."""
        return not (self.parts or self.joints or self.geoms)

    def joined(self, other: "Patch") -> "Patch":
        """Merge another patch into this one: shifts add up, otherwise the other's values win."""
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
        """Describe each change in words."""
        changes = []
        for kind in ("parts", "joints", "geoms"):
            for name, edit in getattr(self, kind).items():
                for key, value in edit.model_dump(exclude_none=True, exclude_defaults=True).items():
                    changes.append(f"{kind[:-1]} {name}: {key} = {_short(value)}")
        return tuple(changes)

    def to_json(self) -> str:
        """Return the JSON of the fields that it sets."""
        return self.model_dump_json(indent=1, exclude_none=True, exclude_defaults=True) + "\n"


def apply(patch: Patch, spec: ObjectSpec) -> tuple[ObjectSpec, tuple[str, ...]]:
    """Apply a patch to an object.

    Returns:
        The object, and the names of parts, joints and geoms that the patch edits but the object
        lacks, such as after a change of its program.

    Raises:
        SpecError: the edits leave no valid object.
    """
    stale = [f"part {n}" for n in patch.parts if n not in {p.name for p in spec.parts}]
    stale += [f"joint {n}" for n in patch.joints if n not in {j.name for j in spec.joints}]
    known = {g.name for p in spec.parts for g in p.geoms}
    stale += [f"geom {n}" for n in patch.geoms if n not in known]
    shifts = _shifts(patch, spec)
    parts = tuple(_part(part, patch, shifts[part.name]) for part in spec.parts)
    joints = tuple(_joint(joint, patch, shifts) for joint in spec.joints)
    sites = tuple(
        s.model_copy(update={"pos": tuple(np.add(s.pos, shifts[s.part]).tolist())})
        for s in spec.sites
    )
    try:
        patched = ObjectSpec(
            name=spec.name,
            label=spec.label,
            materials=spec.materials,
            parts=parts,
            joints=tuple(JointSpec.model_validate(j.model_dump()) for j in joints),
            sites=sites,
        )
    except ValidationError as error:
        raise SpecError(
            f"the patch of {spec.name}: {validation_message(error, ObjectSpec)}"
        ) from None
    return patched, tuple(stale)


def _shifts(patch: Patch, spec: ObjectSpec) -> dict[str, np.ndarray]:
    """Return the translation [3] m of each part: its own, plus that of its parent."""
    shifts: dict[str, np.ndarray] = {}
    for part, joint in spec.ordered:
        above = np.zeros(3) if joint is None else shifts[joint.parent]
        edit = patch.parts.get(part.name)
        own = (0.0, 0.0, 0.0) if edit is None or edit.shift is None else edit.shift
        shifts[part.name] = above + np.array(own)
    return shifts


def _part(part: PartSpec, patch: Patch, shift: np.ndarray) -> PartSpec:
    edit = patch.parts.get(part.name, PartEdit())
    mass, inertia = part.mass, part.inertia
    if edit.mass is not None:
        mass = None if edit.mass == "derived" else edit.mass
        inertia = None
    if edit.inertia is not None:
        inertia = None if edit.inertia == "derived" else edit.inertia
    if inertia is not None and np.any(shift):
        inertia = inertia.model_copy(update={"pos": tuple(np.add(inertia.pos, shift).tolist())})
    geoms = [geom for old in part.geoms for geom in _geom(old, part, patch)]
    if np.any(shift):
        geoms = [g.model_copy(update={"pos": tuple(np.add(g.pos, shift).tolist())}) for g in geoms]
    return part.model_copy(update={"geoms": tuple(geoms), "mass": mass, "inertia": inertia})


def _geom(geom: GeomSpec, part: PartSpec, patch: Patch) -> list[GeomSpec]:
    edit = patch.geoms.get(geom.name)
    visual_collides = any(
        g.name in patch.geoms and patch.geoms[g.name].as_seen and g.role != "collision"
        for g in part.geoms
    )
    if visual_collides and geom.role == "collision":
        return []  # The visible shape collides in its place.
    if edit is None:
        return [geom]
    if edit.as_seen and geom.role != "collision":
        return [geom.model_copy(update={"role": "both"})]
    if edit.shrink is not None and geom.role != "visual":
        small = geom.model_copy(
            update={"shape": geom.shape.scaled(edit.shrink), "role": "collision"}
        )
        if geom.role == "collision":
            return [small]
        name = f"{geom.name[:40]}_shrunk"
        return [geom.model_copy(update={"role": "visual"}), small.model_copy(update={"name": name})]
    return [geom]


def _joint(joint: JointSpec, patch: Patch, shifts: dict[str, np.ndarray]) -> JointSpec:
    edit = patch.joints.get(joint.name, JointEdit())
    update = edit.model_dump(include={"lower", "upper", "damping", "friction"}, exclude_none=True)
    if joint.type not in ("revolute", "prismatic"):
        # Only the upper limit of a ball can change; the other types have no range.
        update = {k: v for k, v in update.items() if k != "lower"}
        if joint.type != "ball":
            update.pop("upper", None)
    pos = joint.pos if edit.origin is None else edit.origin
    update["pos"] = tuple(np.add(pos, shifts[joint.parent]).tolist())
    return joint.model_copy(update=update)


def overlay_path(program: Path) -> Path:
    """Return the path of a program's patch."""
    return program.with_name(program.stem + SUFFIX)


def read_overlay(program: Path) -> Patch | None:
    """Read the patch beside a program; None if there is none.

    Raises:
        SpecError: the file cannot be read, or is no patch.
    """
    path = overlay_path(program)
    return read_model(path, Patch, SpecError, "a patch") if path.exists() else None


def write_overlay(program: Path, patch: Patch) -> Path:
    """Write a patch beside its program, and return its path.

    Raises:
        SpecError: the file cannot be written.
    """
    path = overlay_path(program)
    try:
        write_atomic(path, patch.to_json())
    except OSError as error:
        raise SpecError(f"cannot write {path}: {error.strerror}") from None
    return path


def _short(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.5g}"
    if isinstance(value, tuple | list):
        return "(" + ", ".join(_short(v) for v in value) + ")"
    if isinstance(value, dict):
        return ", ".join(f"{k} {_short(v)}" for k, v in value.items())
    return str(value)
