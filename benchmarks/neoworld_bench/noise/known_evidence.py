"""Evidence that a user gives besides the photograph, made from the ground truth with its errors.

Depth has the noise of a sensor, holes and flying pixels. That of a monocular network has smooth
errors and an unknown scale and shift besides. Masks and calibrations are exact.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8
from scipy.ndimage import gaussian_filter, maximum_filter, minimum_filter

from neoworld_mjx.errors import SpecError, choices
from neoworld_mjx.estimate.views import posed
from neoworld_mjx.evidence.depth_image import MONOCULAR, DepthImage, sensor_sd
from neoworld_mjx.evidence.evidence import Evidence
from neoworld_mjx.evidence.further_photo import FurtherPhoto
from neoworld_mjx.evidence.known_camera import KnownCamera
from neoworld_mjx.evidence.masks import Masks
from neoworld_mjx.render.rasterize import draw_scene
from neoworld_mjx.spec import Box2D, Camera, SceneSpec, world_poses
from neoworld_mjx.spec.pose import from_yaw, matrix

from ..fidelity.rendered_responses import disturbed_box2d
from ..fidelity.rendered_scenes import photograph

KINDS = ("fov", "exif", "pose", "depth", "affine", "disparity", "masks", "second", "stereo")
"""Kinds of evidence.

- fov: the field of view, calibrated.
- exif: the field of view with an error of EXIF_SD, and this deviation.
- pose: pitch, roll and height of the camera, calibrated.
- depth: depth of a sensor in meters.
- affine, disparity: depth and 1/depth of a network, with unknown scale and shift.
- masks: masks of all objects but supports.
- second: a second photograph from BESIDE aside, with 2D boxes as of a response.
- stereo: the same with the pose relative to the first camera, calibrated.
"""
ALTERNATIVES = (("fov", "exif"), ("depth", "affine", "disparity"), ("second", "stereo"))
"""Kinds of which at most one is given."""
EXIF_SD = 0.03
"""Standard deviation of the logarithm of the focal length in EXIF data."""
HOLES = 0.1
"""Share of a sensor's pixels without a depth."""
FLYING = 0.5
"""Share of the pixels at an edge of the depth at which a sensor mixes the depths of both sides."""
EDGE = 0.02
"""Least difference of neighboring depths at an edge, relative to the depth."""
SMOOTH = 1 / 8
"""Correlation length of the smooth errors, relative to the width of the image."""
AFFINE, DISPARITY = (0.37, -0.11), (3.0, 0.2)
"""Scale and shift by which a network's values follow from depth [m] and 1/depth [1/m]."""
BESIDE = math.radians(40.0)
"""Angle about the vertical through the scene's middle from the first to the second camera [rad]."""
LEAST_SEEN_PX = 12
"""Number of visible pixels from which on a second photograph shows an object."""
WIDTH_PX = 640
"""Width of depth images and masks [px]."""


def kinds_of(words: str) -> tuple[str, ...]:
    """Return the kinds of evidence that are joined by "+"; none for "none".

    Raises:
        SpecError: there is no such kind, or two exclude each other.
    """
    kinds = () if words == "none" else tuple(words.split("+"))
    for kind in kinds:
        if kind not in KINDS:
            raise SpecError(f"evidence: {choices(kind, KINDS)}")
    for some in ALTERNATIVES:
        given = [kind for kind in some if kind in kinds]
        if len(given) > 1:
            raise SpecError(f"evidence: got {' and '.join(given)}, at most one of them is valid")
    return kinds


def known_evidence(
    kinds: Sequence[str],
    truth: SceneSpec,
    photo: UInt8[np.ndarray, "row column 3"],
    number: int,
) -> Evidence:
    """Return the photograph with evidence of some kinds.

    Args:
        kinds: kinds of evidence, as returned by `kinds_of`; none for the photograph alone.
        truth: the ground truth, with the camera of the photograph.
        photo: the photograph (sRGB).
        number: seed of the errors. For one number, a kind has the same errors with any other kinds.
    """
    camera = truth.camera
    assert camera is not None
    rng = {kind: np.random.default_rng((number, k)) for k, kind in enumerate(KINDS)}
    depth = None
    if "depth" in kinds:
        depth = DepthImage(_sensor_depth(truth, camera, rng["depth"]))
    elif "affine" in kinds:
        scale, shift = AFFINE
        z = _network_depth(truth, camera, rng["affine"])
        depth = DepthImage((z - shift) / scale, "affine", smooth_sd=MONOCULAR)
    elif "disparity" in kinds:
        scale, shift = DISPARITY
        z = _network_depth(truth, camera, rng["disparity"])
        depth = DepthImage(scale / z + shift, "disparity", smooth_sd=MONOCULAR)
    known = _known_camera(kinds, camera, rng["exif"])
    further = ()
    if "second" in kinds or "stereo" in kinds:
        # Both kinds have the same boxes.
        further = (_second_photo(truth, camera, rng["second"], with_pose="stereo" in kinds),)
    masks = _masks(truth, camera) if "masks" in kinds else None
    return Evidence(photo, known, depth, masks, further=further)


def second_camera(truth: SceneSpec, camera: Camera) -> Camera:
    """Return the camera that is BESIDE aside, and looks at the scene as the first one does."""
    poses = world_poses(truth)
    middle = np.median([poses[o.name].pos for o in truth.objects if not o.static], axis=0)
    turn = matrix(from_yaw(BESIDE))
    return posed(camera, turn @ camera.axes(), middle + turn @ (camera.position() - middle))


def _second_photo(
    truth: SceneSpec, first: Camera, rng: np.random.Generator, *, with_pose: bool
) -> FurtherPhoto:
    camera = second_camera(truth, first)
    owner = draw_scene(truth, camera, camera.width).owner
    boxes = {}
    for k, item in enumerate(truth.objects):
        rows, columns = np.nonzero(owner == k)
        if not item.environment and len(rows) >= LEAST_SEEN_PX:
            low, high = (columns.min(), rows.min()), (columns.max() + 1, rows.max() + 1)
            exact = Box2D(x0=float(low[0]), y0=float(low[1]), x1=float(high[0]), y1=float(high[1]))
            boxes[item.name] = disturbed_box2d(exact, camera, rng)
    relative = np.eye(4)
    relative[:3, :3] = first.axes().T @ camera.axes()
    relative[:3, 3] = first.axes().T @ (camera.position() - first.position())
    taken = photograph(truth.model_copy(update={"camera": camera}))
    return FurtherPhoto(taken, boxes, to_first=relative if with_pose else None, source="second.png")


def _known_camera(
    kinds: Sequence[str], camera: Camera, rng: np.random.Generator
) -> KnownCamera | None:
    known: dict[str, Any] = {}
    if "fov" in kinds:
        known["focal"] = camera.focal
    if "exif" in kinds:
        known |= {"focal": camera.focal * math.exp(EXIF_SD * rng.normal()), "focal_sd": EXIF_SD}
    if "pose" in kinds:
        known |= {"pitch": camera.pitch, "roll": camera.roll, "height": camera.height}
    return KnownCamera((camera.width, camera.height_px), **known) if known else None


def _masks(truth: SceneSpec, camera: Camera) -> Masks:
    labels = draw_scene(truth, camera, WIDTH_PX).owner + 1
    names = {item.name: k + 1 for k, item in enumerate(truth.objects) if not item.environment}
    return Masks(np.where(np.isin(labels, list(names.values())), labels, 0), names)


def _true_depth(truth: SceneSpec, camera: Camera) -> Float[np.ndarray, "row column"]:
    """Return the depth of each pixel [m]; NaN where there is nothing."""
    depth = draw_scene(truth, camera, WIDTH_PX).depth
    return np.where(np.isfinite(depth), depth, np.nan)


def _sensor_depth(
    truth: SceneSpec, camera: Camera, rng: np.random.Generator
) -> Float[np.ndarray, "row column"]:
    z = with_flying_pixels(_true_depth(truth, camera), rng)
    z = z + rng.normal(size=z.shape) * sensor_sd(z)
    z[rng.random(z.shape) < HOLES] = np.nan
    return z


def with_flying_pixels(
    depth: Float[np.ndarray, "row column"], rng: np.random.Generator
) -> Float[np.ndarray, "row column"]:
    """Mix the depths of both sides at some pixels next to edges of the depth.

    Args:
        depth: depth of each pixel [m]; NaN where there is none.
        rng: source of the choice of pixels and of the shares of both sides.
    """
    near = minimum_filter(np.nan_to_num(depth, nan=np.inf), 3)
    far = maximum_filter(np.nan_to_num(depth, nan=-np.inf), 3)
    mixed = near + rng.random(depth.shape) * np.where(np.isfinite(near), far - near, 0.0)
    with np.errstate(invalid="ignore"):
        flying = (far - near > EDGE * depth) & (rng.random(depth.shape) < FLYING)
    return np.where(flying, mixed, depth)


def _network_depth(
    truth: SceneSpec, camera: Camera, rng: np.random.Generator
) -> Float[np.ndarray, "row column"]:
    z = _sensor_depth(truth, camera, rng)
    field = gaussian_filter(rng.normal(size=z.shape), SMOOTH * z.shape[1])
    return z * (1 + MONOCULAR * field / field.std())
