"""Conversion of a program's object into an ObjectSpec: structure checks, joint losses, origin.

Joints without authored losses get damping and dry friction from the mass of the child part.
"""

import math
from typing import Any

from pydantic import ValidationError

from .. import spec as S
from ..checks.signals import Signal, error_signal, has_errors
from ..io.text_files import validation_message
from ..spec import Inertial, JointSpec
from ..spec.mass import inertia_about
from .sdk_object import Object

GRAVITY = 9.81
SETTLING_S = 0.4
"""Time constant [s] with which damping slows down a joint."""
TURNING_FRICTION, SLIDING_FRICTION = 0.02, 0.1
"""Dry friction of turning joints, over weight times moment arm; of sliding joints, over weight."""


def default_losses(joint: JointSpec, child: Inertial) -> tuple[float, float]:
    """Return the default damping and dry friction of a joint that is not fixed.

    Units are N s/m and N for a prismatic joint, and N m s/rad and N m for other joints.

    Args:
        joint: the joint.
        child: mass and inertia of the part that the joint moves.
    """
    inertia = inertia_about(joint, child)
    if joint.type == "prismatic":
        return inertia / SETTLING_S, SLIDING_FRICTION * child.mass * GRAVITY
    # The moment arm is the radius of gyration, so that a balanced knob has friction, too.
    arm = math.sqrt(inertia / child.mass)
    return inertia / SETTLING_S, TURNING_FRICTION * child.mass * GRAVITY * arm


def assemble(
    objects: list[Object], *, without_joints: bool = False
) -> tuple[S.ObjectSpec | None, list[Signal]]:
    """Convert the only object of a program into an ObjectSpec.

    Args:
        objects: every `Object` that the program created.
        without_joints: if True, the parts have no joints yet, and every part is fixed to the first
            part.

    Returns:
        The ObjectSpec and an empty list, or, if the object is invalid, None and the errors. The
        origin of the ObjectSpec is the center of the bounding box's bottom face.
    """
    if len(objects) != 1:
        names = ", ".join(repr(obj.name) for obj in objects[:5])
        message = f"a program makes exactly one Object, this one made {len(objects)}"
        hint = "call Object(name, label=...) once; parts of it are made by .part(name)"
        code = "many_objects" if objects else "no_object"
        return None, [error_signal(code, message + (f": {names}" if objects else ""), hint=hint)]
    obj = objects[0]
    if without_joints and obj._joints:
        return None, [_premature_joints(obj)]
    signals = [s for s in _structure(obj) if not (without_joints and s.code == "orphan_part")]
    if has_errors(signals):
        return None, signals
    joint_fields: list[dict[str, Any]] = [joint._fields for joint in obj._joints]
    if without_joints:
        root, *children = [part.name for part in obj._parts]
        joint_fields = [
            {"name": f"{name[:40]}_held", "type": "fixed", "parent": root, "child": name}
            for name in children
        ]
    used = {geom._spec.material for part in obj._parts for geom in part._geoms}
    try:
        spec = S.ObjectSpec(
            name=obj.name,
            label=obj.label,
            materials=tuple(m for name, m in obj._materials.items() if name in used),
            parts=tuple(
                S.PartSpec(name=p.name, geoms=tuple(g._spec for g in p._geoms), mass=p._mass)
                for p in obj._parts
            ),
            joints=tuple(S.JointSpec(**fields) for fields in joint_fields),
            sites=tuple(obj._sites),
        )
    except ValidationError as error:
        return None, [error_signal("structure", validation_message(error, S.ObjectSpec))]
    inertials = {part.name: S.inertial(spec, part) for part in spec.parts}
    joints = tuple(
        _with_losses(joint, fields, inertials[joint.child])
        for joint, fields in zip(spec.joints, joint_fields, strict=True)
    )
    return _rounded(S.recentred(spec.model_copy(update={"joints": joints}))), signals


def _rounded(spec: S.ObjectSpec) -> S.ObjectSpec:
    """Round positions, quaternions, axes and losses to digits that are equal on all processors.

    Positions are rounded to 1e-9 m, quaternions and axes to 1e-12, losses to 6 significant digits.
    """

    def rounded(model: Any, update: dict[str, Any], **digits: int) -> Any:
        for field, count in digits.items():
            update[field] = tuple(round(value, count) + 0.0 for value in getattr(model, field))
        return model.model_copy(update=update)

    parts = [
        part.model_copy(
            update={"geoms": tuple(rounded(geom, {}, pos=9, quat=12) for geom in part.geoms)}
        )
        for part in spec.parts
    ]
    joints = []
    for joint in spec.joints:
        losses = {name: float(f"{getattr(joint, name):.6g}") for name in ("damping", "friction")}
        joints.append(rounded(joint, losses, pos=9, axis=12))
    sites = tuple(rounded(site, {}, pos=9) for site in spec.sites)
    update = {"parts": tuple(parts), "joints": tuple(joints), "sites": sites}
    return spec.model_copy(update=update)


def _structure(obj: Object) -> list[Signal]:
    """Return the errors of the part tree.

    These are an object without parts, parts without colliders, unattached parts, and joint cycles.
    """
    if not obj._parts:
        hint = "make one with .part(name) and .add shapes to it"
        return [error_signal("no_parts", f"object {obj.name!r} has no parts", hint=hint)]
    signals = []
    parents = {joint._fields["child"]: joint._fields["parent"] for joint in obj._joints}
    roots = [part.name for part in obj._parts if part.name not in parents]
    for part in obj._parts:
        origin = {"part": part.name, "line": part._line}
        if all(geom._spec.role == "visual" for geom in part._geoms):
            message = f"part {part.name!r} has no shape that collides"
            hint = "add a shape with role 'both', or leave the part out"
            signals.append(error_signal("empty_part", message, hint=hint, **origin))
        if part.name in roots[1:]:
            message = f"part {part.name!r} hangs on nothing; the root is {roots[0]!r}"
            hint = "join it to another part by fixed, revolute, prismatic or continuous"
            signals.append(error_signal("orphan_part", message, hint=hint, **origin))
    for child, parent in parents.items():
        chain, ancestor = [child], parent
        while ancestor in parents and ancestor not in chain:
            chain.append(ancestor)
            ancestor = parents[ancestor]
        if ancestor == child:
            message = f"joints go in a circle: {' -> '.join([*chain, child])}"
            hint = "joints form a tree with one root part"
            signals.append(error_signal("joint_cycle", message, part=child, hint=hint))
            break
    return signals


def _with_losses(joint: S.JointSpec, authored: dict[str, object], child: S.Inertial) -> S.JointSpec:
    """Set damping and dry friction to their defaults where the program leaves them unset."""
    if joint.type == "fixed":
        return joint
    values = dict(zip(("damping", "friction"), default_losses(joint, child), strict=True))
    return joint.model_copy(update={k: v for k, v in values.items() if k not in authored})


def _premature_joints(obj: Object) -> Signal:
    names = ", ".join(joint.name for joint in obj._joints[:4])
    message = f"the geometry program makes joints ({names})"
    hint = "only parts and shapes here; joints, doors and drawers come in the next program"
    return error_signal("joint_in_geometry", message, hint=hint)
