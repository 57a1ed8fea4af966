"""Checks of a parse that need no model: geometry against the photo, the hierarchy, and common sense.

That names, parents and cycles are in order is not checked here, as no `SceneTree` exists without it.
Each finding carries its number and the bound it was held against, and a way out in words.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict

from ..measure.boxes import (
    footprint,
    iou_2d,
    polygon_area,
    shared_2d,
    shared_3d,
    shared_footprint,
    upright,
)
from ..spec import Box3D, SceneTree, TreeNode
from .kinds import kind_of
from .project import expected_box

SEEN_WARNS, SEEN_FAILS = 0.6, 0.35
"""Agreement of the projected 3D box with the 2D box, see `agreement`."""
INSIDE_WARNS, INSIDE_FAILS = 0.6, 0.25
"""Share of a child's footprint that lies in its parent's."""
GAP_WARNS, GAP_FAILS = 0.15, 1.0
"""Gap under an object, over its height."""
GAP_LEAST_M = 0.01
"""Gaps under this are never spoken of."""
SIZE_FAILS = 2.0
"""A longest edge so many times out of its label's range is an error, less a warning."""
OVERLAP_WARNS = 0.4
"""Share of the smaller of two boxes that lies in the other, where neither carries the other."""
TWICE_WARNS = 0.85
"""Overlap of the 2D boxes of two things with one label."""
EDGE = 0.01
"""Of the picture's longer side: boxes nearer to its edge may be cut off by it."""

_SUPPORTS = ("table", "floor", "wall", "counter", "countertop", "ground", "ceiling", "worktop")


class Finding(BaseModel):
    """One thing that is wrong with a parse."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    severity: Literal["error", "warning"]
    node: str
    code: str
    value: float
    """What was measured: shares and ratios, or metres where the code ends in _m."""
    threshold: float
    hint: str

    def phrase(self) -> str:
        """Say it in one line, with numbers rounded so that they hold on every machine."""
        return f"{self.node}: {self.hint} [{self.code} {self.value:.2g}, bound {self.threshold:g}]"


def check_tree(tree: SceneTree) -> tuple[Finding, ...]:
    """Check a parse; errors come first, else in the order of the nodes."""
    found: list[Finding] = []
    for node in tree.nodes:
        found += _projection(tree, node)
        found += _size(node)
        found += _flags(tree, node)
        if node.parent is not None:
            found += _carried(node, tree.node(node.parent))
    found += _pairs(tree)
    return tuple(sorted(found, key=lambda finding: finding.severity != "error"))


def check_score(tree: SceneTree, findings: Sequence[Finding]) -> float:
    """Score a parse in [0, 1] by itself: half agreement with the 2D boxes, half lack of findings.

    An object with an error counts as lost, one with warnings alone loses a third for each.
    """
    judged = [node for node in tree.nodes if not node.environment] or list(tree.nodes)
    seen = float(np.mean([agreement(tree, node) for node in judged]))
    lost = {node.name: 0.0 for node in tree.nodes}
    for finding in findings:
        lost[finding.node] += 1.0 if finding.severity == "error" else 1 / 3
    clean = 1.0 - sum(min(value, 1.0) for value in lost.values()) / len(lost)
    return (seen + clean) / 2


def agreement(tree: SceneTree, node: TreeNode) -> float:
    """Return how well a node's 3D box, seen by the camera, agrees with its 2D box, in [0, 1].

    For what is seen whole it is their intersection over union. Of what is partly hidden the 2D box is
    smaller than the projection, so sides that something hides may lie anywhere inside it.
    """
    expected = expected_box(tree.camera, node)
    if expected is None:
        return 0.0
    seen = np.array(node.box2d.as_tuple())
    hidden = hidden_sides(tree, node)
    outer = np.array([-1, -1, 1, 1]) * (expected - seen) > 0
    cut = np.where(hidden & outer, seen, expected)
    if cut[0] >= cut[2] or cut[1] >= cut[3]:
        return 0.0
    return iou_2d(cut, seen)


def hidden_sides(tree: SceneTree, node: TreeNode) -> np.ndarray:
    """Tell which sides of a 2D box (left, top, right, bottom) may not be the object's own, [4] bool.

    A side is not if it lies at the picture's edge, or if the box of an occluder covers a third or
    more of it; if what hides the object is not known, no side is sure.
    """
    camera = tree.camera
    edge = EDGE * max(camera.width, camera.height_px)
    box = np.array(node.box2d.as_tuple())
    at_edge = np.array(
        [
            box[0] <= edge,
            box[1] <= edge,
            box[2] >= camera.width - edge,
            box[3] >= camera.height_px - edge,
        ]
    )
    if not node.occluded:
        return at_edge
    covered = np.zeros(4, bool)
    for name in node.occluded_by:
        other = np.array(tree.node(name).box2d.as_tuple()) + edge * np.array([-1, -1, 1, 1])
        for side in range(4):
            axis, along = side % 2, 1 - side % 2
            shared = min(box[along + 2], other[along + 2]) - max(box[along], other[along])
            across = other[axis] <= box[side] <= other[axis + 2]
            covered[side] |= across and shared >= (box[along + 2] - box[along]) / 3
    if not node.occluded_by and not at_edge.any():
        return np.ones(4, bool)
    return at_edge | covered


def _projection(tree: SceneTree, node: TreeNode) -> Iterator[Finding]:
    if node.environment:
        if expected_box(tree.camera, node) is None:
            yield _finding(
                "error", node, "out_of_view", 0.0, 0.0, "its 3D box lies outside the picture"
            )
        return
    value = agreement(tree, node)
    if value < SEEN_WARNS:
        yield _finding(
            "error" if value < SEEN_FAILS else "warning",
            node,
            "projection",
            value,
            SEEN_WARNS,
            f"its 3D box, seen by the camera, does not cover its 2D box{_off(tree, node)}",
        )


def _off(tree: SceneTree, node: TreeNode) -> str:
    """Say in words how a projected box misses the 2D box."""
    expected = expected_box(tree.camera, node)
    if expected is None:
        return ": it lies outside the picture"
    seen = np.array(node.box2d.as_tuple())
    sides = seen[2:] - seen[:2]
    shift = ((expected[:2] + expected[2:]) - (seen[:2] + seen[2:])) / 2 / sides
    ratio = (expected[2:] - expected[:2]) / sides
    said = []
    if shift[0] and abs(shift[0]) > 0.15:
        said.append(f"too far {'right' if shift[0] > 0 else 'left'}")
    if abs(shift[1]) > 0.15:
        said.append(f"too far {'down' if shift[1] > 0 else 'up'}")
    for value, way in zip(ratio, ("wide", "high"), strict=True):
        if not 0.8 < value < 1.25:
            said.append(f"{value:.1f} times as {way}")
    return ": it is " + ", ".join(said) if said else ""


def _size(node: TreeNode) -> Iterator[Finding]:
    kind, longest = kind_of(node.label), max(node.box3d.size)
    if kind is None:
        return
    if longest > kind.high:
        over, bound, word = longest / kind.high, kind.high, "large"
    else:
        over, bound, word = kind.low / longest, kind.low, "small"
    if over > 1:
        yield _finding(
            "error" if over > SIZE_FAILS else "warning",
            node,
            "size_m",
            longest,
            bound,
            f"a longest edge of {longest:.2g} m is {word} for a {node.label}",
        )


def _flags(tree: SceneTree, node: TreeNode) -> Iterator[Finding]:
    if node.environment and node.articulation:
        yield _finding(
            "warning",
            node,
            "environment",
            len(node.articulation),
            0,
            "it is marked as environment but has movable parts, so it should be an object",
        )
    if not node.environment and node.label.lower().split(" ")[-1] in _SUPPORTS[1:]:
        yield _finding(
            "warning", node, "environment", 0, 1, f"a {node.label} should be marked environment"
        )
    for name in node.occluded_by:
        other = tree.node(name)
        edge = EDGE * max(tree.camera.width, tree.camera.height_px)
        grown = np.array(other.box2d.as_tuple()) + edge * np.array([-1, -1, 1, 1])
        if shared_2d(grown, node.box2d) == 0:
            yield _finding(
                "warning",
                node,
                "occluded_by",
                0,
                0,
                f"{name} cannot hide it: their boxes are apart",
            )
    if node.occluded and not node.occluded_by and not hidden_sides(tree, _unhidden(node)).any():
        yield _finding(
            "warning", node, "occluded_by", 0, 1, "it is marked hidden; say by which objects"
        )


def _unhidden(node: TreeNode) -> TreeNode:
    return node.model_copy(update={"occluded": False})


def _carried(node: TreeNode, parent: TreeNode) -> Iterator[Finding]:
    child, below = upright(node), upright(parent)
    if node.relation == "attached":
        yield from _attached(node, parent, child, below)
        return
    feet = footprint(child)
    inside = shared_footprint(feet, footprint(below)) / polygon_area(feet)
    if inside < INSIDE_WARNS:
        yield _finding(
            "error" if inside < INSIDE_FAILS else "warning",
            node,
            "footprint",
            inside,
            INSIDE_WARNS,
            f"only {inside:.0%} of its footprint lies in that of {parent.name}, which carries it",
        )
    bottom, top, floor = child.position[2], _top(below), below.position[2]
    bound = max(GAP_LEAST_M, GAP_WARNS * min(child.size[2], 1.0))
    # A thing in a hollow stands lower than its carrier's top, so only slabs bear at their top alone.
    if bottom > top + bound:
        yield _gap(node, bottom - top, bound, child, f"it floats above {parent.name}")
    elif bottom < floor - bound:
        yield _gap(node, floor - bottom, bound, child, f"it reaches below {parent.name}")
    elif _slab(parent) and node.relation == "on" and bottom < top - bound:
        yield _gap(node, top - bottom, bound, child, f"it is sunk into {parent.name}")


def _attached(node: TreeNode, parent: TreeNode, child: Box3D, below: Box3D) -> Iterator[Finding]:
    grown = child.model_copy(
        update={
            "size": tuple(edge + 0.04 for edge in child.size),
            "position": (*child.position[:2], child.position[2] - 0.02),
        }
    )
    if shared_3d(grown, below) == 0:
        yield _finding(
            "error",
            node,
            "attached",
            0,
            0,
            f"it is attached to {parent.name} but does not reach it",
        )


def _gap(node: TreeNode, gap: float, bound: float, box: Box3D, words: str) -> Finding:
    fails = gap > max(GAP_FAILS * box.size[2], 2 * bound)
    hint = f"{words} by {gap:.2g} m"
    return _finding("error" if fails else "warning", node, "gap_m", gap, bound, hint)


def _top(box: Box3D) -> float:
    return box.position[2] + box.size[2]


def _slab(node: TreeNode) -> bool:
    """Tell whether things can only stand on top of it: flat, and part of the room."""
    return node.environment and node.box3d.size[2] < 0.2 * min(node.box3d.size[:2])


def _pairs(tree: SceneTree) -> Iterator[Finding]:
    things = [node for node in tree.nodes if not node.environment]
    above = {node.name: _carriers(tree, node) for node in things}
    for i, first in enumerate(things):
        for second in things[i + 1 :]:
            if first.label == second.label and iou_2d(first.box2d, second.box2d) > TWICE_WARNS:
                yield _finding(
                    "warning",
                    second,
                    "twice",
                    iou_2d(first.box2d, second.box2d),
                    TWICE_WARNS,
                    f"it has the box and label of {first.name}: is it listed twice?",
                )
            if first.name in above[second.name] or second.name in above[first.name]:
                continue
            a, b = upright(first), upright(second)
            smaller = min(math.prod(a.size), math.prod(b.size))
            share = shared_3d(a, b) / smaller
            if share > OVERLAP_WARNS:
                yield _finding(
                    "warning",
                    second,
                    "overlap",
                    share,
                    OVERLAP_WARNS,
                    f"its 3D box and that of {first.name} take the same space: move one, or let one "
                    "carry the other",
                )


def _carriers(tree: SceneTree, node: TreeNode) -> set[str]:
    names: set[str] = set()
    while node.parent is not None:
        names.add(node.parent)
        node = tree.node(node.parent)
    return names


def _finding(
    severity: Literal["error", "warning"],
    node: TreeNode,
    code: str,
    value: float,
    threshold: float,
    hint: str,
) -> Finding:
    return Finding(
        severity=severity,
        node=node.name,
        code=code,
        value=float(value),
        threshold=float(threshold),
        hint=hint,
    )
