"""Make the SDK's object of a scene of Blender: parts, materials, masses, joints and points.

Every value goes through the SDK, so that both languages have the same rules, limits and complaints.
"""

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from ...checks.signals import Signal
from ...config import ProgramOptions
from ...errors import choices
from ...io.names import identifier
from ..exception_signals import exception_signal, limit_signal
from ..materials import MATERIALS
from ..part import Joint, Part
from ..placing import Shape
from ..sdk_object import Object
from ..session import LimitExceeded, Session, entered
from .blender_answer import BlenderJoint, BlenderMaterial, BlenderScene, BlenderShape
from .blender_availability import require_blender
from .blender_process import blender_answer, failure
from .mesh_islands import MAX_FACES, islands, shape_of

JOINTS = ("fixed", "revolute", "continuous", "prismatic", "ball")
_DYNAMICS = ("damping", "friction", "stiffness", "effort", "velocity")
_USUAL = "plastic"
"""Material of shapes without one."""


def run_blender(text: str, session: Session, options: ProgramOptions) -> tuple[str, list[Signal]]:
    """Run a program in Blender and make the SDK's object of what it leaves.

    Args:
        text: the program.
        session: collects the object, and counts parts, shapes and convex pieces.
        options: the limits.

    Returns:
        Printed text, and errors.

    Raises:
        ProgramError: Blender is not installed, or the machine cannot confine it.
    """
    require_blender()
    answer = blender_answer(
        text,
        timeout_s=options.blender_timeout_s,
        memory_mib=options.blender_memory_mib,
        printed_bytes=options.max_output_bytes,
    )
    failed = failure(answer, options.blender_timeout_s)
    if failed is not None or answer.scene is None:
        return answer.printed, [] if failed is None else [failed]
    return answer.printed, read_back(answer.scene, session, options)


def read_back(
    scene: BlenderScene, session: Session, options: ProgramOptions | None = None
) -> list[Signal]:
    """Make the object of a scene in a session; return errors and warnings.

    Args:
        scene: what Blender's process wrote, untrusted.
        session: collects the object.
        options: time for splitting shapes into convex pieces.
    """
    options = options or ProgramOptions()
    if scene.error is not None:
        return [_raised(scene)]
    try:
        with entered(session):
            return _Reading(scene, time.monotonic() + options.blender_timeout_s).read()
    except LimitExceeded as exceeded:
        return [limit_signal(exceeded, session)]
    except (ValueError, TypeError, TimeoutError) as error:
        return [exception_signal(error)]


def _raised(scene: BlenderScene) -> Signal:
    error = scene.error
    assert error is not None
    codes = {"SyntaxError": "syntax", "MemoryError": "memory", "RecursionError": "recursion"}
    denied = error.type in ("PermissionError", "BlockingIOError", "OSError")
    return Signal(
        severity="error",
        code="forbidden" if denied else codes.get(error.type, "runtime"),
        message=f"{error.type}: {error.message}",
        line=error.line,
        column=error.column,
        hint="programs have no files, network or processes" if denied else "",
    )


class _Reading:
    """One scene as it becomes an object."""

    def __init__(self, scene: BlenderScene, until: float) -> None:
        self.scene, self.until = scene, until
        self.object = Object(identifier(scene.name, "object"), label=scene.label)
        self.materials = {material.name: material for material in scene.materials}
        self.defined: dict[str, str] = {}
        self.parts: dict[str, Part] = {}
        self.warnings: list[Signal] = []

    def read(self) -> list[Signal]:
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
            part = self._known(site.part, f"site {site.name!r}: site")
            self.object.site(identifier(site.name, "site"), part, _rounded(site.at))
        return self.warnings

    def _part(self, name: str) -> Part:
        if name not in self.parts:
            taken = {part.name for part in self.parts.values()}
            self.parts[name] = self.object.part(identifier(name, "part", taken))
        return self.parts[name]

    def _known(self, name: str, argument: str) -> Part:
        if name not in self.parts:
            raise ValueError(f"{argument}: {choices(name, self.parts)}")
        return self.parts[name]

    def _add(self, shape: BlenderShape, part: Part) -> None:
        """Add the solids of a Blender object to its part."""
        context = f"object {shape.name!r}"
        vertices, faces, slots = shape.triangles()
        if len(faces) > MAX_FACES:
            raise ValueError(f"{context} has {len(faces)} triangles, at most {MAX_FACES} are read")
        for island in islands(vertices, faces, slots):
            if time.monotonic() > self.until:
                raise TimeoutError("splitting the shapes into convex pieces takes too long")
            try:
                made = shape_of(island, shape.convex or shape.role == "visual")
            except ValueError as error:
                raise ValueError(f"{context}: {error}") from None
            if made is None:
                continue
            described, at = made
            part.add(
                Shape(described, at),
                material=self._material(shape, island.slot),
                role=shape.role,  # pyright: ignore[reportArgumentType] the SDK checks it
                name=self._geom_name(shape, part),
            )

    def _geom_name(self, shape: BlenderShape, part: Part) -> str:
        return identifier(shape.name, "shape", part._named)

    def _material(self, shape: BlenderShape, slot: int) -> str:
        """Return the name of the material of a slot, defined in the object on first use."""
        name = shape.materials[slot] if slot < len(shape.materials) else ""
        if name not in self.materials:
            message = f"object {shape.name!r} has no material: {_USUAL} is assumed"
            hint = "obj.data.materials.append(...) one that is named after what it is made of"
            self.warnings.append(
                Signal(severity="warning", code="no_material", message=message, hint=hint)
            )
            return _USUAL
        if name not in self.defined:
            self.defined[name] = self._define(self.materials[name])
        return self.defined[name]

    def _define(self, material: BlenderMaterial) -> str:
        own = material.model_dump(exclude_none=True, exclude={"name"})
        label = identifier(material.name, "material", set(self.defined.values()))
        own["like"] = own.get("like") or _made_of(label)
        for key in ("rgb", "rgb2"):
            own |= {key: tuple(own[key])} if key in own else {}
        if own["like"] is None and "density" not in own:
            raise ValueError(
                f"material {material.name!r}: name it after what it is made of, such as "
                f"'{_USUAL}_grey', or give it like= or density=; known are {', '.join(MATERIALS)}"
            )
        return self.object.material(label, **own)

    def _join(self) -> None:
        """Make the joints, those that others name before these."""
        made: dict[str, Joint] = {}
        waiting = list(self.scene.joints)
        while waiting:
            ready = [joint for joint in waiting if _named_by(joint) <= made.keys()]
            if not ready:
                joint, known = waiting[0], [joint.name for joint in self.scene.joints]
                unknown = sorted(_named_by(joint) - made.keys())
                raise ValueError(
                    f"joint {joint.name!r}: mimic or after: {choices(unknown[0], known)}, and none "
                    "may wait for itself"
                )
            for joint in ready:
                made[joint.name] = self._joint(joint, made)
            waiting = [joint for joint in waiting if joint.name not in made]

    def _joint(self, joint: BlenderJoint, made: dict[str, Joint]) -> Joint:
        context = f"joint {joint.name!r}"
        if joint.type not in JOINTS:
            raise ValueError(f'{context}: empty["joint"]: {choices(joint.type, JOINTS)}')
        parent = self._known(joint.parent, f'{context}: empty["parent"]')
        child = self._known(joint.child, f'{context}: empty["child"]')
        given: dict[str, Any] = {"at": _rounded(joint.at)}
        if joint.type in ("revolute", "prismatic"):
            if joint.range is None:
                raise ValueError(f'{context}: needs empty["range"] = (lower, upper)')
            given["range"] = tuple(joint.range)
            given["opens"] = _direction(joint.opens)
        if joint.type == "ball":
            given["swing"] = joint.swing
        elif joint.type != "fixed":
            given["axis"] = _direction(joint.axis)
        keys = _DYNAMICS if joint.type in ("revolute", "prismatic") else ()
        keys = ("damping", "friction", "effort", "velocity") if joint.type == "continuous" else keys
        keys = ("damping", "friction", "stiffness") if joint.type == "ball" else keys
        given |= {k: v for k in keys if (v := getattr(joint, k)) is not None}
        if joint.mimic and joint.type in ("revolute", "prismatic", "continuous"):
            given["mimic"] = made[joint.mimic]
            given["multiplier"] = 1.0 if joint.multiplier is None else joint.multiplier
            given["offset"] = joint.offset or 0.0
        openers = [made[name] for name in _after(joint)]
        if openers and joint.type != "fixed":
            given["after"] = openers
        make: Callable[..., Joint] = getattr(self.object, joint.type)
        taken = {other.name for other in made.values()}
        arguments = {} if joint.type == "fixed" else given
        return make(identifier(joint.name, "joint", taken), parent, child, **arguments)


def _direction(value: list[float] | str | None) -> Any:
    return value if value is None or isinstance(value, str) else _rounded(value)


def _rounded(values: list[float]) -> tuple[float, float, float]:
    """Round the last digits of single precision away."""
    x, y, z = (np.round(values, 7) + 0.0).tolist()
    return x, y, z


def _after(joint: BlenderJoint) -> list[str]:
    return [name.strip() for name in (joint.after or "").split(",") if name.strip()]


def _named_by(joint: BlenderJoint) -> set[str]:
    return {*_after(joint), *([joint.mimic] if joint.mimic else [])}


def _made_of(name: str) -> str | None:
    """Return the named material that a name holds as words: "oak" for "dark_oak"."""
    words = f"_{name.lower()}_"
    held = [known for known in MATERIALS if f"_{known}_" in words]
    return max(held, key=len, default=None)
