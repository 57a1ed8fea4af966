"""How well an answer's numbers are judged: standard deviations of the fit's priors, with reasons.

The text gives the median and the ninth decile of what a loose fit of boxes changed in answers to
four photographs (61 objects): upper bounds, as part of it was the fit's own error. Losses are soft,
so that what is further off can move. An answer that says how sure it is of an object replaces the
constants, within `SPREAD`.
"""

import math

import numpy as np
from jaxtyping import Float

from ..spec import Camera, SceneTree, TreeNode
from ..spec.pose import from_yaw, matrix

PIXELS, SIDE = 0.003, 0.015
"""Of a 2D side: over the picture's longer side, plus a share of its own box: read off to 1 to 3 px
at 640, less well where an outline is soft. Disagreement within it moves nothing."""
LOG_SIZE, LOG_ASPECT = 0.03, 0.02
"""Of the logarithm of an object's scale and of its edges' ratios: 1 %, 5 %. Sizes come from what
such things are known to measure, so they are the best of the numbers."""
KNOWN_SIZE = 0.01
"""The same of an edge that all such things have."""
YAW = math.radians(3.0)
"""Of the heading [rad]: 0.2 deg, 2 deg, where boxes show it at all."""
DEPTH, ASIDE = 0.035, 0.015
"""Of a position along and across the view, over the distance from the camera: together 4 %, 8 %. A
foot is judged by its pixel, and one row is worth more metres than one column."""
LEANING = 0.5
"""Share of `DEPTH` for what leans on something, whose distance that thing gives."""
ROOM_M = 0.005
"""Least room [m] of a thing in another one: boxes are rough, and some things stick out."""
UPRIGHT = math.radians(10.0)
"""Tilt up to which the foot of a thing is in the middle of its box."""
FASTENED_M, FASTENED = 0.005, 0.025
"""Of what is attached: along the normal of its carrier [m], in its plane over the distance."""
CONTACT_M, CONTACT = 0.002, 0.05
"""Of the height over the carrier: metres plus a share of the object's height (feet, rims); on a
slab of the environment metres alone, as composition sets the object down there."""
SLAB = 0.2
"""Largest height of a slab over its shorter edge."""
PITCH, LOG_HEIGHT = math.radians(1.5), 0.04
"""Of the camera's pitch [rad] and of the logarithm of its height, which are worked out from
vanishing points, ellipses and known sizes. Roll and field of view stay: boxes cannot tell a wrong
field of view from wrong distances, while vanishing points can."""
MEASURED = 0.3
"""Share of them for a number that the answer says it measured."""
SPREAD = 4.0
"""Largest factor, up or down, by which an answer's own standard deviation departs from these."""


def camera_spread(tree: SceneTree) -> Float[np.ndarray, "2"]:
    """Return standard deviations of the camera's pitch [rad] and log height."""
    measured = tree.camera_measured
    return np.array(
        [
            PITCH * (MEASURED if "pitch" in measured else 1.0),
            LOG_HEIGHT * (MEASURED if "height" in measured else 1.0),
        ]
    )


def side_tolerance(camera: Camera, node: TreeNode) -> Float[np.ndarray, "4"]:
    """Return standard deviations [px] of the sides of a node's 2D box."""
    x0, y0, x1, y1 = node.box2d.as_tuple()
    sides = np.array([x1 - x0, y1 - y0, x1 - x0, y1 - y0])
    return PIXELS * max(camera.width, camera.height_px) + SIDE * sides


def size_spread(node: TreeNode) -> tuple[float, Float[np.ndarray, "3"]]:
    """Return standard deviations of the log of a node's scale, and of that of each edge's ratio."""
    whole = _told(node.cues.size_sd, LOG_SIZE)
    edges = np.full(3, LOG_ASPECT * whole / LOG_SIZE)
    known = np.array([axis in node.cues.known_size for axis in "xyz"])
    return (KNOWN_SIZE if known.any() else whole), np.where(known, KNOWN_SIZE, edges)


def yaw_spread(node: TreeNode) -> float:
    """Return the standard deviation of a node's heading [rad]."""
    return _told(node.cues.yaw_sd, YAW)


def is_slab(node: TreeNode) -> bool:
    """Return whether a node is flat, such as a floor or the top of a table."""
    length, width, height = node.box3d.size
    return height < SLAB * min(length, width)


def rests_on_slab(tree: SceneTree, node: TreeNode) -> bool:
    """Return whether a node stands on a flat support of the environment."""
    if node.parent is None or node.relation != "on":
        return False
    parent = tree.node(node.parent)
    return parent.slab and is_slab(parent)


def place_information(tree: SceneTree, node: TreeNode) -> Float[np.ndarray, "3 3"]:
    """Return the matrix that maps a change of position [m] to standard deviations.

    Rows are directions over their deviations: along the view, across it, and up. An attached
    object is held along the normal of its carrier instead; what is in another one is held to the
    room that it has there.
    """
    offset = np.array(node.box3d.position) - tree.camera.position()
    distance = float(np.linalg.norm(offset))
    # Right below the camera any direction is across the view.
    along = offset[:2] / max(float(np.hypot(*offset[:2])), 1e-6)
    told = node.cues.position_sd
    if node.relation == "attached" and node.parent is not None:
        frame = _carrier_frame(tree.node(node.parent))
        plane = _told(told, FASTENED * distance)
        return frame / np.array([FASTENED_M, plane, plane])[:, None]
    depth = DEPTH * (LEANING if node.relation == "leaning" else 1.0) * distance
    spread = np.array([_told(told, depth), _told(told, ASIDE * distance)])
    if node.relation == "in" and node.parent is not None:
        spread = np.minimum(spread, room_inside(tree, node))
    height = CONTACT_M
    if not rests_on_slab(tree, node):
        height += CONTACT * node.box3d.size[2]
    rows = np.array([[*along, 0.0], [-along[1], along[0], 0.0], [0.0, 0.0, 1.0]])
    return rows / np.array([*spread, height])[:, None]


def room_inside(tree: SceneTree, node: TreeNode) -> float:
    """Return how far a node can move to each side in what it is in [m], at least ROOM_M."""
    outer = tree.node(node.parent).box3d.size[:2] if node.parent is not None else (np.inf, np.inf)
    return max((min(outer) - min(node.box3d.size[:2])) / 2, ROOM_M)


def shift_inside(tree: SceneTree, node: TreeNode) -> Float[np.ndarray, "2"]:
    """Return the smallest shift [m] after which a node's box is over that of what it is in.

    Along each side of the container one of the two boxes spans the other: a lid, a pot in a pot,
    a spoon that sticks out of a bowl. Zero for what is tilted, whose box is far from its foot, and
    for what is in a part of its container, such as a drawer.
    """
    if node.relation != "in" or node.parent is None or node.parent_link is not None:
        return np.zeros(2)
    outer = tree.node(node.parent)
    if not all(abs(n.base_tilt[0]) > math.cos(UPRIGHT / 2) for n in (node, outer)):
        return np.zeros(2)
    axes = matrix(from_yaw(outer.box3d.yaw))[:2, :2]
    turn = np.abs(matrix(from_yaw(node.box3d.yaw - outer.box3d.yaw)))[:2, :2]
    room = np.abs(np.array(outer.box3d.size[:2]) - turn @ np.array(node.box3d.size[:2])) / 2
    off = axes.T @ np.subtract(node.box3d.position[:2], outer.box3d.position[:2])
    return axes @ (np.clip(off, -room, room) - off)


def wall_normal(tree: SceneTree, node: TreeNode) -> Float[np.ndarray, "3"]:
    """Return the level unit normal of the plate of the environment that a node is attached to.

    Zero for what is not attached to one: only what hangs on a wall can neither leave it nor turn.
    """
    if node.relation == "attached" and node.parent is not None:
        carrier = tree.node(node.parent)
        thin, next_longer, _ = sorted(carrier.box3d.size)
        if carrier.environment and carrier.box3d.size[2] > thin and thin < SLAB * next_longer:
            return _carrier_frame(carrier)[0]
    return np.zeros(3)


def _carrier_frame(carrier: TreeNode) -> Float[np.ndarray, "3 3"]:
    """Return unit rows: the normal of a carrier's largest face, and two directions in it."""
    c, s = math.cos(carrier.box3d.yaw), math.sin(carrier.box3d.yaw)
    axes = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    return np.roll(axes, -int(np.argmin(carrier.box3d.size)), axis=0)


def _told(own: float | None, usual: float) -> float:
    """Return the answer's own standard deviation, within `SPREAD` of the usual one."""
    return usual if own is None else float(np.clip(own, usual / SPREAD, usual * SPREAD))
