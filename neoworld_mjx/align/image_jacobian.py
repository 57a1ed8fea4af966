"""Derivatives of image points with respect to the alignment's unknowns, by finite differences."""

import numpy as np
from jaxtyping import Float, Int

from .placement import Placement
from .rasterize import pixels_of
from .unknowns import CAMERA, STEP, STRETCH, Unknowns


def image_jacobian(
    unknowns: Unknowns,
    now: Placement,
    neighbors: list[Placement],
    k: int,
    points: Float[np.ndarray, "n 3"],
    normal: Float[np.ndarray, "n 2"],
    width: int,
    bodies: Int[np.ndarray, " n"] | None = None,
) -> Float[np.ndarray, "n v"]:
    """Return the derivatives of image points along normals with respect to the unknowns.

    Args:
        unknowns: the unknowns.
        now: the placement.
        neighbors: the placements of `Unknowns.neighbors`, at the same values of the unknowns.
        k: index of the object.
        points: points in the frames of their bodies [m].
        normal: unit vectors in the image, one for each point.
        width: width of the image [px].
        bodies: body of each point; if None, all points belong to body `k`.

    Returns:
        The derivatives [px per unit] with respect to all unknowns, and then with respect to the
        stretches of `Unknowns.stretch_columns`.
    """
    along = lambda p, camera: np.sum(pixels_of(camera, p, width)[0] * normal, axis=1)
    # Objects without open joints are transformed as a whole.
    body = k if bodies is None or (bodies == k).all() else bodies
    start = along(now.world(body, points), now.camera)
    moved_by = [j for j, joint in enumerate(unknowns.joints) if joint.object == k]
    result = np.zeros((len(points), unknowns.size + STRETCH * (1 + len(moved_by))))
    for u in [*range(CAMERA), *unknowns.columns_of(k)]:
        near = neighbors[u]
        result[:, u] = (along(near.world(body, points), near.camera) - start) / STEP
    foot = unknowns.lowest[k] * now.turn[k][2]
    own = points if body is k else now.local(k, now.world(body, points))
    for axis in range(STRETCH):
        stretched = own.copy()
        stretched[:, axis] += STEP * (own - foot)[:, axis]
        moved = along(now.world(k, stretched), now.camera)
        result[:, unknowns.size + axis] = (moved - start) / STEP
    for i, j in enumerate(moved_by, 1):
        anchor = unknowns.joints[j].anchor
        if anchor is None or body is k:
            continue
        # A longer door may look like a door at another angle.
        moves = np.array([j in part.joints for part in unknowns.parts])
        rows = np.append(np.zeros(len(unknowns.scene.objects), bool), moves)[body]
        for axis in range(STRETCH):
            stretched = points.copy()
            stretched[rows, axis] += STEP * (points - anchor)[rows, axis]
            moved = along(now.world(body, stretched), now.camera)
            result[:, unknowns.size + STRETCH * i + axis] = (moved - start) / STEP
    return result
