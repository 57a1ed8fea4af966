"""Edits of a finished run by an agent.

An edit writes the files that a person would edit: the layout patch, or an object's program.
"""

import json
import math
from pathlib import Path
from typing import Any, Literal

from ..compose.layout_patch import ObjectPlacement, read_layout_patch, write_layout_patch
from ..config import Config
from ..errors import SpecError, choices
from ..io.files import write_inside
from ..program.building import build
from ..spec import SceneSpec, joint_keys, support_frame, world_poses
from ..spec.pose import conjugate, pose, rotate, yaw_of

FARTHEST_M = 100.0
"""Maximum shift of an object by an edit, along each axis [m]."""
LIMITED = ("revolute", "prismatic")
Changed = Literal["compose", "verify"]


def apply_edit(
    out: Path,
    scene: SceneSpec,
    name: str,
    move: tuple[float, float],
    turn_deg: float,
    joints: dict[str, float],
    program: str | None,
    config: Config,
) -> tuple[str, Changed] | None:
    """Write an edit of an object into a run folder; see `AgentTools.edit`.

    Returns:
        The edit in words, and the step from which the run repeats; None if nothing changes.

    Raises:
        SpecError: a number is out of range, or the program does not build.
    """
    placement = placement_of(scene, name, move, turn_deg, joints)
    if placement is None and program is None:
        return None
    if program is not None:
        built = build(program, config.program)
        if not built.ok:
            raise SpecError("; ".join(signal.phrase() for signal in built.signals))
        write_inside(out, f"objects/{name}/program.py", program)
    step: Changed = "compose" if program is None else "verify"
    parts = ["moved"] * any(move) + ["turned"] * bool(turn_deg) + ["joints set"] * bool(joints)
    edit = f"{name}: {', '.join(parts + ['another program'] * (program is not None))}"
    if placement is not None:
        write_layout_patch(out, read_layout_patch(out).merged(name, placement))
    return edit, step


def pose_in_words(scene: SceneSpec, name: str) -> str:
    """Return the pose of an object in the world, and its joints."""
    item, placed = scene.object(name), world_poses(scene)[name]
    at = " ".join(f"{value:.4f}" for value in placed.pos.tolist())
    turn = f"yaw_deg {math.degrees(yaw_of(placed.quat)):.2f}"
    return f"{name} on {item.parent}: at {at}, {turn}, joints {json.dumps(item.joint_state)}"


def fall_of_agreement(earlier: dict[str, Any], later: dict[str, Any], name: str) -> str:
    """Return the box IoU of an object before and after an edit; empty if it does not fall."""
    before, after = (
        metrics.get("box_iou", {}).get("objects", {}).get(name, {}).get("refined")
        for metrics in (earlier, later)
    )
    if before is None or after is None or round(after, 2) >= round(before, 2):
        return ""
    return f"{before:.2f} -> {after:.2f}"


def placement_of(
    scene: SceneSpec,
    name: str,
    move: tuple[float, float],
    turn_deg: float,
    joints: dict[str, float],
) -> ObjectPlacement | None:
    """Return an edit of an object in its parent's frame; None if nothing changes."""
    item, change = scene.object(name), dict[str, Any]()
    if max(map(abs, move)) > FARTHEST_M:
        raise SpecError(f"move: got {list(move)}, valid is up to {FARTHEST_M:g} m")
    if any(move):
        frame = pose()
        if item.parent is not None:
            parent_pose = world_poses(scene)[item.parent]
            frame = support_frame(scene.object(item.parent), parent_pose, item.parent_link)
        x, y, _ = rotate(conjugate(frame.quat), [*move, 0.0]).tolist()
        change["xy"] = (item.xy[0] + x, item.xy[1] + y)
    if turn_deg:
        change["yaw"] = item.yaw + math.radians(turn_deg)
    known = [key for joint in item.spec.joints for key in joint_keys(joint)]
    ranges = {joint.name: joint for joint in item.spec.joints if joint.type in LIMITED}
    for joint, value in joints.items():
        if joint not in known:
            raise SpecError(f"joints: {choices(joint, known)}")
        if joint in ranges and not ranges[joint].lower <= value <= ranges[joint].upper:
            valid = f"{ranges[joint].lower:g} to {ranges[joint].upper:g}"
            raise SpecError(f"joints: {joint}: got {value:g}, valid is {valid}")
        change.setdefault("joint_state", {})[joint] = value
    return ObjectPlacement(**change) if change else None
