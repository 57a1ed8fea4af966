"""Assemble an ObjectSpec from a program's objects: structure, default joint losses, origin."""

from pydantic import ValidationError

from .. import spec as S
from ..config import describe
from ..spec import Inertial
from .joint_losses import default_losses
from .sdk_object import Object
from .signals import Signal, has_errors


def assemble(made: list[Object]) -> tuple[S.ObjectSpec | None, list[Signal]]:
    """Turn a program's object into its description, or say why that cannot be done."""
    if len(made) != 1:
        names = ", ".join(repr(item.name) for item in made[:5])
        return None, [
            Signal(
                severity="error",
                code="no_object" if not made else "many_objects",
                message=f"a program makes exactly one Object, this one made {len(made)}"
                + (f": {names}" if made else ""),
                hint="call Object(name, label=...) once; parts of it are made by .part(name)",
            )
        ]
    item = made[0]
    signals = list(_structure(item))
    if has_errors(signals):
        return None, signals
    used = {geom._spec.material for part in item._parts for geom in part._geoms}
    try:
        plain = S.ObjectSpec(
            name=item.name,
            label=item.label,
            materials=tuple(m for name, m in item._materials.items() if name in used),
            parts=tuple(
                S.PartSpec(name=p.name, geoms=tuple(g._spec for g in p._geoms), mass=p._mass)
                for p in item._parts
            ),
            joints=tuple(S.JointSpec(**joint._fields) for joint in item._joints),
            sites=tuple(item._sites),
        )
    except ValidationError as error:
        return None, [
            Signal(severity="error", code="structure", message=describe(error, S.ObjectSpec))
        ]
    inertials = {part.name: S.inertial(plain, part) for part in plain.parts}
    joints = tuple(
        _with_losses(joint, made_joint._fields, inertials[joint.child])
        for joint, made_joint in zip(plain.joints, item._joints, strict=True)
    )
    return _rounded(S.recentred(plain.model_copy(update={"joints": joints}))), signals


def _rounded(spec: S.ObjectSpec) -> S.ObjectSpec:
    """Drop the last digits, which differ from one processor to the next; to a nanometre."""
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


def _structure(item: Object) -> list[Signal]:
    found = []
    if not item._parts:
        return [
            Signal(
                severity="error",
                code="no_parts",
                message=f"object {item.name!r} has no parts",
                hint="make one with .part(name) and .add shapes to it",
            )
        ]
    carried = {joint._fields["child"]: joint._fields["parent"] for joint in item._joints}
    roots = [part.name for part in item._parts if part.name not in carried]
    for part in item._parts:
        colliding = any(geom._spec.role != "visual" for geom in part._geoms)
        if not colliding:
            found.append(
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
            found.append(
                Signal(
                    severity="error",
                    code="orphan_part",
                    part=part.name,
                    line=part._line,
                    message=f"part {part.name!r} hangs on nothing; the root is {roots[0]!r}",
                    hint="join it to another part by fixed, revolute, prismatic or continuous",
                )
            )
    for start, first in carried.items():
        chain, at = [start], first
        while at in carried and at not in chain:
            chain.append(at)
            at = carried[at]
        if at == start:
            found.append(
                Signal(
                    severity="error",
                    code="joint_cycle",
                    part=start,
                    message=f"joints go in a circle: {' -> '.join([*chain, start])}",
                    hint="joints form a tree with one root part",
                )
            )
            break
    return found


def _with_losses(joint: S.JointSpec, authored: dict[str, object], child: Inertial) -> S.JointSpec:
    """Fill in damping and dry friction that the program left open, from the child's mass."""
    if joint.type == "fixed":
        return joint
    values = dict(zip(("damping", "friction"), default_losses(joint, child), strict=True))
    return joint.model_copy(update={k: v for k, v in values.items() if k not in authored})
