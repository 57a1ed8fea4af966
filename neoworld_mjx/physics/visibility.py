"""Visibility of objects in the photograph's camera, for populations of layouts.

Objects occlude one another, and the image border cuts them. Each object has a window, which is its
image box, clipped at the image border. Rays are cast through this window, so that small objects are
resolved as finely as large objects.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float
from neoworld_kernels.convex_pieces import ObjectPoses, dot, true_indices
from neoworld_kernels.first_hits import (
    ConvexRows,
    Rays,
    first_hits,
    flat_rows,
    image_boxes,
    round_rows,
)

from .array_types import AnyArray
from .layout import Poses, rotation
from .scene_arrays import SceneArrays

WINDOW_TILE, WINDOW_TILES = 8, 3
"""Number of cells along a side of a tile, and of tiles along a side of an object's window."""
GOLDEN = 0.618034
"""Shift of rays within cells from each row or column to the next, as a fraction of a cell, so that
an edge along the grid crosses cells at many positions."""
INSET = 0.01
"""Distance by which the rays through an object's extreme points are moved inward, relative to the
object's image box."""
LEAST_DEPTH_M = 1e-3
"""Depth [m] to which smaller depths are raised before a projection."""


class Outlines(eqx.Module):
    """Projections of whole objects, occluded or not."""

    boxes: Float[Array, "pop object 4"]
    """left, top, right, bottom relative to the image center [px]."""
    extremes: Float[Array, "pop object 4 2"]
    """Leftmost, topmost, rightmost and bottommost points (x, y) [px]."""
    middle: Float[Array, "pop object 2"]
    """Mean of the projected outline points [px]."""
    depth: Float[Array, "pop object"]
    """Depth of the center of each object's bounding box [m]."""


class Visible(eqx.Module):
    """Visible parts of objects."""

    boxes: Float[Array, "pop object 4"]
    """Boxes of the visible parts, relative to the image center [px]. The box of an invisible object
    has zero area."""
    outlines: Outlines


def outlines(scene: SceneArrays, poses: Poses) -> Outlines:
    """Project the outlines of objects into the image. Differentiable."""
    v = scene.photo
    poses = without_spin(scene, poses)
    turn = rotation(poses.quat) * poses.scale[..., None, None]
    offset = poses.pos - v.position
    # Sums of products, which XLA fuses with the minima: small matrix products are slow on CPUs.
    turn = dot([axis[:, None] for axis in v.axes], [turn[..., None, i, :] for i in range(3)])
    shift = dot(v.axes, [offset[..., None, i] for i in range(3)])

    def project(points: AnyArray) -> tuple[Array, Array, Array]:
        coordinates = [points[..., j] for j in range(3)]
        x, y, z = (
            dot([turn[..., None, k, j] for j in range(3)], coordinates) + shift[..., None, k]
            for k in range(3)
        )
        z = jnp.maximum(z, LEAST_DEPTH_M)
        return x / z * v.focal, y / z * v.focal, z

    x, y, _ = project(scene.outline)
    box, extremes = [], []
    for axis, least in ((0, True), (1, True), (0, False), (1, False)):
        along, other = (x, y) if axis == 0 else (y, x)
        side = along.min(axis=2) if least else along.max(axis=2)
        across = jnp.min(jnp.where(along == side[..., None], other, jnp.inf), axis=2)
        box.append(side)
        extremes.append(jnp.stack((side, across) if axis == 0 else (across, side), axis=-1))
    _, _, depth = project(jnp.mean(scene.corners, axis=1, keepdims=True))
    return Outlines(
        jnp.stack(box, axis=-1),
        jnp.stack(extremes, axis=2),
        jnp.stack([x.mean(axis=2), y.mean(axis=2)], axis=-1),
        depth[..., 0],
    )


def without_spin(scene: SceneArrays, poses: Poses) -> Poses:
    """Remove the rotations of round objects about their axes, since these are invisible."""
    w, x, y, z = jnp.moveaxis(poses.quat, -1, 0)
    square = w * w + z * z
    length = jnp.sqrt(jnp.where(square > 1e-12, square, 1.0))
    c, s = w / length, z / length
    swing = jnp.stack([w * c + z * s, x * c - y * s, y * c + x * s, z * c - w * s], axis=-1)
    undo = scene.round[:, None] & (square > 1e-12)[..., None]
    return eqx.tree_at(lambda p: p.quat, poses, jnp.where(undo, swing, poses.quat))


class _CameraScene(NamedTuple):
    placed: ObjectPoses
    families: list[ConvexRows]
    boxes: list[Float[Array, "row 5 pop"]]


def _in_camera_frame(scene: SceneArrays, poses: Poses) -> _CameraScene:
    v = scene.photo
    poses = without_spin(scene, poses)
    turn, offset = rotation(poses.quat), poses.pos - v.position
    rot = jnp.stack([dot(axis, [turn[..., i, :] for i in range(3)]) for axis in v.axes.T], axis=2)
    pos = jnp.stack([dot(axis, [offset[..., i] for i in range(3)]) for axis in v.axes.T], axis=2)
    placed = ObjectPoses(
        jnp.transpose(pos, (1, 2, 0)), jnp.transpose(rot, (1, 2, 3, 0)), jnp.asarray(poses.scale).T
    )
    families = [rows(scene.colliders) for rows in (flat_rows, round_rows)]
    boxes = [image_boxes(placed, f.owner, f.pos, f.rot, f.extent) for f in families]
    return _CameraScene(placed, families, boxes)


def _rows_in_window(
    camera_scene: _CameraScene, window: Float[Array, "4 pop"], behind: Any
) -> list[Array]:
    """Return masks of the rows that meet a window, in some candidate, and are not behind a depth.

    There is one mask for each family of rows. `behind` is an inverse depth [1/m].
    """
    masks = []
    for rows, box in zip(camera_scene.families, camera_scene.boxes, strict=True):
        meets = (box[:, 0] <= window[2]) & (box[:, 2] >= window[0])
        meets &= (box[:, 1] <= window[3]) & (box[:, 3] >= window[1]) & (box[:, 4] >= behind)
        masks.append(rows.used & jnp.any(meets, axis=1))
    return masks


def _grid() -> Float[np.ndarray, "2 tile cell"]:
    """Return the position of each cell's ray in the window, from 0 to 1, ordered by tiles."""
    n = WINDOW_TILE * WINDOW_TILES
    row, column = np.mgrid[:n, :n]
    x = (column + (0.5 + GOLDEN * row) % 1) / n
    y = (row + (0.5 + GOLDEN * column) % 1) / n
    tiles = np.stack([x, y]).reshape(2, WINDOW_TILES, WINDOW_TILE, WINDOW_TILES, WINDOW_TILE)
    return tiles.swapaxes(2, 3).reshape(2, WINDOW_TILES**2, -1).astype(np.float32)


def visibility(scene: SceneArrays, poses: Poses) -> Visible:
    """Return the visible part of each scored object.

    A side of a box is exact if the object itself or the image ends there. At an occluder, it is
    accurate to about a hundredth of the object's size. The result has no gradient. The function may
    be jitted and vmapped.
    """
    scene, poses = jax.tree.map(lax.stop_gradient, (scene, poses))
    return _visible_parts(scene, poses, outlines(scene, poses))


def _visible_parts(scene: SceneArrays, poses: Poses, projected: Outlines) -> Visible:
    focal = scene.photo.focal
    camera_scene = _in_camera_frame(scene, poses)
    population_last = lambda v: jnp.moveaxis(v, 0, -1) / focal
    full, extremes, middle = (
        population_last(projected.boxes),
        population_last(projected.extremes),
        population_last(projected.middle),
    )
    border = scene.photo.edges / focal
    low, high = jnp.tile(border[:2], 2)[:, None], jnp.tile(border[2:], 2)[:, None]
    least_inverse_depth = _least_inverse_depth(camera_scene, scene.count)
    grid = jnp.asarray(_grid())
    scored_indices, scored_count = true_indices(jnp.asarray(scene.photo.scored))
    pop = poses.scale.shape[0]

    def observe(i: Array, result: Array) -> Array:
        k = scored_indices[i]
        window = jnp.clip(full[k], low, high)
        window = window.at[2:].set(jnp.maximum(window[2:], window[:2] + 1e-6))
        span = window[2:] - window[:2]
        # Tiles of cells, followed by a block of rays just inside the four extreme points.
        size = full[k, 2:] - full[k, :2]
        inward = middle[k] - extremes[k]
        length = jnp.maximum(jnp.max(jnp.abs(inward) / jnp.maximum(size, 1e-6), axis=1), 1e-6)
        inner = extremes[k] + inward * jnp.minimum(INSET / length, 1.0)[:, None]
        tip_rays = jnp.repeat(inner, WINDOW_TILE * WINDOW_TILE // 4, axis=0)
        x, y = (
            jnp.concatenate([grid[a][..., None] * span[a] + window[a], tip_rays[None, :, a]])
            for a in range(2)
        )
        near = [
            rows & (scene.photo.occludes[family.owner] | (family.owner == k))
            for rows, family in zip(
                _rows_in_window(camera_scene, window, least_inverse_depth[k]),
                camera_scene.families,
                strict=True,
            )
        ]
        target = jnp.arange(scene.count) == k
        others, itself = first_hits(
            camera_scene.placed,
            camera_scene.families,
            near,
            Rays(x, y),
            target.astype(jnp.int32),
            2,
        )
        hit, shown = itself > 0, itself > others
        cells = shown[:-1]
        any_cell = jnp.any(cells, axis=(0, 1))
        extent = lambda v: [
            jnp.min(jnp.where(cells, v[:-1], jnp.inf), axis=(0, 1)),
            jnp.max(jnp.where(cells, v[:-1], -jnp.inf), axis=(0, 1)),
        ]
        (x0, x1), (y0, y1) = extent(x), extent(y)
        sampled = jnp.stack([x0, y0, x1, y1])
        cell = jnp.tile(span, (2, 1)) / (WINDOW_TILE * WINDOW_TILES)
        in_image = (full[k] >= low) & (full[k] <= high)
        tips = slice(None, None, WINDOW_TILE * WINDOW_TILE // 4)
        tip_visible, tip_hit = shown[-1][tips], hit[-1][tips]
        # If the ray misses a thin tip, the adjacent cells decide.
        by_cells = ~tip_hit & (jnp.abs(sampled - full[k]) < 1.5 * cell)
        ends_here = in_image & (tip_visible | by_cells)
        cut = ~in_image & (jnp.abs(sampled - window) < 1.5 * cell)
        box = jnp.where(ends_here | cut, window, sampled)
        any_visible = any_cell | jnp.any(tip_visible, axis=0)
        centre = jnp.tile(middle[k], (2, 1))
        box = jnp.where(any_visible & jnp.all(jnp.isfinite(box), axis=0), box, centre)
        return result.at[k].set(box)

    boxes = lax.fori_loop(0, scored_count, observe, jnp.zeros((scene.count, 4, pop)))
    return Visible(jnp.moveaxis(boxes, -1, 0) * focal, projected)


def _least_inverse_depth(camera_scene: _CameraScene, count: int) -> Float[Array, "object pop"]:
    """Return a lower bound of the inverse depth of every point of each object."""
    placed = camera_scene.placed
    least = jnp.full((count, placed.scale.shape[1]), jnp.inf)
    for rows in camera_scene.families:
        reach = jnp.sqrt(jnp.sum(jnp.max(rows.extent**2, axis=1), axis=1))
        center = rows.pos
        far = jnp.sqrt(jnp.sum(center**2, axis=1)) + reach
        depth = placed.pos[rows.owner, 2] + far[:, None] * placed.scale[rows.owner]
        inverse = jnp.where(rows.used[:, None], 1.0 / jnp.maximum(depth, LEAST_DEPTH_M), jnp.inf)
        least = least.at[rows.owner].min(inverse)
    return least
