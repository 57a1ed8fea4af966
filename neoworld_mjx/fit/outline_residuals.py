"""Residuals of projected outlines: distances [px] from the 2D boxes and contacts."""

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float, Int

from ..spec import Camera
from ..spec.pose import rotate
from .fit_data import FitData
from .projection import NEAR_M, Silhouette
from .visible_sides import EDGE
from .wireframe import (
    CutSurfaces,
    Wireframe,
    extents_in_picture,
    hull_wireframe,
    near_border,
    stack_surfaces,
)

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
        if k == 1 and data.cut:
            rows_alike = np.setdiff1d(data.cut[0].rows, data.cut[1].rows)
            boxes[rows_alike] = _OUTWARD * extents[0][rows_alike]
        if data.cut and len(cut := data.cut[k].rows):
            points = data.cut[k].points
            view, _ = to_camera_frame(data, camera, values, points, cut)
            within = extents_in_picture(camera, view, data.cut[k].edges, data.cut[k].owners)
            size = np.tile([camera.width, camera.height_px], 2)
            boxes[cut] = np.where(np.isnan(within), np.clip(boxes[cut], 0, size), within)
        extents.append(_OUTWARD * boxes)
        above_foot = (height > FOOT_HEIGHT * data.heights[:, None] + 1e-4)[..., None]
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


def outline_agreements(data: FitData, x: Float[np.ndarray, " u"]) -> Float[np.ndarray, " n"]:
    """Return the intersection over union of each projected outline and 2D box, from 0 to 1.

    A hidden side agrees with every outline that extends beyond it.
    """
    outward = _OUTWARD * data.boxes
    projected = _OUTWARD * (outward - outline_residuals(data, x)[:, :4])
    low = np.maximum(projected[:, :2], data.boxes[:, :2])
    high = np.minimum(projected[:, 2:], data.boxes[:, 2:])
    shared = np.prod(np.maximum(high - low, 0.0), axis=1)
    areas = [np.prod(np.maximum(b[:, 2:] - b[:, :2], 0.0), axis=1) for b in (projected, data.boxes)]
    return shared / np.maximum(sum(areas) - shared, 1e-9)


def to_camera_frame(
    data: FitData,
    camera: Camera,
    values: Float[np.ndarray, "n 7"],
    points: Float[np.ndarray, "k m 3"],
    rows: Int[np.ndarray, " k"],
) -> tuple[Float[np.ndarray, "k m 3"], Float[np.ndarray, "k m"]]:
    """Return points of the objects `rows` in the camera frame, and heights above the lowest [m]."""
    values, tilts = values[rows], data.tilts[rows][:, None]
    log_sizes = data.log_sizes(values, rows)
    sizes = (data.sizes[rows] * np.exp(np.clip(log_sizes, -3, 3)))[:, None]
    local = rotate(tilts, points * sizes)
    low = rotate(tilts, data.lowest[rows] * sizes)[..., 2].min(axis=1)
    height = local[..., 2] - low[:, None]
    c, s = np.cos(values[:, 6])[:, None], np.sin(values[:, 6])[:, None]
    world = np.stack(
        [c * local[..., 0] - s * local[..., 1], s * local[..., 0] + c * local[..., 1], height],
        -1,
    )
    return (world + values[:, None, :3] - camera.position()) @ camera.axes(), height


def cut_surfaces(
    data: FitData, shapes: Mapping[str, Wireframe], silhouettes: Sequence[Silhouette]
) -> tuple[CutSurfaces, ...]:
    """Return the surfaces of the first objects that the picture's border may cut; see `FitData`.

    At most MAX_CUT objects are included. For the others, sides at the border are ignored.
    """
    rows = itertools.islice((i for i in range(len(data.objects)) if _may_be_cut(data, i)), MAX_CUT)
    smallest: dict[int, Wireframe] = {}
    largest: dict[int, Wireframe] = {}
    for i in rows:
        if shape := shapes.get(data.objects[i].name):
            smallest[i] = _trimmed(data, i, shape)
        else:
            smallest[i] = hull_wireframe(silhouettes[i].inner)
            largest[i] = hull_wireframe(silhouettes[i].outer)
    return (stack_surfaces(smallest), stack_surfaces(largest)) if smallest else ()


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


def _trimmed(data: FitData, index: int, frame: Wireframe) -> Wireframe:
    """Return the wireframe of a cut object, without edges that cannot determine its visible box."""
    camera, rows = data.tree.camera, np.array([index])
    view, _ = to_camera_frame(data, camera, data.values, frame.points[None], rows)
    edges = near_border(camera, view[0], frame.edges)
    used, renumbered = np.unique(edges, return_inverse=True)
    return Wireframe(frame.hull, frame.points[used], renumbered.reshape(-1, 2))


def _projected(camera: Camera, view: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 2"]:
    """Return the pixels of points in the camera frame."""
    pixels = view[..., :2] / np.maximum(view[..., 2:], NEAR_M) * camera.focal
    return pixels + np.array([camera.width, camera.height_px]) / 2


def _distance_from_interval(
    value: Float[np.ndarray, " n"], low: Float[np.ndarray, " n"], high: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Return the signed distances of values from an interval; 0 within it."""
    return np.maximum(value - high, 0.0) - np.maximum(low - value, 0.0)
