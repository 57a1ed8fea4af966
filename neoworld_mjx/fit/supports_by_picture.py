"""Tell by the picture what carries an object, where the answer's carrier cannot.

An answer says that a sponge is on the table, but its place is in a basket: as answered it would
stand in the basket's floor. Either its place is off, and it stands beside the basket, or its
carrier is. Both are fitted to its 2D box by the built shapes: as answered, at the nearest place
where nothing is in the way, and in or on the other object. The carrier changes only where the
picture says so more clearly than answers are rarely wrong about carriers.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

from ..measure.boxes import footprint, polygon_area, shared_footprint, support_footprint, upright
from ..physics.support import column, posed_pieces
from ..spec import ObjectSpec, SceneObject, SceneTree, TreeNode
from ..spec.fit_to_box import fit_to_box
from ..spec.pose import from_yaw, matrix, pose, rotate
from ..spec.tree import Relation
from .fit_problem import CAMERA, FitProblem
from .tree_checks import INSIDE_WARNS
from .wireframe import Wireframe

RATE = 1 / 32
"""Share of objects with a wrong carrier in an answer: of 30 objects in five rendered pictures none
had one, by Laplace's rule of succession."""
GAIN = 2 * math.log(1 / RATE - 1)
"""Least fall of the sum of squared residuals, as twice a log-likelihood, for another carrier."""
DEEP_M = 0.002
"""Overlap of built shapes from which on an object cannot be where the answer has it."""
BESIDE = 0.01
"""Share of a footprint over its carrier below which the object is not on it at all."""
LEVEL_M = 0.004
"""Surfaces within this height count as one."""
BELOW_RIM = 0.1
"""Depth below an object's top, over the height of the lower of both, from which on "in" is said."""
SAMPLES = 15
"""Columns along each side of a footprint."""
PLACES = 9
"""Places along each side of a square around an object's own."""
FITTED = 3
"""Places or heights that are fitted: those that agree best with the 2D box unfitted."""
DIRECTIONS, STEPS = 16, 40
"""Ways out of another object, and places along each."""


@dataclass(frozen=True)
class OtherCarrier:
    """What carries an object by the picture, in place of what the answer says."""

    before: str
    """Relation and carrier of the answer."""
    parent: str
    relation: Relation
    z: float
    """Height of its lowest point [m]."""
    gain: float
    """Fall of the sum of squared residuals of its fit."""

    def phrase(self) -> str:
        """Return why, in words."""
        return (
            f"as answered, {self.before}, it would stand in another object or on nothing; "
            f"{self.relation} {self.parent} its fit to the photo is better by {self.gain:.0f} "
            f"squared standard deviations, of which {GAIN:.0f} are needed"
        )


def other_carriers(
    answered: SceneTree,
    fitted: SceneTree,
    objects: Mapping[str, ObjectSpec],
    surfaces: Mapping[str, Wireframe],
) -> dict[str, OtherCarrier]:
    """Return the objects that something other than the answer says carries them.

    Args:
        answered: the scene tree before the fit.
        fitted: the same fitted by real shapes.
        objects: the built objects by name, at any size.
        surfaces: their visible surfaces, see `FitProblem`.
    """
    things = [node for node in fitted.nodes if not node.environment]
    solids = {node.name: _Solid(node, objects[node.name]) for node in things}
    found = {}
    for node in things:
        if node.parent is None or node.relation not in ("on", "in"):
            continue
        others = _others(fitted, node, solids)
        if not others:
            continue
        trial = _Trial(answered, fitted, node, surfaces[node.name])
        here = np.array(node.box3d.position[:2])
        levels: list[tuple[float, TreeNode, Relation, float, Float[np.ndarray, " 2"]]] = [
            (trial.unfitted(other.name, relation, z, place), other, relation, z, place)
            for other in others
            for relation, z, place in _levels(node, here, other, solids)
        ]
        ways: list[tuple[float, str, Relation, float]] = [
            (_inside(trial, other, relation, z, place), other.name, relation, z)
            for _, other, relation, z, place in sorted(levels, key=lambda level: level[0])[:FITTED]
        ]
        cost, parent, relation, z = min(
            ways, key=lambda way: way[0], default=(np.inf, "", "on", 0.0)
        )
        if cost == np.inf:
            continue
        gain = _as_answered(trial, solids, others) - cost
        if GAIN < gain < np.inf:
            found[node.name] = OtherCarrier(
                f"{node.relation} {node.parent}", parent, relation, z, gain
            )
    return without_circles(fitted, found)


def without_circles(tree: SceneTree, found: Mapping[str, OtherCarrier]) -> dict[str, OtherCarrier]:
    """Return the changes after which nothing carries itself; of a circle the clearer ones."""
    parents = {node.name: node.parent for node in tree.nodes}
    kept = {}
    for name, change in sorted(found.items(), key=lambda entry: -entry[1].gain):
        below: str | None = change.parent
        while below not in (None, name):
            below = parents[below]
        if below is None:
            parents[name], kept[name] = change.parent, change
    return kept


def with_carriers(tree: SceneTree, changes: Mapping[str, OtherCarrier]) -> SceneTree:
    """Return a tree in which objects rest on other carriers, with what they carry themselves."""
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


class _Solid:
    """An object's collision shapes, scaled to its parsed box, as vertical columns in the world."""

    def __init__(self, node: TreeNode, spec: ObjectSpec) -> None:
        fit = fit_to_box(spec, node)
        middle = fit.factor * fit.bottom_center
        scaled, state = fit.scaled()
        item = SceneObject(name=node.name, spec=scaled, base_tilt=node.base_tilt, joint_state=state)
        x, y, z = node.box3d.position
        to = pose((x, y, 0.0), from_yaw(node.box3d.yaw)).then(pose(-rotate(node.base_tilt, middle)))
        self.pieces = [(piece, to.then(at)) for piece, at in posed_pieces(item)]
        self.articulated = any(joint.type != "fixed" for joint in spec.joints)
        self.lift = 0.0
        sides = np.linspace(*_ends(footprint(upright(node))), SAMPLES).T
        xy = np.stack(np.meshgrid(*sides, indexing="ij"), -1).reshape(-1, 2)
        lows, highs = self.spans(xy)
        under, over = lows.min(axis=0), highs.max(axis=0)
        met = np.isfinite(under)
        if met.any():
            self.lift = float(z - under.min())
        self.xy, self.under, self.over = xy[met], under[met] + self.lift, over[met] + self.lift

    def spans(
        self, xy: Float[np.ndarray, "k 2"]
    ) -> tuple[Float[np.ndarray, "p k"], Float[np.ndarray, "p k"]]:
        """Return from which to which height [m] each piece reaches over points.

        (inf, -inf) where it is not over or under a point.
        """
        columns = [column(piece, at, xy) for piece, at in self.pieces]
        return (
            np.array([low for low, _ in columns]) + self.lift,
            np.array([high for _, high in columns]) + self.lift,
        )

    def depth(self, other: "_Solid", shift: Float[np.ndarray, " 3"]) -> float:
        """Return how deep [m] it would be in another one along the vertical, after a shift."""
        lows, highs = other.spans(self.xy + shift[:2])
        over, under = self.over + shift[2], self.under + shift[2]
        return float(np.max(np.minimum(highs, over) - np.maximum(lows, under), initial=-np.inf))


class _Trial:
    """One object's fit to its 2D box, the rest of the scene held."""

    def __init__(
        self, answered: SceneTree, fitted: SceneTree, node: TreeNode, surface: Wireframe
    ) -> None:
        self.fitted, self.node, self.surface = fitted, node, surface
        # The place that the answer has it at is the prior; heights are the carriers'.
        self.answered = answered.node(node.name).box3d
        self.problems: dict[tuple[str, str, float], FitProblem] = {}

    def at(self, xy: Float[np.ndarray, " 2"], z: float) -> TreeNode:
        """Return the fitted object at another place [m]."""
        box = self.node.box3d.model_copy(update={"position": (*xy.tolist(), z)})
        return self.node.model_copy(update={"box3d": box})

    def cost(
        self, carrier: str, relation: str, z: float, xy: Float[np.ndarray, " 2"] | None = None
    ) -> tuple[float, Float[np.ndarray, " 2"]]:
        """Fit scale and heading, and the place [m] if none is given, at a height.

        Returns:
            The sum of squared residuals, and the place.
        """
        problem = self._problem(carrier, relation, z)
        start = problem.start()
        place = np.array(self.node.box3d.position[:2] if xy is None else xy)
        start[CAMERA : CAMERA + 2] = place
        free = problem.free(np.zeros(1, bool), camera=False)
        held = CAMERA + np.array([2] if xy is None else [0, 1, 2])
        free = free[~np.isin(free, held)]

        def residuals(part: Float[np.ndarray, " f"]) -> Float[np.ndarray, " r"]:
            full = start.copy()
            full[free] = part
            return problem.residuals(full)

        result = least_squares(residuals, start[free], x_scale="jac", max_nfev=STEPS)
        if xy is None:
            place = result.x[:2]
        return float(2 * result.cost), place

    def unfitted(self, carrier: str, relation: str, z: float, xy: Float[np.ndarray, " 2"]) -> float:
        """Return the sum of squared residuals at a place [m], at the scale and heading it has."""
        problem = self._problem(carrier, relation, z)
        start = problem.start()
        start[CAMERA : CAMERA + 2] = xy
        return float(np.sum(problem.residuals(start) ** 2))

    def _problem(self, carrier: str, relation: str, z: float) -> FitProblem:
        """Return the fit of the object alone, at a height [m] on a carrier."""
        key = carrier, relation, z
        if key not in self.problems:
            x, y, _ = self.answered.position
            box = self.answered.model_copy(update={"position": (x, y, z)})
            update = {"parent": carrier, "relation": relation, "parent_link": None, "box3d": box}
            node = self.node.model_copy(update=update)
            nodes = tuple(node if n.name == node.name else n for n in self.fitted.nodes)
            tree = self.fitted.model_copy(update={"nodes": nodes})
            self.problems[key] = FitProblem(tree, [node], {node.name: self.surface})
        return self.problems[key]


def _others(tree: SceneTree, node: TreeNode, solids: Mapping[str, _Solid]) -> list[TreeNode]:
    """Return what may carry an object in place of its parent, which cannot; none if that can."""
    above = {node.name, node.parent}
    for other in tree.top_down():
        above |= {other.name} if other.parent in above - {node.parent} else set()
    others = [
        other
        for other in tree.nodes
        if other.name not in above and not (other.environment or solids[other.name].articulated)
    ]
    assert node.parent is not None
    if node.parent in solids and _over(node, tree.node(node.parent)) < BESIDE:
        return [n for n in others if _over(node, n) >= INSIDE_WARNS]
    own, still = solids[node.name], np.zeros(3)
    return [n for n in others if own.depth(solids[n.name], still) > DEEP_M]


def _over(node: TreeNode, carrier: TreeNode) -> float:
    """Return the share of an object's footprint that is over another one's."""
    feet = footprint(upright(node))
    return shared_footprint(support_footprint(carrier), feet) / polygon_area(feet)


def _inside(
    trial: _Trial,
    carrier: TreeNode,
    relation: Relation,
    z: float,
    at: Float[np.ndarray, " 2"],
) -> float:
    """Return the cost of an object's fit in or on another one, at a place that is over it."""
    cost, place = trial.cost(carrier.name, relation, z)
    if _over(trial.at(place, z), carrier) >= INSIDE_WARNS:
        return cost
    if _over(trial.at(at, z), carrier) >= INSIDE_WARNS:
        return trial.cost(carrier.name, relation, z, at)[0]
    return np.inf


def _as_answered(trial: _Trial, solids: Mapping[str, _Solid], others: Sequence[TreeNode]) -> float:
    """Return the cost of an object's fit where its answered carrier can carry it."""
    node = trial.node
    assert node.parent is not None
    parent = trial.fitted.node(node.parent)
    if node.parent in solids and _over(node, parent) < BESIDE:
        at = _towards(node, parent)
        return min(
            (
                trial.cost(parent.name, relation, z, at)[0]
                for relation, z, _ in _levels(node, at, parent, solids)
            ),
            default=np.inf,
        )
    own, z = solids[node.name], node.box3d.position[2]
    here, places = np.array(node.box3d.position[:2]), []
    size = node.box3d.size
    reach = max(math.hypot(*other.box3d.size[:2]) for other in others) + math.hypot(*size[:2])
    for turn in np.linspace(0, 2 * np.pi, DIRECTIONS, endpoint=False):
        way = np.array([math.cos(turn), math.sin(turn)])
        for step in np.linspace(0, reach, STEPS):
            shift = np.array([*(step * way), 0.0])
            if all(own.depth(solids[other.name], shift) <= DEEP_M for other in others):
                places.append(here + shift[:2])
                break
    of = lambda place: trial.unfitted(parent.name, node.relation, z, place)
    nearest = sorted(places, key=of)[:FITTED]
    costs = [trial.cost(parent.name, node.relation, z, place)[0] for place in nearest]
    return min(costs, default=np.inf)


def _towards(node: TreeNode, carrier: TreeNode) -> Float[np.ndarray, " 2"]:
    """Return the place [m] nearest to an object's own that is over another one's box."""
    box, axes = upright(carrier), matrix(from_yaw(carrier.box3d.yaw))[:2, :2]
    half = np.array(box.size[:2]) / 2
    off = axes.T @ np.subtract(node.box3d.position[:2], box.position[:2])
    return np.array(box.position[:2]) + axes @ np.clip(off, -half, half)


def _levels(
    node: TreeNode,
    at: Float[np.ndarray, " 2"],
    carrier: TreeNode,
    solids: Mapping[str, _Solid],
) -> Iterator[tuple[Relation, float, Float[np.ndarray, " 2"]]]:
    """Yield relation, height [m] and nearest place [m] of each way to stand in or on another one.

    Places are tried up to half a width around one, as a hole may be a centimetre off.
    """
    own, other = solids[node.name], solids[carrier.name]
    away = np.linspace(-0.5, 0.5, PLACES) * min(node.box3d.size[:2])
    shifts = np.stack(np.meshgrid(away, away, indexing="ij"), -1).reshape(-1, 2)
    shifts = shifts[np.argsort(np.linalg.norm(shifts, axis=1), kind="stable")]
    xy = own.xy + (at - np.array(node.box3d.position[:2]))
    _, highs = other.spans((xy + shifts[:, None]).reshape(-1, 2))
    tops = highs.max(axis=0).reshape(len(shifts), -1)
    heights = (tops - (own.under - own.under.min())).max(axis=1)
    rim = float(other.over.max()) - BELOW_RIM * min(node.box3d.size[2], carrier.box3d.size[2])
    seen: list[float] = []
    for height, shift in zip(heights.tolist(), shifts, strict=True):
        if math.isfinite(height) and all(abs(height - level) > LEVEL_M for level in seen):
            seen.append(height)
            yield ("in" if height < rim else "on"), height, at + shift


def _ends(corners: Float[np.ndarray, "n 2"]) -> tuple[np.ndarray, np.ndarray]:
    return corners.min(axis=0), corners.max(axis=0)
