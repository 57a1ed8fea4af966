"""Fit camera and poses again, with the built objects in place of outlines of their categories.

After Step 2 the silhouette of an object is known, so its 2D box says more: scale, place and
heading are fitted to what its surface covers; its proportions are the program's.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from ..measure import SidesShown
from ..render import visible_surface
from ..spec import ObjectSpec, SceneTree, TreeNode
from ..spec.fit_to_box import fit_to_box
from .fit_tree import FitReport, fit_tree
from .supports_by_picture import other_carriers, with_carriers
from .wireframe import Wireframe, edges_of, hull_wireframe


def refit_tree(
    tree: SceneTree,
    objects: Mapping[str, ObjectSpec],
    shown: Mapping[str, SidesShown] | None = None,
    *,
    carriers: bool = True,
) -> tuple[SceneTree, FitReport]:
    """Fit a tree to its 2D boxes by the shapes of its objects.

    Args:
        tree: the scene tree of Step 1.
        objects: the built objects by name, at any size.
        shown: which sides of their visible boxes they show, by `measure.shown_sides` of the scene
            composed from the tree; without it boxes tell what is before what.
        carriers: whether another object may carry one than the tree says; see `other_carriers`.

    Returns:
        The fitted tree, and the report; see `fit_tree`.
    """
    nodes = [node for node in tree.nodes if not node.environment]
    surfaces = {node.name: surface_of(objects[node.name], node) for node in nodes}
    fitted, report = fit_tree(tree, surfaces, shown)
    changes = other_carriers(tree, fitted, objects, surfaces) if carriers else {}
    if not changes:
        return fitted, report
    fitted, report = fit_tree(with_carriers(tree, changes), surfaces, shown)
    return fitted, replace(report, carriers=changes)


def surface_of(spec: ObjectSpec, node: TreeNode) -> Wireframe:
    """Return an object's visible surface [m], in the frame of its parsed box.

    The object is scaled to the box as composition does it, and its joints are as parsed.
    """
    fit = fit_to_box(spec, node)
    vertices, triangles = visible_surface(spec, fit.state)
    points: Float[np.ndarray, "_ 3"] = fit.factor * (vertices - fit.bottom_center)
    hull = hull_wireframe(points)
    return hull._replace(edges=edges_of(triangles)) if len(triangles) else hull
