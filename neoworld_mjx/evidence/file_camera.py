"""A camera as a file states it, and the camera of a photograph that it implies."""

import math
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from pydantic import Field, model_validator

from ..errors import EvidenceError
from ..spec import Spec
from ..spec.base import Number, Vec3
from .known_camera import EXACT_FOCAL, KnownCamera
from .lens import COEFFICIENTS, Lens, LensModel, Pinhole, is_pinhole, pinhole_of

Row = tuple[Number, Number, Number, Number]
Rows = tuple[Row, Row, Row, Row]
VERTICAL = 1e-6
"""A camera looks straight down or up if the horizontal component of its unit viewing direction is
at most this value."""
GRAVITY_SD = math.radians(0.5)
"""Standard deviation of pitch and roll that follow from a measured gravity [rad]."""
LEVEL_BASE = math.radians(2.0)
"""Largest angle between z of a base frame and a measured vertical [rad]."""
ASPECT = 0.01
"""Largest relative difference between aspect ratios of pictures of one view."""
SHAPES = (4 / 3, 3 / 2, 16 / 9, 16 / 10, 5 / 4)
"""Aspect ratios of cameras, of the longer to the shorter side."""
SQUARE = 0.05
"""Relative difference between fx and fy above which a picture must have been stretched."""


class Distortion(Spec):
    """Distortion of a lens."""

    model: LensModel = "brown_conrady"
    coefficients: tuple[Number, ...] = Field(max_length=8)
    """k1 k2 p1 p2 k3 (k4 k5 k6), or k1 k2 k3 k4 of a fisheye."""

    @model_validator(mode="after")
    def _fits_model(self) -> "Distortion":
        most = COEFFICIENTS[self.model]
        if len(self.coefficients) > most:
            raise ValueError(
                f"{self.model} has at most {most} coefficients, got {len(self.coefficients)}"
            )
        return self


class FileCamera(Spec):
    """A camera: its intrinsics, given as fovy or as fx, fy, cx and cy, and its pose."""

    pose: Rows | None = None
    """Rigid transform from the camera's frame to the base frame of a robot, or to the world frame
    of a scene (Z up) [m]; None if the pose is not stated."""
    axes: Literal["opencv", "opengl"] = "opencv"
    """Axes of the camera's frame: x right, y down, z ahead (opencv), or x right, y up, z back
    (opengl)."""
    gravity: Vec3 | None = None
    """Direction of gravity, in the camera's frame, of any length. (0, 1, 0) is a level
    camera with OpenCV's axes."""
    ground: Number | None = None
    """Height of the scene's plane z = 0 in the base frame [m]: of the floor or, if no floor is
    visible, of the table's top."""
    width: int | None = Field(default=None, ge=1)
    height: int | None = Field(default=None, ge=1)
    """Size of the image that the intrinsics belong to [px]; by default that of the photograph."""
    fovy: float | None = Field(default=None, gt=0.01, lt=math.pi - 0.01)
    """Vertical field of view [rad]."""
    fx: float | None = Field(default=None, gt=0, allow_inf_nan=False)
    """Focal lengths (fx, fy) and principal point (cx, cy) [px]. As in OpenCV, (0, 0) is the middle
    of the first pixel."""
    fy: float | None = Field(default=None, gt=0, allow_inf_nan=False)
    cx: Number | None = None
    cy: Number | None = None
    focal_sd: float | None = Field(default=None, gt=0, le=1)
    """Standard deviation of the focal length, relative to it; None for a calibrated one."""
    distortion: Distortion | None = None
    depth_scale: float | None = Field(default=None, gt=0, allow_inf_nan=False)
    """Unit of the depth images of this camera [mm], as in BOP; None if not stated."""

    @model_validator(mode="after")
    def _complete(self) -> "FileCamera":
        stated = [value is not None for value in (self.fx, self.fy, self.cx, self.cy)]
        if any(stated) and not all(stated):
            raise ValueError("fx, fy, cx and cy must be given together")
        if any(stated) and self.fovy is not None:
            raise ValueError("give fovy, or fx, fy, cx and cy, not both")
        if (self.width is None) != (self.height is None):
            raise ValueError("width and height must be given together")
        if self.distortion is not None and not any(stated):
            raise ValueError("a distortion belongs to fx, fy, cx and cy")
        if self.gravity is not None and math.hypot(*self.gravity) < 1e-6:
            raise ValueError("gravity must not be zero")
        if self.pose is not None and (problem := rigid_problem(np.array(self.pose))):
            raise ValueError(problem)
        return self

    def completed_by(self, other: "FileCamera | None") -> "FileCamera":
        """Return a copy whose missing pose or intrinsics are taken from another camera."""
        if other is None:
            return self
        update: dict[str, object] = {}
        if self.pose is None:
            update |= {"pose": other.pose, "axes": other.axes}
            if self.ground is None:
                update["ground"] = other.ground
        if self.fovy is None and self.fx is None:
            names = ("width", "height", "fovy", "fx", "fy", "cx", "cy", "focal_sd", "distortion")
            update |= {name: getattr(other, name) for name in names}
        return self.model_copy(update=update)

    def matrix(self) -> Float[np.ndarray, "4 4"] | None:
        """Return the pose of the camera's frame with OpenCV's axes."""
        if self.pose is None:
            return None
        return np.array(self.pose) @ (TO_OPENCV if self.axes == "opengl" else np.eye(4))

    def up(self) -> Float[np.ndarray, " 3"] | None:
        """Return the measured vertical, a unit vector in the camera's frame with OpenCV's axes."""
        if self.gravity is None:
            return None
        up = -np.array(self.gravity) / math.hypot(*self.gravity)
        return TO_OPENCV[:3, :3] @ up if self.axes == "opengl" else up


TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
"""Transform from OpenCV's camera axes to OpenGL's (x right, y up, z back), and its inverse."""


def rigid_problem(matrix: NDArray) -> str:
    """Return what is wrong with a 4 x 4 matrix that should be rigid; "" if nothing is."""
    rotation = matrix[:3, :3]
    if not np.allclose(matrix[3], (0, 0, 0, 1)):
        hint = "; its rows and columns are swapped" if np.allclose(matrix[:3, 3], 0) else ""
        return f"pose is not a rigid transform: its last row is not 0 0 0 1{hint}"
    if np.abs(rotation @ rotation.T - np.eye(3)).max() >= 1e-3:
        size = float(abs(np.linalg.det(rotation))) ** (1 / 3)
        scaled = size > 0 and np.abs(rotation @ rotation.T / size**2 - np.eye(3)).max() < 1e-3
        hint = f"it scales by {size:.4g}" if scaled else "its columns are no unit vectors at 90 deg"
        return f"pose is not a rigid transform: {hint}"
    if np.linalg.det(rotation) < 0:
        return "pose is not a rigid transform: it mirrors, so one axis has the wrong sign"
    return ""


def rows_of(matrix: NDArray) -> Rows:
    """Return the rows of a 4 x 4 matrix as tuples."""
    a, b, c, d = (tuple(row) for row in np.asarray(matrix, float).tolist())
    return a, b, c, d


def camera_angles(axes: Float[np.ndarray, "3 3"]) -> tuple[float, float, float]:
    """Return the heading, downward pitch and roll of a camera [rad], given its axes as columns.

    The axes are right, down and ahead, in a frame whose z points up.
    """
    right, down, ahead = axes.T
    level = ahead if np.hypot(*ahead[:2]) > VERTICAL else -down * np.sign(-ahead[2])
    heading = math.atan2(level[1], level[0])
    pitch = math.asin(float(np.clip(-ahead[2], -1, 1)))
    level_right = np.array([math.sin(heading), -math.cos(heading), 0.0])
    level_down = np.cross(ahead, level_right)
    return heading, pitch, math.atan2(float(right @ level_down), float(right @ level_right))


def level_transform(up: Float[np.ndarray, "3"]) -> Float[np.ndarray, "4 4"]:
    """Return the transform from a camera's frame (OpenCV) to a world frame with a level floor.

    The origin of the world frame is the camera, its z axis points up, and its x axis is the
    horizontal viewing direction.

    Args:
        up: vector of any length that points up, in the camera's frame.

    Raises:
        EvidenceError: `up` is zero.
    """
    size = float(np.linalg.norm(up))
    if size < 1e-6:
        raise EvidenceError("up must not be zero")
    z = np.asarray(up, float) / size
    ahead = np.array([0.0, 0.0, 1.0])
    x = ahead - (ahead @ z) * z
    if np.linalg.norm(x) < VERTICAL:  # x is the image's top (looking down) or bottom (looking up).
        x = np.array([0.0, -1.0, 0.0]) * -np.sign(ahead @ z)
    x /= np.linalg.norm(x)
    result = np.eye(4)
    result[:3, :3] = np.stack([x, np.cross(z, x), z])
    return result


def known_camera(
    stated: FileCamera, size: tuple[int, int], source: str
) -> tuple[KnownCamera, Lens | None]:
    """Return the camera of a photograph, and its lens if the photograph must be undistorted.

    The intrinsics are scaled to the photograph if it has another size.

    Args:
        stated: the camera.
        size: width and height of the photograph [px].
        source: where the camera comes from, for messages.

    Raises:
        EvidenceError: the intrinsics do not fit the photograph, or the pose is impossible.
    """
    camera, lens = intrinsics(stated, size, source)
    return replace(camera, **_direction(stated, source)), lens


def intrinsics(
    stated: FileCamera, size: tuple[int, int], source: str
) -> tuple[KnownCamera, Lens | None]:
    """Return what `known_camera` returns, without the pose."""
    lens, sd = photo_lens(stated, size, source), stated.focal_sd or EXACT_FOCAL
    if stated.fovy is not None:
        focal = size[1] / 2 / math.tan(stated.fovy / 2)
        return KnownCamera(size, focal=focal, focal_sd=sd, source=source), None
    if lens is None:
        return KnownCamera(size, source=source), None
    shown, distorted = pinhole_of(lens), lens
    if is_pinhole(lens):
        shown, distorted = Pinhole(size, sum(lens.focal) / 2, lens.center), None
    principal = (shown.center[0] - shown.size[0] / 2, shown.center[1] - shown.size[1] / 2)
    known = KnownCamera(
        shown.size, focal=shown.focal, focal_sd=sd, principal=principal, source=source
    )
    return known, distorted


def photo_lens(stated: FileCamera, size: tuple[int, int], source: str) -> Lens | None:
    """Return the lens of a stated camera for a picture of a size; None without fx, fy, cx and cy.

    Raises:
        EvidenceError: the intrinsics do not fit the picture.
    """
    if stated.width is not None and stated.height is not None:
        _check_size((stated.width, stated.height), size, source)
    if stated.fx is None or stated.fy is None or stated.cx is None or stated.cy is None:
        return None
    calibrated = (stated.width or size[0], stated.height or size[1])
    x, y = (new / old for new, old in zip(size, calibrated, strict=True))
    distortion = stated.distortion or Distortion(coefficients=())
    lens = Lens(
        size,
        (stated.fx * x, stated.fy * y),
        ((stated.cx + 0.5) * x, (stated.cy + 0.5) * y),
        distortion.model,
        distortion.coefficients,
    )
    _check_lens(lens, stated, source)
    return lens


def _check_size(calibrated: tuple[int, int], size: tuple[int, int], source: str) -> None:
    """Refuse intrinsics of a picture that is no scaled copy of the photograph."""
    given, own = (f"{w} x {h} pixels" for w, h in (calibrated, size))
    ratio = (size[0] / size[1]) / (calibrated[0] / calibrated[1])
    if abs(ratio - 1) <= ASPECT:
        return
    if abs(size[0] / size[1] * (calibrated[0] / calibrated[1]) - 1) <= ASPECT:
        cause = "the photograph is turned by 90 degrees: give it as the camera stored it"
    else:
        cause = (
            "the photograph is cropped, or of another camera mode: calibrate for its size, or "
            "subtract the crop's left and top from cx and cy and give its width and height"
        )
    raise EvidenceError(f"{source} is for {given}, the photograph has {own}: {cause}")


def _check_lens(lens: Lens, stated: FileCamera, source: str) -> None:
    """Refuse a principal point far off the middle, and pixels that are not square."""
    (width, height), (x, y) = lens.size, lens.center
    off = lambda x, y: max(abs(x / width - 0.5), abs(y / height - 0.5))
    if off(x, y) > 0.25:
        given = f"{source}: the principal point ({stated.cx:g}, {stated.cy:g})"
        if off(y, x) < 0.1:
            raise EvidenceError(f"{given} is off the middle: cx and cy are swapped")
        raise EvidenceError(
            f"{given} is not near the middle of a photograph of {width} x {height} pixels: give "
            "the width and height that the intrinsics belong to"
        )
    fx, fy = lens.focal
    if abs(fx / fy - 1) <= SQUARE:
        return
    # Square pixels of a sensor with the shape of a camera, in a picture that was stretched.
    sides = ([1] if width >= height else []) + ([-1] if width <= height else [])
    shaped = lambda ratio: any(abs(ratio**k / s - 1) < 0.02 for s in SHAPES for k in sides)
    if shaped(width * fy / (height * fx)):
        return
    swapped = shaped(width * fx / (height * fy))
    cause = (
        "fx and fy are swapped"
        if swapped
        else "one of them is wrong, or of a photograph of another size"
    )
    raise EvidenceError(
        f"{source}: fx {stated.fx:g} and fy {stated.fy:g} make pixels {fy / fx:.2f} times as wide "
        f"as tall: {cause}"
    )


def _direction(stated: FileCamera, source: str) -> dict[str, Any]:
    """Return pitch and roll, and the place in the base frame, as far as they are stated."""
    matrix, up = stated.matrix(), stated.up()
    if matrix is None:
        if up is None:
            return {}
        _, pitch, roll = camera_angles(level_transform(up)[:3, :3])
        _check_gravity(pitch, roll, source)
        return {"pitch": pitch, "roll": roll, "angle_sd": GRAVITY_SD}
    check_pose(stated, source)
    heading, pitch, roll = camera_angles(matrix[:3, :3])
    if up is not None:
        tilt = math.acos(float(np.clip((matrix[:3, :3] @ up)[2], -1, 1)))
        if tilt > LEVEL_BASE:
            _check_gravity(*camera_angles(level_transform(up)[:3, :3])[1:], source)
            raise EvidenceError(
                f"{source}: gravity and the base frame disagree by {math.degrees(tilt):.1f} deg: z "
                "of the base frame must be vertical; give the pose in a level frame of the robot"
            )
    x, y, z = matrix[:3, 3].tolist()
    values: dict[str, Any] = {"pitch": pitch, "roll": roll, "heading": heading}
    values["base"] = (x, y, z)
    if stated.ground is not None:
        values["height"] = z - stated.ground
    return values


UPSIDE_DOWN = math.radians(100)
"""Roll above which a camera counts as upside down [rad]."""
LOOKS_UP = math.radians(-20)
"""Pitch below which a camera shows no scene on a support [rad]."""


def _plausible(axes: NDArray) -> bool:
    _, pitch, roll = camera_angles(axes)
    return pitch >= LOOKS_UP and abs(roll) <= UPSIDE_DOWN


def _check_gravity(pitch: float, roll: float, source: str) -> None:
    if pitch >= LOOKS_UP and abs(roll) <= UPSIDE_DOWN:
        return
    raise EvidenceError(
        f"{source}: with this gravity the camera is upside down or looks up (pitch "
        f"{math.degrees(pitch):.0f}, roll {math.degrees(roll):.0f} deg): gravity points down, (0, "
        "1, 0) for a level camera; an accelerometer at rest measures the opposite, so change its "
        "sign"
    )


FAR_M = 50.0
"""Distance from the origin of the base frame above which a camera's position is no position [m]."""


def check_pose(stated: FileCamera, source: str) -> None:
    """Refuse a pose with which the camera cannot see a scene on a support, naming the cause.

    Raises:
        EvidenceError: the camera is upside down, looks up, or is below the ground or far away.
    """
    matrix = stated.matrix()
    assert matrix is not None
    place = matrix[:3, 3]
    far = float(np.linalg.norm(place))
    if far > FAR_M:
        raise EvidenceError(
            f"{source}: the camera is {far:.0f} m from the base: is the pose in millimeters? Give "
            "its last column in meters"
        )
    axes = matrix[:3, :3]
    depth = 0.0 if stated.ground is None else stated.ground - float(place[2])
    below = depth > 0
    if _plausible(axes) and not below:
        return
    pitch = camera_angles(axes)[1]
    state = f"looks up by {math.degrees(-pitch):.0f} deg" if pitch < LOOKS_UP else "is upside down"
    if below and _plausible(axes):
        state = f"is {depth:.2f} m below the ground"
    inverse = np.linalg.inv(matrix)
    other = "opencv" if stated.axes == "opengl" else "opengl"
    above = stated.ground or 0.0
    if not below and _plausible((matrix @ TO_OPENCV)[:3, :3]):
        cause = f"the axes of its frame look like those of {other}: give axes: {other}"
    elif _plausible(inverse[:3, :3]) and inverse[2, 3] > above:
        cause = "it looks like the transform from the base to the camera: give its inverse"
    else:
        cause = "the pose maps the camera's frame to the base frame, whose z points up"
    raise EvidenceError(f"{source}: with this pose the camera {state}: {cause}")
