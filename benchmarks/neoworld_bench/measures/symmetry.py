"""Rotational symmetry of an object about the vertical."""

import math

import numpy as np

from neoworld_mjx.physics.support import posed_shapes
from neoworld_mjx.spec import SceneObject


def symmetry(item: SceneObject) -> float:
    """Return the smallest rotation about the vertical that maps an object onto itself [rad].

    0 for round objects, such as a ball or a standing can, whose heading is undefined.
    """
    points = np.vstack(
        [pose.apply(shape.surface()[0]) for shape, pose in posed_shapes(item, tilted=True)]
    )
    angles = np.linspace(0, 2 * np.pi, 360, endpoint=False)
    extents = points[:, :2] @ np.stack([np.cos(angles), np.sin(angles)])
    outline = extents.max(axis=0)
    for step in (10, 45, 60, 90, 120, 180):
        if np.abs(outline - np.roll(outline, step)).max() < 0.02 * outline.max():
            return 0.0 if step == 10 else math.radians(step)
    return 2 * math.pi
