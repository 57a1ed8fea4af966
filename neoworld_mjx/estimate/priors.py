"""Prior standard deviations of the fit, and the size ranges of object categories.

Object categories: size range and outline of objects, by the head noun of a label.

The ranges are deliberately wide: they reject a cup of 1 m, but accept a cup of 18 cm.

Each pair of percentages or angles in the docstrings is the median and the 90th percentile of
changes by a weakly regularized fit of boxes. The fit was applied to the responses for four
photographs (61 objects). These values are upper bounds, because they include the error of the fit.
The losses are soft, so values with larger errors can move. If a response states a standard
deviation, it replaces the constant, within a factor of `MAX_SD_RATIO`.
"""

import math
import re
from typing import Literal, NamedTuple, cast

import numpy as np
from jaxtyping import Float

from ..spec import Camera, SceneTree, TreeNode
from ..spec.pose import from_yaw, matrix

Outline = Literal["box", "round", "tapered", "ball", "handled", "spoon", "loose"]
"""Shape of an object within its 3D box:

- "box": the box itself,
- "round": an upright cylinder,
- "tapered": an upright cylinder with a narrower foot,
- "ball": a ball,
- "handled": a round body with a handle at its front,
- "spoon": a lying bowl with a thin handle at its back,
- "loose": a shape between box and cylinder.
"""


class Category(NamedTuple):
    """Size range and outline of the objects of a category."""

    low: float
    """Longest edge of the smallest common object [m]."""
    high: float
    """Longest edge of the largest common object [m]."""
    outline: Outline


_SMALLER = frozenset(["small", "little", "mini", "miniature", "tiny", "toy"])
_LARGER = frozenset(["large", "big", "giant", "tall", "floor", "standing", "wall"])


_TABLE = """
cup mug teacup | 0.04 0.18 handled
glass tumbler goblet wineglass | 0.05 0.30 round
saucer | 0.08 0.22 tapered
plate | 0.10 0.45 tapered
dish | 0.05 0.45 tapered
bowl basin | 0.07 0.60 tapered
bottle flask thermos | 0.08 0.50 round
can tin | 0.04 0.35 round
jar canister | 0.04 0.35 round
vase flowerpot carafe | 0.06 0.80 round
pitcher jug | 0.08 0.50 handled
candle | 0.02 0.35 round
pot kettle teapot casserole | 0.10 0.65 loose
saucepan pan skillet wok | 0.12 0.75 handled
bucket bin basket | 0.10 1.00 tapered
roll | 0.03 0.60 round
tape | 0.03 0.30 round
clock | 0.04 0.80 loose
lemon lime egg plum apricot walnut | 0.02 0.12 ball
apple orange peach pear tomato onion potato mango | 0.03 0.18 ball
ball | 0.02 0.80 ball
melon watermelon pumpkin | 0.10 0.70 ball
globe | 0.08 1.50 loose
banana carrot cucumber corn eggplant zucchini | 0.06 0.45 loose
bread loaf | 0.06 0.50 loose
spoon teaspoon tablespoon fork spatula ladle | 0.08 0.50 spoon
knife whisk tongs chopstick brush | 0.08 0.50 loose
pen pencil marker screwdriver toothbrush | 0.06 0.35 loose
scissors hammer pliers wrench drill | 0.08 0.45 loose
key coin ring screw nut bolt | 0.01 0.12 loose
phone smartphone calculator remote controller | 0.07 0.28 box
mouse | 0.05 0.18 loose
keyboard | 0.20 0.60 box
laptop tablet notebook | 0.12 0.50 box
monitor screen television tv | 0.25 2.00 box
book magazine | 0.08 0.50 box
paper card envelope | 0.04 0.80 box
box carton package packet parcel | 0.02 1.20 box
bag sachet | 0.03 1.00 loose
block brick cube dice | 0.01 0.40 box
tray | 0.05 1.20 box
board | 0.10 1.20 box
lid cap cover | 0.02 0.60 loose
sponge soap | 0.04 0.25 box
cloth towel napkin rag mat rug | 0.08 4.00 loose
glasses sunglasses | 0.08 0.22 loose
lamp light | 0.08 2.20 loose
plant flower | 0.03 2.50 loose
toy figure figurine statuette doll | 0.02 1.00 loose
toaster blender mixer | 0.12 0.60 loose
microwave oven | 0.30 1.00 box
fridge refrigerator | 0.40 2.20 box
dishwasher washer dryer stove | 0.40 1.30 box
sink | 0.20 1.20 box
cabinet cupboard drawers dresser wardrobe chest bookcase bookshelf nightstand | 0.25 3.50 box
drawer | 0.10 1.50 box
shelf | 0.15 4.00 box
rack | 0.06 4.00 loose
door window | 0.30 4.00 box
chair stool armchair bench | 0.25 2.50 loose
sofa couch bed | 1.00 3.50 loose
table desk counter countertop tabletop worktop island | 0.20 8.00 loose
top surface | 0.10 8.00 box
floor ground wall ceiling carpet | 0.20 50.0 box
"""


def _parse_table() -> dict[str, Category]:
    categories = {}
    for line in _TABLE.strip().splitlines():
        words, values = line.split("|")
        low, high, outline = values.split()
        for word in words.split():
            categories[word] = Category(float(low), float(high), cast(Outline, outline))
    return categories


CATEGORIES = _parse_table()


def size_range(label: str) -> tuple[float, float] | None:
    """Return the range of longest edges [m] for a label; words like "small" and "large" widen it.

    Returns:
        The lower and the upper limit, or None if the category is unknown.
    """
    category = category_of(label)
    if category is None:
        return None
    words = set(re.findall(r"[a-z]+", label.lower()))
    low = category.low / 2 if words & _SMALLER else category.low
    return low, category.high * 2 if words & _LARGER else category.high


def category_of(label: str) -> Category | None:
    """Return the category of a label's head noun: "soup can" is a can, "box of tea" is a box.

    Returns:
        The category, or None if no word of the label is in the table.
    """
    words = re.findall(r"[a-z]+", re.split(r"\b(?:of|with|for|in|on)\b", label.lower())[0])
    for word in reversed(words):
        for form in (word, word.removesuffix("s"), word.removesuffix("es")):
            if form in CATEGORIES:
                return CATEGORIES[form]
    return None


PICTURE_SIDE_SD, BOX_SIDE_SD = 0.003, 0.015
"""Side of a 2D box: a fraction of the picture's longer side, plus a fraction of the 2D box's size.
Sides are accurate to 1 to 3 px in a picture of 640 px, but less accurate if an outline is
blurred."""
LOG_SIZE, LOG_ASPECT = 0.03, 0.02
"""Logarithm of an object's scale, and logarithm of the ratios of its edges: 1 %, 5 %. Sizes are the
most accurate values, because the sizes of such objects are well known."""
KNOWN_SIZE = 0.01
"""Logarithm of an edge that has a standard length."""
YAW = math.radians(3.0)
"""Heading [rad]: 0.2 deg, 2 deg, if the box depends on the heading."""
DEPTH, ACROSS = 0.035, 0.015
"""Position along and across the view, relative to the distance from the camera: together 4 %, 8 %.
The pixel of an object's foot determines the position, and one row of pixels spans more meters than
one column."""
LEANING_FACTOR = 0.5
"""Fraction of `DEPTH` for an object that leans on another object, because that object limits the
position."""
MIN_CLEARANCE_M = 0.005
"""Minimum clearance [m] in a container, because boxes are approximate and contents may protrude."""
MAX_UPRIGHT_TILT = math.radians(10.0)
"""Maximum tilt [rad] at which the foot of an object is assumed to be in the middle of its box."""
FASTENED_M, FASTENED = 0.005, 0.025
"""Position of an attached object: along the support's normal [m], and in the support's plane,
relative to the distance from the camera."""
CONTACT_M, CONTACT = 0.002, 0.05
"""Height above the support: a constant [m], plus a fraction of the object's height (for feet and
rims). On a slab of the environment, only the constant is used, because composition places the
object on the slab's top."""
MAX_SLAB_RATIO = 0.2
"""Maximum ratio of a slab's height to its shorter edge."""
PITCH, LOG_HEIGHT = math.radians(1.5), 0.04
"""Camera's pitch [rad] and logarithm of its height, which are computed from vanishing points,
ellipses and known sizes. Roll and field of view are fixed: boxes cannot distinguish a wrong field
of view from wrong distances, but vanishing points can."""
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
