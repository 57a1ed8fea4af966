"""Checks of a parse without a model: geometry against the photo, the hierarchy, plausible sizes.

`SceneTree` itself validates names, parents and the absence of cycles. Each issue states its
measured value, the threshold, and a hint for the correction.
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
    support_footprint,
    upright,
)
from ..spec import Box3D, SceneTree, TreeNode
from .categories import size_range
from .projection import expected_box, outline_of
from .visible_sides import EDGE, hidden_sides

AGREEMENT_WARNS, AGREEMENT_FAILS = 0.6, 0.35
"""Agreement of the projected 3D box with the 2D box, see `agreement`."""
INSIDE_WARNS, INSIDE_FAILS = 0.6, 0.25
"""Share of a child's footprint that lies in its parent's."""
GAP_WARNS, GAP_FAILS = 0.15, 1.0
"""Gap under an object, over its height."""
GAP_LEAST_M = 0.01
"""Smaller gaps are not reported."""
SIZE_FAILS = 2.0
"""A longest edge so many times out of its category's range is an error, less is a warning."""
OVERLAP_WARNS = 0.4
"""Share of the smaller of two boxes inside the other, where neither object carries the other."""
SAME_WARNS = 0.6
"""Intersection over union of two boxes, where the larger object may leave room in its own: a lamp's
arm reaches over a cup, a trunk stands under a table."""
TWICE_WARNS = 0.85
"""Intersection over union of the 2D boxes of two objects with the same label."""

_SUPPORTS = ("table", "floor", "wall", "counter", "countertop", "ground", "ceiling", "worktop")


class SceneIssue(BaseModel):
    """One fault of a parse."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    severity: Literal["error", "warning"]
    node: str
    code: str
    value: float
    """Measured share or ratio, or metres where the code ends in _m."""
    threshold: float
    hint: str

    def phrase(self) -> str:
        """Return one line, with numbers rounded so that they are the same on every machine."""
        return f"{self.node}: {self.hint} [{self.code} {self.value:.2g}, bound {self.threshold:g}]"


def check_tree(tree: SceneTree) -> tuple[SceneIssue, ...]:
    """Check a parse; return errors first, else in the order of the nodes."""
    issues: list[SceneIssue] = []
    for node in tree.nodes:
        issues += _projection(tree, node)
        issues += _size(node)
        issues += _flags(tree, node)
        if node.parent is not None:
            issues += _on_carrier(node, tree.node(node.parent))
    issues += _pairs(tree)
    return tuple(sorted(issues, key=lambda issue: issue.severity != "error"))


def check_score(tree: SceneTree, issues: Sequence[SceneIssue]) -> float:
    """Return a score of a parse in [0, 1]: the mean of its agreement and of its lack of issues.

    An object with an error counts 0, one with warnings alone loses a third for each.
    """
    objects = [node for node in tree.nodes if not node.environment] or list(tree.nodes)
    mean_agreement = float(np.mean([agreement(tree, node) for node in objects]))
    lost = {node.name: 0.0 for node in tree.nodes}
    for issue in issues:
        lost[issue.node] += 1.0 if issue.severity == "error" else 1 / 3
    clean = 1.0 - sum(min(value, 1.0) for value in lost.values()) / len(lost)
    return (mean_agreement + clean) / 2


def agreement(tree: SceneTree, node: TreeNode) -> float:
    """Return how well a node's 3D box, projected by the camera, agrees with its 2D box, in [0, 1].

    For a fully visible object it is their intersection over union. The 2D box of a partly hidden
    one is smaller than the projection, so hidden sides may lie anywhere inside the projection.
    """
    expected = expected_box(tree.camera, node)
    if expected is None:
        return 0.0
    visible = np.array(node.box2d.as_tuple())
    hidden = hidden_sides(tree, node)
    outer = np.array([-1, -1, 1, 1]) * (expected - visible) > 0
    cut = np.where(hidden & outer, visible, expected)
    if cut[0] >= cut[2] or cut[1] >= cut[3]:
        return 0.0
    return iou_2d(cut, visible)


def _projection(tree: SceneTree, node: TreeNode) -> Iterator[SceneIssue]:
    if node.environment:
        if expected_box(tree.camera, node) is None:
            yield _issue(
                "error", node, "out_of_view", 0.0, 0.0, "its 3D box lies outside the picture"
            )
        return
    value = agreement(tree, node)
    if value < AGREEMENT_WARNS and not _near(tree, node):
        yield _issue(
            "error" if value < AGREEMENT_FAILS else "warning",
            node,
            "projection",
            value,
            AGREEMENT_WARNS,
            f"the projection of its 3D box does not match its 2D box{_off(tree, node)}",
        )


def _near(tree: SceneTree, node: TreeNode) -> bool:
    """Tell whether every visible side of a projected box is as near as a box can be read."""
    expected = expected_box(tree.camera, node)
    if expected is None:
        return False
    miss = np.abs(expected - np.array(node.box2d.as_tuple()))[~hidden_sides(tree, node)]
    return bool(np.all(miss <= EDGE * max(tree.camera.width, tree.camera.height_px)))


def _off(tree: SceneTree, node: TreeNode) -> str:
    """Describe how a projected box misses the 2D box."""
    expected = expected_box(tree.camera, node)
    if expected is None:
        return ": it lies outside the picture"
    visible = np.array(node.box2d.as_tuple())
    sides = visible[2:] - visible[:2]
    shift = ((expected[:2] + expected[2:]) - (visible[:2] + visible[2:])) / 2 / sides
    ratio = (expected[2:] - expected[:2]) / sides
    phrases = []
    if abs(shift[0]) > 0.15:
        phrases.append(f"too far {'right' if shift[0] > 0 else 'left'}")
    if abs(shift[1]) > 0.15:
        phrases.append(f"too far {'down' if shift[1] > 0 else 'up'}")
    for value, extent in zip(ratio, ("wide", "high"), strict=True):
        if not 0.8 < value < 1.25:
            phrases.append(f"{value:.1f} times as {extent}")
    return ": it is " + ", ".join(phrases) if phrases else ""


def _size(node: TreeNode) -> Iterator[SceneIssue]:
    bounds, longest = size_range(node.label), max(node.box3d.size)
    if bounds is None:
        return
    low, high = bounds
    if longest > high:
        over, bound, word = longest / high, high, "large"
    else:
        over, bound, word = low / longest, low, "small"
    if over > 1:
        yield _issue(
            "error" if over > SIZE_FAILS else "warning",
            node,
            "size_m",
            longest,
            bound,
            f"its longest edge, {longest:.2g} m, is {word} for a {node.label}",
        )


def _flags(tree: SceneTree, node: TreeNode) -> Iterator[SceneIssue]:
    if node.environment and node.articulation:
        yield _issue(
            "warning",
            node,
            "environment",
            float(len(node.articulation)),
            0.0,
            "it is marked as environment but has moving parts, so it should be an object",
        )
    if not node.environment and node.label.lower().split(" ")[-1] in _SUPPORTS[1:]:
        yield _issue(
            "warning",
            node,
            "environment",
            0.0,
            1.0,
            f"a {node.label} should be marked as environment",
        )
    for name in node.occluded_by:
        other = tree.node(name)
        edge = EDGE * max(tree.camera.width, tree.camera.height_px)
        grown = np.array(other.box2d.as_tuple()) + edge * np.array([-1, -1, 1, 1])
        if shared_2d(grown, node.box2d) == 0:
            yield _issue(
                "warning",
                node,
                "occluded_by",
                0.0,
                0.0,
                f"{name} cannot hide it: their boxes do not overlap",
            )
    if node.occluded and not node.occluded_by and not hidden_sides(tree, _unhidden(node)).any():
        yield _issue(
            "warning",
            node,
            "occluded_by",
            0.0,
            1.0,
            "it is marked as hidden; name the objects that hide it",
        )


def _unhidden(node: TreeNode) -> TreeNode:
    return node.model_copy(update={"occluded": False})


def _on_carrier(node: TreeNode, parent: TreeNode) -> Iterator[SceneIssue]:
    child, below = upright(node), upright(parent)
    if node.relation == "attached":
        yield from _attached(node, parent, child, below)
        return
    feet = footprint(child)
    inside = shared_footprint(support_footprint(parent), feet) / polygon_area(feet)
    if inside < INSIDE_WARNS:
        # What does not fill its box may stand on a small foot and reach far beyond it.
        fails = inside < (0.01 if _roomy(node) else INSIDE_FAILS)
        yield _issue(
            "error" if fails else "warning",
            node,
            "footprint",
            inside,
            INSIDE_WARNS,
            f"only {inside:.0%} of its footprint lies in that of its support {parent.name}",
        )
    bottom, top, floor = child.position[2], _top(below), below.position[2]
    bound = max(GAP_LEAST_M, GAP_WARNS * min(child.size[2], 1.0))
    # An object in a hollow rests below its support's top, so only slabs carry at their top alone.
    if bottom > top + bound:
        yield _gap(node, bottom - top, bound, child, f"it floats above {parent.name}")
    elif bottom < floor - bound:
        yield _gap(node, floor - bottom, bound, child, f"it extends below {parent.name}")
    elif _slab(parent) and node.relation == "on" and bottom < top - bound:
        yield _gap(node, top - bottom, bound, child, f"it is sunk into {parent.name}")


def _attached(node: TreeNode, parent: TreeNode, child: Box3D, below: Box3D) -> Iterator[SceneIssue]:
    grown = child.model_copy(
        update={
            "size": tuple(edge + 0.04 for edge in child.size),
            "position": (*child.position[:2], child.position[2] - 0.02),
        }
    )
    if shared_3d(grown, below) == 0:
        yield _issue(
            "error",
            node,
            "attached",
            0.0,
            0.0,
            f"it is attached to {parent.name} but does not reach it",
        )


def _gap(node: TreeNode, gap: float, bound: float, box: Box3D, words: str) -> SceneIssue:
    fails = gap > max(GAP_FAILS * box.size[2], 2 * bound)
    hint = f"{words} by {gap:.2g} m"
    return _issue("error" if fails else "warning", node, "gap_m", gap, bound, hint)


def _top(box: Box3D) -> float:
    return box.position[2] + box.size[2]


def _slab(node: TreeNode) -> bool:
    """Return whether objects can only rest on top of it: a flat part of the environment."""
    return node.slab and node.box3d.size[2] < 0.2 * min(node.box3d.size[:2])


def _pairs(tree: SceneTree) -> Iterator[SceneIssue]:
    objects = [node for node in tree.nodes if not node.environment]
    supports = {node.name: _carriers(tree, node) for node in objects}
    for i, first in enumerate(objects):
        for second in objects[i + 1 :]:
            if first.label == second.label and iou_2d(first.box2d, second.box2d) > TWICE_WARNS:
                yield _issue(
                    "warning",
                    second,
                    "twice",
                    iou_2d(first.box2d, second.box2d),
                    TWICE_WARNS,
                    f"it has the box and label of {first.name}: is it listed twice?",
                )
            if first.name in supports[second.name] or second.name in supports[first.name]:
                continue
            a, b = upright(first), upright(second)
            (smaller, _), (larger, outer) = sorted(
                ((math.prod(box.size), node) for box, node in ((a, first), (b, second))),
                key=lambda pair: pair[0],
            )
            shared = shared_3d(a, b)
            share, same = shared / smaller, shared / (smaller + larger - shared)
            if share > OVERLAP_WARNS and (same > SAME_WARNS or not _roomy(outer)):
                yield _issue(
                    "warning",
                    second,
                    "overlap",
                    share,
                    OVERLAP_WARNS,
                    f"its 3D box and that of {first.name} occupy the same space: move one, or let "
                    "one support the other",
                )


def _roomy(node: TreeNode) -> bool:
    """Tell whether an object may leave much of its box empty, as its category does not fill it."""
    return outline_of(node) in ("loose", "spoon")


def _carriers(tree: SceneTree, node: TreeNode) -> set[str]:
    names: set[str] = set()
    while node.parent is not None:
        names.add(node.parent)
        node = tree.node(node.parent)
    return names


def _issue(
    severity: Literal["error", "warning"],
    node: TreeNode,
    code: str,
    value: float,
    threshold: float,
    hint: str,
) -> SceneIssue:
    return SceneIssue(
        severity=severity,
        node=node.name,
        code=code,
        value=value,
        threshold=threshold,
        hint=hint,
    )
