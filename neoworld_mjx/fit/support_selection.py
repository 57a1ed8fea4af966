"""Selection of another support for an object whose parsed support is infeasible.

A response may state that a sponge is on the table although its position is in a basket, where it
would penetrate the basket's floor. Either the position is wrong, and the sponge is next to the
basket, or the support is wrong. Both hypotheses are fitted to the 2D box with built shapes. One
hypothesis places the object on the parsed support, at the nearest position without overlap. The
other places it in or on the other object. The support changes only if the likelihood ratio exceeds
the prior odds of the parsed support.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..measure.boxes import (
    footprint,
    polygon_area,
    polygon_intersection,
    support_footprint,
    upright,
)
from ..spec import ObjectSpec, SceneTree, TreeNode
from ..spec.pose import from_yaw, matrix
from ..spec.tree import Relation
from .fit_report import MIN_GAIN, OtherSupport
from .solid_columns import SolidColumns
from .support_fit import SupportFit
from .tree_checks import INSIDE_WARNING
from .wireframe import Wireframe

MAX_OVERLAP_M = 0.002
"""Overlap of built shapes [m] above which an object cannot be at its parsed position."""
MIN_FOOTPRINT = 0.01
"""Fraction of an object's footprint over its support below which the object is not on the
support."""
LEVEL_M = 0.004
"""Height difference up to which surfaces count as one [m]."""
BELOW_RIM = 0.1
"""Depth below a support's top above which the relation is `in`, relative to the smaller of the two
objects' heights."""
POSITIONS = 9
"""Number of positions along each side of a square around an object's position."""
MAX_FITS = 3
"""Maximum number of positions or heights to fit; those with the lowest costs before the fit are
used."""
DIRECTIONS, STEPS = 16, 40
"""Number of directions in which an object is moved out of others, and of positions along each."""


class _Level(NamedTuple):
    """A surface in or on another object that may support an object."""

    support: TreeNode
    relation: Relation
    z: float
    xy: Float[np.ndarray, " 2"]


def other_supports(
    parsed: SceneTree,
    fitted: SceneTree,
    objects: Mapping[str, ObjectSpec],
    surfaces: Mapping[str, Wireframe],
) -> dict[str, OtherSupport]:
    """Return the new supports of the objects whose parsed support is less likely.

    Args:
        parsed: the scene tree before the fit.
        fitted: the scene tree fitted with built shapes.
        objects: the built objects by name, at any size.
        surfaces: visible surfaces of the objects, see `fit_problem`.
    """
    nodes = [node for node in fitted.nodes if not node.environment]
    solids = {node.name: SolidColumns(node, objects[node.name]) for node in nodes}
    supports = {}
    for node in nodes:
        if node.parent is None or node.relation not in ("on", "in"):
            continue
        candidates = _candidates(fitted, node, solids)
        if not candidates:
            continue
        fit = SupportFit(parsed, fitted, node, surfaces[node.name])
        position = np.array(node.box3d.position[:2])
        levels = [level for c in candidates for level in _levels(node, position, c, solids)]
        levels.sort(key=lambda level: fit.cost_unfitted(level.support.name, *level[1:]))
        costs = [(_cost_at(fit, level), level) for level in levels[:MAX_FITS]]
        cost, level = min(costs, key=lambda entry: entry[0], default=(np.inf, None))
        if level is None or cost == np.inf:
            continue
        gain = _cost_as_parsed(fit, solids, candidates) - cost
        if MIN_GAIN < gain < np.inf:
            supports[node.name] = OtherSupport(
                f"{node.relation} {node.parent}", level.support.name, level.relation, level.z, gain
            )
    return without_cycles(fitted, supports)


def without_cycles(
    tree: SceneTree, supports: Mapping[str, OtherSupport]
) -> dict[str, OtherSupport]:
    """Return the changes except those that close a cycle; larger gains take precedence."""
    parents = {node.name: node.parent for node in tree.nodes}
    accepted = {}
    for name, change in sorted(supports.items(), key=lambda entry: -entry[1].gain):
        below: str | None = change.parent
        while below not in (None, name):
            below = parents[below]
        if below is None:
            parents[name], accepted[name] = change.parent, change
    return accepted


def with_supports(tree: SceneTree, changes: Mapping[str, OtherSupport]) -> SceneTree:
    """Return a tree with new supports for some objects; children move with their parents."""
    lifts: dict[str, float] = {}
    nodes = {node.name: node for node in tree.nodes}
    for node in tree.top_down():
        change = changes.get(node.name)
        lift = lifts.get(node.parent or "", 0.0)
        update: dict[str, object] = {}
        if change is not None:
            lift = change.z - node.box3d.position[2]
            update = {"parent": change.parent, "parent_link": None, "relation": change.relation}
        lifts[node.name] = lift
        x, y, z = node.box3d.position
        update["box3d"] = node.box3d.model_copy(update={"position": (x, y, z + lift)})
        nodes[node.name] = node.model_copy(update=update)
    return SceneTree.model_validate({**dict(tree), "nodes": tuple(nodes.values())})


def _candidates(
    tree: SceneTree, node: TreeNode, solids: Mapping[str, SolidColumns]
) -> list[TreeNode]:
    """Return alternative supports of an object; an empty list if its parent is feasible."""
    excluded = {node.name, node.parent}
    for other in tree.top_down():
        excluded |= {other.name} if other.parent in excluded - {node.parent} else set()
    others = [
        other
        for other in tree.nodes
        if other.name not in excluded and not (other.environment or solids[other.name].articulated)
    ]
    assert node.parent is not None
    if node.parent in solids and _fraction_over(node, tree.node(node.parent)) < MIN_FOOTPRINT:
        return [other for other in others if _fraction_over(node, other) >= INSIDE_WARNING]
    solid, no_shift = solids[node.name], np.zeros(3)
    return [other for other in others if solid.depth(solids[other.name], no_shift) > MAX_OVERLAP_M]


def _fraction_over(node: TreeNode, support: TreeNode) -> float:
    """Return the fraction of an object's footprint that is over another object."""
    feet = footprint(upright(node))
    return polygon_intersection(support_footprint(support), feet) / polygon_area(feet)


def _cost_at(fit: SupportFit, level: _Level) -> float:
    """Return the cost of an object's fit on a level; infinite if the object leaves the support."""
    support, relation, z, xy = level
    cost, fitted_xy = fit.cost(support.name, relation, z)
    if _fraction_over(fit.node_at(fitted_xy, z), support) >= INSIDE_WARNING:
        return cost
    if _fraction_over(fit.node_at(xy, z), support) >= INSIDE_WARNING:
        return fit.cost(support.name, relation, z, xy)[0]
    return np.inf


def _cost_as_parsed(
    fit: SupportFit, solids: Mapping[str, SolidColumns], obstacles: Sequence[TreeNode]
) -> float:
    """Return the cost of an object's fit at the nearest feasible position on its parsed support."""
    node = fit.node
    assert node.parent is not None
    parent = fit.fitted.node(node.parent)
    if node.parent in solids and _fraction_over(node, parent) < MIN_FOOTPRINT:
        nearest = _nearest_over(node, parent)
        levels = _levels(node, nearest, parent, solids)
        costs = (fit.cost(parent.name, level.relation, level.z, nearest)[0] for level in levels)
        return min(costs, default=np.inf)
    solid, z = solids[node.name], node.box3d.position[2]
    position, free = np.array(node.box3d.position[:2]), []
    reach = max(math.hypot(*other.box3d.size[:2]) for other in obstacles)
    reach += math.hypot(*node.box3d.size[:2])
    for angle in np.linspace(0, 2 * np.pi, DIRECTIONS, endpoint=False):
        direction = np.array([math.cos(angle), math.sin(angle)])
        for step in np.linspace(0, reach, STEPS):
            shift = np.array([*(step * direction), 0.0])
            if all(solid.depth(solids[other.name], shift) <= MAX_OVERLAP_M for other in obstacles):
                free.append(position + shift[:2])
                break
    free.sort(key=lambda xy: fit.cost_unfitted(parent.name, node.relation, z, xy))
    costs = (fit.cost(parent.name, node.relation, z, xy)[0] for xy in free[:MAX_FITS])
    return min(costs, default=np.inf)


def _nearest_over(node: TreeNode, support: TreeNode) -> Float[np.ndarray, " 2"]:
    """Return the position [m] over a support's box that is nearest to an object."""
    box, axes = upright(support), matrix(from_yaw(support.box3d.yaw))[:2, :2]
    half = np.array(box.size[:2]) / 2
    offset = axes.T @ np.subtract(node.box3d.position[:2], box.position[:2])
    return np.array(box.position[:2]) + axes @ np.clip(offset, -half, half)


def _levels(
    node: TreeNode,
    xy: Float[np.ndarray, " 2"],
    support: TreeNode,
    solids: Mapping[str, SolidColumns],
) -> Iterator[_Level]:
    """Yield the levels in or on another object, each with the nearest position [m].

    Positions are up to half of the object's width away from `xy`, so that the position of a hole
    need not be accurate.
    """
    solid, support_columns = solids[node.name], solids[support.name]
    offsets = np.linspace(-0.5, 0.5, POSITIONS) * min(node.box3d.size[:2])
    shifts = np.stack(np.meshgrid(offsets, offsets, indexing="ij"), -1).reshape(-1, 2)
    shifts = shifts[np.argsort(np.linalg.norm(shifts, axis=1), kind="stable")]
    columns = solid.xy + (xy - np.array(node.box3d.position[:2]))
    _, highs = support_columns.spans((columns + shifts[:, None]).reshape(-1, 2))
    tops = highs.max(axis=0).reshape(len(shifts), -1)
    heights = (tops - (solid.bottom - solid.bottom.min())).max(axis=1)
    rim = float(support_columns.top.max()) - BELOW_RIM * min(
        node.box3d.size[2], support.box3d.size[2]
    )
    levels: list[float] = []
    for height, shift in zip(heights.tolist(), shifts, strict=True):
        if math.isfinite(height) and all(abs(height - level) > LEVEL_M for level in levels):
            levels.append(height)
            yield _Level(support, "in" if height < rim else "on", height, xy + shift)
