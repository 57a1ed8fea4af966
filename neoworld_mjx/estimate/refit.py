"""Second fit, with built shapes in place of category outlines, and selection of other supports.

Vertical columns through an object's collision geometry, for overlaps and support heights.

Fit of a single object to its 2D box on a candidate support, with the rest of the scene fixed.

Selection of another support for an object whose parsed support is infeasible.

A response may state that a sponge is on the table although its position is in a basket, where it
would penetrate the basket's floor. Either the position is wrong, and the sponge is next to the
basket, or the support is wrong. Both hypotheses are fitted to the 2D box with built shapes. One
hypothesis places the object on the parsed support, at the nearest position without overlap. The
other places it in or on the other object. The support changes only if the likelihood ratio exceeds
the prior odds of the parsed support.

After Step 2, the program determines the proportions and the silhouette of an object. The 2D box
then determines the object's scale, position and heading more accurately.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

from ..evidence.known_camera import KnownCamera
from ..measure import SidesShown
from ..measure.boxes import (
    footprint,
    polygon_area,
    polygon_intersection,
    support_footprint,
    upright,
)
from ..physics.support import posed_pieces, vertical_intersections
from ..render import visible_surface
from ..spec import ObjectSpec, SceneObject, SceneTree, TreeNode
from ..spec.pose import from_yaw, matrix, pose, rotate
from ..spec.scale import fit_to_box
from ..spec.tree import Relation
from .fit_data import CAMERA
from .fit_problem import FitProblem, fit_problem
from .fit_tree import MIN_GAIN, FitReport, OtherSupport, fit_tree
from .projection import Wireframe, edges_of, hull_wireframe
from .tree_checks import INSIDE_WARNING

SAMPLES = 15
"""Number of columns along each side of a footprint."""


class SolidColumns:
    """Vertical columns [m] in the world through an object that is scaled to its parsed box.

    Attributes:
        xy: positions of the columns that intersect the object [m].
        bottom: lowest height of the object in each column [m].
        top: highest height of the object in each column [m].
    """

    def __init__(self, node: TreeNode, spec: ObjectSpec) -> None:
        fit = fit_to_box(spec, node)
        middle = fit.factor * fit.bottom_center
        scaled, state = fit.scaled()
        item = SceneObject(name=node.name, spec=scaled, base_tilt=node.base_tilt, joint_state=state)
        x, y, z = node.box3d.position
        to_world = pose((x, y, 0.0), from_yaw(node.box3d.yaw)).then(
            pose(-rotate(node.base_tilt, middle))
        )
        self._pieces = [(piece, to_world.then(local)) for piece, local in posed_pieces(item)]
        self.articulated = any(joint.type != "fixed" for joint in spec.joints)
        self._lift = 0.0
        corners = footprint(upright(node))
        sides = np.linspace(corners.min(axis=0), corners.max(axis=0), SAMPLES).T
        xy = np.stack(np.meshgrid(*sides, indexing="ij"), -1).reshape(-1, 2)
        lows, highs = self.spans(xy)
        bottom, top = lows.min(axis=0), highs.max(axis=0)
        intersects = np.isfinite(bottom)
        if intersects.any():
            self._lift = float(z - bottom.min())
        self.xy = xy[intersects]
        self.bottom, self.top = bottom[intersects] + self._lift, top[intersects] + self._lift

    def spans(
        self, xy: Float[np.ndarray, "k 2"]
    ) -> tuple[Float[np.ndarray, "p k"], Float[np.ndarray, "p k"]]:
        """Return the lowest and the highest height [m] of each convex piece in vertical columns.

        The result is (inf, -inf) for a piece that does not intersect the column.
        """
        columns = [
            vertical_intersections(piece, piece_pose, xy) for piece, piece_pose in self._pieces
        ]
        return (
            np.array([low for low, _ in columns]) + self._lift,
            np.array([high for _, high in columns]) + self._lift,
        )

    def depth(self, other: "SolidColumns", shift: Float[np.ndarray, " 3"]) -> float:
        """Return the largest vertical overlap [m] with another object after a shift of this one."""
        lows, highs = other.spans(self.xy + shift[:2])
        top, bottom = self.top + shift[2], self.bottom + shift[2]
        return float(np.max(np.minimum(highs, top) - np.maximum(lows, bottom), initial=-np.inf))


FIT_STEPS = 40
"""Maximum number of evaluations by the solver."""


class SupportFit:
    """Fits of one object at given heights and positions, with the parsed position as the prior.

    Args:
        parsed: the scene tree before the fit.
        fitted: the fitted scene tree.
        node: the object in the fitted tree.
        surface: the object's built surface, see `fit_problem`.
    """

    def __init__(
        self, parsed: SceneTree, fitted: SceneTree, node: TreeNode, surface: Wireframe
    ) -> None:
        self.fitted, self.node = fitted, node
        self._surface = surface
        self._parsed_box = parsed.node(node.name).box3d
        self._problems: dict[tuple[str, str, float], FitProblem] = {}

    def node_at(self, xy: Float[np.ndarray, " 2"], z: float) -> TreeNode:
        """Return the fitted object at another position [m]."""
        box = self.node.box3d.model_copy(update={"position": (*xy.tolist(), z)})
        return self.node.model_copy(update={"box3d": box})

    def cost(
        self, support: str, relation: str, z: float, xy: Float[np.ndarray, " 2"] | None = None
    ) -> tuple[float, Float[np.ndarray, " 2"]]:
        """Fit scale and heading at the height `z` [m]; if `xy` is None, also fit the position.

        Returns:
            The sum of squared residuals, and the position [m].
        """
        problem = self._problem(support, relation, z)
        initial = problem.data.initial_unknowns()
        position = np.array(self.node.box3d.position[:2] if xy is None else xy)
        initial[CAMERA : CAMERA + 2] = position
        free = problem.free(np.zeros(1, bool), camera=False)
        fixed = CAMERA + np.array([2] if xy is None else [0, 1, 2])
        free = free[~np.isin(free, fixed)]

        def residuals(part: Float[np.ndarray, " f"]) -> Float[np.ndarray, " r"]:
            full = initial.copy()
            full[free] = part
            return problem.residuals(full)

        result = least_squares(residuals, initial[free], x_scale="jac", max_nfev=FIT_STEPS)
        return float(2 * result.cost), result.x[:2] if xy is None else position

    def cost_unfitted(
        self, support: str, relation: str, z: float, xy: Float[np.ndarray, " 2"]
    ) -> float:
        """Return the sum of squared residuals at a position [m], without a fit."""
        problem = self._problem(support, relation, z)
        unknowns = problem.data.initial_unknowns()
        unknowns[CAMERA : CAMERA + 2] = xy
        return float(np.sum(problem.residuals(unknowns) ** 2))

    def _problem(self, support: str, relation: str, z: float) -> FitProblem:
        key = support, relation, z
        if key not in self._problems:
            x, y, _ = self._parsed_box.position
            box = self._parsed_box.model_copy(update={"position": (x, y, z)})
            update = {"parent": support, "relation": relation, "parent_link": None, "box3d": box}
            node = self.node.model_copy(update=update)
            nodes = tuple(node if n.name == node.name else n for n in self.fitted.nodes)
            tree = self.fitted.model_copy(update={"nodes": nodes})
            self._problems[key] = fit_problem(tree, [node], {node.name: self._surface})
        return self._problems[key]


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
        if node.parent is None or node.relation not in ("on", "in") or node.cues.kept:
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


def refit_tree(
    tree: SceneTree,
    objects: Mapping[str, ObjectSpec],
    shown: Mapping[str, SidesShown] | None = None,
    *,
    change_supports: bool = True,
    known: KnownCamera | None = None,
) -> tuple[SceneTree, FitReport]:
    """Fit a tree to its 2D boxes with the built shapes of its objects.

    Args:
        tree: the scene tree of Step 1.
        objects: the built objects by name, at any size.
        shown: visible sides of the objects, from `measure.shown_sides` of the scene composed from
            the tree; if None, occlusion is estimated from 2D boxes.
        change_supports: if True, allow supports other than those of the tree; see `other_supports`.
        known: known parameters of the camera, which the tree has.

    Returns:
        The fitted tree, and the report; see `fit_tree`.
    """
    nodes = [node for node in tree.nodes if not node.environment]
    surfaces = {node.name: surface_of(objects[node.name], node) for node in nodes}
    fitted, report = fit_tree(tree, surfaces, shown, known)
    changes = other_supports(tree, fitted, objects, surfaces) if change_supports else {}
    if not changes:
        return fitted, report
    fitted, report = fit_tree(with_supports(tree, changes), surfaces, shown, known)
    return fitted, replace(report, supports=changes)


def surface_of(spec: ObjectSpec, node: TreeNode) -> Wireframe:
    """Return an object's visible surface [m], in the frame of its parsed box.

    The object is scaled to the box as in composition, and has the parsed joint states.
    """
    fit = fit_to_box(spec, node)
    vertices, triangles = visible_surface(spec, fit.state)
    points: Float[np.ndarray, "_ 3"] = fit.factor * (vertices - fit.bottom_center)
    hull = hull_wireframe(points)
    return hull._replace(edges=edges_of(triangles)) if len(triangles) else hull
