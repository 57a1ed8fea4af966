"""Prior of the fit of a parsed tree: standard deviations of camera, sizes, headings and places.

The losses are soft, so values with larger errors can move. If a response states a standard
deviation, it replaces the constant, within a factor of `MAX_SD_RATIO`.
"""

import math

import numpy as np
from jaxtyping import Float

from ...spec import Camera, SceneTree, TreeNode
from ...spec.pose import from_yaw, matrix
from ..prior import (
    ACROSS,
    DEPTH,
    FASTENED,
    FASTENED_M,
    LOG_ASPECT,
    LOG_HEIGHT,
    LOG_SIZE,
    PITCH,
    YAW,
)

PICTURE_SIDE_SD, BOX_SIDE_SD = 0.003, 0.015
"""Side of a 2D box: a fraction of the picture's longer side, plus a fraction of the 2D box's size.
Sides are accurate to 1 to 3 px in a picture of 640 px, but less accurate if an outline is
blurred."""
KNOWN_SIZE = 0.01
"""Logarithm of an edge that has a standard length."""
LEANING_FACTOR = 0.5
"""Fraction of `DEPTH` for an object that leans on another object, because that object limits the
position."""
MIN_CLEARANCE_M = 0.005
"""Minimum clearance [m] in a container, because boxes are approximate and contents may protrude."""
MAX_UPRIGHT_TILT = math.radians(10.0)
"""Maximum tilt [rad] at which the foot of an object is assumed to be in the middle of its box."""
CONTACT_M, CONTACT = 0.002, 0.05
"""Height above the support: a constant [m], plus a fraction of the object's height (for feet and
rims). On a slab of the environment, only the constant is used, because composition places the
object on the slab's top."""
MAX_SLAB_RATIO = 0.2
"""Maximum ratio of a slab's height to its shorter edge."""
MEASURED_FACTOR = 0.3
"""Factor of `PITCH` and `LOG_HEIGHT` for a value that was measured in the picture."""
MAX_SD_RATIO = 4.0
"""Maximum ratio of a stated standard deviation to its constant, and of the constant to it."""


def camera_sd(tree: SceneTree) -> Float[np.ndarray, "2"]:
    """Return the standard deviations of the camera's pitch [rad] and log height.

    If the response states them, they are used within `MAX_SD_RATIO`. Otherwise, they are the
    constants, reduced by `MEASURED_FACTOR` if the response measured the value.
    """
    default = {
        name: sd * (MEASURED_FACTOR if stated is None and name in tree.camera_measured else 1.0)
        for name, sd, stated in (
            ("pitch", PITCH, tree.pitch_sd),
            ("height", LOG_HEIGHT, tree.height_sd),
        )
    }
    pitch = _stated_or_default(tree.pitch_sd, default["pitch"])
    return np.array([pitch, _stated_or_default(tree.height_sd, default["height"])])


def side_sd(camera: Camera, node: TreeNode) -> Float[np.ndarray, "4"]:
    """Return the standard deviations [px] of the sides of a node's 2D box."""
    x0, y0, x1, y1 = node.box2d.as_tuple()
    sides = np.array([x1 - x0, y1 - y0, x1 - x0, y1 - y0])
    return PICTURE_SIDE_SD * max(camera.width, camera.height_px) + BOX_SIDE_SD * sides


def size_sd(node: TreeNode) -> tuple[float, Float[np.ndarray, "3"]]:
    """Return the standard deviations of a node's log scale, and of the log ratio of each edge."""
    scale = _stated_or_default(node.cues.size_sd, LOG_SIZE)
    edges = np.full(3, LOG_ASPECT * scale / LOG_SIZE)
    known = np.array([axis in node.cues.known_size for axis in "xyz"])
    return (KNOWN_SIZE if known.any() else scale), np.where(known, KNOWN_SIZE, edges)


def yaw_sd(node: TreeNode) -> float:
    """Return the standard deviation of a node's heading [rad]."""
    return _stated_or_default(node.cues.yaw_sd, YAW)


def position_whitening(tree: SceneTree, node: TreeNode) -> Float[np.ndarray, "3 3"]:
    """Return the matrix that maps a change of position [m] to multiples of standard deviations.

    Each row is a unit vector divided by the standard deviation in its direction. The directions are
    along the view, across the view, and up. For an attached object, they are the normal of the
    support's largest face and two directions in this face. For an object in a container, the
    clearance limits the horizontal standard deviations.
    """
    offset = np.array(node.box3d.position) - tree.camera.position()
    distance = float(np.linalg.norm(offset))
    # Directly below the camera, any direction is across the view.
    view_direction = offset[:2] / max(float(np.hypot(*offset[:2])), 1e-6)
    stated = node.cues.position_sd
    if node.relation == "attached" and node.parent is not None:
        in_plane = _stated_or_default(stated, FASTENED * distance)
        axes = _face_axes(tree.node(node.parent))
        return axes / np.array([FASTENED_M, in_plane, in_plane])[:, None]
    depth = DEPTH * (LEANING_FACTOR if node.relation == "leaning" else 1.0) * distance
    horizontal = np.array(
        [_stated_or_default(stated, depth), _stated_or_default(stated, ACROSS * distance)]
    )
    if node.relation == "in" and node.parent is not None:
        container = tree.node(node.parent).box3d
        clearance = (min(container.size[:2]) - min(node.box3d.size[:2])) / 2
        horizontal = np.minimum(horizontal, max(clearance, MIN_CLEARANCE_M))
    height = CONTACT_M
    if not rests_on_slab(tree, node):
        height += CONTACT * node.box3d.size[2]
    rows = np.array(
        [[*view_direction, 0.0], [-view_direction[1], view_direction[0], 0.0], [0.0, 0.0, 1.0]]
    )
    return rows / np.array([*horizontal, height])[:, None]


def shift_inside(tree: SceneTree, node: TreeNode) -> Float[np.ndarray, "2"]:
    """Return the smallest horizontal shift [m] that aligns an object's box with its container's.

    After the shift, the larger of the two boxes spans the smaller box along each side of the
    container. The object may be the larger one, such as a lid or a spoon that protrudes from a
    bowl. The shift is zero for tilted objects, whose boxes are far from their feet, and for objects
    in a part of the container, such as a drawer.
    """
    if node.relation != "in" or node.parent is None or node.parent_link is not None:
        return np.zeros(2)
    outer = tree.node(node.parent)
    if not all(abs(n.base_tilt[0]) > math.cos(MAX_UPRIGHT_TILT / 2) for n in (node, outer)):
        return np.zeros(2)
    axes = matrix(from_yaw(outer.box3d.yaw))[:2, :2]
    rotation = np.abs(matrix(from_yaw(node.box3d.yaw - outer.box3d.yaw)))[:2, :2]
    clearance = (
        np.abs(np.array(outer.box3d.size[:2]) - rotation @ np.array(node.box3d.size[:2])) / 2
    )
    offset = axes.T @ np.subtract(node.box3d.position[:2], outer.box3d.position[:2])
    return axes @ (np.clip(offset, -clearance, clearance) - offset)


def is_slab(node: TreeNode) -> bool:
    """Return True if a node is flat, like a floor or the top of a table."""
    length, width, height = node.box3d.size
    return height < MAX_SLAB_RATIO * min(length, width)


def rests_on_slab(tree: SceneTree, node: TreeNode) -> bool:
    """Return True if a node stands on a flat support of the environment."""
    if node.parent is None or node.relation != "on":
        return False
    parent = tree.node(node.parent)
    return parent.slab and is_slab(parent)


def wall_normal(tree: SceneTree, node: TreeNode) -> Float[np.ndarray, "3"]:
    """Return the horizontal unit normal of the wall to which a node is attached, or zero.

    Objects attached to a wall of the environment can neither leave the wall nor turn.
    """
    if node.relation == "attached" and node.parent is not None:
        support = tree.node(node.parent)
        thin, next_longer, _ = sorted(support.box3d.size)
        if (
            support.environment
            and support.box3d.size[2] > thin
            and thin < MAX_SLAB_RATIO * next_longer
        ):
            return _face_axes(support)[0]
    return np.zeros(3)


def _face_axes(node: TreeNode) -> Float[np.ndarray, "3 3"]:
    """Return the unit normal of a box's largest face and two unit vectors in the face, as rows."""
    c, s = math.cos(node.box3d.yaw), math.sin(node.box3d.yaw)
    axes = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    return np.roll(axes, -int(np.argmin(node.box3d.size)), axis=0)


def _stated_or_default(stated: float | None, default: float) -> float:
    """Return a stated standard deviation within `MAX_SD_RATIO` of the default, or the default."""
    return (
        default
        if stated is None
        else float(np.clip(stated, default / MAX_SD_RATIO, default * MAX_SD_RATIO))
    )
