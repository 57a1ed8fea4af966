"""Checks of a parse that need no model: agreement with the photo, hierarchy, and sizes.

`SceneTree` itself validates names, parents and the absence of cycles. Each issue states the
measured value, the threshold, and a hint for the correction. A model estimates distances less
accurately than pixels and sizes, and Step 4 corrects them. Therefore a projection or a footprint is
no issue if it is none at the place within `REACH` at which the outline agrees best with the 2D box,
and a gap is none if a move within `REACH` closes it.

Of two thresholds, an issue beyond `..._WARNING` is a warning, and an issue beyond `..._ERROR` is an
error.
"""

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict

from ..measure.boxes import (
    footprint,
    intersection_2d,
    intersection_3d,
    iou_2d,
    polygon_intersection,
    support_footprint,
    upright,
)
from ..spec import SceneTree, TreeNode
from ..spec.triangles import polygon_area
from .categories import size_range
from .outlines import EDGE, expected_box, hidden_sides, nearest_outline, outline_of

REACH = 0.1
"""Largest distance by which checks move an object along or across the view, relative to its
distance from the camera."""
ROUNDS = 3
"""Number of corrections of a place in the picture."""
AGREEMENT_WARNING, AGREEMENT_ERROR = 0.6, 0.35
"""Minimum agreement of the projected 3D box with the 2D box, see `best_agreement`."""
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
    issues: list[SceneIssue] = []
    for node in tree.nodes:
        issues += [*_projection(tree, node), *_size(node), *_flags(tree, node)]
        if node.parent is not None:
            issues += _support(tree, node, tree.node(node.parent))
    issues += _pairs(tree)
    return tuple(sorted(issues, key=lambda issue: issue.severity != "error"))


def check_score(tree: SceneTree, issues: Sequence[SceneIssue]) -> float:
    """Return the score of a parse in [0, 1]: the mean of agreement and freedom from issues.

    The freedom of a node from issues is 0 if the node has an error. Otherwise, it is 1, reduced by
    1/3 for each warning. A camera with issues counts as another node.
    """
    objects = [node for node in tree.nodes if not node.environment] or list(tree.nodes)
    mean_agreement = float(np.mean([best_agreement(tree, node) for node in objects]))
    penalties = {node.name: 0.0 for node in tree.nodes}
    for issue in issues:
        cost = 1.0 if issue.severity == "error" else 1 / 3
        penalties[issue.node] = penalties.get(issue.node, 0.0) + cost
    clean = 1.0 - sum(min(value, 1.0) for value in penalties.values()) / len(penalties)
    return (mean_agreement + clean) / 2


def agreement(tree: SceneTree, node: TreeNode) -> float:
    """Return the agreement of a node's outline in its 3D box with its 2D box, in [0, 1].

    It is the intersection over union of the 2D box and `nearest_outline`: hidden sides of a 2D box
    may lie anywhere within the projection, and those of an object of unknown shape anywhere between
    its smallest and its largest outline.
    """
    return _overlap(nearest_outline(tree, node), node)


def best_agreement(tree: SceneTree, node: TreeNode) -> float:
    """Return the largest agreement of a node at places within `REACH`; see `agreement`."""
    return _overlap(_best_place(tree, node).outline, node)


def _overlap(outline: Float[np.ndarray, "4"] | None, node: TreeNode) -> float:
    if outline is None or outline[0] >= outline[2] or outline[1] >= outline[3]:
        return 0.0
    return iou_2d(outline, node.box2d)


class _Place(NamedTuple):
    """A place of a node, and the box of its outline there [px]; None outside the picture."""

    node: TreeNode
    outline: Float[np.ndarray, "4"] | None


def _best_place(tree: SceneTree, node: TreeNode) -> _Place:
    """Return a node at the place within `REACH` at which its outline agrees best with its 2D box.

    The node moves across the view to where visible sides agree, and along the view to where the
    distances between two visible sides do. Its size and heading, which may be wrong, do not change.
    """
    camera, box = tree.camera, node.box3d
    eye, axes = camera.position(), camera.axes()
    center = box.corners(node.base_tilt).mean(axis=0)
    offset, depth = center - eye, float((center - eye) @ axes[:, 2])
    hidden = hidden_sides(tree, node)
    visible = ~hidden.reshape(2, 2).T  # Rows: horizontal and vertical. Columns: the two sides.
    seen = np.reshape(node.box2d.as_tuple(), (2, 2)).T
    outline = nearest_outline(tree, node, hidden)
    best = _Place(node, outline)
    log_distance, shift = 0.0, np.zeros(2)
    for _ in range(ROUNDS):
        if outline is None:
            break
        drawn = outline.reshape(2, 2).T
        weights = np.where(visible.any(axis=1, keepdims=True), visible, True)
        shift += np.average(seen - drawn, axis=1, weights=weights) / camera.focal
        shift *= min(1.0, REACH / max(float(np.linalg.norm(shift)), 1e-9))
        if (whole := visible.all(axis=1)).any():
            ratios = np.ptp(drawn, axis=1)[whole] / np.ptp(seen, axis=1)[whole]
            log_distance += float(np.log(np.maximum(ratios, 1e-3)).mean())
            log_distance = float(np.clip(log_distance, -REACH, REACH))
        place = eye + math.exp(log_distance) * (offset + depth * axes[:, :2] @ shift)
        position = tuple((np.array(box.position) + place - center).tolist())
        moved = node.model_copy(update={"box3d": box.model_copy(update={"position": position})})
        outline = nearest_outline(tree, moved, hidden)
        if _overlap(outline, node) > _overlap(best.outline, node):
            best = _Place(moved, outline)
    return best


def _projection(tree: SceneTree, node: TreeNode) -> Iterator[SceneIssue]:
    if node.environment:
        if expected_box(tree.camera, node) is None:
            hint = "its 3D box lies outside the picture"
            yield _issue(node, "out_of_view", 0.0, 0.0, hint, is_error=True)
        return
    outline = _best_place(tree, node).outline
    value, sides = _overlap(outline, node), np.array(node.box2d.as_tuple())
    if outline is not None and np.all(np.abs(outline - sides) <= _edge(tree)):
        return
    if value < AGREEMENT_WARNING:
        hint = f"the projection of its 3D box does not match its 2D box{_mismatch(tree, node)}"
        is_error = value < AGREEMENT_ERROR
        yield _issue(node, "projection", value, AGREEMENT_WARNING, hint, is_error=is_error)


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


def _share_inside(node: TreeNode, parent: TreeNode) -> float:
    """Return the share of an object's footprint that is within that of its support."""
    feet = footprint(upright(node))
    return polygon_intersection(support_footprint(parent), feet) / polygon_area(feet)


def _support(tree: SceneTree, node: TreeNode, parent: TreeNode) -> Iterator[SceneIssue]:
    child, below = upright(node), upright(parent)
    if node.relation == "attached":
        size = tuple(edge + 0.04 for edge in child.size)
        x, y, z = child.position
        enlarged = child.model_copy(update={"size": size, "position": (x, y, z - 0.02)})
        if intersection_3d(enlarged, below) == 0:
            hint = f"it is attached to {parent.name} but does not reach it"
            yield _issue(node, "attached", 0.0, 0.0, hint, is_error=True)
        return
    inside = _share_inside(node, parent)
    if inside < INSIDE_WARNING and not node.environment:
        seen = parent if parent.environment else _best_place(tree, parent).node
        inside = max(inside, _share_inside(_best_place(tree, node).node, seen))
    if inside < INSIDE_WARNING:
        # An object that does not fill its box may stand on a small foot.
        is_error = inside < (0.01 if _fills_box_loosely(node) else INSIDE_ERROR)
        hint = f"only {inside:.0%} of its footprint lies in that of its support {parent.name}"
        yield _issue(node, "footprint", inside, INSIDE_WARNING, hint, is_error=is_error)
    bottom, floor = child.position[2], below.position[2]
    top = floor + below.size[2]
    reach = 0.0 if node.environment else REACH * abs(tree.camera.height - bottom)
    bound = max(MIN_GAP_M, GAP_WARNING * min(child.size[2], 1.0), reach)
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
