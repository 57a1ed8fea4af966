"""Second fit of camera and boxes, with built shapes in place of the outlines of categories.

After Step 2, the program determines the proportions and the silhouette of an object. The 2D box
then determines the object's scale, position and heading more accurately.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from ..measure import SidesShown
from ..render import visible_surface
from ..spec import ObjectSpec, SceneTree, TreeNode
from ..spec.fit_to_box import fit_to_box
from .fit_report import FitReport
from .fit_tree import fit_tree
from .support_selection import other_supports, with_supports
from .wireframe import Wireframe, edges_of, hull_wireframe


def refit_tree(
    tree: SceneTree,
    objects: Mapping[str, ObjectSpec],
    shown: Mapping[str, SidesShown] | None = None,
    *,
    change_supports: bool = True,
) -> tuple[SceneTree, FitReport]:
    """Fit a tree to its 2D boxes with the built shapes of its objects.

    Args:
        tree: the scene tree of Step 1.
        objects: the built objects by name, at any size.
        shown: visible sides of the objects, from `measure.shown_sides` of the scene composed from
            the tree; if None, occlusion is estimated from 2D boxes.
        change_supports: if True, allow supports other than those of the tree; see `other_supports`.

    Returns:
        The fitted tree, and the report; see `fit_tree`.
    """
    nodes = [node for node in tree.nodes if not node.environment]
    surfaces = {node.name: surface_of(objects[node.name], node) for node in nodes}
    fitted, report = fit_tree(tree, surfaces, shown)
    changes = other_supports(tree, fitted, objects, surfaces) if change_supports else {}
    if not changes:
        return fitted, report
    fitted, report = fit_tree(with_supports(tree, changes), surfaces, shown)
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
