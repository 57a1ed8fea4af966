"""Second fit, with built shapes in place of category outlines.

After Step 2, the program determines the proportions and the silhouette of an object. The 2D box
then determines the object's scale, position and heading more accurately.
"""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from ..evidence.known_camera import KnownCamera
from ..measure import SidesShown
from ..render import visible_surface
from ..spec import ObjectSpec, SceneTree, TreeNode
from ..spec.scale import fit_to_box
from .fit_tree import FitReport, fit_tree
from .projection import Wireframe, edges_of, hull_wireframe


def refit_tree(
    tree: SceneTree,
    objects: Mapping[str, ObjectSpec],
    shown: Mapping[str, SidesShown] | None = None,
    *,
    known: KnownCamera | None = None,
) -> tuple[SceneTree, FitReport]:
    """Fit a tree to its 2D boxes with the built shapes of its objects.

    Args:
        tree: the scene tree of Step 1.
        objects: the built objects by name, at any size.
        shown: visible sides of the objects, from `measure.shown_sides` of the scene composed from
            the tree; if None, occlusion is estimated from 2D boxes.
        known: known parameters of the camera, which the tree has.

    Returns:
        The fitted tree, and the report; see `fit_tree`.
    """
    nodes = [node for node in tree.nodes if not node.environment]
    surfaces = {node.name: surface_of(objects[node.name], node) for node in nodes}
    return fit_tree(tree, surfaces, shown, known)


def surface_of(spec: ObjectSpec, node: TreeNode) -> Wireframe:
    """Return an object's visible surface [m], in the frame of its parsed box.

    The object is scaled to the box as in composition, and has the parsed joint states.
    """
    fit = fit_to_box(spec, node)
    vertices, triangles = visible_surface(spec, fit.state)
    points: Float[np.ndarray, "_ 3"] = fit.factor * (vertices - fit.bottom_center)
    hull = hull_wireframe(points)
    return hull._replace(edges=edges_of(triangles)) if len(triangles) else hull
