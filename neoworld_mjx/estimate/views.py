"""Cameras of further photographs of a scene: their unknowns, and their start from 2D boxes.

A camera whose pose is unknown is first placed by the 2D boxes of the objects, as the first
photograph places these. Six unknowns then change it in the alignment: a translation along its axes
and a rotation vector about them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from ..evidence.file_camera import camera_angles
from ..evidence.further_photo import FurtherPhoto
from ..render import visible_surface
from ..spec import Camera, SceneSpec, world_poses

EACH_VIEW = 6
"""Number of unknowns of a further camera."""
FREE_M, FREE = 0.5, 0.5
"""Standard deviations of an unknown position, relative to the distance, and direction [rad]."""
POSE_M, POSE = 0.002, math.radians(0.2)
"""Standard deviations of a known relative pose: position [m] and direction [rad]."""
RELATIVE = 0.01
"""Standard deviation of a position in an unknown unit across its direction, relative to the
distance of the two cameras."""
STARTS = 24
"""Number of directions around the scene from which the search for a camera starts."""
REFINED = 12
"""Number of starts that are refined with the sides of boxes."""
SIDE_PX, SIDE = 3.0, 0.02
"""Standard deviation of a side of a 2D box: a constant, in pixels of an image REFERENCE_PX wide,
and a share of the box's size."""
REFERENCE_PX = 640.0
LEVEL, HIGHER, LOG_DISTANCE = math.radians(8.0), math.radians(20.0), 0.3
"""Prior standard deviations of a further camera: roll [rad], difference of pitch from that of the
first camera [rad], and logarithm of the distance relative to that of the first camera."""
BORDER_PX = 3.0
"""Distance from the border of the image within which a side of a box may be cut [px]."""
LEAST_OBJECTS = 3
"""Least number of objects from whose boxes an unknown pose is estimated."""
LARGEST_MEDIAN = 3.0
"""Median residual of the boxes' sides above which a pose is refused, in standard deviations. Of
thirty scenes with noise, right poses reach 2.4; the best poses for exchanged boxes begin at 3.5."""
POINTS = 64
"""Number of directions in which the extreme points of an object are used."""


@dataclass(frozen=True)
class ViewCamera:
    """Camera of a further photograph, as a function of the unknowns."""

    camera: Camera
    """The camera in the world frame where all unknowns are 0."""
    depth: float
    """Depth of the scene's middle along the view [m]."""
    to_first: Float[np.ndarray, "4 4"] | None
    """Transform to the frame of the first camera, with which this one then moves; None if the pose
    is unknown, in which case the camera moves with the scene."""
    shares_focal: bool
    """True if the camera has the focal length of the first one."""
    precision: Float[np.ndarray, "6 6"]
    """Prior precision of its unknowns."""
    photo: FurtherPhoto
    """The photograph."""

    def at(
        self, first: Camera, ahead: float, log_focal: float, change: Float[np.ndarray, " 6"]
    ) -> Camera:
        """Return the camera at some values of the unknowns.

        Args:
            first: the first camera.
            ahead: shift of the scene along the world's x axis [m].
            log_focal: change of the logarithm of the first camera's focal length.
            change: translation [m] and rotation vector [rad] along the camera's axes.
        """
        axes, position = self.camera.axes(), self.camera.position()
        fovy = self.camera.fovy
        if self.to_first is not None:
            axes = first.axes() @ self.to_first[:3, :3]
            position = first.position() + first.axes() @ self.to_first[:3, 3]
        else:
            position = position + [ahead, 0.0, 0.0]
        if self.shares_focal:
            fovy = 2 * math.atan(math.tan(fovy / 2) * math.exp(-log_focal))
            if self.to_first is None:
                # As with the first camera, the image of the scene's middle does not change.
                position = position - axes[:, 2] * self.depth * math.expm1(log_focal)
        position = position + axes @ change[:3]
        axes = axes @ Rotation.from_rotvec(change[3:]).as_matrix()
        return posed(self.camera.model_copy(update={"fovy": fovy}), axes, position)


def posed(
    camera: Camera, axes: Float[np.ndarray, "3 3"], position: Float[np.ndarray, " 3"]
) -> Camera:
    """Return a camera with other axes (right, down and ahead as columns) and another position."""
    yaw, pitch, roll = camera_angles(axes)
    x, y, z = position.tolist()
    update = {"yaw": yaw, "pitch": pitch, "roll": roll, "xy": (x, y), "height": z}
    return camera.model_copy(update=update)


class LocatedView(NamedTuple):
    """The camera of a further photograph, or the reason why there is none."""

    view: ViewCamera | None
    reason: str = ""


def located_views(
    scene: SceneSpec, first: Camera, photos: Sequence[FurtherPhoto]
) -> tuple[tuple[ViewCamera, ...], dict[str, str]]:
    """Return the cameras of further photographs, and why others have none, by their sources.

    Args:
        scene: the composed scene.
        first: camera of the first photograph.
        photos: the further photographs.
    """
    located = [(photo.source, locate(scene, first, photo)) for photo in photos]
    views = tuple(found.view for _, found in located if found.view is not None)
    return views, {source: found.reason for source, found in located if found.view is None}


def locate(scene: SceneSpec, first: Camera, photo: FurtherPhoto) -> LocatedView:
    """Return the camera of a further photograph by its boxes, or by its known pose.

    Args:
        scene: the composed scene, whose boxes are those of the first photograph.
        first: camera of the first photograph.
        photo: the further photograph.
    """
    rows, columns = photo.photo.shape[:2]
    focal, principal = photo.focal, photo.principal
    if focal is None:
        scale = rows / first.height_px
        focal, principal = first.focal * scale, tuple(scale * v for v in first.principal)
    lens = first.model_copy(
        update={
            "width": columns,
            "height_px": rows,
            "fovy": 2 * math.atan(rows / 2 / focal),
            "principal": principal,
        }
    )
    targets = _targets(scene, photo)
    middle = _middle(scene, first)
    if photo.to_first is not None and photo.metric:
        camera = _relative(lens, first, photo.to_first)
        precision = np.diag(np.repeat([1 / POSE_M**2, 1 / POSE**2], 3))
        return LocatedView(_view(camera, middle, photo.to_first, photo, precision))
    if len(targets) < LEAST_OBJECTS:
        return LocatedView(
            None, f"it shows {len(targets)} of the objects; its pose needs {LEAST_OBJECTS}"
        )
    to_first = photo.to_first
    if to_first is None:
        camera = _resected(lens, first, targets, middle)
    else:
        to_first = _scaled(lens, first, targets, to_first)
        camera = _relative(lens, first, to_first)
    off = _side_residuals(camera, targets)
    worst = float(np.median(np.abs(off))) if len(off) else math.inf
    if worst > LARGEST_MEDIAN:
        return LocatedView(
            None,
            f"its boxes contradict the scene at every pose (median {worst:.0f} standard "
            "deviations): is it of the same scene, with the same names?",
        )
    depth = float(camera.project(middle)[1])
    precision = np.diag(np.repeat([1 / (FREE_M * depth) ** 2, 1 / FREE**2], 3))
    if to_first is not None:
        # The unknown unit frees the position along the line between the two cameras.
        apart = to_first[:3, :3].T @ to_first[:3, 3]
        distance = float(np.linalg.norm(apart))
        along = np.outer(apart, apart) / distance**2
        precision = np.diag(np.repeat([0.0, 1 / POSE**2], 3))
        precision[:3, :3] = along / (FREE_M * distance) ** 2
        precision[:3, :3] += (np.eye(3) - along) / (RELATIVE * distance) ** 2
    return LocatedView(_view(camera, middle, to_first, photo, precision))


def _view(
    camera: Camera,
    middle: Float[np.ndarray, " 3"],
    to_first: Float[np.ndarray, "4 4"] | None,
    photo: FurtherPhoto,
    precision: Float[np.ndarray, "6 6"],
) -> ViewCamera:
    depth = float(camera.project(middle)[1])
    return ViewCamera(camera, depth, to_first, photo.focal is None, precision, photo)


def _scaled(
    lens: Camera,
    first: Camera,
    targets: Sequence["_Target"],
    to_first: Float[np.ndarray, "4 4"],
) -> Float[np.ndarray, "4 4"]:
    """Return a relative pose in the unit with which its boxes agree most."""

    def scaled(log_unit: float) -> Float[np.ndarray, "4 4"]:
        result = to_first.copy()
        result[:3, 3] *= math.exp(log_unit) / max(float(np.linalg.norm(to_first[:3, 3])), 1e-9)
        return result

    def off(u: Float[np.ndarray, " 1"]) -> Float[np.ndarray, " n"]:
        return _side_residuals(_relative(lens, first, scaled(float(u[0]))), targets)

    # The distance of the two cameras, from 2 cm to 20 m.
    starts = np.linspace(math.log(0.02), math.log(20.0), 60)
    cost = [float(np.sum(np.log1p(off(np.array([u])) ** 2))) for u in starts]
    best = starts[[int(np.argmin(cost))]]
    fit = least_squares(off, best, loss="soft_l1", max_nfev=30)
    return scaled(float(fit.x[0]))


def _relative(lens: Camera, first: Camera, to_first: Float[np.ndarray, "4 4"]) -> Camera:
    axes = first.axes() @ to_first[:3, :3]
    return posed(lens, axes, first.position() + first.axes() @ to_first[:3, 3])


class _Target(NamedTuple):
    """An object whose box is known in a further photograph."""

    points: Float[np.ndarray, "n 3"]
    """Extreme points of the object in the world [m]."""
    box: Float[np.ndarray, " 4"]
    """2D box [px]."""


def _targets(scene: SceneSpec, photo: FurtherPhoto) -> list[_Target]:
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(POINTS, 3))
    poses, targets = world_poses(scene), []
    for item in scene.objects:
        if item.environment or item.name not in photo.boxes:
            continue
        vertices = poses[item.name].apply(visible_surface(item.spec, item.joint_state)[0])
        extreme = np.unique((vertices @ directions.T).argmax(axis=0))
        box = np.array(photo.boxes[item.name].as_tuple())
        targets.append(_Target(vertices[extreme], box))
    return targets


def _middle(scene: SceneSpec, first: Camera) -> Float[np.ndarray, " 3"]:
    poses = world_poses(scene)
    places = np.array([poses[o.name].pos for o in scene.objects if not o.environment])
    ahead = places[first.project(places)[1] > 0]
    return np.median(ahead if len(ahead) else places, axis=0)


def _resected(
    lens: Camera, first: Camera, targets: Sequence[_Target], middle: Float[np.ndarray, " 3"]
) -> Camera:
    """Return the camera from which the objects look most like their boxes."""
    offset = first.position() - middle
    distance = float(np.linalg.norm(offset))
    azimuth = math.atan2(offset[1], offset[0])
    elevation = math.asin(float(np.clip(offset[2] / distance, -1, 1)))
    centers = np.array([target.points.mean(axis=0) for target in targets])
    boxes = np.array([target.box for target in targets])
    pixels = (boxes[:, :2] + boxes[:, 2:]) / 2
    spread = max(float(np.median(np.abs(pixels - np.median(pixels, axis=0)))), 1.0)

    def camera(u: Float[np.ndarray, " 6"]) -> Camera:
        eye_azimuth, eye_elevation, log_distance, roll, right, down = u.tolist()
        eye_elevation = max(min(eye_elevation, 1.55), -1.55)
        away = np.array(
            [
                math.cos(eye_elevation) * math.cos(eye_azimuth),
                math.cos(eye_elevation) * math.sin(eye_azimuth),
                math.sin(eye_elevation),
            ]
        )
        eye = middle + distance * math.exp(max(min(log_distance, 2.0), -2.0)) * away
        level = lens.model_copy(
            update={
                "xy": (float(eye[0]), float(eye[1])),
                "height": float(eye[2]),
                "yaw": eye_azimuth + math.pi,
                "pitch": eye_elevation,
                "roll": 0.0,
            }
        )
        turned = level.axes() @ Rotation.from_rotvec([-down, right, roll]).as_matrix()
        return posed(lens, turned, eye)

    def prior(u: Float[np.ndarray, " 6"]) -> Float[np.ndarray, " 3"]:
        return np.array([(u[1] - elevation) / HIGHER, u[2] / LOG_DISTANCE, u[3] / LEVEL])

    def by_centers(u: Float[np.ndarray, " 6"]) -> Float[np.ndarray, " n"]:
        seen, depth = camera(u).project(centers)
        off = np.where(depth[:, None] > 0, (seen - pixels) / spread, 10.0)
        return np.append(10 * off.ravel(), prior(u))

    def by_sides(u: Float[np.ndarray, " 6"]) -> Float[np.ndarray, " n"]:
        return np.append(_side_residuals(camera(u), targets), prior(u))

    found = []
    for k in range(STARTS):
        start = np.array([azimuth + 2 * math.pi * k / STARTS, elevation, 0.0, 0.0, 0.0, 0.0])
        fit = least_squares(by_centers, start, loss="soft_l1", max_nfev=20)
        found.append((float(fit.cost), k, fit.x))
    best = []
    for _, k, start in sorted(found, key=lambda entry: entry[:2])[:REFINED]:
        fit = least_squares(by_sides, start, loss="soft_l1", max_nfev=30)
        best.append((float(fit.cost), k, fit.x))
    return camera(min(best, key=lambda entry: entry[:2])[2])


def _side_residuals(camera: Camera, targets: Sequence[_Target]) -> Float[np.ndarray, " n"]:
    """Return the distances of boxes' sides from the projected objects, in standard deviations."""
    counts = [len(target.points) for target in targets]
    starts = np.cumsum([0, *counts[:-1]])
    pixels, depth = camera.project(np.concatenate([target.points for target in targets]))
    low = np.minimum.reduceat(pixels, starts)
    high = np.maximum.reduceat(pixels, starts)
    behind = np.minimum.reduceat(depth, starts) <= 0
    boxes = np.array([target.box for target in targets])
    sides = np.concatenate([boxes[:, 2:] - boxes[:, :2]] * 2, axis=1)
    deviation = SIDE_PX * camera.width / REFERENCE_PX + SIDE * sides
    off = (np.concatenate([low, high], axis=1) - boxes) / deviation
    off[behind] = 100.0
    limit = np.array([camera.width, camera.height_px] * 2, float)
    cut = (boxes < BORDER_PX) | (boxes > limit - BORDER_PX)
    return np.where(cut, 0.0, off).ravel()
