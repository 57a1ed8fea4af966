"""Checks of evidence against the photograph, which name the likely cause of a contradiction.

Edges of a depth image are edges of the photograph, since both show the outlines of objects. The
score of a registration is the mean standardized gradient of the photograph at the edges of the
depth image. A registration is accepted if its score stands out among those of other shifts.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from PIL import Image

from ..errors import EvidenceError
from ..spec import Camera, SceneTree
from .depth_image import DepthImage
from .evidence import Evidence, PhotoPixels
from .known_camera import KnownCamera
from .masks import Masks

FAR_M, NEAR_M = 30.0, 0.03
"""Median depths of a scene on a table or in a room lie between [m]."""
FLAT = 1.02
"""Ratio of the far to the near depths up to which an image shows one flat surface."""
MIN_KNOWN = 0.02
"""Least share of pixels with a depth."""
GRID = (48, 64)
"""Rows and columns of the pixels whose depths are compared with those of the ground."""
LEVEL = 0.1
"""Least slope of the lines of sight to the ground."""
SCALE = 3.2
"""Largest ratio of measured depths to those of the ground, and of the inverse."""
WIDTH = 160
"""Width at which edges are compared [px]."""
REACH = 24
"""Largest shift that is tried [px at WIDTH]."""
SLACK = 2
"""Shift of a registered depth image that is accepted [px at WIDTH]."""
EDGE = 0.03
"""Relative difference of depths from which on there is an edge."""
MIN_EDGES = 60
"""Least number of edge pixels that a judgment needs."""
WORST_SCORE, WORST_SIGMA = 0.6, 3.0
"""A depth image is refused if both the score of its registration, and the number of standard
deviations by which the score exceeds those of other shifts, are below these bounds. Three real
depth images have at least .86 and 5.4, those of sixteen rendered scenes with noise at least 1.35
and 5.3."""
CLEAR_SCORE, CLEAR_SIGMA = 0.7, 3.5
"""A mirrored or turned depth image is named if it exceeds both bounds."""
SHIFTED, SHIFTED_SIGMA = 1.4, 5.0
"""A depth image is not registered, or mirrored, if the score of another shift, or of a flip, is
higher by this factor, and exceeds those of all shifts by this number of standard deviations."""


def check_evidence(evidence: Evidence, rgb: PhotoPixels, *, edges: bool = True) -> None:
    """Refuse evidence that contradicts itself or the photograph.

    Args:
        evidence: the evidence, with images that show the view of the photograph.
        rgb: the photograph (sRGB), at any size.
        edges: if False, do not compare the edges of the depth image with the photograph.

    Raises:
        EvidenceError: the evidence is wrong; the message states the likely cause.
    """
    if evidence.camera is not None:
        _check_focal(evidence.camera)
    if evidence.masks is not None:
        _check_masks(evidence.masks)
    if evidence.depth is not None:
        _check_depth(evidence.depth)
        if evidence.camera is not None:
            _check_scale(evidence.depth, evidence.camera)
        if edges:
            _check_registration(evidence.depth, rgb)


def _check_focal(camera: KnownCamera) -> None:
    if camera.focal is None:
        return
    fovy = 2 * np.degrees(np.arctan(camera.size[1] / 2 / camera.focal))
    if not 3 <= fovy <= 150:
        raise EvidenceError(
            f"{camera.source}: the vertical field of view would be {fovy:.1f} deg: give the focal "
            "length in pixels of the photograph, or with the width and height that it belongs to"
        )


def _check_masks(masks: Masks) -> None:
    present = set(np.unique(masks.labels).tolist()) - {0}
    if not present:
        raise EvidenceError(f"{masks.source} has no masks: all of its pixels are 0")
    empty = [name for name, number in masks.names.items() if number not in present]
    if empty:
        raise EvidenceError(f"{masks.source}: the masks of {', '.join(empty[:5])} are empty")


def _check_depth(depth: DepthImage) -> None:
    """Refuse depths in a wrong unit, and those of a single flat surface."""
    values = depth.values[np.isfinite(depth.values)]
    share = values.size / depth.values.size
    if share < MIN_KNOWN:
        raise EvidenceError(
            f"{depth.source}: only {share:.1%} of its pixels have a depth; at least "
            f"{MIN_KNOWN:.0%} must"
        )
    near, middle, far = np.quantile(values, [0.02, 0.5, 0.98])
    if depth.kind != "metric":
        if far - near <= (FLAT - 1) * abs(middle):
            raise EvidenceError(f"{depth.source} is constant: it shows one flat surface")
        return
    if middle > FAR_M:
        cause = "is the scale ten times too large, or are these values of a disparity?"
        if NEAR_M < middle / 1000 < FAR_M:
            cause = "its values are millimeters: give scale: 0.001"
        raise EvidenceError(f"{depth.source}: the median depth is {middle:.4g} m: {cause}")
    if middle < NEAR_M:
        cause = "give the scale in meters per unit"
        if NEAR_M < middle * 1000 < FAR_M:
            cause = "its values are meters already: give scale: 1"
        raise EvidenceError(f"{depth.source}: the median depth is {middle:.3g} m: {cause}")
    if far <= FLAT * near:
        raise EvidenceError(
            f"{depth.source} is constant ({near:.3g} to {far:.3g} m): it shows a wall or a cover, "
            "and no object"
        )


def _check_scale(depth: DepthImage, camera: KnownCamera) -> None:
    """Refuse depths that contradict the distance of a camera with a known pose from the ground."""
    known = None not in (camera.focal, camera.pitch, camera.roll, camera.height)
    if depth.kind != "metric" or not known:
        return
    width, height = camera.size
    blank = Camera(width=width, height_px=height, fovy=1, height=1, pitch=0)
    placed = camera.camera(blank)
    rows, columns = GRID
    values = depth.resized(rows, columns).values[rows // 2 :]
    u, v = np.meshgrid(
        (np.arange(columns) + 0.5) * width / columns,
        (np.arange(rows // 2, rows) + 0.5) * height / rows,
    )
    rays = placed.rays(np.stack([u, v], axis=-1))
    ahead = rays @ placed.axes()[:, 2]
    seen = np.isfinite(values) & (rays[..., 2] < -LEVEL)
    if seen.mean() < MIN_KNOWN:
        return
    ground = ahead[seen] * placed.height / -rays[..., 2][seen]
    ratio = float(np.median(values[seen] / ground))
    if not 1 / SCALE < ratio < SCALE:
        raise EvidenceError(
            f"{depth.source}: depths are {ratio:.2g} times those of the ground seen from "
            f"{camera.height:.2f} m: give the scale in meters per unit, or correct ground"
        )


def check_distances(depth: DepthImage, tree: SceneTree) -> None:
    """Refuse metric depths in another unit than the distances of a tree.

    Args:
        depth: the depth image, in the view of the tree's camera.
        tree: the tree of a response, whose distances are right within a factor of `SCALE`.

    Raises:
        EvidenceError: most objects are at other distances.
    """
    if depth.kind != "metric":
        return
    height, width = depth.values.shape
    per_pixel = np.array([width / tree.camera.width, height / tree.camera.height_px] * 2)
    ratios = []
    for node in tree.nodes:
        left, top, right, bottom = np.array(node.box2d.as_tuple()) * per_pixel
        # The middle of the box shows the object.
        rows = slice(round(0.7 * top + 0.3 * bottom), round(0.3 * top + 0.7 * bottom) + 1)
        columns = slice(round(0.7 * left + 0.3 * right), round(0.3 * left + 0.7 * right) + 1)
        values = depth.values[rows, columns]
        _, distance = tree.camera.project(node.box3d.corners(node.base_tilt).mean(axis=0))
        if not node.environment and np.isfinite(values).any() and distance > 0:
            ratios.append(float(np.nanmedian(values)) / float(distance))
    ratio = float(np.median(ratios)) if ratios else 1.0
    if not 1 / SCALE < ratio < SCALE:
        raise EvidenceError(
            f"{depth.source}: its depths are {ratio:.2g} times the distances that the response "
            "estimates from known sizes: give the scale in meters per unit"
        )


class _Registration(NamedTuple):
    """Scores of the shifts of a depth image."""

    score: float
    """Highest score near no shift."""
    sigma: float
    """Number of standard deviations by which `score` exceeds the mean of all shifts."""
    best: tuple[int, int]
    """Shift (right, down) with the highest score [px at WIDTH]."""
    best_score: float
    best_sigma: float


def _check_registration(depth: DepthImage, rgb: PhotoPixels) -> None:
    """Refuse a depth image whose edges are not those of the photograph."""
    photo = _photo_edges(rgb)
    given = _registration(photo, _depth_edges(depth, len(photo)))
    if given is None:
        return
    shifted = given.best_score > SHIFTED * given.score and given.best_sigma > SHIFTED_SIGMA
    flip = _flip(depth, photo, given)
    other = flip is not None and flip[1].score > SHIFTED * given.score
    certain = flip is not None and flip[1].sigma > SHIFTED_SIGMA
    unlike = given.score < WORST_SCORE and given.sigma < WORST_SIGMA
    if not (shifted or unlike or (other and certain)):
        return
    if flip is not None and not (shifted and given.best_score > flip[1].score):
        cause = flip[0]
    elif shifted:
        cause = _shift_phrase(given)
    else:
        cause = (
            "it is of another photograph, or of a sensor next to the camera (give its camera and "
            "to_photo)"
        )
    raise EvidenceError(
        f"{depth.source}: its edges are not those of the photograph: {cause}. If it is right, give "
        "check: false in the evidence file"
    )


def _flip(
    depth: DepthImage, photo: NDArray, given: _Registration
) -> tuple[str, _Registration] | None:
    """Return the flip that fits the photograph clearly, and better than the depth image does."""
    backward, all_ = slice(None, None, -1), slice(None)
    flips = {
        "it is mirrored: flip it from left to right": (all_, backward),
        "it is mirrored: flip it upside down": (backward, all_),
        "it is turned by 180 degrees": (backward, backward),
    }
    fits: list[tuple[str, _Registration]] = []
    for cause, flip in flips.items():
        flipped = DepthImage(depth.values[flip], depth.kind)
        other = _registration(photo, _depth_edges(flipped, len(photo)))
        if other is not None and other.score > CLEAR_SCORE and other.sigma > CLEAR_SIGMA:
            fits.append((cause, other))
    best = max(fits, key=lambda fit: fit[1].score, default=None)
    return None if best is None or best[1].score <= given.score else best


def _shift_phrase(given: _Registration) -> str:
    right, down = (shift * 100 / WIDTH for shift in given.best)
    sides = f"{abs(right):.0f} % {'right' if right > 0 else 'left'}"
    sides += f" and {abs(down):.0f} % {'down' if down > 0 else 'up'}"
    return (
        f"they fit if it is moved {sides} (of the width), so it is not registered; align the "
        "sensor's depth with its color image, or give the sensor's camera and to_photo"
    )


def _photo_edges(rgb: PhotoPixels) -> Float[np.ndarray, "cell_row cell_column"]:
    """Return the largest gradient of the photograph in each cell of an image WIDTH wide."""
    from scipy.ndimage import gaussian_filter

    rows = max(round(WIDTH * rgb.shape[0] / rgb.shape[1]), 8)
    small = Image.fromarray(rgb).resize((2 * WIDTH, 2 * rows), Image.Resampling.BOX)
    colors = np.asarray(small, float) / 255
    gradient = np.zeros(colors.shape[:2])
    for k in range(3):
        down, right = np.gradient(gaussian_filter(colors[..., k], 1.0))
        gradient = np.maximum(gradient, np.hypot(right, down))
    cells = gradient.reshape(rows, 2, WIDTH, 2).max(axis=(1, 3))
    return np.minimum(cells, np.quantile(cells, 0.95))


def _depth_edges(depth: DepthImage, rows: int) -> Float[np.ndarray, "cell_row cell_column"]:
    """Return 1 in each cell of an image WIDTH wide with a step of the depth, elsewhere 0."""
    from scipy.ndimage import maximum_filter, minimum_filter

    values = depth.resized(2 * rows, 2 * WIDTH).values
    known = np.isfinite(values)
    if depth.kind == "metric":
        inverse = np.where(known, 1 / np.where(known, values, 1.0), 0.0)
        unit = inverse
    else:
        inverse = np.where(known, values, 0.0)
        unit = np.full(values.shape, np.ptp(values[known]) if known.any() else 1.0)
    steps = []
    for size in (3, 5):
        high = maximum_filter(np.where(known, inverse, -np.inf), size)
        low = minimum_filter(np.where(known, inverse, np.inf), size)
        steps.append(np.where(known, high - low, 0.0))
    # The difference over a plane grows with the distance, that over a step does not.
    edge = known & (steps[0] > EDGE * unit) & (steps[0] > 0.75 * steps[1])
    return edge.reshape(rows, 2, WIDTH, 2).max(axis=(1, 3)).astype(float)


def _registration(photo: NDArray, edges: NDArray) -> _Registration | None:
    """Score all shifts of edges; None if there are too few to judge."""
    count = edges.sum()
    if count < MIN_EDGES or photo.std() < 1e-6:
        return None
    standardized = (photo - photo.mean()) / photo.std()
    shape = [side + 2 * REACH for side in photo.shape]
    product = np.fft.rfft2(standardized, shape) * np.conj(np.fft.rfft2(edges, shape))
    scores = np.fft.irfft2(product, shape) / count
    shifts = np.arange(-REACH, REACH + 1)
    scores = scores[np.ix_(shifts, shifts)]
    mean, deviation = scores.mean(), max(scores.std(), 1e-9)
    near = scores[REACH - SLACK : REACH + SLACK + 1, REACH - SLACK : REACH + SLACK + 1].max()
    down, right = np.unravel_index(scores.argmax(), scores.shape)
    sigma = lambda score: float((score - mean) / deviation)
    return _Registration(
        float(near),
        sigma(near),
        (int(right) - REACH, int(down) - REACH),
        float(scores.max()),
        sigma(scores.max()),
    )
