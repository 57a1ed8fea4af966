"""Smooth visual surfaces of shapes: closed triangle meshes, and the policy for their normals.

Colliders may be coarse and in pieces; a surface is one watertight mesh of the whole shape, outward,
the same bytes for the same shape. Only pictures and exported visuals use it, never physics.
"""

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from .csg import CSG
from .extruded import Extrusion, RoundedBox
from .mesh import Mesh
from .shapes import Box, Capsule, Cylinder, Ellipsoid, HollowBox, Lathe, Prism, Shape, Sphere
from .swept import Sweep

SECTORS = 64
"""Facets around a round shape, at least."""
BALL_SECTORS, RINGS = 32, 16
"""Facets around a ball, and from pole to pole; exports alone show them, and want small files."""
CREASE = math.radians(40.0)
"""Faces that meet at a smaller angle [rad] are shaded as one smooth surface."""


def surface(shape: Shape) -> tuple[NDArray, NDArray]:
    """Return the closed outward surface of a shape, in the shape's frame.

    Args:
        shape: any shape of the specification.

    Returns:
        vertices [v, 3] m, float64, and triangles [f, 3], int64, counter-clockwise from outside.
        The arrays are shared and read-only.
    """
    return _shared(shape)  # pyright: ignore[reportArgumentType] frozen models have a hash


@lru_cache(maxsize=1024)
def _shared(shape: Shape) -> tuple[NDArray, NDArray]:
    vertices, faces = _build(shape)
    vertices.setflags(write=False)
    faces.setflags(write=False)
    return vertices, faces


def corner_normals(vertices: NDArray, faces: NDArray, crease: float = CREASE) -> NDArray:
    """Return unit normals per triangle corner [f, 3, 3].

    A corner takes the mean, weighted by area, of the faces around its vertex whose own normals are
    within `crease` [rad] of its face's normal; so cylinders shade smoothly and rims stay sharp.
    """
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    area = np.cross(b - a, c - a)
    length = np.linalg.norm(area, axis=1, keepdims=True)
    unit = area / np.where(length > 0, length, 1.0)
    face_of = np.repeat(np.arange(len(faces)), 3)
    order = np.argsort(faces.ravel(), kind="stable")
    vertex = faces.ravel()[order]
    start = np.searchsorted(vertex, np.arange(len(vertices) + 1))
    count = np.diff(start)
    # Every ordered pair of corners (one, other) that share a vertex, grouped by `one`.
    per_corner = count[vertex]
    one = np.repeat(np.arange(len(order)), per_corner)
    offset = np.arange(len(one)) - np.repeat(np.cumsum(per_corner) - per_corner, per_corner)
    other = np.repeat(start[vertex], per_corner) + offset
    one_face, other_face = face_of[order[one]], face_of[order[other]]
    smooth = np.sum(unit[one_face] * unit[other_face], axis=1) >= math.cos(crease)
    total = np.zeros((len(order), 3))
    np.add.at(total, order[one[smooth]], area[other_face[smooth]])
    size = np.linalg.norm(total, axis=1, keepdims=True)
    fallback = unit[face_of]
    normals = np.where(size > 0, total / np.where(size > 0, size, 1.0), fallback)
    return normals.reshape(-1, 3, 3)


def _build(shape: Shape) -> tuple[NDArray, NDArray]:
    if isinstance(shape, Sweep | Extrusion | RoundedBox | CSG | Mesh):
        return shape.surface()
    if isinstance(shape, Box):
        return _prism(_rectangle(shape.size[0], shape.size[1]), shape.size[2])
    if isinstance(shape, Prism):
        return _prism(np.array(shape.outline), shape.height)
    if isinstance(shape, HollowBox):
        return _hollow_box(shape)
    if isinstance(shape, Lathe):
        vertices, faces = _lathe(shape)
        return vertices * [1.0, shape.oval, 1.0], faces
    if isinstance(shape, Cylinder):
        r, h = shape.radius, shape.height / 2
        return _revolve(np.array([[0, -h], [r, -h], [r, h], [0, h]]), SECTORS)
    if isinstance(shape, Capsule):
        return _revolve(_meridian(shape.radius, shape.length / 2), BALL_SECTORS)
    if isinstance(shape, Sphere):
        return _revolve(_meridian(shape.radius, 0.0), BALL_SECTORS)
    assert isinstance(shape, Ellipsoid)
    vertices, faces = _revolve(_meridian(1.0, 0.0), BALL_SECTORS)
    return vertices * np.array(shape.radii), faces


def _rectangle(x: float, y: float) -> NDArray:
    return np.array([[-x, -y], [x, -y], [x, y], [-x, y]]) / 2


def _prism(outline: NDArray, height: float) -> tuple[NDArray, NDArray]:
    after = np.roll(outline, -1, axis=0)
    if np.sum(outline[:, 0] * after[:, 1] - outline[:, 1] * after[:, 0]) < 0:
        outline = outline[::-1]
    n = len(outline)
    vertices = np.vstack(
        [
            np.column_stack([outline, np.full(n, -height / 2)]),
            np.column_stack([outline, np.full(n, height / 2)]),
        ]
    )
    i = np.arange(n)
    j = (i + 1) % n
    sides = np.vstack([np.column_stack([i, j, n + j]), np.column_stack([i, n + j, n + i])])
    k = np.arange(1, n - 1)
    bottom = np.column_stack([np.zeros_like(k), k + 1, k])
    top = np.column_stack([np.full_like(k, n), n + k, n + k + 1])
    return vertices, np.vstack([sides, bottom, top])


def _hollow_box(shape: HollowBox) -> tuple[NDArray, NDArray]:
    """Skin the box's filled cells, on the grid that the walls cut it into."""
    grid, cavity = [], []
    for axis, letter in enumerate("xyz"):
        half = shape.size[axis] / 2
        low = f"-{letter}" in shape.open
        high = f"+{letter}" in shape.open
        lines = [-half, *([] if low else [-half + shape.wall])]
        cavity.append(len(lines) - 1)
        grid.append(np.array([*lines, *([] if high else [half - shape.wall]), half]))
    cells = [len(line) - 1 for line in grid]
    filled = np.zeros([n + 2 for n in cells], bool)
    filled[1:-1, 1:-1, 1:-1] = True
    filled[tuple(c + 1 for c in cavity)] = False
    corners: dict[tuple[int, int, int], int] = {}
    points: list[list[float]] = []
    faces: list[list[int]] = []
    for cell in np.argwhere(filled):
        for axis in range(3):
            for side in (0, 1):
                beyond = cell.copy()
                beyond[axis] += 2 * side - 1
                if filled[tuple(beyond)]:
                    continue
                u, v = (axis + 1) % 3, (axis + 2) % 3
                quad = []
                for du, dv in ((0, 0), (1, 0), (1, 1), (0, 1)):
                    at = cell - 1
                    at[axis] += side
                    at[u] += du
                    at[v] += dv
                    key = (int(at[0]), int(at[1]), int(at[2]))
                    if key not in corners:
                        corners[key] = len(points)
                        points.append([float(grid[i][key[i]]) for i in range(3)])
                    quad.append(corners[key])
                if side == 0:
                    quad.reverse()
                faces += [[quad[0], quad[1], quad[2]], [quad[0], quad[2], quad[3]]]
    return np.array(points), np.array(faces)


def _lathe(shape: Lathe) -> tuple[NDArray, NDArray]:
    # A multiple of the colliders' sectors, so that their corners are corners of the surface too.
    sectors = shape.sectors * math.ceil(SECTORS / shape.sectors)
    return _revolve(section(shape), sectors, closed=ring_section(shape))


def ring_section(shape: Lathe) -> bool:
    """Tell whether a lathe's section is a loop that stays off the axis."""
    return shape.thickness is not None and shape.profile[0][0] > 0


def section(shape: Lathe) -> NDArray:
    """Return the chain of (r, z) corners [n, 2] m that bounds a lathe's section.

    It begins and ends on the axis, unless it is a ring's: then it is a loop.
    """
    profile = np.array(shape.profile)
    if shape.thickness is None:
        # Radii that change at one height bound no volume at the ends and only once in between.
        z = profile[:, 1]
        keep = [
            i
            for i in range(len(z))
            if not (
                (z[i] == z[0] and i + 1 < len(z) and z[i + 1] == z[0])
                or (z[i] == z[-1] and i > 0 and z[i - 1] == z[-1])
                or (0 < i < len(z) - 1 and z[i - 1] == z[i] == z[i + 1])
            )
        ]
        p = profile[keep]
        foot = [[0.0, p[0, 1]]] if p[0, 0] > 0 else []
        head = [[0.0, p[-1, 1]]] if p[-1, 0] > 0 else []
        return np.array([*foot, *p.tolist(), *head])
    outer, floor = profile, shape.floor()
    if floor is not None and np.linalg.norm(profile - floor, axis=1).min() > 1e-9:
        # The colliders are cut at the inner floor; their corners there belong to the surface, too.
        outer = np.insert(profile, np.flatnonzero(profile[:, 1] >= floor[1])[0], floor, axis=0)
    return np.vstack([outer, shape.inner()[::-1]])


def _meridian(radius: float, half_length: float) -> NDArray:
    angle = np.linspace(-np.pi / 2, np.pi / 2, RINGS + 1)
    p = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    p[[0, -1], 0] = 0.0
    if half_length == 0:
        return p
    middle = RINGS // 2
    low, high = p[: middle + 1].copy(), p[middle:].copy()
    low[:, 1] -= half_length
    high[:, 1] += half_length
    return np.vstack([low, high])


def _revolve(chain: NDArray, sectors: int, *, closed: bool = False) -> tuple[NDArray, NDArray]:
    """Turn a chain of (r, z) corners [n, 2] about z; points on the axis become one vertex."""
    angle = 2 * np.pi * np.arange(sectors) / sectors
    points, rings = [], []
    total = 0
    for r, z in chain:
        if r == 0:
            points.append(np.array([[0.0, 0.0, z]]))
            rings.append(np.full(sectors, total))
        else:
            ring = np.column_stack([r * np.cos(angle), r * np.sin(angle), np.full(sectors, z)])
            points.append(ring)
            rings.append(total + np.arange(sectors))
        total += len(points[-1])
    loop = [*rings, rings[0]] if closed else rings
    faces = []
    for a, b in zip(loop[:-1], loop[1:], strict=True):
        a1, b1 = np.roll(a, -1), np.roll(b, -1)
        if a[0] != a1[0]:
            faces.append(np.column_stack([a, a1, b]))
        if b[0] != b1[0]:
            faces.append(np.column_stack([a1, b1, b]))
    vertices, triangles = np.vstack(points), np.vstack(faces)
    used, inverse = np.unique(triangles, return_inverse=True)
    vertices, triangles = vertices[used], inverse.reshape(-1, 3)
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    if np.sum(a * np.cross(b, c)) < 0:
        triangles = triangles[:, ::-1]
    return vertices, np.ascontiguousarray(triangles)


__all__ = ["CREASE", "corner_normals", "ring_section", "section", "surface"]
