"""Rotational symmetry of an object about the vertical."""

import math

import numpy as np

from neoworld_mjx.physics.support import posed_shapes
from neoworld_mjx.spec import SceneObject

MOST_DIFFERENCE = 0.02
"""Maximum difference between symmetric extents, as a fraction of the largest extent."""


def symmetry(item: SceneObject) -> float:
    """Return the smallest rotation about the vertical that maps an object onto itself [rad].

    The result is 0 for round objects, such as a ball or a standing can, whose heading is undefined.
    Without symmetry, it is 2 pi.
    """
    points = np.vstack(
        [pose.apply(shape.surface()[0]) for shape, pose in posed_shapes(item, tilted=True)]
    )
    points[:, 2] -= points[:, 2].mean()
    angles = np.linspace(0, 2 * np.pi, 360, endpoint=False)
    around = np.stack([np.cos(angles), np.sin(angles)])
    # Use extents to the sides and obliquely up and down: half a turn does not map a leaning object
    # onto itself, although its extents to the sides stay the same.
    extents = np.stack(
        [(points @ np.vstack([around, np.full(360, up)])).max(axis=0) for up in (0.0, 1.0, -1.0)]
    )
    # Measure extents from the Steiner point, which rotates with the outline.
    extents -= around.T @ (around @ extents[0]) * 2 / len(angles)
    for step in (10, 45, 60, 90, 120, 180):
        difference = np.abs(extents - np.roll(extents, step, axis=1)).max()
        if difference < MOST_DIFFERENCE * extents.max():
            return 0.0 if step == 10 else math.radians(step)
    return 2 * math.pi
