"""Fit of a single object to its 2D box on a candidate support, with the rest of the scene fixed."""

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

from ..spec import SceneTree, TreeNode
from .fit_data import CAMERA
from .fit_problem import FitProblem, fit_problem
from .wireframe import Wireframe

STEPS = 40
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

        result = least_squares(residuals, initial[free], x_scale="jac", max_nfev=STEPS)
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
