"""Assemble the ObjectSpec of a program's object: structure, default joint losses, origin."""

from typing import Any

from pydantic import ValidationError

from .. import spec as S
from ..checks.signals import Signal, has_errors
from ..io.validation_message import validation_message
from ..spec import Inertial
from .joint_losses import default_losses
from .sdk_object import Object


def assemble(
    objects: list[Object], *, loose: bool = False
) -> tuple[S.ObjectSpec | None, list[Signal]]:
    """Turn the only object of a program into its description.

    Args:
        objects: every `Object` that the program made.
        loose: whether its parts have no joints yet; each is then fastened to the first.

    Returns:
        The description, its origin at the centre of the bounding box's bottom face, or None, and
        the errors that prevent it.
    """
    if len(objects) != 1:
        names = ", ".join(repr(obj.name) for obj in objects[:5])
        return None, [
            Signal(
                severity="error",
                code="no_object" if not objects else "many_objects",
                message=f"a program makes exactly one Object, this one made {len(objects)}"
                + (f": {names}" if objects else ""),
                hint="call Object(name, label=...) once; parts of it are made by .part(name)",
            )
        ]
    obj = objects[0]
    if loose and obj._joints:
        return None, [_joined_too_soon(obj)]
    signals = [s for s in _structure(obj) if not (loose and s.code == "orphan_part")]
    if has_errors(signals):
        return None, signals
    joints_given: list[dict[str, Any]] = [joint._fields for joint in obj._joints]
    if loose:
        root, *others = [part.name for part in obj._parts]
        joints_given = [
            {"name": f"{name[:40]}_held", "type": "fixed", "parent": root, "child": name}
            for name in others
        ]
    used = {geom._spec.material for part in obj._parts for geom in part._geoms}
    try:
        authored = S.ObjectSpec(
            name=obj.name,
            label=obj.label,
            materials=tuple(m for name, m in obj._materials.items() if name in used),
            parts=tuple(
                S.PartSpec(name=p.name, geoms=tuple(g._spec for g in p._geoms), mass=p._mass)
                for p in obj._parts
            ),
            joints=tuple(S.JointSpec(**fields) for fields in joints_given),
            sites=tuple(obj._sites),
        )
    except ValidationError as error:
        return None, [
            Signal(
                severity="error", code="structure", message=validation_message(error, S.ObjectSpec)
            )
        ]
    inertials = {part.name: S.inertial(authored, part) for part in authored.parts}
    joints = tuple(
        _with_losses(joint, fields, inertials[joint.child])
        for joint, fields in zip(authored.joints, joints_given, strict=True)
    )
    return _rounded(S.recentred(authored.model_copy(update={"joints": joints}))), signals


def _rounded(spec: S.ObjectSpec) -> S.ObjectSpec:
    """Round positions to 1e-9 m and quaternions to 1e-12.

    The last digits differ from one processor to the next.
    """
    vec = lambda values, digits: tuple(round(v, digits) + 0.0 for v in values)
    parts = tuple(
        part.model_copy(
            update={
                "geoms": tuple(
                    geom.model_copy(update={"pos": vec(geom.pos, 9), "quat": vec(geom.quat, 12)})
                    for geom in part.geoms
                )
            }
        )
        for part in spec.parts
    )
    joints = tuple(
        joint.model_copy(
            update={
                "pos": vec(joint.pos, 9),
                "axis": vec(joint.axis, 12),
                "damping": float(f"{joint.damping:.6g}"),
                "friction": float(f"{joint.friction:.6g}"),
            }
        )
        for joint in spec.joints
    )
    sites = tuple(site.model_copy(update={"pos": vec(site.pos, 9)}) for site in spec.sites)
    return spec.model_copy(update={"parts": parts, "joints": joints, "sites": sites})


def _structure(obj: Object) -> list[Signal]:
    """Return errors of the tree of parts: no part, empty or unattached parts, cycles of joints."""
    if not obj._parts:
        return [
            Signal(
                severity="error",
                code="no_parts",
                message=f"object {obj.name!r} has no parts",
                hint="make one with .part(name) and .add shapes to it",
            )
        ]
    signals = []
    parents = {joint._fields["child"]: joint._fields["parent"] for joint in obj._joints}
    roots = [part.name for part in obj._parts if part.name not in parents]
    for part in obj._parts:
        if all(geom._spec.role == "visual" for geom in part._geoms):
            signals.append(
                Signal(
                    severity="error",
                    code="empty_part",
                    part=part.name,
                    line=part._line,
                    message=f"part {part.name!r} has no shape that collides",
                    hint="add a shape with role 'both', or leave the part out",
                )
            )
        if part.name in roots[1:]:
            signals.append(
                Signal(
                    severity="error",
                    code="orphan_part",
                    part=part.name,
                    line=part._line,
                    message=f"part {part.name!r} hangs on nothing; the root is {roots[0]!r}",
                    hint="join it to another part by fixed, revolute, prismatic or continuous",
                )
            )
    for child, parent in parents.items():
        chain, ancestor = [child], parent
        while ancestor in parents and ancestor not in chain:
            chain.append(ancestor)
            ancestor = parents[ancestor]
        if ancestor == child:
            signals.append(
                Signal(
                    severity="error",
                    code="joint_cycle",
                    part=child,
                    message=f"joints go in a circle: {' -> '.join([*chain, child])}",
                    hint="joints form a tree with one root part",
                )
            )
            break
    return signals


def _with_losses(joint: S.JointSpec, authored: dict[str, object], child: Inertial) -> S.JointSpec:
    """Fill in damping and dry friction that the program did not author, from the child's mass."""
    if joint.type == "fixed":
        return joint
    values = dict(zip(("damping", "friction"), default_losses(joint, child), strict=True))
    return joint.model_copy(update={k: v for k, v in values.items() if k not in authored})


def _joined_too_soon(obj: Object) -> Signal:
    names = ", ".join(joint.name for joint in obj._joints[:4])
    return Signal(
        severity="error",
        code="joint_in_geometry",
        message=f"the geometry program makes joints ({names})",
        hint="only parts and shapes here; joints, doors and drawers come in the next program",
    )
