"""Least-squares problem of the fit: residuals of the picture and the priors, and the Jacobian.

Residuals of the picture are distances [px] of 2D boxes and contacts from projected outlines.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from ...spec import Box3D, Camera, SceneTree, TreeNode
from ...spec.pose import rotate
from .fit_data import CAMERA, FitData, object_data
from .projection import (
    NEAR_M,
    CutSurfaces,
    Silhouette,
    extents_in_picture,
    hull_wireframe,
    silhouette_of,
    stack_surfaces,
)
from .sides import EDGE
from .tree_prior import rests_on_slab, shift_inside

MAX_CUT = 8
"""Maximum number of objects whose visible part is projected edge by edge, which is slow."""
FOOT_HEIGHT = 0.03
"""Height of the foot of an object above its lowest point, relative to the object's height."""
_OUTWARD = np.array([-1.0, -1.0, 1.0, 1.0])


def outline_residuals(data: FitData, x: Float[np.ndarray, " u"]) -> Float[np.ndarray, "n 6"]:
    """Return the distances of 2D boxes' sides and contacts from the projected outlines [px].

    Columns 0 to 3 are positive if the 2D box extends beyond the largest outline, and negative if
    the smallest outline extends beyond a visible side. The last two columns are the distances of
    the contact from the projected foot, to the right and down. They are 0 if the contact is
    unknown.
    """
    camera, values = data.unpack(x)
    extents, feet = [], []
    rows = np.arange(len(data.objects))
    for k, points in enumerate((data.inner, data.outer)):
        view, height = to_camera_frame(data, camera, values, points, rows)
        pixels = _projected(camera, view)
        boxes = np.concatenate([pixels.min(axis=1), pixels.max(axis=1)], axis=1)
        if data.cut:
            cut = data.cut[k].rows
            points = data.cut[k].points
            view, _ = to_camera_frame(data, camera, values, points, cut)
            within = extents_in_picture(camera, view, data.cut[k].edges, data.cut[k].owners)
            size = np.tile([camera.width, camera.height_px], 2)
            boxes[cut] = np.where(np.isnan(within), np.clip(boxes[cut], 0, size), within)
        extents.append(_OUTWARD * boxes)
        above_foot = (height > FOOT_HEIGHT * data.sizes[:, 2:] + 1e-4)[..., None]
        low = np.where(above_foot, np.inf, pixels).min(axis=1)
        high = np.where(above_foot, -np.inf, pixels).max(axis=1)
        feet.append((low[:, 0], high[:, 0], high[:, 1]))
    visible = _OUTWARD * data.boxes
    beyond = np.maximum(visible - np.maximum(*extents), 0.0)
    within = np.maximum(np.minimum(*extents) - visible, 0.0)
    sides = beyond - np.where(data.hidden, 0.0, within)
    (left, right, bottom), (left_2, right_2, bottom_2) = feet
    u, v = data.contacts.T
    horizontal = _distance_from_interval(u, np.minimum(left, left_2), np.maximum(right, right_2))
    vertical = _distance_from_interval(
        v, np.minimum(bottom, bottom_2), np.maximum(bottom, bottom_2)
    )
    contact = np.nan_to_num(
        np.column_stack([horizontal, vertical]), nan=0.0, posinf=0.0, neginf=0.0
    )
    return np.concatenate([sides, contact], axis=1)


def nearest_boxes(data: FitData, x: Float[np.ndarray, " u"]) -> Float[np.ndarray, "n 4"]:
    """Return the box of each projected outline (x0, y0, x1, y1) that is nearest to the 2D box [px].

    Where the outline is not known, its sides lie anywhere between those of the smallest and of the
    largest outline. A hidden side agrees with every outline that extends beyond it.
    """
    return data.boxes - _OUTWARD * outline_residuals(data, x)[:, :4]


def to_camera_frame(
    data: FitData,
    camera: Camera,
    values: Float[np.ndarray, "n 7"],
    points: Float[np.ndarray, "k m 3"],
    rows: Int[np.ndarray, " k"],
) -> tuple[Float[np.ndarray, "k m 3"], Float[np.ndarray, "k m"]]:
    """Return points of the objects `rows` in the camera frame, and heights above the lowest [m]."""
    values, tilts = values[rows], data.tilts[rows][:, None]
    sizes = (data.sizes[rows] * np.exp(np.clip(values[:, 3:6], -3, 3)))[:, None]
    local = rotate(tilts, points * sizes)
    low = rotate(tilts, data.lowest[rows] * sizes)[..., 2].min(axis=1)
    height = local[..., 2] - low[:, None]
    c, s = np.cos(values[:, 6])[:, None], np.sin(values[:, 6])[:, None]
    world = np.stack(
        [c * local[..., 0] - s * local[..., 1], s * local[..., 0] + c * local[..., 1], height],
        -1,
    )
    return (world + values[:, None, :3] - camera.position()) @ camera.axes(), height


def cut_surfaces(data: FitData, silhouettes: Sequence[Silhouette]) -> tuple[CutSurfaces, ...]:
    """Return the surfaces of the first objects that the picture's border may cut; see `FitData`.

    At most MAX_CUT objects are included. For the others, sides at the border are ignored.
    """
    rows = [i for i in range(len(data.objects)) if _may_be_cut(data, i)][:MAX_CUT]
    inner = {i: hull_wireframe(silhouettes[i].inner) for i in rows}
    outer = {i: hull_wireframe(silhouettes[i].outer) for i in rows}
    return (stack_surfaces(inner), stack_surfaces(outer)) if rows else ()


def _may_be_cut(data: FitData, index: int) -> bool:
    """Return True if an object's 2D box or its initial outline reaches the border."""
    camera, rows = data.tree.camera, np.array([index])
    size = np.array([camera.width, camera.height_px], float)
    pixels = [data.boxes[index].reshape(2, 2)]
    for points in (data.inner, data.outer):
        view, _ = to_camera_frame(data, camera, data.values, points[rows], rows)
        pixels.append(_projected(camera, view).reshape(-1, 2))
    ends, edge = np.concatenate(pixels), EDGE * size.max()
    return bool((ends <= edge).any() or (ends >= size - edge).any())


def _projected(camera: Camera, view: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 2"]:
    """Return the pixels of points in the camera frame."""
    pixels = view[..., :2] / np.maximum(view[..., 2:], NEAR_M) * camera.focal
    return pixels + camera.center


def _distance_from_interval(
    value: Float[np.ndarray, " n"], low: Float[np.ndarray, " n"], high: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Return the signed distances of values from an interval; 0 within it."""
    return np.maximum(value - high, 0.0) - np.maximum(low - value, 0.0)


STEP = 1e-7
"""Step of finite differences, in the unit of each unknown."""
DEAD_ZONE = 1.0
"""Largest residual of a side that has no effect, in standard deviations."""


@dataclass(frozen=True)
class FitProblem:
    """Residuals as functions of the unknowns of a `FitData`."""

    data: FitData
    follow: Float[np.ndarray, "n 3"]
    """Fraction of the parent's motion along x, y, z with which an object's prior position moves."""
    offsets: Float[np.ndarray, "n 3"]
    """Prior positions [m] relative to `anchors`."""

    def free(self, fixed: Bool[np.ndarray, " n"], *, camera: bool) -> Int[np.ndarray, " f"]:
        """Return the indices of the unknowns to solve for.

        Args:
            fixed: True for objects that do not move.
            camera: True if the camera may move.
        """
        data = self.data
        free = np.ones((len(data.objects), 7), bool)
        free[data.round | data.normals.any(axis=1), 6] = False
        free[fixed] = False
        return np.flatnonzero(np.concatenate([np.full(CAMERA, camera), free.ravel()]))

    def position_deviations(self, values: Float[np.ndarray, "n 7"]) -> Float[np.ndarray, "n 3"]:
        """Return the differences from the prior positions, in standard deviations."""
        offset = values[:, :3] - _anchors(self.data, self.follow, values) - self.offsets
        return np.einsum("nij,nj->ni", self.data.whitening, offset)

    def residuals(self, x: Float[np.ndarray, " u"]) -> Float[np.ndarray, " r"]:
        """Return all residuals, divided by their standard deviations and with a soft L1 loss.

        Residuals of the picture below `DEAD_ZONE` are 0, so objects that agree with the picture do
        not move. The soft L1 loss limits the effect of outliers among boxes and parsed values. The
        prior of the camera has a quadratic loss instead, so no single object moves the camera far.
        """
        data = self.data
        _, values = data.unpack(x)
        pixels = outline_residuals(data, x)
        sd = np.concatenate([data.side_sd, data.side_sd[:, [0, 1]]], axis=1)
        picture = np.sign(pixels) * np.maximum(np.abs(pixels) / sd - DEAD_ZONE, 0.0)
        log_sizes = values[:, 3:6]
        scale = log_sizes.mean(axis=1, keepdims=True)
        return np.concatenate(
            [
                _soft_l1(picture).ravel(),
                x[:CAMERA],
                _soft_l1(self.position_deviations(values)).ravel(),
                _soft_l1(scale / data.scale_sd[:, None]).ravel(),
                _soft_l1((log_sizes - scale) / data.edge_sd).ravel(),
                _soft_l1((values[:, 6] - data.values[:, 6]) / data.yaw_sd),
            ]
        )

    def costs(self, x: Float[np.ndarray, " u"]) -> Float[np.ndarray, " n_1"]:
        """Return the sum of squared residuals of each object, followed by that of the camera."""
        n = len(self.data.objects)
        return np.bincount(self._owners() % (n + 1), self.residuals(x) ** 2, n + 1)

    def jacobian(self, x: Float[np.ndarray, " u"]) -> Float[np.ndarray, "r u"]:
        """Return the derivative of the residuals by forward differences.

        An object's residuals depend only on the unknowns of the object, of its parent and of the
        camera. One finite difference can therefore perturb all objects whose depths in the tree
        have the same parity.
        """
        residuals = self.residuals(x)
        jacobian = np.zeros((len(residuals), len(x)))
        for k in range(CAMERA):
            perturbed = x.copy()
            perturbed[k] += STEP
            jacobian[:, k] = (self.residuals(perturbed) - residuals) / STEP
        owners = self._owners()
        parents = np.where(owners >= 0, self.data.parents[owners], -1)
        for parity in (0, 1):
            group = self.data.levels % 2 == parity
            moved = np.where((parents >= 0) & group[parents], parents, -1)
            moved = np.where((owners >= 0) & group[owners], owners, moved)
            rows = np.flatnonzero(moved >= 0)
            for k in range(7):
                perturbed = x.copy()
                perturbed[CAMERA + 7 * np.flatnonzero(group) + k] += STEP
                change = (self.residuals(perturbed) - residuals) / STEP
                jacobian[rows, CAMERA + 7 * moved[rows] + k] = change[rows]
        return jacobian

    def _owners(self) -> Int[np.ndarray, " r"]:
        """Return the object index of each row of `residuals`; -1 for rows of the camera."""
        n = len(self.data.objects)
        owners = np.concatenate([np.arange(n).repeat(count) for count in (6, 3, 1, 3, 1)])
        return np.insert(owners, 6 * n, [-1] * CAMERA)

    def tree(self, x: Float[np.ndarray, " u"], fixed: Bool[np.ndarray, " n"]) -> SceneTree:
        """Return the tree at `x`, with lengths rounded to 10 um and angles rounded to 1e-5 rad.

        Args:
            x: values of the unknowns.
            fixed: True for objects that stay exactly as in the initial tree.
        """
        data = self.data
        camera, values = data.unpack(x)
        boxes = {}
        for i, node in enumerate(data.objects):
            if fixed[i] or np.allclose(values[i], data.values[i], rtol=0, atol=1e-6):
                continue
            size = np.array(node.box3d.size) * np.exp(values[i, 3:6])
            boxes[node.name] = Box3D(
                position=tuple(np.round(values[i, :3], 5).tolist()),
                size=tuple(np.maximum(np.round(size, 5), 1e-5).tolist()),
                yaw=round(math.remainder(values[i, 6], 2 * math.pi), 5),
            )
        old = data.tree.camera
        camera_update = {
            name: round(getattr(camera, name), 5)
            for name in ("pitch", "height")
            if abs(getattr(camera, name) - getattr(old, name)) > 1e-6
        }
        nodes = tuple(
            node.model_copy(update={"box3d": boxes[node.name]}) if node.name in boxes else node
            for node in data.tree.nodes
        )
        return data.tree.model_copy(
            update={"camera": old.model_copy(update=camera_update), "nodes": nodes}
        )


def outline_data(tree: SceneTree, objects: Sequence[TreeNode]) -> FitData:
    """Return the data of objects, parents first, with the outlines of their categories."""
    silhouettes = [silhouette_of(node) for node in objects]
    data = object_data(tree, objects, silhouettes)
    return replace(data, cut=cut_surfaces(data, silhouettes))


def fit_problem(tree: SceneTree, objects: Sequence[TreeNode]) -> FitProblem:
    """Set up the fit of some objects of a tree.

    Args:
        tree: the parsed scene.
        objects: the nodes to fit, parents first.
    """
    data = outline_data(tree, objects)
    # The picture determines the position of a visible object. A hidden object and the content of a
    # container follow their parents.
    inside = np.array([node.relation == "in" for node in objects])
    follow_xy = np.where(inside, 1.0, data.hidden.mean(axis=1))
    follow = np.column_stack([follow_xy, follow_xy, np.ones(len(objects))])
    offsets = data.values[:, :3] - _anchors(data, follow, data.values)
    offsets[:, 2] += [_prior_lift(tree, node) for node in objects]
    # The prior position is inside a container, even if the parsed position is not.
    supported = data.parents >= 0
    offsets[supported, :2] += np.array([shift_inside(tree, node) for node in objects])[supported]
    return FitProblem(data, follow, offsets)


def _anchors(
    data: FitData, follow: Float[np.ndarray, "n 3"], values: Float[np.ndarray, "n 7"]
) -> Float[np.ndarray, "n 3"]:
    """Return the points [m] to which prior positions are relative.

    For an object on another fitted object, the point is on top of its parent, multiplied by
    `follow`. For an object on the environment, it is the world's origin.
    """
    parents = data.parents
    height_scale = np.exp(values[parents, 5])
    top = values[parents, :3].copy()
    top[:, 2] += height_scale * data.sizes[parents, 2]
    return np.where(parents[:, None] >= 0, follow * top, 0.0)


def _prior_lift(tree: SceneTree, node: TreeNode) -> float:
    """Return the prior height of an object above its parsed height [m].

    An object on a slab of the environment is at the slab's top. Elsewhere, an object may be at any
    depth within its parent, which may be hollow. Attached and leaning objects keep their height.
    """
    if node.parent is None or node.relation in ("attached", "leaning"):
        return 0.0
    parent = tree.node(node.parent)
    gap = node.box3d.position[2] - parent.box3d.position[2] - parent.box3d.size[2]
    if rests_on_slab(tree, node):
        return -gap
    return float(np.clip(gap, -parent.box3d.size[2], 0.0)) - gap


def _soft_l1(residual: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Return residuals whose squares grow like r^2 near 0 and like 2 |r| far from 0 (soft L1)."""
    return residual * np.sqrt(2.0 / (np.sqrt(1.0 + residual**2) + 1.0))
