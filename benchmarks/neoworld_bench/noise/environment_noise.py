"""Errors of environment supports in a response: sizes of tables, positions of walls and furniture.

Errors of supports were not measured separately. They have the errors that were measured on objects
whose response gives a position in space. The top of a table or floor is the reference for heights
and keeps its position.
"""

import numpy as np
from jaxtyping import Float

from neoworld_mjx.spec import SceneTree, TreeNode

from ..fidelity.rendered_responses import ASIDE, DEPTH, LOG_ASPECT, LOG_SIZE, YAW


def with_other_supports(response: SceneTree, truth: SceneTree, number: int) -> SceneTree:
    """Return a response with errors in its environment supports.

    Args:
        response: response with noise in the numbers of its objects.
        truth: exact response.
        number: seed of the noise.
    """
    rng = np.random.default_rng((number, 49))
    eye = truth.camera.position()
    nodes = [_disturbed(node, eye, rng) if node.environment else node for node in response.nodes]
    return response.model_copy(update={"nodes": tuple(nodes)})


def _disturbed(node: TreeNode, eye: Float[np.ndarray, " 3"], rng: np.random.Generator) -> TreeNode:
    box = node.box3d
    factor = np.exp(LOG_SIZE * rng.normal() + LOG_ASPECT * rng.normal(size=3))
    turn, out, aside = rng.normal(size=3)
    place, yaw = np.array(box.position), box.yaw
    if min(box.size) == box.size[2]:
        factor[2] = 1.0
    else:
        reach, view = float(np.linalg.norm(place - eye)), place[:2] / np.linalg.norm(place[:2])
        across = np.array([-view[1], view[0]])
        place[:2] += reach * (DEPTH * out * view + ASIDE * aside * across)
        yaw += YAW * turn
    update = {
        "position": tuple(place.tolist()),
        "size": tuple((np.array(box.size) * factor).tolist()),
        "yaw": yaw,
    }
    return node.model_copy(update={"box3d": box.model_copy(update=update)})
