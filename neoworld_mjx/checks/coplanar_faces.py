"""Visible faces of two shapes in one plane: renderers show an arbitrary one of them.

A door panel that ends exactly where its frame does is drawn in the frame's color, in the next
renderer in its own, or in stripes.
"""

import itertools
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import shapely
from jaxtyping import Float

from ..spec import GeomSpec, ObjectSpec
from .signals import Signal

SAME_PLANE_M = 2e-5
"""Largest distance of two planes that count as one [m]."""
STAND_OUT_M = 0.0005
"""Distance by which one of the faces should stand out [m]."""
LEAST_SHARE = 0.1
"""Fraction of the smaller face that must lie in the other face."""
LEAST_M2 = 2.5e-5
"""Smallest area of a face that is checked [m^2]."""
MOST_TRIANGLES = 120
"""A face of more triangles is left out, to bound the time."""
MOST_REPORTED = 4
SAME_COLOR = 0.05
"""Largest difference of red, green or blue, 0 to 1, of shapes that look alike."""
DOWN = -0.9
"""Vertical component of a normal below which a face is not seen."""
SIDES = (("back", "front"), ("right side", "left side"), ("bottom", "top"))


class _Face(NamedTuple):
    """The triangles of one shape in one plane."""

    geom: GeomSpec
    corners: Float[np.ndarray, "t 3 2"]
    """Corners in the plane [m], counterclockwise."""
    area: float


def coplanar_faces(spec: ObjectSpec) -> Iterator[Signal]:
    """Yield a warning for each pair of shapes of different colors with visible faces in one plane.

    All joints are at zero. Faces that point down are left out.
    """
    pairs = (
        (normal, first, second)
        for normal, faces in _planes(spec)
        for first, second in itertools.combinations(faces, 2)
        if _differ(spec, first, second) and _cover(first, second)
    )
    for normal, first, second in itertools.islice(pairs, MOST_REPORTED):
        axis = int(np.argmax(np.abs(normal)))
        side = SIDES[axis][int(normal[axis] > 0)]
        names = [f"{face.geom.name} ({face.geom.material})" for face in (first, second)]
        yield Signal(
            severity="warning",
            code="coplanar_faces",
            message=f"{' and '.join(names)} end in the same plane at the {side}, so one hides the "
            "other there",
            hint=f"let the one that is seen stand out by {1000 * STAND_OUT_M:g} mm or more",
        )


def _planes(spec: ObjectSpec) -> Iterator[tuple[Float[np.ndarray, "3"], list[_Face]]]:
    """Yield the normal and the faces of each plane with faces of more than one material."""
    geoms = [geom for part in spec.parts for geom in part.geoms if geom.role != "collision"]
    surfaces = [geom.shape.surface() for geom in geoms]
    corners = np.concatenate(
        [g.pose().apply(v)[f] for g, (v, f) in zip(geoms, surfaces, strict=True)] or [_NONE]
    )
    owners = np.repeat(np.arange(len(geoms)), [len(faces) for _, faces in surfaces])
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    doubled = np.linalg.norm(cross, axis=1)
    normals = np.round(cross / np.maximum(doubled, 1e-15)[:, None], 3) + 0.0
    offsets = np.einsum("ni,ni->n", normals, corners.mean(axis=1))
    seen = np.flatnonzero((doubled > 0) & (normals[:, 2] >= DOWN))
    keys = np.column_stack([normals, np.round(offsets / SAME_PLANE_M)])[seen]
    kinds, kind, counts = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(kind.ravel(), kind="stable")
    for key, members in zip(kinds, np.split(seen[order], np.cumsum(counts)[:-1]), strict=True):
        if len({geoms[k].material for k in set(owners[members].tolist())}) < 2:
            continue
        across = np.cross(key[:3], np.eye(3)[int(np.argmin(np.abs(key[:3])))])
        basis = np.column_stack([across, np.cross(key[:3], across)]) / np.linalg.norm(across)
        faces = []
        for k in np.unique(owners[members]).tolist():
            own = members[owners[members] == k]
            area = float(doubled[own].sum() / 2)
            if area >= LEAST_M2 and len(own) <= MOST_TRIANGLES:
                faces.append(_Face(geoms[k], corners[own] @ basis, area))
        yield key[:3], faces


_NONE = np.zeros((0, 3, 3))


def _differ(spec: ObjectSpec, first: _Face, second: _Face) -> bool:
    colors = [np.array(spec.material(face.geom.material).rgba) for face in (first, second)]
    return bool(np.abs(colors[0] - colors[1]).max() > SAME_COLOR)


def _cover(first: _Face, second: _Face) -> bool:
    """Return True if two faces of one plane cover each other in part."""
    shapes = [shapely.union_all(shapely.polygons(face.corners)) for face in (first, second)]
    return shapes[0].intersection(shapes[1]).area > LEAST_SHARE * min(first.area, second.area)
