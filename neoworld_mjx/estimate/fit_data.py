"""Constants of the fit, with one row per object, and the visible sides of the 2D boxes.

Sides of 2D boxes that show an object's outline, uncut by occluders and the picture's border.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float, Int

from ..spec import Box3D, Camera, Quat, SceneTree, TreeNode
from .priors import camera_sd, position_whitening, side_sd, size_sd, wall_normal, yaw_sd
from .projection import (
    CutSurfaces,
    Silhouette,
    outline_points,
    stacked,
    to_world,
)

SIDES = ("left", "top", "right", "bottom")
EDGE = 0.01
"""Distance from the picture's border within which the border may cut a box, relative to the
picture's longer side."""
HIDDEN_FRACTION = 1 / 3
"""Fraction of a side within the box of a named occluder above which the side counts as hidden."""
HIDDEN_FRACTION_UNNAMED = 0.6
"""The same fraction for a nearer object that the response does not name as an occluder."""
CUT_OFF = 0.02
"""Distance outside the picture at which an extreme point counts as cut off, relative to the
picture's longer side."""


def hidden_sides(tree: SceneTree, node: TreeNode) -> Bool[np.ndarray, "4"]:
    """Return a mask of the sides of a 2D box (left, top, right, bottom) that may be hidden.

    A side counts as hidden in each of these cases:

    - The side lies at the picture's border.
    - The border cuts the object, and the extreme point of the 3D outline on this side lies outside
      the picture.
    - An object in front covers much of the side: an occluder that the response names, the container
      of the object, or a nearer object whose 2D box overlaps.

    If the response lists the cut sides, the list replaces the last case. If the response marks the
    object as occluded, but names no occluder and no side lies at the border, every side counts as
    hidden.

    Args:
        tree: the parsed scene, or a fit of it.
        node: the object whose sides are tested.
    """
    camera = tree.camera
    edge = EDGE * max(camera.width, camera.height_px)
    box = np.array(node.box2d.as_tuple())
    frame = np.array([0.0, 0.0, camera.width, camera.height_px])
    outward = np.array([-1.0, -1.0, 1.0, 1.0])
    at_border = outward * (frame - box) <= edge
    hidden = at_border | _cut_points(tree, node, at_border)
    if node.cues.cut_sides is not None:
        # The border may cut a side even if the response does not list it.
        return hidden | np.array([side in node.cues.cut_sides for side in SIDES])
    if node.occluded and not _occluders(node) and not at_border.any():
        return np.ones(4, bool)
    return hidden | _covered_sides(tree, node, box, edge)


def _occluders(node: TreeNode) -> set[str]:
    """Return the names of the objects that occlude an object according to the response."""
    names = set(node.occluded_by)
    if node.relation == "in" and node.parent is not None:
        names.add(node.parent)
    return names


def _covered_sides(
    tree: SceneTree, node: TreeNode, box: Float[np.ndarray, "4"], edge: float
) -> Bool[np.ndarray, "4"]:
    """Return a mask of the sides of a box that the boxes of possible occluders cover."""
    names, hidden = _occluders(node), np.zeros(4, bool)
    boxes = np.array([other.box2d.as_tuple() for other in tree.nodes])
    fractions = _covered_fractions(box, boxes, edge)
    for k in np.flatnonzero((fractions >= HIDDEN_FRACTION).any(axis=1)):
        other = tree.nodes[k]
        if other.name == node.name:
            continue
        if other.name in names:
            hidden |= fractions[k] >= HIDDEN_FRACTION
        elif (fractions[k] >= HIDDEN_FRACTION_UNNAMED).any() and _is_nearer(tree, other, node):
            hidden |= fractions[k] >= HIDDEN_FRACTION_UNNAMED
    return hidden


def _cut_points(
    tree: SceneTree, node: TreeNode, at_border: Bool[np.ndarray, "4"]
) -> Bool[np.ndarray, "4"]:
    """Return a mask of the sides of a cut object whose extreme points are outside the picture."""
    if not at_border.any():
        return np.zeros(4, bool)
    camera = tree.camera
    points, _ = outline_points(node)
    pixels, depth = camera.project(to_world(points, node.box3d, node.base_tilt))
    if depth.min() <= 0:
        return np.ones(4, bool)
    size = np.array([camera.width, camera.height_px], float)
    slack = CUT_OFF * size.max()
    outside = ((pixels < -slack) | (pixels > size + slack)).any(axis=1)
    low, high = pixels.argmin(axis=0), pixels.argmax(axis=0)
    return outside[np.array([*low, *high])]


def _is_nearer(tree: SceneTree, other: TreeNode, node: TreeNode) -> bool:
    """Return True if `other` is nearer than `node`, and neither is the parent of the other."""
    if other.environment or node.environment:
        return False
    if other.parent == node.name or node.parent == other.name:
        return False
    camera = tree.camera
    nearer, depth = (
        _depth(camera, item.box3d, item.base_tilt)  # pyright: ignore[reportArgumentType]
        for item in (other, node)
    )
    return nearer < depth


@lru_cache(maxsize=1024)  # Many pairs of objects compare their depths.
def _depth(camera: Camera, box: Box3D, tilt: Quat) -> float:
    """Return the mean depth of a box's corners [m]."""
    eye, axis = camera.position(), camera.axes()[:, 2]
    return float(((box.corners(tilt) - eye) @ axis).mean())


def _covered_fractions(
    box: Float[np.ndarray, "4"], occluders: Float[np.ndarray, "n 4"], slack: float
) -> Float[np.ndarray, "n 4"]:
    """Return the fraction of each side of a box that lies in other boxes, grown by `slack`."""
    enlarged = occluders + slack * np.array([-1.0, -1.0, 1.0, 1.0])
    low, high = np.maximum(enlarged[:, :2], box[:2]), np.minimum(enlarged[:, 2:], box[2:])
    # Vertical sides extend along y, horizontal ones along x.
    overlap = (np.maximum(high - low, 0.0) / (box[2:] - box[:2]))[:, [1, 0, 1, 0]]
    within = (np.tile(enlarged[:, :2], 2) <= box) & (box <= np.tile(enlarged[:, 2:], 2))
    return np.where(within, overlap, 0.0)


CAMERA = 2
"""Number of unknowns of the camera; each object has seven."""


@dataclass(frozen=True)
class FitData:
    """The scene tree and the objects to fit, as arrays.

    The first two unknowns are the camera's pitch [rad] and log height, each divided by its prior
    standard deviation. For each object, seven unknowns follow: x, y, z [m], log length, log width,
    log height, and yaw [rad].
    """

    tree: SceneTree
    objects: tuple[TreeNode, ...]
    parents: Int[np.ndarray, " n"]
    """Index of each object's parent among the objects; -1 if the parent is in the environment."""
    levels: Int[np.ndarray, " n"]
    """Number of ancestors of each object among the objects."""
    round: Bool[np.ndarray, " n"]
    """True for objects whose outlines do not depend on the heading."""
    sizes: Float[np.ndarray, "n 3"]
    """Size [m] of the outlines' unit boxes."""
    values: Float[np.ndarray, "n 7"]
    """Values of the objects' unknowns in the tree."""
    tilts: Float[np.ndarray, "n 4"]
    boxes: Float[np.ndarray, "n 4"]
    """2D boxes (x0, y0, x1, y1) [px]."""
    contacts: Float[np.ndarray, "n 2"]
    """Image points at which objects touch their supports [px]; NaN if unknown."""
    inner: Float[np.ndarray, "n a 3"]
    """Points of each object's smallest outline."""
    outer: Float[np.ndarray, "n b 3"]
    """Points of each object's largest outline."""
    lowest: Float[np.ndarray, "n c 3"]
    """Points of each object; the lowest of them is at the height of the object's box."""
    hidden: Bool[np.ndarray, "n 4"]
    """True for sides of a 2D box that an occluder or the picture's border may cut."""
    normals: Float[np.ndarray, "n 3"]
    """Unit normal of the wall to which an object is attached; 0 for other objects."""
    camera_sd: Float[np.ndarray, "2"]
    side_sd: Float[np.ndarray, "n 4"]
    scale_sd: Float[np.ndarray, " n"]
    edge_sd: Float[np.ndarray, "n 3"]
    yaw_sd: Float[np.ndarray, " n"]
    whitening: Float[np.ndarray, "n 3 3"]
    """Matrices that map changes of position [m] to multiples of prior standard deviations."""
    cut: tuple[CutSurfaces, ...] = ()
    """Smallest outlines of the objects that the picture's border may cut, then their largest
    outlines; a largest outline that equals the smallest one is omitted."""

    def initial_unknowns(self) -> Float[np.ndarray, " u"]:
        """Return the values of the unknowns in the tree."""
        return np.concatenate([np.zeros(CAMERA), self.values.ravel()])

    def unpack(self, x: Float[np.ndarray, " u"]) -> tuple[Camera, Float[np.ndarray, "n 7"]]:
        """Return the camera and the objects' unknowns.

        For an object attached to a wall, the displacement along the wall's normal is removed.
        """
        camera = self.tree.camera
        pitch, log_height = x[:CAMERA] * self.camera_sd
        fitted_camera = camera.model_copy(
            update={
                "pitch": float(np.clip(camera.pitch + pitch, -1.55, 1.55)),
                "height": camera.height * math.exp(np.clip(log_height, -2, 2)),
            }
        )
        values = x[CAMERA:].reshape(len(self.objects), 7).copy()
        normal_shift = np.sum(
            (values[:, :3] - self.values[:, :3]) * self.normals, axis=1, keepdims=True
        )
        values[:, :3] -= normal_shift * self.normals
        return fitted_camera, values


def object_data(
    tree: SceneTree,
    objects: Sequence[TreeNode],
    silhouettes: Sequence[Silhouette],
) -> FitData:
    """Collect the data of objects, which are ordered parents first; see `fit_problem`."""
    names = [node.name for node in objects]
    parents = [names.index(n.parent) if n.parent in names else -1 for n in objects]
    levels = np.zeros(len(objects), int)
    for i, parent in enumerate(parents):
        levels[i] = levels[parent] + 1 if parent >= 0 else 0
    positions = np.array([node.box3d.position for node in objects])
    yaws = np.array([node.box3d.yaw for node in objects])
    scale_sds, edge_sds = zip(*(size_sd(node) for node in objects), strict=True)
    contacts = [node.cues.contact or (np.nan, np.nan) for node in objects]
    return FitData(
        tree=tree,
        objects=tuple(objects),
        parents=np.array(parents),
        levels=levels,
        round=np.array([silhouette.round for silhouette in silhouettes]),
        sizes=np.array([node.box3d.size for node in objects]),
        values=np.column_stack([positions, np.zeros((len(objects), 3)), yaws]),
        tilts=np.array([node.base_tilt for node in objects]),
        boxes=np.array([node.box2d.as_tuple() for node in objects]),
        contacts=np.array(contacts, float),
        inner=stacked([silhouette.inner for silhouette in silhouettes]),
        outer=stacked([silhouette.outer for silhouette in silhouettes]),
        lowest=stacked([silhouette.lowest for silhouette in silhouettes]),
        hidden=np.array([hidden_sides(tree, node) for node in objects]),
        normals=np.array([wall_normal(tree, node) for node in objects]),
        camera_sd=camera_sd(tree),
        side_sd=np.array([side_sd(tree.camera, node) for node in objects]),
        scale_sd=np.array(scale_sds),
        edge_sd=np.array(edge_sds),
        yaw_sd=np.array([yaw_sd(node) for node in objects]),
        whitening=np.array([position_whitening(tree, node) for node in objects]),
    )
