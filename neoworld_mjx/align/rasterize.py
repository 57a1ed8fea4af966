"""Rasterization of triangle meshes: the object and the depth at every pixel.

Unlike the ray caster of `render`, the rasterizer needs no compiled model. A scene can therefore be
rendered again after every change of a pose or a size.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import find_objects

from ..render import visible_surface
from ..spec import Camera, SceneSpec, world_poses

NEAR_M = 0.02
"""Least depth [m]; triangles with a corner at a smaller depth are not rendered."""
CHUNK = 1 << 21
"""Largest number of pixels that are tested at once."""


class WorldMesh(NamedTuple):
    """A triangle mesh in the world frame."""

    vertices: Float[np.ndarray, "v 3"]
    """[m]"""
    triangles: Int[np.ndarray, "t 3"]
    face: Int[np.ndarray, " t"] | None = None
    """Index of the smooth face of each triangle, see `creases`; if None, there is a single face."""


def joined(meshes: Sequence[WorldMesh]) -> WorldMesh:
    """Return several meshes as one."""
    first = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return WorldMesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([m.triangles + start for m, start in zip(meshes, first, strict=False)]),
    )


class DrawnObjects(NamedTuple):
    """Nearest object at each pixel."""

    owner: Int[np.ndarray, "row column"]
    """Index of the mesh; -1 for none."""
    depth: Float[np.ndarray, "row column"]
    """Depth along the view [m]; inf for none."""
    body: Int[np.ndarray, "row column"] | None = None
    """Index of the nearest body, as defined in `open_joints`; -1 for none. If None, bodies are not
    distinguished."""
    face: Int[np.ndarray, "row column"] | None = None
    """Index of the nearest smooth face, see `creases`; -1 for none."""


def window_of(mask: Bool[np.ndarray, "row column"], reach: int = 0) -> tuple[slice, slice]:
    """Return the rows and columns of a nonempty mask, widened by `reach` pixels on each side."""
    rows, columns = find_objects(mask.astype(np.uint8))[0]
    widened = lambda span: slice(max(span.start - reach, 0), span.stop + reach)
    return widened(rows), widened(columns)


def pixels_of(
    camera: Camera, points: Float[np.ndarray, "n 3"], width: int
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " n"]]:
    """Project points to an image that is `width` pixels wide; return pixels and depths [m]."""
    pixels, depth = camera.project(points)
    return pixels * (width / camera.width), depth


def height_of(camera: Camera, width: int) -> int:
    """Return the height [px] of the camera's image scaled to `width`."""
    return max(1, round(camera.height_px * width / camera.width))


def draw_scene(scene: SceneSpec, camera: Camera, width: int) -> DrawnObjects:
    """Render the visible surfaces of a scene's objects; see `draw_objects`."""
    poses, meshes = world_poses(scene), []
    for item in scene.objects:
        vertices, triangles = visible_surface(item.spec, item.joint_state)
        meshes.append(WorldMesh(poses[item.name].apply(vertices), triangles))
    return draw_objects(meshes, camera, width)


def draw_objects(meshes: Sequence[WorldMesh], camera: Camera, width: int) -> DrawnObjects:
    """Render meshes with a depth buffer; both sides of a triangle are visible.

    Args:
        meshes: one for each object.
        camera: the camera.
        width: width of the image [px]; the height follows from the camera's aspect ratio.
    """
    height = height_of(camera, width)
    size = np.array([width, height])
    corners, owners, faces = [], [], []
    for k, mesh in enumerate(meshes):
        pixels, depth = pixels_of(camera, mesh.vertices, width)
        ahead = (depth > NEAR_M)[mesh.triangles].all(axis=1)
        rows = mesh.triangles[ahead]
        inverse = 1.0 / np.maximum(depth, NEAR_M)
        corners.append(np.concatenate([pixels, inverse[:, None]], axis=1)[rows].reshape(-1, 3, 3))
        owners.append(np.full(len(rows), k))
        faces.append(np.zeros(len(rows), int) if mesh.face is None else mesh.face[ahead])
    triangle, owner, face = (np.concatenate(part) for part in (corners, owners, faces))
    # Pixel centers are at half-integers.
    low = np.ceil(np.clip(triangle[..., :2].min(axis=1) - 0.5, 0, size)).astype(int)
    high = np.floor(np.clip(triangle[..., :2].max(axis=1) - 0.5, -1, size - 1)).astype(int)
    box = np.maximum(high - low + 1, 0)
    nearest = np.zeros(width * height)
    first = np.full(width * height, -1)
    powers = np.ceil(np.log2(np.maximum(box, 1))).astype(int)
    visible = (box > 0).all(axis=1)
    for tall in np.unique(powers[visible], axis=0):
        columns, lines = np.minimum(2**tall, size).tolist()
        group = np.flatnonzero(visible & (powers == tall).all(axis=1))
        step = max(1, CHUNK // (columns * lines))
        for start in range(0, len(group), step):
            rows = group[start : start + step]
            pixel, inverse, k = _covered(triangle[rows], low[rows], box[rows], columns, lines)
            spot = pixel[:, 1] * width + pixel[:, 0]
            np.maximum.at(nearest, spot, inverse)
            front = inverse >= nearest[spot]
            first[spot[front]] = rows[k[front]]
    shape = (height, width)
    with np.errstate(divide="ignore"):
        depth = np.where(first >= 0, 1.0 / nearest, np.inf)
    # At pixels without a triangle, the index -1 selects the appended -1.
    owner, face = (np.append(ids, -1)[first].reshape(shape) for ids in (owner, face))
    return DrawnObjects(owner, depth.reshape(shape), face=face)


def _covered(
    triangle: Float[np.ndarray, "t 3 3"],
    low: Int[np.ndarray, "t 2"],
    box: Int[np.ndarray, "t 2"],
    columns: int,
    lines: int,
) -> tuple[Int[np.ndarray, "n 2"], Float[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Return the pixels that triangles cover, the inverse depths, and the triangles' indices."""
    x = low[:, 0, None, None] + np.arange(columns)[None, None, :]
    y = low[:, 1, None, None] + np.arange(lines)[None, :, None]
    a, b, c = (triangle[:, k, :, None, None] for k in range(3))
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    safe = np.where(np.abs(area) < 1e-12, np.inf, area)
    u, v = x + 0.5, y + 0.5
    second = ((u - a[:, 0]) * (c[:, 1] - a[:, 1]) - (v - a[:, 1]) * (c[:, 0] - a[:, 0])) / safe
    third = ((b[:, 0] - a[:, 0]) * (v - a[:, 1]) - (b[:, 1] - a[:, 1]) * (u - a[:, 0])) / safe
    inside = (second >= 0) & (third >= 0) & (second + third <= 1) & np.isfinite(safe)
    inside &= (np.arange(columns) < box[:, 0, None])[:, None, :]
    inside &= (np.arange(lines) < box[:, 1, None])[:, :, None]
    inverse = a[:, 2] + second * (b[:, 2] - a[:, 2]) + third * (c[:, 2] - a[:, 2])
    k, line, column = np.nonzero(inside)
    pixel = np.stack([low[k, 0] + column, low[k, 1] + line], axis=1)
    return pixel, inverse[inside], k
