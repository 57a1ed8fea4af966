"""Validate the arguments of a joint; anchors and directions may be words."""

import math
from typing import Any

from .. import spec as S
from ..checks.signals import in_radians
from . import validate
from .part import Part, extent_of
from .placing import anchor_of, direction, hinge_of, is_hinge

MAX_RANGE = 1e4
"""Largest limit of a joint that is read; the compile checks refuse far smaller ones with a hint."""


def joint_fields(
    context: str, name: str, kind: str, parent: Part, child: Part, arguments: dict[str, Any]
) -> dict[str, Any]:
    """Return the fields of a `JointSpec` that the arguments of a call determine.

    Args:
        context: the joint, for messages.
        name: name of the joint.
        kind: its type.
        parent: part that it is attached to.
        child: part that it moves.
        arguments: arguments of the call, by name.

    Raises:
        TypeError: an argument has the wrong type.
        ValueError: an argument has a wrong value, or one is missing.
    """
    fields: dict[str, Any] = {"name": name, "type": kind}
    fields |= {"parent": parent.name, "child": child.name}
    at: Any = arguments.get("at")
    axis = arguments.get("axis")
    if is_hinge(at):
        point, along = hinge_of(child._extent(), extent_of([parent]), at, f"{context}: at")
        fields["pos"] = tuple(point.tolist())
        fields["axis"] = tuple(along.tolist())
    elif isinstance(at, str):
        fields["pos"] = tuple(anchor_of(child._extent(), at, f"{context}: at").tolist())
    elif at is not None:
        fields["pos"] = validate.vector(at, f"{context}: at")
    if axis is not None:
        fields["axis"] = direction(axis, f"{context}: axis")
    elif kind == "revolute" and "axis" not in fields:
        raise ValueError(f"{context}: needs axis=, unless at= names a hinge such as 'left.hinge'")
    if "range" in arguments:
        lower, upper = validate.sequence(arguments["range"], f"{context}: range", 2, 2)
        fields["lower"] = validate.number(lower, f"{context}: range", MAX_RANGE)
        fields["upper"] = validate.number(upper, f"{context}: range", MAX_RANGE)
        if kind in ("revolute", "ball"):
            for limit in (fields["lower"], fields["upper"]):
                validate.doubt_radians(limit, f"{context}: range")
    if arguments.get("swing") is not None:
        swing = validate.number(arguments["swing"], f"{context}: swing")
        if not 0 < swing <= math.pi:
            meant = f"; {in_radians(swing)}" if swing > math.pi else ""
            raise ValueError(
                f"{context}: swing must lie above 0 and up to pi, got {swing!r}{meant}"
            )
        fields["upper"] = swing
    for key in ("damping", "friction", "stiffness", "effort", "velocity"):
        if arguments.get(key) is not None:
            fields[key] = validate.number(arguments[key], f"{context}: {key}")
    if arguments.get("opens") is not None:
        fields["intent"] = S.Intent(opens=direction(arguments["opens"], f"{context}: opens"))
    leader = arguments.get("mimic")
    if leader is not None and arguments.get("after") is not None:
        raise ValueError(f"{context}: after= belongs to {leader.name!r}, which it follows")
    if leader is not None:
        fields["mimic"] = S.Mimic(
            joint=leader.name,
            multiplier=validate.number(arguments["multiplier"], f"{context}: multiplier"),
            offset=validate.number(arguments["offset"], f"{context}: offset"),
        )
    return fields
