"""Depth of the photograph's pixels as rows of the normal equations.

The residual of a pixel is the distance between the measured and the rendered point along the
rendered normal (point to plane): points that slide along a face cost nothing. Points are compared
in the camera's frame, where the intrinsics alone determine the measured point. The scale and shift
of a monocular depth image are unknowns of the same equations.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import binary_erosion

from ...evidence.depth_image import DepthImage, sensor_sd
from ...evidence.masks import Masks
from ...render.rasterize import DrawnObjects
from ...spec import Camera
from ..unknowns import Placement, Unknowns
from .linear import LinearEvidence, unprojected, value_jacobian

MARGIN_PX, REFERENCE_PX = 3.0, 640.0
"""Width of the margin along outlines that is omitted, in pixels of an image REFERENCE_PX wide: the
outline is uncertain, and sensors mix the two depths there."""
LEAST_PIXELS, MOST_PIXELS = 20, 400
"""Numbers of pixels of an object that are needed, and that are used."""
OBSERVATIONS, SMOOTH_OBSERVATIONS, SUPPORT_OBSERVATIONS = 30, 2, 300
"""Numbers of independent observations: of an object by a sensor, of anything by an image with
smooth errors, and of a large support by a sensor."""
SHAPE, LARGEST_M, LEAST_M = 0.02, 0.5, 0.002
"""Standard deviation of a surface: relative to the size of its object up to LARGEST_M [m], and a
constant [m]."""
SUPPORT_M, SUPPORT = 0.002, 0.02
"""Standard deviation of the height of a fixed support: a constant [m], and a share of its height
above z = 0."""
LARGE = 0.1
"""Share of the image from which on a support counts fully: of a support of which little shows, the
little may be something else."""
UPWARD = 0.8
"""Least vertical component of the normal of a fixed support's surface that is evidence. Positions
of walls are guesses."""
OUTLYING = 3.0
"""Residual at which the weight of a pixel is quartered, in standard deviations, if it exceeds the
reach of the stage."""
ROBUST_STEPS = 20
"""Number of iteratively reweighted fits of scale and shift."""


class MeasuredDepth(NamedTuple):
    """Depth of each pixel at the values of scale and shift that fit the rendered scene best."""

    depth: Float[np.ndarray, "row column"]
    """Along the view [m]; NaN where none is measured."""
    derivative: Float[np.ndarray, "row column 2"] | None
    """Derivatives of the depth with respect to scale and shift; None for metric depth."""


@dataclass(frozen=True)
class DepthPixels:
    """Pixels of an object with a measured depth, at the current placement."""

    row: Int[np.ndarray, " n"]
    column: Int[np.ndarray, " n"]
    normal: Float[np.ndarray, "n 3"]
    """Unit normal of the rendered surface, in the camera's frame."""
    residual: Float[np.ndarray, " n"]
    """Distance from the rendered to the measured point along the normal [m]."""


def measured_depth(image: DepthImage, drawn: DrawnObjects) -> MeasuredDepth:
    """Return the depth in meters; scale and shift of a monocular image are fitted to the rendering.

    Args:
        image: the depth image, at the size of the rendering.
        drawn: the rendered scene.
    """
    if image.kind == "metric":
        return MeasuredDepth(image.values, None)
    value, target = image.values, drawn.depth
    if image.kind == "disparity":
        target = 1.0 / target
    used = np.isfinite(value) & np.isfinite(target)
    center, spread = float(np.mean(value[used])), max(float(np.std(value[used])), 1e-12)
    unit = (value - center) / spread
    scale, shift = _line(unit[used], target[used])
    fitted = scale * unit + shift
    columns = np.stack([unit, np.ones_like(unit)], axis=-1)
    if image.kind == "affine":
        return MeasuredDepth(np.where(fitted > 0, fitted, np.nan), columns)
    depth = np.where(fitted > 0, 1.0 / np.where(fitted > 0, fitted, 1.0), np.nan)
    return MeasuredDepth(depth, -(depth**2)[..., None] * columns)


def _line(value: Float[np.ndarray, " n"], target: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """Return scale and shift of the line through most points, by reweighted least squares."""
    design = np.stack([value, np.ones_like(value)], axis=1)
    weight = np.ones(len(value))
    solution = np.zeros(2)
    for _ in range(ROBUST_STEPS):
        weighted = design * weight[:, None]
        solution = np.linalg.lstsq(weighted.T @ design, weighted.T @ target, rcond=None)[0]
        residual = target - design @ solution
        spread = max(1.48 * float(np.median(np.abs(residual))), 1e-9)
        weight = 1 / (1 + (residual / (2 * spread)) ** 2) ** 2
    return float(solution[0]), float(solution[1])


def pixel_rays(camera: Camera, width: int, height: int) -> Float[np.ndarray, "row column 3"]:
    """Return the points of depth 1 in the camera's frame at the centers of an image's pixels."""
    ratio = camera.width / width
    v, u = np.mgrid[:height, :width] + 0.5
    offset = (np.stack([u, v], axis=-1) * ratio - camera.center) / camera.focal
    return np.concatenate([offset, np.ones((height, width, 1))], axis=-1)


def surface_normals(
    points: Float[np.ndarray, "row column 3"], owner: Int[np.ndarray, "row column"]
) -> Float[np.ndarray, "row column 3"]:
    """Return unit normals by differences of the neighbors that show the same object; NaN elsewhere.

    Args:
        points: rendered points in the camera's frame [m].
        owner: object at each pixel.
    """
    right, below = np.full_like(points, np.nan), np.full_like(points, np.nan)
    same = (owner[:, 2:] == owner[:, 1:-1]) & (owner[:, :-2] == owner[:, 1:-1])
    right[:, 1:-1][same] = (points[:, 2:] - points[:, :-2])[same]
    same = (owner[2:] == owner[1:-1]) & (owner[:-2] == owner[1:-1])
    below[1:-1][same] = (points[2:] - points[:-2])[same]
    normal = np.cross(right, below)
    with np.errstate(invalid="ignore", divide="ignore"):
        return normal / np.linalg.norm(normal, axis=-1, keepdims=True)


def eroded(mask: Bool[np.ndarray, "row column"]) -> Bool[np.ndarray, "row column"]:
    """Return a mask without its margin; the margin is narrower where little would remain."""
    margin = max(1, round(MARGIN_PX * mask.shape[1] / REFERENCE_PX))
    for width in range(margin, 0, -1):
        inner = binary_erosion(mask, iterations=width, border_value=1)
        if inner.sum() >= LEAST_PIXELS:
            return np.asarray(inner, bool)
    return mask


@dataclass(frozen=True)
class SceneDepth:
    """Measured depth of a rendered scene."""

    unknowns: Unknowns
    now: Placement
    drawn: DrawnObjects
    image: DepthImage
    """The depth image, at the size of the rendering."""
    measured: MeasuredDepth
    masks: Mapping[int, Bool[np.ndarray, "row column"]]
    """Pixels that show an object in the photograph, by index; unknown for other objects."""

    @classmethod
    def of(
        cls,
        image: DepthImage,
        masks: Masks | None,
        unknowns: Unknowns,
        now: Placement,
        drawn: DrawnObjects,
    ) -> "SceneDepth":
        """Return the depth of a scene rendered in the placement `now`."""
        size = drawn.owner.shape
        names = [item.name for item in unknowns.scene.objects]
        resized = image.resized(*size)
        known = {} if masks is None else masks.at(names, *size)
        return cls(unknowns, now, drawn, resized, measured_depth(resized, drawn), known)

    @property
    def global_count(self) -> int:
        """Number of unknowns of the image: 2 if its scale and shift are unknown."""
        return 0 if self.measured.derivative is None else 2

    @cached_property
    def rays(self) -> Float[np.ndarray, "row column 3"]:
        """Result of `pixel_rays`."""
        height, width = self.drawn.owner.shape
        return pixel_rays(self.now.camera, width, height)

    @cached_property
    def usable(self) -> Bool[np.ndarray, "row column"]:
        """Pixels with a measured depth and a rendered normal."""
        return np.isfinite(self.normals).all(axis=-1) & np.isfinite(self.measured.depth)

    @cached_property
    def normals(self) -> Float[np.ndarray, "row column 3"]:
        """Result of `surface_normals`."""
        drawn = self.drawn
        depth = np.where(np.isfinite(drawn.depth), drawn.depth, np.nan)
        return surface_normals(self.rays * depth[..., None], drawn.owner)

    def is_support(self, k: int) -> bool:
        """Return whether an object is a support of the environment, or another fixed root."""
        item = self.unknowns.scene.objects[k]
        return item.environment or item.parent is None

    def drawn_points(self, mask: Bool[np.ndarray, "row column"]) -> Float[np.ndarray, "n 3"]:
        """Return the rendered points at some pixels, in the camera's frame [m]."""
        return self.rays[mask] * self.drawn.depth[mask][:, None]

    def shown(self, k: int) -> Bool[np.ndarray, "row column"]:
        """Return the pixels that show an object in the rendering and in its mask, if it has one."""
        shown = self.drawn.owner == k
        return shown & self.masks[k] if k in self.masks else shown

    def box(self, k: int) -> Float[np.ndarray, " 4"] | None:
        """Return the 2D box of an object in pixels of the rendering, or None if it has none."""
        box = self.unknowns.scene.objects[k].box2d
        if box is None:
            return None
        return np.array(box.as_tuple()) * self.drawn.owner.shape[1] / self.now.camera.width

    @cached_property
    def level(self) -> Bool[np.ndarray, "row column"]:
        """Pixels whose rendered surface is level."""
        with np.errstate(invalid="ignore"):
            return np.abs(self.normals @ self.now.camera.axes()[2]) > UPWARD

    def pixels(self, k: int) -> DepthPixels | None:
        """Return the pixels of an object whose depth is measured; None if there are too few."""
        shown = self.shown(k)
        if shown.sum() < LEAST_PIXELS:
            return None
        usable = self.usable & self.level if self.is_support(k) else self.usable
        row, column = np.nonzero(eroded(shown) & usable)
        if len(row) < LEAST_PIXELS:
            return None
        pick = np.linspace(0, len(row) - 1, min(MOST_PIXELS, len(row))).astype(int)
        row, column = row[pick], column[pick]
        normal = self.normals[row, column]
        gap = (self.measured.depth - self.drawn.depth)[row, column]
        residual = gap * np.sum(self.rays[row, column] * normal, axis=1)
        return DepthPixels(row, column, normal, residual)

    def evidence(self, neighbors: list[Placement], k: int, reach: float) -> LinearEvidence | None:
        """Return the evidence of an object's depth, or None if too few of its pixels have one.

        Args:
            neighbors: the placements of `Unknowns.neighbors`.
            k: index of the object; a fixed one is evidence about the camera.
            reach: residual at which the weight of a pixel is quartered [m], if it is larger than
                OUTLYING standard deviations.
        """
        pixels = self.pixels(k)
        if pixels is None:
            return None
        unknowns, now, drawn = self.unknowns, self.now, self.drawn
        row, column, normal, residual = pixels.row, pixels.column, pixels.normal, pixels.residual
        depth = drawn.depth[row, column]
        pixel = np.stack([column, row], axis=1) + 0.5
        world = unprojected(now, pixel, depth, drawn.owner.shape[1])
        local = now.local(k, world)
        along = lambda points, camera: np.sum(
            (points - camera.position()) @ camera.axes() * normal, axis=1
        )
        jacobian = value_jacobian(unknowns, now, neighbors, k, local, along)
        deviation = self._deviation(k, depth, world[:, 2])
        support = self.is_support(k)
        count = SUPPORT_OBSERVATIONS if support else OBSERVATIONS
        if self.image.smooth_sd:
            count = SMOOTH_OBSERVATIONS
        if support:
            count *= min(1.0, float(self.shown(k).mean()) / LARGE)
        independent = min(1.0, count / len(residual))
        robust = 1 / (1 + (residual / np.maximum(reach, OUTLYING * deviation)) ** 2) ** 2
        weight = independent * robust / deviation**2
        if self.image.confidence is not None:
            weight = weight * self.image.confidence[row, column]
        extra = None
        if self.measured.derivative is not None:
            slope = np.sum(self.rays[row, column] * normal, axis=1)
            extra = -self.measured.derivative[row, column] * slope[:, None]
        return LinearEvidence(jacobian, residual, weight, extra)

    def _deviation(
        self, k: int, depth: Float[np.ndarray, " n"], height: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, " n"]:
        """Return the standard deviations of the residuals of an object's points [m].

        Args:
            k: index of the object.
            depth: depth of each point along the view [m].
            height: height of each point above z = 0 [m].
        """
        surface = np.hypot(SUPPORT_M, 0.0 if k in self.unknowns.free else SUPPORT * height)
        if not self.is_support(k):
            vertices = self.unknowns.surfaces[k].vertices
            size = float(np.ptp(vertices, axis=0).max()) * float(self.now.scale[k])
            surface = np.full_like(depth, math.hypot(SHAPE * min(size, LARGEST_M), LEAST_M))
        smooth = self.image.smooth_sd * depth
        return np.sqrt(sensor_sd(depth) ** 2 + smooth**2 + surface**2)
