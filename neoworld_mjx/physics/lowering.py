"""Colliders for an engine that cannot collide cylinders and ellipsoids with boxes and meshes.

They become convex polyhedra, as far inside the true surface as outside of it. Only rollouts use
these; D_pen and every measure see the canonical colliders.
"""

import dataclasses

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from .mjcf import to_mjspec
from .model import SceneModel

SIDES = 12
"""Of the prism that stands for a cylinder."""

_CYLINDER, _ELLIPSOID = (
    int(mujoco.mjtGeom.mjGEOM_CYLINDER),
    int(mujoco.mjtGeom.mjGEOM_ELLIPSOID),
)


def lowered(scene: SceneModel) -> SceneModel:
    """Return the scene with its cylinders and ellipsoids as polyhedra; masses stay as they are."""
    static = scene.static
    spec = to_mjspec(scene.spec, timestep=float(static.mjm.opt.timestep))
    for geom in spec.geoms:
        if int(geom.type) not in (_CYLINDER, _ELLIPSOID):
            continue
        mesh = spec.add_mesh(name=f"{geom.name}/lowered")
        mesh.uservert = polyhedron(int(geom.type), np.array(geom.size)).ravel()
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
        geom.type, geom.meshname = mujoco.mjtGeom.mjGEOM_MESH, mesh.name
    mjm = spec.compile()
    mjm.opt.disableflags = static.mjm.opt.disableflags
    return dataclasses.replace(scene, static=dataclasses.replace(static, mjm=mjm))


def polyhedron(kind: int, size: NDArray) -> NDArray:
    """Return the corners [n, 3] of the polyhedron that replaces a MuJoCo cylinder or ellipsoid."""
    if kind == _ELLIPSOID:
        return _ball()[0] * size
    turn = 2 * np.pi * np.arange(SIDES) / SIDES
    ring = size[0] * _prism_factor() * np.column_stack([np.cos(turn), np.sin(turn)])
    return np.vstack([np.column_stack([ring, np.full(SIDES, z)]) for z in (-size[1], size[1])])


def _prism_factor() -> float:
    # Corners as far outside of the circle as edges are inside of it.
    return 2 / (1 + np.cos(np.pi / SIDES))


def _ball() -> tuple[NDArray, float]:
    """Return 56 corners around the unit sphere and how far the farthest is from its centre.

    A flat side faces each way of each axis: an ellipsoid that lies on a pole would tip over on a
    corner there.
    """
    ticks = np.tan(np.pi / 4 * np.array([-1.0, -1 / 3, 1 / 3, 1.0]))
    u, v = (axis.ravel() for axis in np.meshgrid(ticks, ticks))
    cap = np.column_stack([u, v, np.ones_like(u)])
    points = np.vstack([np.roll(side * cap, k, axis=1) for k in range(3) for side in (-1.0, 1.0)])
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    points = np.unique(points.round(12), axis=0)
    inner = float(np.abs(ConvexHull(points).equations[:, 3]).min())
    factor = 2 / (1 + inner)
    return points * factor, factor
