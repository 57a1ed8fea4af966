"""Joints of a program's object; anchors and directions may be given by name."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, no_type_check

from .. import spec as S
from ..checks.signals import radians_hint
from . import session as validate
from .part import Joint, Part, Point2, Vec3, anchor_of, direction, extent_of, hinge_of, is_hinge
from .session import current_line

MAX_RANGE = 1e4
"""Largest joint limit that is accepted here [m or rad]; the compile checks allow far less."""
After = Part | Joint | Sequence[Part | Joint] | None
"""Parts or joints that must be open before a joint moves."""


@no_type_check
class ObjectJoints:
    """Methods of `Object` that connect parts by joints."""

    _joints: list[Joint]
    if TYPE_CHECKING:  # Members of `Object`.
        name: str

        def part(  # noqa: D102
            self, name: str, material: str | None = None, mass: float | None = None
        ) -> Part: ...

    def fixed(self, name: str, parent: Part, child: Part) -> Joint:
        """Fasten `child` rigidly to `parent`."""
        return self._join("fixed", name, parent, child, {})

    def revolute(
        self,
        name: str,
        parent: Part,
        child: Part,
        *,
        at: Vec3 | str,
        axis: Vec3 | str | None = None,
        range: Point2,
        damping: float | None = None,
        friction: float | None = None,
        stiffness: float = 0.0,
        effort: float | None = None,
        velocity: float | None = None,
        mimic: Joint | None = None,
        multiplier: float = 1.0,
        offset: float = 0.0,
        after: After = None,
        opens: Vec3 | str | None = None,
    ) -> Joint:
        """Hinge `child` to `parent` at a point, about an axis, between two angles [rad].

        Positive angles follow the right-hand rule about `axis`, and should open the joint. The
        shapes of the program show the object at angle 0.

        `at` may be an anchor of the child. "left.hinge" is the left edge of a flat child. If `axis`
        is None, this anchor also sets the axis so that positive angles move the child away from the
        parent.

        By default, damping [N m s/rad] and friction [N m] are derived from the child's inertia and
        weight. With `mimic`, the joint's angle is multiplier * q + offset, where q is the position
        of the other joint. `after` lists the parts or joints that must be open first, such as the
        door for the rack of a dishwasher. `opens` is the direction in which the child's center
        starts to move, such as "front"; the compile checks compare the direction with the axis.
        """
        return self._join("revolute", name, parent, child, call_arguments(locals()))

    def continuous(
        self,
        name: str,
        parent: Part,
        child: Part,
        *,
        at: Vec3 | str,
        axis: Vec3 | str,
        damping: float | None = None,
        friction: float | None = None,
        effort: float | None = None,
        velocity: float | None = None,
        mimic: Joint | None = None,
        multiplier: float = 1.0,
        offset: float = 0.0,
        after: After = None,
    ) -> Joint:
        """Let `child`, such as a wheel or a knob, turn without limits about an axis."""
        return self._join("continuous", name, parent, child, call_arguments(locals()))

    def ball(
        self,
        name: str,
        parent: Part,
        child: Part,
        *,
        at: Vec3 | str,
        swing: float | None = None,
        damping: float | None = None,
        friction: float | None = None,
        stiffness: float = 0.0,
        after: After = None,
    ) -> Joint:
        """Let `child` turn about a point in all directions.

        `swing` is the largest angle from the initial orientation [rad]; if None, there is no limit.
        """
        return self._join("ball", name, parent, child, call_arguments(locals()))

    def prismatic(
        self,
        name: str,
        parent: Part,
        child: Part,
        *,
        axis: Vec3 | str,
        range: Point2,
        at: Vec3 | str | None = None,
        damping: float | None = None,
        friction: float | None = None,
        stiffness: float = 0.0,
        effort: float | None = None,
        velocity: float | None = None,
        mimic: Joint | None = None,
        multiplier: float = 1.0,
        offset: float = 0.0,
        after: After = None,
        opens: Vec3 | str | None = None,
    ) -> Joint:
        """Let `child` slide along an axis between two positions [m]; positive positions open."""
        return self._join("prismatic", name, parent, child, call_arguments(locals()))

    def _join(
        self, kind: str, name: str, parent: Part, child: Part, arguments: dict[str, Any]
    ) -> Joint:
        context = f"joint {validate.name(name, 'joint name')!r}"
        validate.unused(name, "joint", [joint.name for joint in self._joints])
        self._check_part(parent, f"{context}: parent")
        self._check_part(child, f"{context}: child")
        if parent is child:
            raise ValueError(f"{context}: parent and child are both {parent.name!r}")
        other = self._joint_of(child)
        if other is not None:
            raise ValueError(
                f"{context}: part {child.name!r} hangs on joint {other.name!r} already; "
                f"a part has one parent"
            )
        leader = arguments.get("mimic")
        if leader is not None and (not isinstance(leader, Joint) or leader not in self._joints):
            raise TypeError(f"{context}: mimic must be a joint of this object, made before")
        if leader is not None and leader._fields["type"] == "ball":
            raise ValueError(f"{context}: cannot follow {leader.name!r}, a ball")
        fields: dict[str, Any] = {"name": name, "type": kind}
        fields |= {"parent": parent.name, "child": child.name}
        fields |= _joint_fields(context, kind, parent, child, arguments)
        if arguments.get("after") is not None:
            fields["after"] = self._openers(arguments["after"], f"{context}: after")
        validate.build_spec(S.JointSpec, context, **fields)
        joint = Joint(fields, current_line())
        self._joints.append(joint)
        return joint

    def _joint_of(self, part: Part) -> Joint | None:
        """Return the joint whose child is the part, or None."""
        return next((j for j in self._joints if j._fields["child"] == part.name), None)

    def _openers(self, value: Any, argument: str) -> tuple[str, ...]:
        """Return the names of joints that are given as joints or as the parts that they move."""
        names = []
        openers = value if isinstance(value, list | tuple) else [value]
        for opener in validate.sequence(openers, argument, 1, 8):
            if isinstance(opener, Part):
                self._check_part(opener, argument)
                joint = self._joint_of(opener)
            else:
                joint = opener if opener in self._joints else None
            if joint is None:
                raise ValueError(
                    f"{argument} must be a part or a joint of this object, or a list of them, "
                    f"whose joint is made before; got {validate.formatted(value)}"
                )
            if joint._fields["type"] not in ("revolute", "prismatic") or "mimic" in joint._fields:
                raise ValueError(
                    f"{argument}: {joint.name!r} must be revolute or prismatic and follow no other"
                )
            names.append(joint.name)
        return tuple(dict.fromkeys(names))

    def _check_part(self, part: Any, argument: str) -> None:
        if not isinstance(part, Part):
            raise TypeError(
                f"{argument} must be a part made by {self.name}.part(...), "
                f"got {validate.formatted(part)}"
            )
        if part._owner is not self:
            raise ValueError(f"{argument} {part.name!r} belongs to another object")


def call_arguments(local: dict[str, Any]) -> dict[str, Any]:
    """Return the arguments of a method call, without `self`, `name`, `parent` and `child`."""
    return {k: v for k, v in local.items() if k not in ("self", "name", "parent", "child")}


def _joint_fields(
    context: str, kind: str, parent: Part, child: Part, arguments: dict[str, Any]
) -> dict[str, Any]:
    """Return the fields of a `JointSpec` that the arguments of a joint method determine."""
    fields: dict[str, Any] = {}
    at: Any = arguments.get("at")
    axis = arguments.get("axis")
    if is_hinge(at):
        point, along = hinge_of(child._extent(), extent_of([parent]), at, f"{context}: at")
        fields |= {"pos": tuple(point.tolist()), "axis": tuple(along.tolist())}
    elif isinstance(at, str):
        fields["pos"] = tuple(anchor_of(child._extent(), at, f"{context}: at").tolist())
    elif at is not None:
        fields["pos"] = validate.vector(at, f"{context}: at")
    if axis is not None:
        fields["axis"] = direction(axis, f"{context}: axis")
    elif kind == "revolute" and "axis" not in fields:
        raise ValueError(f"{context}: needs axis=, unless at= names a hinge such as 'left.hinge'")
    if "range" in arguments:
        limits = validate.pair(arguments["range"], f"{context}: range", MAX_RANGE)
        fields["lower"], fields["upper"] = limits
        if kind == "revolute":
            for limit in limits:
                validate.warn_of_degrees(limit, f"{context}: range")
    if arguments.get("swing") is not None:
        swing = validate.number(arguments["swing"], f"{context}: swing")
        if not 0 < swing <= math.pi:
            conversion = f"; {radians_hint(swing)}" if swing > math.pi else ""
            raise ValueError(
                f"{context}: swing must lie above 0 and up to pi, got {swing!r}{conversion}"
            )
        fields["upper"] = swing
    for key in ("damping", "friction", "stiffness", "effort", "velocity"):
        if arguments.get(key) is not None:
            fields[key] = validate.number(arguments[key], f"{context}: {key}")
    if arguments.get("opens") is not None:
        fields["intent"] = S.Intent(opens=direction(arguments["opens"], f"{context}: opens"))
    leader = arguments.get("mimic")
    if leader is not None:
        if arguments.get("after") is not None:
            raise ValueError(f"{context}: after= belongs to {leader.name!r}, which it follows")
        numbers = {
            key: validate.number(arguments[key], f"{context}: {key}")
            for key in ("multiplier", "offset")
        }
        fields["mimic"] = S.Mimic(joint=leader.name, **numbers)
    return fields
