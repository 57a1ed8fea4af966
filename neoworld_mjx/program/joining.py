"""Validate what a program says of a joint; anchors and directions may be words."""

import math
from typing import Any

from .. import spec as S
from . import validate
from .part import Part, extent_of
from .placing import MAX_ANGLE_RAD, anchor_of, direction, hinge_of, is_hinge


def joint_fields(
    what: str, name: str, kind: str, parent: Part, child: Part, given: dict[str, Any]
) -> dict[str, Any]:
    """Return the fields of a `spec.Joint` that a program gives.

    Args:
        what: for messages.
        name: of the joint.
        kind: its type.
        parent: what it hangs on.
        child: what it moves.
        given: the arguments of the call.
    """
    fields: dict[str, Any] = {"name": name, "type": kind}
    fields |= {"parent": parent.name, "child": child.name}
    at: Any = given.get("at")
    axis = given.get("axis")
    if is_hinge(at):
        point, along = hinge_of(child._extent(), extent_of([parent]), at, f"{what}: at")
        fields["pos"] = tuple(point.tolist())
        fields["axis"] = tuple(along.tolist())
    elif isinstance(at, str):
        fields["pos"] = tuple(anchor_of(child._extent(), at, f"{what}: at").tolist())
    elif at is not None:
        fields["pos"] = validate.vector(at, f"{what}: at")
    if axis is not None:
        fields["axis"] = direction(axis, f"{what}: axis")
    elif kind == "revolute" and "axis" not in fields:
        raise ValueError(f"{what}: needs axis=, unless at= names a hinge such as 'left.hinge'")
    if "range" in given:
        lower, upper = validate.sequence(given["range"], f"{what}: range", 2, 2)
        fields["lower"] = validate.number(lower, f"{what}: range", MAX_ANGLE_RAD)
        fields["upper"] = validate.number(upper, f"{what}: range", MAX_ANGLE_RAD)
    if given.get("swing") is not None:
        swing = validate.number(given["swing"], f"{what}: swing")
        if not 0 < swing <= math.pi:
            raise ValueError(f"{what}: swing must lie above 0 and up to pi, got {swing!r}")
        fields["upper"] = swing
    for key in ("damping", "friction", "stiffness", "effort", "velocity"):
        if given.get(key) is not None:
            fields[key] = validate.number(given[key], f"{what}: {key}")
    if given.get("opens") is not None:
        fields["intent"] = S.Intent(opens=direction(given["opens"], f"{what}: opens"))
    leader = given.get("mimic")
    if leader is not None and given.get("after") is not None:
        raise ValueError(f"{what}: after= belongs to {leader.name!r}, which it follows")
    if leader is not None:
        fields["mimic"] = S.Mimic(
            joint=leader.name,
            multiplier=validate.number(given["multiplier"], f"{what}: multiplier"),
            offset=validate.number(given["offset"], f"{what}: offset"),
        )
    return fields


__all__ = ["joint_fields"]
