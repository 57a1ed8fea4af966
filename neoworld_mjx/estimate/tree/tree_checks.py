"""Checks of a parse that need no model: agreement with the photo, hierarchy, and sizes.

`SceneTree` itself validates names, parents and the absence of cycles. Each issue states the
measured value, the threshold, and a hint for the correction.

Of two thresholds, an issue beyond `..._WARNING` is a warning, and an issue beyond `..._ERROR` is an
error.
"""

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Literal

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict

from ...measure.boxes import (
    footprint,
    intersection_2d,
    intersection_3d,
    iou_2d,
    polygon_area,
    polygon_intersection,
    support_footprint,
    upright,
)
from ...spec import SceneTree, TreeNode
from .categories import size_range
from .fit_problem import nearest_boxes, outline_data
from .projection import expected_box, outline_of
from .sides import EDGE, hidden_sides

AGREEMENT_WARNING, AGREEMENT_ERROR = 0.6, 0.35
"""Minimum agreement of the projected 3D box with the 2D box, see `agreement`."""
INSIDE_WARNING, INSIDE_ERROR = 0.6, 0.25
"""Minimum fraction of a child's footprint that is within its parent's footprint."""
GAP_WARNING, GAP_ERROR = 0.15, 1.0
"""Maximum gap under an object, relative to its height."""
MIN_GAP_M = 0.01
"""Smallest gap that is reported [m]."""
SIZE_ERROR = 2.0
"""Factor by which the longest edge of an object must be outside its category's range to be an
error."""
OVERLAP_WARNING = 0.4
"""Maximum fraction of the smaller of two boxes that is within the larger box, if neither object
supports the other."""
IOU_3D_WARNING = 0.6
"""Maximum intersection over union of two boxes if the larger object may not fill its box. For
example, the arm of a lamp may be over a cup, or a trunk may be under a table."""
DUPLICATE_IOU_WARNING = 0.85
"""Maximum intersection over union of the 2D boxes of two objects with the same label."""

_ENVIRONMENT = ("floor", "wall", "counter", "countertop", "ground", "ceiling", "worktop")


class SceneIssue(BaseModel):
    """An issue of a parse."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    severity: Literal["error", "warning"]
    node: str
    code: str
    value: float
    """Measured fraction or ratio; a length in meters if the code ends in _m."""
    threshold: float
    hint: str

    def phrase(self) -> str:
        """Return the issue as one line; rounded numbers make it equal on all machines."""
        return f"{self.node}: {self.hint} [{self.code} {self.value:.2g}, bound {self.threshold:g}]"


def check_tree(tree: SceneTree) -> tuple[SceneIssue, ...]:
    """Check a parse; return errors, then warnings, each in the order of the nodes."""
    issues = [*check_objects(tree), *_pairs(tree)]
    return tuple(sorted(issues, key=lambda issue: issue.severity != "error"))


def check_objects(tree: SceneTree) -> Iterator[SceneIssue]:
    """Check every node and its support; `check_tree` also checks pairs of objects."""
    for node in tree.nodes:
        yield from _projection(tree, node)
        yield from _size(node)
        yield from _flags(tree, node)
        if node.parent is not None:
            yield from _support(node, tree.node(node.parent))


def check_score(tree: SceneTree, issues: Sequence[SceneIssue]) -> float:
    """Return the score of a parse in [0, 1]: the mean of agreement and freedom from issues.

    The freedom of a node from issues is 0 if the node has an error. Otherwise, it is 1, reduced by
    1/3 for each warning. A camera with issues counts as another node.
    """
    objects = [node for node in tree.nodes if not node.environment] or list(tree.nodes)
    mean_agreement = float(np.mean([agreement(tree, node) for node in objects]))
    penalties = {node.name: 0.0 for node in tree.nodes}
    for issue in issues:
        cost = 1.0 if issue.severity == "error" else 1 / 3
        penalties[issue.node] = penalties.get(issue.node, 0.0) + cost
    clean = 1.0 - sum(min(value, 1.0) for value in penalties.values()) / len(penalties)
    return (mean_agreement + clean) / 2


def nearest_outline(tree: SceneTree, node: TreeNode) -> Float[np.ndarray, "4"] | None:
    """Return the box of a node's projected outline that is nearest to its 2D box [px].

    Returns:
        The box (x0, y0, x1, y1), see `nearest_boxes`; None if the node is outside the picture.
    """
    if expected_box(tree.camera, node) is None:
        return None
    data = outline_data(tree, [node])
    return nearest_boxes(data, data.initial_unknowns())[0]


def agreement(tree: SceneTree, node: TreeNode) -> float:
    """Return the agreement of a node's outline in its 3D box with its 2D box, in [0, 1].

    It is the intersection over union of the 2D box and `nearest_outline`: hidden sides of a 2D box
    may lie anywhere within the projection, and those of an object of unknown shape anywhere between
    its smallest and its largest outline.
    """
    nearest = nearest_outline(tree, node)
    if nearest is None or nearest[0] >= nearest[2] or nearest[1] >= nearest[3]:
        return 0.0
    return iou_2d(nearest, node.box2d)


def _projection(tree: SceneTree, node: TreeNode) -> Iterator[SceneIssue]:
    if node.environment:
        if expected_box(tree.camera, node) is None:
            hint = "its 3D box lies outside the picture"
            yield _issue(node, "out_of_view", 0.0, 0.0, hint, is_error=True)
        return
    value = agreement(tree, node)
    if value < AGREEMENT_WARNING and not _within_reading_error(tree, node):
        hint = f"the projection of its 3D box does not match its 2D box{_mismatch(tree, node)}"
        is_error = value < AGREEMENT_ERROR
        yield _issue(node, "projection", value, AGREEMENT_WARNING, hint, is_error=is_error)


def _within_reading_error(tree: SceneTree, node: TreeNode) -> bool:
    """Return True if every visible side is within the reading error of the projected box."""
    nearest = nearest_outline(tree, node)
    if nearest is None:
        return False
    return bool(np.all(np.abs(nearest - np.array(node.box2d.as_tuple())) <= _edge(tree)))


def _mismatch(tree: SceneTree, node: TreeNode) -> str:
    """Describe the difference between the projected box and the 2D box."""
    expected = nearest_outline(tree, node)
    if expected is None:
        return ": it lies outside the picture"
    visible = np.array(node.box2d.as_tuple())
    sides = visible[2:] - visible[:2]
    shift = ((expected[:2] + expected[2:]) - (visible[:2] + visible[2:])) / 2 / sides
    ratio = (expected[2:] - expected[:2]) / sides
    phrases = []
    for value, (negative, positive) in zip(shift, (("left", "right"), ("up", "down")), strict=True):
        if abs(value) > 0.15:
            phrases.append(f"too far {positive if value > 0 else negative}")
    for value, extent in zip(ratio, ("wide", "high"), strict=True):
        if not 0.8 < value < 1.25:
            phrases.append(f"{value:.1f} times as {extent}")
    return ": it is " + ", ".join(phrases) if phrases else ""


def _size(node: TreeNode) -> Iterator[SceneIssue]:
    bounds, longest = size_range(node.label), max(node.box3d.size)
    if bounds is None:
        return
    low, high = bounds
    excess, bound, adjective = (longest / high, high, "large")
    if longest <= high:
        excess, bound, adjective = low / longest, low, "small"
    if excess > 1:
        hint = f"its longest edge, {longest:.2g} m, is {adjective} for a {node.label}"
        yield _issue(node, "size_m", longest, bound, hint, is_error=excess > SIZE_ERROR)


def _flags(tree: SceneTree, node: TreeNode) -> Iterator[SceneIssue]:
    if node.environment and node.articulation and not node.furniture:
        hint = (
            "it is marked as environment but has moving parts, so it should be an object, or "
            "furniture if nothing of it but these parts moves"
        )
        yield _issue(node, "environment", float(len(node.articulation)), 0.0, hint)
    if not node.environment and node.label.lower().split(" ")[-1] in _ENVIRONMENT:
        hint = f"a {node.label} should be marked as environment"
        yield _issue(node, "environment", 0.0, 1.0, hint)
    for name in node.occluded_by:
        occluder = np.array(tree.node(name).box2d.as_tuple())
        if intersection_2d(occluder + _edge(tree) * np.array([-1, -1, 1, 1]), node.box2d) == 0:
            hint = f"{name} cannot hide it: their boxes do not overlap"
            yield _issue(node, "occluded_by", 0.0, 0.0, hint)
    unmarked = node.model_copy(update={"occluded": False})
    if node.occluded and not node.occluded_by and not hidden_sides(tree, unmarked).any():
        hint = "it is marked as hidden; name the objects that hide it"
        yield _issue(node, "occluded_by", 0.0, 1.0, hint)


def _support(node: TreeNode, parent: TreeNode) -> Iterator[SceneIssue]:
    child, below = upright(node), upright(parent)
    if node.relation == "attached":
        size = tuple(edge + 0.04 for edge in child.size)
        x, y, z = child.position
        enlarged = child.model_copy(update={"size": size, "position": (x, y, z - 0.02)})
        if intersection_3d(enlarged, below) == 0:
            hint = f"it is attached to {parent.name} but does not reach it"
            yield _issue(node, "attached", 0.0, 0.0, hint, is_error=True)
        return
    feet = footprint(child)
    inside = polygon_intersection(support_footprint(parent), feet) / polygon_area(feet)
    if inside < INSIDE_WARNING:
        # An object that does not fill its box may stand on a small foot.
        is_error = inside < (0.01 if _fills_box_loosely(node) else INSIDE_ERROR)
        hint = f"only {inside:.0%} of its footprint lies in that of its support {parent.name}"
        yield _issue(node, "footprint", inside, INSIDE_WARNING, hint, is_error=is_error)
    bottom, floor = child.position[2], below.position[2]
    top = floor + below.size[2]
    bound = max(MIN_GAP_M, GAP_WARNING * min(child.size[2], 1.0))
    # An object may rest in a hollow below its support's top, but a slab supports only at its top.
    slab = parent.slab and parent.box3d.size[2] < 0.2 * min(parent.box3d.size[:2])
    gap, problem = 0.0, ""
    if bottom > top + bound and not (node.environment and node.slab):
        gap, problem = bottom - top, f"it floats above {parent.name}"
    elif bottom < floor - bound:
        gap, problem = floor - bottom, f"it extends below {parent.name}"
    elif slab and node.relation == "on" and bottom < top - bound:
        gap, problem = top - bottom, f"it is sunk into {parent.name}"
    if problem:
        is_error = gap > max(GAP_ERROR * child.size[2], 2 * bound)
        yield _issue(node, "gap_m", gap, bound, f"{problem} by {gap:.2g} m", is_error=is_error)


def _pairs(tree: SceneTree) -> Iterator[SceneIssue]:
    objects = [node for node in tree.nodes if not node.environment]
    supports = {node.name: _supports(tree, node) for node in objects}
    for first, second in itertools.combinations(objects, 2):
        same_2d = iou_2d(first.box2d, second.box2d)
        if first.label == second.label and same_2d > DUPLICATE_IOU_WARNING:
            hint = f"it has the box and label of {first.name}: is it listed twice?"
            yield _issue(second, "twice", same_2d, DUPLICATE_IOU_WARNING, hint)
        if first.name in supports[second.name] or second.name in supports[first.name]:
            continue
        a, b = upright(first), upright(second)
        (smaller, _), (larger, outer) = sorted(
            ((math.prod(box.size), node) for box, node in ((a, first), (b, second))),
            key=lambda pair: pair[0],
        )
        shared = intersection_3d(a, b)
        overlap, iou = shared / smaller, shared / (smaller + larger - shared)
        if overlap > OVERLAP_WARNING and (iou > IOU_3D_WARNING or not _fills_box_loosely(outer)):
            hint = (
                f"its 3D box and that of {first.name} occupy the same space: move one, or let "
                "one support the other"
            )
            yield _issue(second, "overlap", overlap, OVERLAP_WARNING, hint)


def _fills_box_loosely(node: TreeNode) -> bool:
    """Return True if objects of a node's category may leave much of their boxes empty."""
    return outline_of(node) in ("loose", "spoon")


def _supports(tree: SceneTree, node: TreeNode) -> set[str]:
    """Return the names of the object's parent and of all further ancestors."""
    names: set[str] = set()
    while node.parent is not None:
        names.add(node.parent)
        node = tree.node(node.parent)
    return names


def _edge(tree: SceneTree) -> float:
    """Return the reading error of a side of a 2D box [px]."""
    return EDGE * max(tree.camera.width, tree.camera.height_px)


def _issue(
    node: TreeNode, code: str, value: float, threshold: float, hint: str, *, is_error: bool = False
) -> SceneIssue:
    return SceneIssue(
        severity="error" if is_error else "warning",
        node=node.name,
        code=code,
        value=value,
        threshold=threshold,
        hint=hint,
    )
