"""Rows of the normal equations: residuals, weights and their Jacobians by finite differences.

Every kind of evidence returns `LinearEvidence` about one object, in the same unknowns.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...render.rasterize import pixels_of
from ...spec import Camera
from ..unknowns import CAMERA, STEP, STRETCH, Placement, Unknowns

REFERENCE_PX = 640.0
"""Width [px] of the image to which constants in pixels refer."""


@dataclass(frozen=True)
class LinearEvidence:
    """Linearized evidence about one object: weight * (residual - jacobian @ change)^2.

    Residuals are in pixels or, for depths, in meters.
    """

    jacobian: Float[np.ndarray, "n v"]
    """Derivatives [px per unit] with respect to all unknowns, and then with respect to the
    stretches of `Unknowns.stretch_columns`."""
    residual: Float[np.ndarray, " n"]
    """[px]"""
    weight: Float[np.ndarray, " n"]
    """[1/px^2]"""
    global_jacobian: Float[np.ndarray, "n g"] | None = None
    """Derivatives with respect to the scale and shift of the depth image; None if the residuals do
    not depend on them."""


def combined(evidence: Sequence[LinearEvidence]) -> LinearEvidence:
    """Return the evidence of several photographs about one object as one."""
    if len(evidence) == 1:
        return evidence[0]
    parts = ([getattr(e, name) for e in evidence] for name in ("jacobian", "residual", "weight"))
    return LinearEvidence(*(np.concatenate(part) for part in parts))


def image_jacobian(
    unknowns: Unknowns,
    now: Placement,
    neighbors: list[Placement],
    k: int,
    points: Float[np.ndarray, "n 3"],
    normal: Float[np.ndarray, "n 2"],
    width: int,
) -> Float[np.ndarray, "n v"]:
    """Return the derivatives of image points along normals with respect to the unknowns.

    Args:
        unknowns: the unknowns.
        now: the placement.
        neighbors: the placements of `Unknowns.neighbors`, at the same values of the unknowns.
        k: index of the object.
        points: points in the object's frame [m].
        normal: unit vectors in the image, one for each point.
        width: width of the image [px].

    Returns:
        The derivatives [px per unit] with respect to all unknowns, and then with respect to the
        stretches of `Unknowns.stretch_columns`.
    """
    along = lambda p, camera: np.sum(pixels_of(camera, p, width)[0] * normal, axis=1)
    return value_jacobian(unknowns, now, neighbors, k, points, along)


def value_jacobian(
    unknowns: Unknowns,
    now: Placement,
    neighbors: list[Placement],
    k: int,
    points: Float[np.ndarray, "n 3"],
    along: Callable[[Float[np.ndarray, "n 3"], Camera], Float[np.ndarray, " n"]],
) -> Float[np.ndarray, "n v"]:
    """Return the derivatives of a value of each point with respect to the unknowns.

    Arguments and columns are as for `image_jacobian`; `along` maps points in the world and the
    camera to the values.
    """
    start = along(now.world(k, points), now.camera)
    result = np.zeros((len(points), unknowns.size + STRETCH))
    for u in [*range(CAMERA), *unknowns.columns_of(k), *unknowns.view_columns(now.view)]:
        near = neighbors[u]
        result[:, u] = (along(near.world(k, points), near.camera) - start) / STEP
    foot = unknowns.lowest[k] * now.turn[k][2]
    for axis in range(STRETCH):
        stretched = points.copy()
        stretched[:, axis] += STEP * (points - foot)[:, axis]
        moved = along(now.world(k, stretched), now.camera)
        result[:, unknowns.size + axis] = (moved - start) / STEP
    return result


def unprojected(
    now: Placement,
    pixel: Float[np.ndarray, "n 2"],
    depth: Float[np.ndarray, " n"],
    width: int,
) -> Float[np.ndarray, "n 3"]:
    """Return the points in the world at some pixels of an image `width` pixels wide [m].

    Args:
        now: the placement, for its camera.
        pixel: pixels of the image.
        depth: depths along the view [m].
        width: width of the image [px].
    """
    camera = now.camera
    ratio = width / camera.width
    offset = (pixel / ratio - camera.center) / camera.focal
    local = np.concatenate([offset, np.ones((len(offset), 1))], axis=1) * depth[:, None]
    return camera.position() + local @ camera.axes().T
