"""Constants of the fit, with one row per object."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from ...spec import Camera, SceneTree, TreeNode
from .projection import CutSurfaces, Silhouette, stacked
from .sides import hidden_sides
from .tree_prior import camera_sd, position_whitening, side_sd, size_sd, wall_normal, yaw_sd

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
