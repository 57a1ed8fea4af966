"""Polyhedra that replace the cylinders and ellipsoids of exported files.

MJX's collision routines lack most pairs with cylinders and ellipsoids. The surface of a polyhedron
deviates from the replaced surface by equal distances inward and outward.
"""

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

PRISM_SIDES = 12
"""Number of sides of the prism that replaces a cylinder."""

_CYLINDER, _ELLIPSOID = (
    int(mujoco.mjtGeom.mjGEOM_CYLINDER),
    int(mujoco.mjtGeom.mjGEOM_ELLIPSOID),
)


def lower_geoms(spec: mujoco.MjSpec) -> frozenset[str]:
    """Replace cylinders and ellipsoids that collide by meshes; return the names of the meshes."""
    meshes = set()
    for geom in spec.geoms:
        if int(geom.type) not in (_CYLINDER, _ELLIPSOID) or not geom.contype:
            continue
        mesh = spec.add_mesh(name=f"{geom.name}-lowered")
        mesh.uservert = polyhedron(int(geom.type), np.array(geom.size)).ravel()
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
        geom.type, geom.meshname = mujoco.mjtGeom.mjGEOM_MESH, mesh.name
        meshes.add(mesh.name)
    return frozenset(meshes)


def polyhedron(kind: int, size: NDArray) -> NDArray:
    """Return the corners [n, 3] of the polyhedron that replaces a MuJoCo cylinder or ellipsoid."""
    if kind == _ELLIPSOID:
        return ellipsoid_corners(size)
    turn = 2 * np.pi * np.arange(PRISM_SIDES) / PRISM_SIDES
    ring = size[0] * _prism_factor() * np.column_stack([np.cos(turn), np.sin(turn)])
    return np.vstack(
        [np.column_stack([ring, np.full(PRISM_SIDES, z)]) for z in (-size[1], size[1])]
    )


def ellipsoid_corners(radii: NDArray) -> NDArray:
    """Return the 56 corners [56, 3] of the polyhedron that replaces an ellipsoid."""
    return _ball()[0] * radii


def _prism_factor() -> float:
    # The corners are as far outside the circle as the edges are inside.
    return 2 / (1 + np.cos(np.pi / PRISM_SIDES))


def _ball() -> tuple[NDArray, float]:
    """Return 56 corners around the unit sphere, and the distance of the corners from its center.

    Each half-axis intersects a flat face, since an ellipsoid would tip over on a corner.
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


def polyhedron_error(kind: str, size: tuple[float, ...]) -> float:
    """Return the largest distance [m] between a piece's surface and the polyhedron's surface."""
    if kind == "cylinder":
        return (_prism_factor() - 1) * size[0]
    return (_ball()[1] - 1) * max(size) if kind == "ellipsoid" else 0.0
