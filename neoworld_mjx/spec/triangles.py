"""Closed triangle meshes: revolution, extrusion, normals, volume and distance.

Polygons in the plane: areas, and distances to their convex hull.
"""

import math

import numpy as np
from numpy.typing import NDArray

SECTORS = 64
"""Smallest number of facets around a round shape."""
BALL_SECTORS, RINGS = 32, 16
"""Numbers of facets around a sphere and from pole to pole; low, since only exports show facets."""
CREASE = math.radians(40.0)
"""Largest angle between faces across which shading is smooth [rad]."""
MAX_PAIRS = 400_000
"""Number of pairs of a point and a triangle that are processed at once."""


def corner_normals(vertices: NDArray, faces: NDArray, crease: float = CREASE) -> NDArray:
    """Return a unit normal for each corner of each triangle, shape [f, 3, 3].

    The normal at a corner of a triangle is the area-weighted mean over those faces around the
    vertex whose normals are within `crease` [rad] of the triangle's normal. Cylinders therefore
    shade smoothly, and rims stay sharp.
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
    # All ordered pairs of corners (one, other) that share a vertex, grouped by `one`.
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


def enclosed_volume(vertices: NDArray, faces: NDArray) -> float:
    """Return the volume [m^3] that a closed mesh with outward normals encloses."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(np.sum(a * np.cross(b, c)) / 6)


def extruded_outline(outline: NDArray, height: float) -> tuple[NDArray, NDArray]:
    """Extrude a convex outline [n, 2] along z from -height/2 to height/2."""
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


def meridian(radius: float, half_length: float) -> NDArray:
    """Return the (r, z) chain [n, 2] from pole to pole of a capsule or, at length 0, a sphere."""
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


def revolved(chain: NDArray, sectors: int, *, closed: bool = False) -> tuple[NDArray, NDArray]:
    """Revolve a chain of (r, z) corners [n, 2] about z; points on the axis become one vertex."""
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


def distance_to_triangles(p: NDArray, vertices: NDArray, faces: NDArray) -> NDArray:
    """Return the distances [m] of points [n, 3] to a closed mesh, negative inside, shape [n]."""
    corners = vertices[faces]
    step = max(1, MAX_PAIRS // len(faces))
    distances = np.empty(len(p))
    for i in range(0, len(p), step):
        chunk = p[i : i + step, None]
        near = _to_triangles(chunk, corners)
        distances[i : i + step] = near * np.where(_winding(chunk, corners) > 0.5, -1.0, 1.0)
    return distances


def _to_triangles(p: NDArray, corners: NDArray) -> NDArray:
    """Return the distances [n] of points [n, 1, 3] to the nearest of the triangles [f, 3, 3]."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    unit = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    best = np.full((len(p), len(corners)), np.inf)
    over = np.ones((len(p), len(corners)), bool)
    for k in range(3):
        a, b = corners[:, k], corners[:, (k + 1) % 3]
        edge, from_a = b - a, p - a
        t = np.sum(from_a * edge, axis=2) / np.maximum(np.sum(edge * edge, axis=1), 1e-300)
        gap = from_a - np.clip(t, 0.0, 1.0)[..., None] * edge
        best = np.minimum(best, np.sum(gap * gap, axis=2))
        over &= np.sum(np.cross(unit, edge) * from_a, axis=2) >= 0
    height = np.sum((p - corners[:, 0]) * unit, axis=2)
    return np.sqrt(np.where(over, height**2, best).min(axis=1))


def _winding(p: NDArray, corners: NDArray) -> NDArray:
    """Return the winding numbers of a surface around points (Van Oosterom and Strackee, 1983)."""
    a, b, c = (corners[:, k] - p for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=2) for v in (a, b, c))
    dot = lambda u, v: np.sum(u * v, axis=2)
    above = dot(a, np.cross(b, c))
    below = la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb
    return np.sum(np.arctan2(above, below), axis=1) / (2 * np.pi)


HULL_EDGE_SAMPLES = 17
"""Number of points along each edge of a hull at which the distance to the polygons is measured."""


def hull_excess(polygons: list[NDArray]) -> float:
    """Return the largest distance between neighboring polygons [n, 2] and their convex hull."""
    import shapely

    corners = shapely.multipoints(np.vstack(polygons))
    around = shapely.get_coordinates(shapely.convex_hull(corners))
    # The largest distance is at edges of the hull that span a gap.
    along = np.linspace(0.0, 1.0, HULL_EDGE_SAMPLES)[:, None, None]
    lids = around[:-1] + along * np.diff(around, axis=0)
    edges = shapely.MultiLineString([np.vstack([p, p[:1]]) for p in polygons])
    return float(shapely.distance(shapely.points(lids), edges).max())


def polygon_area(p: NDArray) -> float:
    """Return the area of a polygon [n, 2], positive if its corners run counterclockwise."""
    q = np.roll(p, -1, axis=0)
    return float(np.sum(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]) / 2)
