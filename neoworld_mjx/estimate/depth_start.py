"""Initial values of the alignment by a depth image: supports and objects at measured places."""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..evidence.depth_image import sensor_sd
from ..measure import iou_2d
from ..render.rasterize import WorldMesh, draw_objects, window_of
from ..spec import Camera, SceneObject, SceneSpec
from .rows.depth import LEAST_M, LEAST_PIXELS, MOST_PIXELS, UPWARD, SceneDepth, eroded
from .unknowns import Unknowns

NEAR_M, NEAR = 0.01, 0.01
"""Difference of two depths up to which they agree: a constant [m], plus a share of the depth."""
LOG_RATIO = 0.15
"""Logarithm of a factor of the distance at which the score of a place is halved."""
FARTHEST_M, AGREEING = 0.5, 0.5
"""Largest shift of a fixed support [m], and the least share of its pixels that must agree on it."""
LEVEL_M = 0.02
"""Height up to which the top of a support is the plane z = 0 [m]. The height of the camera, not the
support, is then unknown."""
LEAST_SCORE = 0.1
"""Score above which a place counts as measured."""
MIDDLE = 0.5
"""Share of the width and height of a 2D box whose middle is assumed to show the object."""


PLANE_M, TILTED = 3.0, math.radians(30.0)
"""Distance of a point of a plane, in standard deviations of the sensor, and the largest angle
between the plane and the composed one [rad]."""
TRIES = 300
"""Number of planes through three random points."""


class SupportPlane(NamedTuple):
    """Camera that the plane of a support determines."""

    pitch: float
    """[rad]"""
    roll: float
    """[rad]"""
    height: float
    """Above z = 0 [m]."""


def support_plane(depth: SceneDepth) -> SupportPlane | None:
    """Return the camera by the plane of the measured points of the largest support, by RANSAC.

    Args:
        depth: metric depth of the rendered scene.

    Returns:
        The camera; None if no support has enough points, or if they are in no plane that is almost
        level in the composed scene.
    """
    supports = [k for k in range(len(depth.unknowns.scene.objects)) if depth.is_support(k)]
    areas = [int((depth.shown(k) & depth.level & depth.usable).sum()) for k in supports]
    if not areas or max(areas) < MOST_PIXELS:
        return None
    k = supports[int(np.argmax(areas))]
    used = depth.shown(k) & depth.level & depth.usable
    points = depth.rays[used] * depth.measured.depth[used][:, None]
    camera = depth.now.camera
    up, tolerance = camera.axes()[2], PLANE_M * sensor_sd(points[:, 2]) + LEAST_M
    rng = np.random.default_rng(0)
    best, most = None, AGREEING * len(points)
    for rows in rng.integers(len(points), size=(TRIES, 3)):
        a, b, c = points[rows]
        normal = np.cross(b - a, c - a)
        length = float(np.linalg.norm(normal))
        if length < 1e-9 or abs(normal @ up) < math.cos(TILTED) * length:
            continue
        inliers = np.abs((points - a) @ normal) < tolerance * length
        if inliers.sum() > most:
            best, most = inliers, int(inliers.sum())
    if best is None:
        return None
    center = points[best].mean(axis=0)
    normal = np.linalg.svd(points[best] - center, full_matrices=False)[2][2]
    normal = normal * np.sign(normal @ up)
    world = depth.now.camera.position() + depth.drawn_points(used) @ camera.axes().T
    top = float(np.median(world[:, 2]))
    pitch = math.asin(float(np.clip(-normal[2], -1, 1)))
    roll = math.atan2(-float(normal[0]), -float(normal[1]))
    return SupportPlane(pitch, roll, top - float(normal @ center))


class MeasuredPlace(NamedTuple):
    """Place of an object, in the camera's frame, and the factor of its size."""

    origin: Float[np.ndarray, " 3"]
    """[m]"""
    ratio: float


def place_by_depth(depth: SceneDepth, k: int) -> MeasuredPlace | None:
    """Return the place and size of an object that its 2D box and its depth suggest.

    Candidates keep the drawn outline at the drawn or at the measured distance, or fill the 2D box
    at the distance measured in its middle. The one that agrees best with 2D box and depth is
    returned; see `_score`.

    Args:
        depth: depth of the rendered scene.
        k: index of the object.

    Returns:
        The place; None if too few of its pixels are measured, or agree with no place.
    """
    unknowns, now = depth.unknowns, depth.now
    mesh = unknowns.mesh(now, k)
    eye, axes = now.camera.position(), now.camera.axes()
    vertices = (mesh.vertices - eye) @ axes
    origin = (now.pos[k] - eye) @ axes
    candidates = [MeasuredPlace(origin, 1.0)]
    shown, box = depth.shown(k), depth.box(k)
    if box is not None:
        inside = np.zeros_like(shown)
        inside[_window(box, shown.shape)] = True
        shown = shown & inside if (shown & inside).sum() >= LEAST_PIXELS else shown
    if shown.sum() >= LEAST_PIXELS:
        used = eroded(shown) & np.isfinite(depth.measured.depth)
        if used.sum() >= LEAST_PIXELS:
            ratio = float(np.median((depth.measured.depth / depth.drawn.depth)[used]))
            candidates.append(MeasuredPlace(ratio * origin, ratio))
    if box is not None and vertices[:, 2].min() > 0:
        filled = _filling(depth, box, vertices, origin)
        if filled is not None:
            candidates.append(filled)
    scores = [_score(depth, box, k, mesh, place) for place in candidates]
    best = int(np.argmax(scores))
    return candidates[best] if len(candidates) > 1 and scores[best] > LEAST_SCORE else None


def _window(box: Float[np.ndarray, " 4"], shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Return the rows and columns of an image that a box touches."""
    (left, top), (right, bottom) = np.floor(box[:2]).astype(int), np.ceil(box[2:]).astype(int)
    rows = slice(max(int(top), 0), min(int(bottom), shape[0]))
    return rows, slice(max(int(left), 0), min(int(right), shape[1]))


def _filling(
    depth: SceneDepth,
    box: Float[np.ndarray, " 4"],
    vertices: Float[np.ndarray, "n 3"],
    origin: Float[np.ndarray, " 3"],
) -> MeasuredPlace | None:
    """Return the place at which an object fills its 2D box, at the depth in the box's middle."""
    camera, columns = depth.now.camera, depth.drawn.owner.shape[1]
    center, half = (box[:2] + box[2:]) / 2, (box[2:] - box[:2]) / 2
    middle = np.concatenate([center - MIDDLE * half, center + MIDDLE * half])
    window = _window(middle, depth.drawn.owner.shape)
    values = depth.measured.depth[window]
    values = values[np.isfinite(values)]
    if len(values) < LEAST_PIXELS / 2:
        return None
    scale = camera.width / columns
    pixels = vertices[:, :2] / vertices[:, 2:] * camera.focal / scale
    drawn_low, drawn_high = pixels.min(axis=0), pixels.max(axis=0)
    # The larger of the two factors: an occluder shortens a box, and nothing lengthens it.
    zoom = float(np.max(2 * half / np.maximum(drawn_high - drawn_low, 1.0)))
    front = float(np.median(values))
    distance = front * origin[2] / max(float(np.quantile(vertices[:, 2], 0.25)), 1e-3)
    ratio = zoom * distance / origin[2]
    seen = (center * scale - camera.center) / camera.focal
    offset = (drawn_low + drawn_high) / 2 * scale / camera.focal
    shift = origin[:2] / origin[2] - offset
    place = np.append((seen + zoom * shift) * distance, distance)
    return MeasuredPlace(place, ratio)


def _score(
    depth: SceneDepth,
    box: Float[np.ndarray, " 4"] | None,
    k: int,
    mesh: WorldMesh,
    place: MeasuredPlace,
) -> float:
    """Return how well an object at a place agrees with its 2D box and the measured depths, 0 to 1.

    It is the intersection over union of the boxes times the share of pixels at the measured depth.
    A pixel counts half if something nearer is measured, and not at all if something farther is.
    """
    now, (_, columns) = depth.now, depth.drawn.owner.shape
    eye, axes = now.camera.position(), now.camera.axes()
    local = (mesh.vertices - now.pos[k]) * place.ratio + eye + axes @ place.origin
    drawn = draw_objects([WorldMesh(local, mesh.triangles)], now.camera, columns)
    shown = (drawn.owner == 0) & np.isfinite(depth.measured.depth)
    if shown.sum() < LEAST_PIXELS / 2:
        return 0.0
    gap = (depth.measured.depth - drawn.depth)[shown]
    tolerance = NEAR_M + (NEAR + 2 * depth.image.smooth_sd) * drawn.depth[shown]
    share = float(np.mean(np.abs(gap) <= tolerance) + 0.5 * np.mean(gap < -tolerance))
    prior = 1 / (1 + (math.log(place.ratio) / LOG_RATIO) ** 2)
    if box is None:
        return prior * share
    visible = shown.copy()
    visible[shown] = np.abs(gap) <= 3 * tolerance
    if not visible.any():
        return 0.0
    rows, cols = window_of(visible)
    return prior * share * iou_2d((cols.start, rows.start, cols.stop, rows.stop), box)


def moved_to(
    unknowns: Unknowns, place: MeasuredPlace, k: int, x: Float[np.ndarray, " u"]
) -> Float[np.ndarray, " 4"]:
    """Return the unknowns with which an object is at a measured place, at its supported height.

    Supports of the environment keep their size: the height of the camera refers to their top.

    Args:
        unknowns: the unknowns.
        place: the place.
        k: index of the object.
        x: values of the unknowns, with those of the camera and of the object's supports.
    """
    now, values = unknowns.place(x[None])[0], x[unknowns.columns(k)].copy()
    target = now.camera.position() + now.camera.axes() @ place.origin
    values[:2] += unknowns.in_support_frame(k, (target - now.pos[k])[:2])
    if not unknowns.scene.objects[k].environment:
        values[3] += math.log(place.ratio)
    return values


def with_places_kept(scene: SceneSpec, before: SceneDepth, after: Camera) -> SceneSpec:
    """Return the scene with raised roots at their measured places, seen by another camera.

    Roots whose top is at z = 0, and those of which no level face is measured, stay.

    Args:
        scene: the composed scene.
        before: its depth, seen by its camera.
        after: the new camera.
    """
    items, now = list(scene.objects), before.now
    for k, item in enumerate(items):
        used = before.shown(k) & before.level & before.usable
        if item.parent is not None or used.sum() < LEAST_PIXELS:
            continue
        height = (now.camera.position() + before.drawn_points(used) @ now.camera.axes().T)[:, 2]
        if abs(float(np.median(height))) < LEVEL_M:
            continue
        ratio = float(np.median((before.measured.depth / before.drawn.depth)[used]))
        origin = ratio * (now.pos[k] - now.camera.position()) @ now.camera.axes()
        x, y, z = (np.subtract(after.position() + after.axes() @ origin, now.pos[k])).tolist()
        place = {"xy": (item.xy[0] + x, item.xy[1] + y), "z": item.z + z}
        items[k] = item.model_copy(update=place)
    return scene.model_copy(update={"objects": tuple(items)})


def with_measured_supports(scene: SceneSpec, depth: SceneDepth) -> SceneSpec:
    """Return the scene with walls and raised supports of the world at their measured places.

    A wall moves along its normal, another support moves up or down. Supports with the top at z = 0
    stay, because the height of the camera refers to them.

    Args:
        scene: the composed scene.
        depth: its metric depth, seen from the camera that other supports determine.
    """
    items = list(scene.objects)
    for k, item in enumerate(items):
        if item.parent is None:
            items[k] = _at_depth(item, k, depth)
    return scene.model_copy(update={"objects": tuple(items)})


def _at_depth(item: SceneObject, k: int, depth: SceneDepth) -> SceneObject:
    used = eroded(depth.shown(k)) & depth.usable
    if used.sum() < LEAST_PIXELS:
        return item
    axes = depth.now.camera.axes()
    normals = depth.normals[used] @ axes.T
    gap = (depth.measured.depth - depth.drawn.depth)[used]
    residual = gap * np.sum(depth.rays[used] * depth.normals[used], axis=1)
    upward = np.abs(normals[:, 2]) > UPWARD
    level = bool(upward.mean() > 0.5)
    chosen = upward if level else ~upward
    direction = normals[chosen]
    # Faces of one direction: the largest one.
    main = direction[np.argmax(direction @ direction.mean(axis=0))]
    same = direction @ main > UPWARD
    along = residual[chosen][same]
    shift = float(np.median(along))
    noise = max(0.02, 0.02 * float(np.median(depth.drawn.depth[used])))
    if abs(shift) > FARTHEST_M or np.mean(np.abs(along - shift) < noise) < AGREEING:
        return item
    if level:
        height = (depth.now.camera.position() + depth.drawn_points(used) @ axes.T)[:, 2]
        if abs(float(np.median(height))) < LEVEL_M:
            return item
        return item.model_copy(update={"z": item.z + shift * float(np.sign(main[2]))})
    x, y = item.xy
    across = shift * main[:2] / max(float(np.linalg.norm(main[:2])), 1e-6)
    return item.model_copy(update={"xy": (x + float(across[0]), y + float(across[1]))})
