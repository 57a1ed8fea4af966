"""Rasterization of triangle meshes: the object and the depth at every pixel.

Unlike the ray caster of `render`, the rasterizer needs no compiled model. A scene can therefore be
rendered again after every change of a pose or a size.
"""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import find_objects

from ..spec import Camera, SceneSpec, world_poses
from .scene_images import visible_surface

NEAR_M = 0.02
"""Least depth [m]; triangles with a corner at a smaller depth are not rendered."""
CHUNK = 1 << 21
"""Number of pixels that are rendered at once; it bounds the memory."""
LEAST_AREA = 1e-12
"""Triangles of less than half this area [px^2] are not rendered."""


class WorldMesh(NamedTuple):
    """A triangle mesh in the world frame."""

    vertices: Float[np.ndarray, "v 3"]
    """[m]"""
    triangles: Int[np.ndarray, "t 3"]


class DrawnObjects(NamedTuple):
    """Nearest object at each pixel."""

    owner: Int[np.ndarray, "row column"]
    """Index of the mesh; -1 for none."""
    depth: Float[np.ndarray, "row column"]
    """Depth along the view [m]; inf for none."""


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
    corners, owners = [], []
    for k, mesh in enumerate(meshes):
        pixels, depth = pixels_of(camera, mesh.vertices, width)
        ahead = (depth > NEAR_M)[mesh.triangles].all(axis=1)
        rows = mesh.triangles[ahead]
        inverse = 1.0 / np.maximum(depth, NEAR_M)
        corners.append(np.concatenate([pixels, inverse[:, None]], axis=1)[rows].reshape(-1, 3, 3))
        owners.append(np.full(len(rows), k))
    triangle, owner = np.concatenate(corners), np.concatenate(owners)
    nearest = np.zeros(width * height)
    first = np.full(width * height, -1)
    spans = _spans(triangle, width, height)
    # Chunks bound the memory; each ends with a whole span.
    chunk = np.cumsum(spans.length) // CHUNK
    for start, stop in itertools.pairwise([0, *(np.flatnonzero(np.diff(chunk)) + 1), len(chunk)]):
        pixel, inverse, row = _covered(_Spans(*(part[start:stop] for part in spans)), width)
        np.maximum.at(nearest, pixel, inverse)
        front = inverse >= nearest[pixel]
        first[pixel[front]] = row[front]
    shape = (height, width)
    with np.errstate(divide="ignore"):
        depth = np.where(first >= 0, 1.0 / nearest, np.inf)
    # At pixels without a triangle, the index -1 selects the appended -1.
    return DrawnObjects(np.append(owner, -1)[first].reshape(shape), depth.reshape(shape))


class _Spans(NamedTuple):
    """Runs of adjacent pixels in a row of the image, each covered by one triangle."""

    triangle: Int[np.ndarray, " n"]
    """Index of the triangle."""
    line: Int[np.ndarray, " n"]
    """Row of the image."""
    start: Int[np.ndarray, " n"]
    """First column."""
    length: Int[np.ndarray, " n"]
    """Number of pixels, at least one."""
    inverse: Float[np.ndarray, " n"]
    """Inverse depth at the first pixel [1/m]."""
    slope: Float[np.ndarray, " n"]
    """Change of the inverse depth from one pixel to the next [1/m]."""


def _spans(triangle: Float[np.ndarray, "t 3 3"], width: int, height: int) -> _Spans:
    """Return the runs of pixels whose centers are inside triangles.

    Args:
        triangle: corners as (column, row, inverse depth); columns and rows in pixels, inverse
            depths in 1/m. The inverse depth is linear in the image.
        width: width of the image [px].
        height: height of the image [px].
    """
    order = np.lexsort((triangle[..., 0], triangle[..., 1]), axis=1)
    # Edges run downward, so two triangles with a common edge end at the same pixels.
    top, middle, bottom = np.take_along_axis(triangle, order[..., None], axis=1).transpose(1, 2, 0)
    left, right = middle - top, bottom - top
    area = left[0] * right[1] - right[0] * left[1]
    flat = np.abs(area) < LEAST_AREA
    area = np.where(flat, np.inf, area)
    slope_x = (left[2] * right[1] - right[2] * left[1]) / area
    slope_y = (left[0] * right[2] - right[0] * left[2]) / area
    # Pixel centers are at half-integers.
    low, high = (np.clip(y[1] - 0.5, -1, height) for y in (top, bottom))
    low, high = np.ceil(low).clip(0).astype(int), np.floor(high).clip(max=height - 1).astype(int)
    t, line = _runs(low, np.where(flat, 0, high - low + 1))
    y = line + 0.5
    x0, y0, _ = top[:, t]
    x1, y1, _ = middle[:, t]
    x2, y2, _ = bottom[:, t]
    long = _crossing(x0, y0, x2, y2, y)
    short = np.where(y < y1, _crossing(x0, y0, x1, y1, y), _crossing(x1, y1, x2, y2, y))
    start = np.ceil(np.clip(np.minimum(long, short) - 0.5, 0, width)).astype(int)
    stop = np.floor(np.clip(np.maximum(long, short) - 0.5, -1, width - 1)).astype(int)
    inverse = top[2, t] + slope_x[t] * (start + 0.5 - x0) + slope_y[t] * (y - y0)
    full = stop >= start
    parts = t, line, start, stop - start + 1, inverse, slope_x[t]
    return _Spans(*(part[full] for part in parts))


def _crossing(
    x0: np.ndarray, y0: np.ndarray, x1: np.ndarray, y1: np.ndarray, y: np.ndarray
) -> np.ndarray:
    """Return the columns at which edges cross rows; a horizontal edge crosses at its start."""
    height = y1 - y0
    share = np.divide(y - y0, height, out=np.zeros_like(y), where=height > 0)
    return x0 + share * (x1 - x0)


def _covered(
    spans: _Spans, width: int
) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Return the pixels of all spans, their inverse depths [1/m] and their triangles."""
    row, offset = _runs(np.zeros(len(spans.length), int), spans.length)
    pixel = (spans.line * width + spans.start)[row] + offset
    inverse = spans.inverse[row] + spans.slope[row] * offset
    return pixel, inverse, spans.triangle[row]


def _runs(
    start: Int[np.ndarray, " n"], count: Int[np.ndarray, " n"]
) -> tuple[Int[np.ndarray, " m"], Int[np.ndarray, " m"]]:
    """Return runs of `count` consecutive integers: the index of the run, and the integer."""
    count = np.maximum(count, 0)
    row = np.repeat(np.arange(len(count)), count)
    first = np.cumsum(count) - count
    return row, np.arange(len(row)) - first[row] + start[row]
