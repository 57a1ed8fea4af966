"""Conversion of a Blender scene into an object of the SDK.

Parts, materials, masses, joints and sites are created by calls of the SDK, so that both languages
have equal limits and messages.
"""

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from ...checks.signals import Signal, error_signal
from ...config import ProgramOptions
from ...errors import choices
from ...io.names import identifier
from ...spec.pose import triple
from ..part import Joint, Part, Shape
from ..sandbox import exception_signal, limit_signal
from ..sdk_object import Object
from ..session import LimitExceeded, Session, use_session
from ..supports import MATERIALS
from .blender_process import failure, run_confined
from .blender_scene import (
    MAX_FACES,
    BlenderJoint,
    BlenderMaterial,
    BlenderScene,
    BlenderShape,
    shape_of,
    split_solids,
)

_DYNAMICS = {
    "fixed": (),
    "revolute": ("damping", "friction", "stiffness", "effort", "velocity"),
    "continuous": ("damping", "friction", "effort", "velocity"),
    "prismatic": ("damping", "friction", "stiffness", "effort", "velocity"),
    "ball": ("damping", "friction", "stiffness"),
}
"""Names of the arguments for dynamics, by joint type."""
_DEFAULT_MATERIAL = "plastic"


def run_blender(text: str, session: Session, options: ProgramOptions) -> tuple[str, list[Signal]]:
    """Run a program in Blender, create its object, and return its printed text and its signals."""
    output = run_confined(
        text,
        timeout_s=options.blender_timeout_s,
        memory_mib=options.blender_memory_mib,
    )
    if output.scene is None:
        return output.printed, [failure(output, options.blender_timeout_s)]
    return output.printed, build_object(output.scene, session, options)


def build_object(scene: BlenderScene, session: Session, options: ProgramOptions) -> list[Signal]:
    """Create the object of an untrusted scene in a session, and return errors and warnings.

    Args:
        scene: the scene.
        session: collects the object and counts the resources that it uses.
        options: limits the time for splitting shapes into convex pieces (`blender_timeout_s`).
    """
    if scene.error is not None:
        return [_raised(scene)]
    try:
        with use_session(session):
            return _Conversion(scene, time.process_time() + options.blender_timeout_s).run()
    except LimitExceeded as exceeded:
        return [limit_signal(exceeded, session)]
    except (ValueError, TypeError, TimeoutError) as error:
        return [exception_signal(error)]


def _raised(scene: BlenderScene) -> Signal:
    error = scene.error
    assert error is not None
    codes = {"SyntaxError": "syntax", "MemoryError": "memory", "RecursionError": "recursion"}
    denied = error.type in ("PermissionError", "BlockingIOError", "OSError")
    return error_signal(
        "forbidden" if denied else codes.get(error.type, "runtime"),
        f"{error.type}: {error.message}",
        line=error.line,
        column=error.column,
        hint="programs have no files, network or processes" if denied else "",
    )


class _Conversion:
    """State of the conversion of one scene into an object."""

    def __init__(self, scene: BlenderScene, deadline: float) -> None:
        self.scene, self.deadline = scene, deadline
        self.object = Object(identifier(scene.name, "object"), label=scene.label)
        self.materials = {material.name: material for material in scene.materials}
        self.defined: dict[str, str] = {}
        self.parts: dict[str, Part] = {}
        self.warnings: list[Signal] = []

    def run(self) -> list[Signal]:
        masses: dict[str, float] = {}
        for shape in self.scene.shapes:
            part = self._part(shape.part)
            self._add(shape, part)
            if shape.mass is not None:
                masses[shape.part] = masses.get(shape.part, 0.0) + shape.mass
        for name, mass in masses.items():
            self.parts[name].set_mass(mass)
        self._join()
        for site in self.scene.sites:
            part = self._known_part(site.part, f"site {site.name!r}: site")
            self.object.site(identifier(site.name, "site"), part, _rounded(site.at))
        return self.warnings

    def _part(self, name: str) -> Part:
        if name not in self.parts:
            names = {part.name for part in self.parts.values()}
            self.parts[name] = self.object.part(identifier(name, "part", names))
        return self.parts[name]

    def _known_part(self, name: str, argument: str) -> Part:
        if name not in self.parts:
            raise ValueError(f"{argument}: {choices(name, self.parts)}")
        return self.parts[name]

    def _add(self, shape: BlenderShape, part: Part) -> None:
        """Add the solids of a Blender object to a part."""
        context = f"object {shape.name!r}"
        vertices, faces, slots = shape.triangles()
        if len(faces) > MAX_FACES:
            raise ValueError(f"{context} has {len(faces)} triangles, at most {MAX_FACES} are read")
        for solid in split_solids(vertices, faces, slots):
            if time.process_time() > self.deadline:
                raise TimeoutError("splitting the shapes into convex pieces takes too long")
            try:
                shape_and_pose = shape_of(solid, shape.convex or shape.role == "visual")
            except ValueError as error:
                raise ValueError(f"{context}: {error}") from None
            if shape_and_pose is None:
                continue
            part.add(
                Shape(*shape_and_pose),
                material=self._material(shape, solid.slot),
                role=shape.role,  # pyright: ignore[reportArgumentType] the SDK checks it
                name=identifier(shape.name, "shape", part._named),
            )

    def _material(self, shape: BlenderShape, slot: int) -> str:
        """Define the material of a slot on first use, and return the material's name."""
        name = shape.materials[slot] if slot < len(shape.materials) else ""
        if name not in self.materials:
            message = f"object {shape.name!r} has no material: {_DEFAULT_MATERIAL} is assumed"
            hint = "obj.data.materials.append(...) one that is named after what it is made of"
            self.warnings.append(
                Signal(severity="warning", code="no_material", message=message, hint=hint)
            )
            return _DEFAULT_MATERIAL
        if name not in self.defined:
            self.defined[name] = self._define(self.materials[name])
        return self.defined[name]

    def _define(self, material: BlenderMaterial) -> str:
        fields = material.model_dump(exclude_none=True, exclude={"name"})
        label = identifier(material.name, "material", set(self.defined.values()))
        fields["like"] = fields.get("like") or _material_in(label)
        for key in ("rgb", "rgb2"):
            fields |= {key: tuple(fields[key])} if key in fields else {}
        if fields["like"] is None and "density" not in fields:
            raise ValueError(
                f"material {material.name!r}: name it after what it is made of, such as "
                f"'{_DEFAULT_MATERIAL}_grey', or give it like= or density=; known are "
                f"{', '.join(MATERIALS)}"
            )
        return self.object.material(label, **fields)

    def _join(self) -> None:
        """Create the joints in an order in which each joint follows the joints that it mentions."""
        built: dict[str, Joint] = {}
        pending = list(self.scene.joints)
        while pending:
            ready = [joint for joint in pending if _referenced_joints(joint) <= built.keys()]
            if not ready:
                joint, known = pending[0], [joint.name for joint in self.scene.joints]
                unknown = sorted(_referenced_joints(joint) - built.keys())
                raise ValueError(
                    f"joint {joint.name!r}: mimic or after: {choices(unknown[0], known)}, and none "
                    "may wait for itself"
                )
            for joint in ready:
                built[joint.name] = self._joint(joint, built)
            pending = [joint for joint in pending if joint.name not in built]

    def _joint(self, joint: BlenderJoint, built: dict[str, Joint]) -> Joint:
        context = f"joint {joint.name!r}"
        if joint.type not in _DYNAMICS:
            raise ValueError(f'{context}: empty["joint"]: {choices(joint.type, _DYNAMICS)}')
        parent = self._known_part(joint.parent, f'{context}: empty["parent"]')
        child = self._known_part(joint.child, f'{context}: empty["child"]')
        create: Callable[..., Joint] = getattr(self.object, joint.type)
        name = identifier(joint.name, "joint", {other.name for other in built.values()})
        if joint.type == "fixed":
            return create(name, parent, child)
        arguments: dict[str, Any] = {"at": _rounded(joint.at)}
        if joint.type in ("revolute", "prismatic"):
            if joint.range is None:
                raise ValueError(f'{context}: needs empty["range"] = (lower, upper)')
            arguments["range"] = tuple(joint.range)
            arguments["opens"] = _direction(joint.opens)
        if joint.type == "ball":
            arguments["swing"] = joint.swing
        else:
            arguments["axis"] = _direction(joint.axis)
        dynamics = {key: getattr(joint, key) for key in _DYNAMICS[joint.type]}
        arguments |= {key: value for key, value in dynamics.items() if value is not None}
        if joint.mimic and joint.type != "ball":
            arguments["mimic"] = built[joint.mimic]
            arguments["multiplier"] = 1.0 if joint.multiplier is None else joint.multiplier
            arguments["offset"] = joint.offset or 0.0
        prerequisites = [built[name] for name in _prerequisite_names(joint)]
        if prerequisites:
            arguments["after"] = prerequisites
        return create(name, parent, child, **arguments)


def _direction(value: list[float] | str | None) -> Any:
    return value if value is None or isinstance(value, str) else _rounded(value)


def _rounded(values: list[float]) -> tuple[float, float, float]:
    """Round to 7 decimals, which is about the precision of Blender's floats."""
    return triple(np.round(values, 7) + 0.0)


def _prerequisite_names(joint: BlenderJoint) -> list[str]:
    return [name.strip() for name in (joint.after or "").split(",") if name.strip()]


def _referenced_joints(joint: BlenderJoint) -> set[str]:
    return {*_prerequisite_names(joint), *([joint.mimic] if joint.mimic else [])}


def _material_in(name: str) -> str | None:
    """Return the named material that a name contains, such as "oak" for "dark_oak", or None."""
    padded = f"_{name.lower()}_"
    return max((m for m in MATERIALS if f"_{m}_" in padded), key=len, default=None)
