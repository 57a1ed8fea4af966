"""Schema of the scene that the Blender process writes, which is untrusted and limited in size.

Decomposition of a Blender mesh into connected solids, and of solids into convex pieces.
"""

import base64
import binascii
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from ...physics.decompose import convex_pieces, hull_points, is_convex, is_flat
from ...spec import Box, Mesh
from ...spec.pose import Pose, from_matrix, pose

Text = Annotated[str, Field(max_length=200)]
Vector3 = Annotated[list[float], Field(min_length=3, max_length=3)]
Number = Annotated[float, Field(ge=-1e6, le=1e6)]
MAX_SHAPES, MAX_JOINTS = 3000, 300
MAX_REACH_M = 100.0
"""Largest allowed coordinate [m]."""


class _Data(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class BlenderMaterial(_Data):
    """A material, with values from its custom properties, or else from its Principled BSDF."""

    name: Text
    density: Number | None = None
    friction: Number | None = None
    like: Text | None = None
    rgb: Vector3 | None = None
    alpha: Number | None = None
    metallic: Number | None = None
    roughness: Number | None = None
    pattern: Text | None = None
    rgb2: Vector3 | None = None
    step: Number | None = None
    along: Text | None = None


class BlenderShape(_Data):
    """The triangles of an object in world coordinates [m], packed as base64."""

    name: Text
    part: Text
    role: Text
    convex: bool
    mass: Number | None = None
    """Mass [kg]; the masses of all shapes of a part add up."""
    materials: list[Text] = Field(max_length=64)
    """Name of the material in each slot; empty for an empty slot."""
    vertices: str
    """Vertices as 64-bit floats, shape [v, 3]."""
    faces: str
    """Vertex indices of each triangle as 32-bit integers, shape [f, 3]."""
    slots: str
    """Material slot of each triangle as a 32-bit integer, shape [f]."""

    def triangles(self) -> tuple[NDArray, NDArray, NDArray]:
        """Return vertices [m], shape [v, 3]; faces, shape [f, 3]; and slots, shape [f].

        Raises:
            ValueError: the arrays are malformed, or vertices are not finite or too far away.
        """
        vertices = _unpacked(self.vertices, "<f8", "vertices").reshape(-1, 3)
        faces = _unpacked(self.faces, "<i4", "faces").reshape(-1, 3).astype(np.int64)
        slots = _unpacked(self.slots, "<i4", "slots").astype(np.int64)
        if not np.isfinite(vertices).all() or np.abs(vertices).max(initial=0.0) > MAX_REACH_M:
            raise ValueError(f"vertices lie beyond {MAX_REACH_M:g} m; lengths are in metres")
        if len(faces) and not 0 <= faces.min() <= faces.max() < len(vertices):
            raise ValueError("a face names a vertex that is not there")
        if len(slots) != len(faces):
            raise ValueError("faces and slots are not as many")
        return vertices, faces, slots


class BlenderJoint(_Data):
    """A joint that an empty of the scene declares, in world coordinates."""

    name: Text
    type: Text
    parent: Text = ""
    child: Text = ""
    at: Vector3
    axis: Vector3 | Text
    range: Annotated[list[float], Field(min_length=2, max_length=2)] | None = None
    opens: Vector3 | Text | None = None
    swing: Number | None = None
    damping: Number | None = None
    friction: Number | None = None
    stiffness: Number | None = None
    effort: Number | None = None
    velocity: Number | None = None
    mimic: Text | None = None
    multiplier: Number | None = None
    offset: Number | None = None
    after: Text | None = None
    """Names of the joints that must be open first, separated by commas."""


class BlenderSite(_Data):
    """A point of a part that an empty of the scene declares, in world coordinates."""

    name: Text
    part: Text
    at: Vector3


class BlenderError(_Data):
    """The exception that ended the program."""

    type: Annotated[str, Field(max_length=60)]
    message: Annotated[str, Field(max_length=600)]
    line: int | None = None
    column: int | None = None


class BlenderScene(_Data):
    """The scene after the program has run, or the program's error."""

    error: BlenderError | None = None
    name: Text = ""
    label: Text = ""
    materials: list[BlenderMaterial] = Field(default=[], max_length=MAX_SHAPES)
    shapes: list[BlenderShape] = Field(default=[], max_length=MAX_SHAPES)
    joints: list[BlenderJoint] = Field(default=[], max_length=MAX_JOINTS)
    sites: list[BlenderSite] = Field(default=[], max_length=MAX_SHAPES)


def _unpacked(text: str, kind: str, name: str) -> NDArray:
    try:
        return np.frombuffer(base64.b64decode(text, validate=True), kind)
    except (binascii.Error, ValueError):
        raise ValueError(f"{name} are no array") from None


MAX_FACES = 200_000
"""Largest number of triangles of an object."""
MAX_CONCAVE_FACES = 20_000
"""Largest number of triangles of a solid that is split into convex pieces."""
_SQUARE = 1e-6
"""Largest deviation of a mesh from a box, relative to the box's size."""


class Solid(NamedTuple):
    """A connected solid of an object."""

    vertices: NDArray
    """Vertices [m], shape [v, 3]."""
    faces: NDArray
    """Vertex indices of each triangle, shape [f, 3]."""
    slot: int
    """Most frequent material slot of the triangles."""


def split_solids(vertices: NDArray, faces: NDArray, slots: NDArray) -> list[Solid]:
    """Split a mesh into connected solids without unused vertices.

    If any solid is open, coincident vertices of the whole mesh are merged first. A closed solid
    with inverted faces is a cavity, which is joined to the largest solid. If all solids are
    inverted, all faces are reversed first.

    Args:
        vertices: vertices [m], shape [v, 3].
        faces: vertex indices of each triangle, shape [f, 3].
        slots: material slot of each triangle, shape [f].
    """
    label = _components(len(vertices), faces)
    if not all(_is_closed(faces[label == k]) for k in np.unique(label)):
        vertices, index = np.unique(np.round(vertices, 6), axis=0, return_inverse=True)
        faces = index.reshape(-1)[faces]
        a, b, c = faces.T
        proper = (a != b) & (b != c) & (c != a)
        faces, slots = faces[proper], slots[proper]
        label = _components(len(vertices), faces)
    groups = [np.flatnonzero(label == k) for k in np.unique(label)]
    volumes = np.array([_volume(vertices, faces[rows]) for rows in groups])
    if groups and volumes.max() < 0:
        faces, volumes = faces[:, ::-1], -volumes
    outer = int(volumes.argmax()) if groups else 0
    cavities = [k for k, v in enumerate(volumes) if v < -1e-12 and _is_closed(faces[groups[k]])]
    for k in cavities:
        groups[outer] = np.concatenate([groups[outer], groups[k]])
    return [
        _solid(vertices, faces[rows], slots[rows])
        for k, rows in enumerate(groups)
        if k not in cavities
    ]


def shape_of(solid: Solid, convex: bool) -> tuple[Box | Mesh, Pose] | None:
    """Return the shape of a solid, and the shape's pose; return None for a solid without extent.

    Args:
        solid: the solid.
        convex: if True, the collider is the convex hull of the solid.

    Raises:
        ValueError: the solid is concave and has too many triangles to be split.
    """
    vertices, faces = solid.vertices, solid.faces
    if len(vertices) < 3 or np.ptp(vertices, axis=0).max() < 1e-5:
        return None
    box = _as_box(vertices, faces)
    if box is not None:
        return box
    if len(vertices) == 3:
        vertices = np.vstack([vertices, vertices.mean(axis=0)])
    if convex or is_flat(vertices) or is_convex(vertices, faces):
        hulls = [hull_points(vertices)]
    elif len(faces) > MAX_CONCAVE_FACES:
        raise ValueError(
            f"a concave solid of {len(faces)} triangles is too fine to be split into convex "
            f"pieces, at most {MAX_CONCAVE_FACES}: use fewer segments, build it of convex objects, "
            'or set obj["convex"] = True if its hull will do'
        )
    else:
        hulls = convex_pieces(vertices, faces).pieces
    triangles = tuple(map(tuple, faces.tolist()))
    return Mesh(vertices=_rows(vertices), faces=triangles, hulls=tuple(map(_rows, hulls))), pose()


def _rows(points: NDArray) -> tuple[tuple[float, float, float], ...]:
    return tuple(map(tuple, np.round(points, 9).tolist()))


def _components(count: int, faces: NDArray) -> NDArray:
    """Return the index of the connected component of each face, shape [f]."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    pairs = np.concatenate([faces[:, :2], faces[:, 1:]])
    graph = coo_matrix((np.ones(len(pairs), np.int8), pairs.T), (count, count))
    label = connected_components(graph, directed=False)[1]
    return label[faces[:, 0]]


def _is_closed(faces: NDArray) -> bool:
    """Return True if every edge belongs to two faces that traverse it in opposite directions."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    directed = {(int(a), int(b)) for a, b in edges}
    return len(directed) == len(edges) and all((b, a) in directed for a, b in directed)


def _volume(vertices: NDArray, faces: NDArray) -> float:
    corners = vertices - vertices.mean(axis=0)
    a, b, c = (corners[faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


def _solid(vertices: NDArray, faces: NDArray, slots: NDArray) -> Solid:
    used, index = np.unique(faces, return_inverse=True)
    slot = int(np.bincount(np.clip(slots, 0, 63)).argmax())
    return Solid(vertices[used], index.reshape(faces.shape), slot)


def _as_box(vertices: NDArray, faces: NDArray) -> tuple[Box, Pose] | None:
    """Return a mesh as a box with a pose, or None if the mesh is not a box."""
    if len(vertices) != 8 or len(faces) != 12:
        return None
    centre = vertices.mean(axis=0)
    neighbors = sorted({int(v) for face in faces if 0 in face for v in face} - {0})
    edges = [vertices[k] - vertices[0] for k in neighbors]
    edges.sort(key=lambda edge: float(edge @ edge))
    axes = []
    for edge in edges:
        length = float(np.linalg.norm(edge))
        if length > 1e-5 and all(abs(edge @ other) < _SQUARE**0.5 * length**2 for other in axes):
            axes.append(edge)
    if len(axes) != 3:
        return None
    # Order the edges by the nearest axes, so that an axis-aligned box has no rotation.
    lengths = np.array([np.linalg.norm(edge) for edge in axes])
    rotation = np.array([edge / length for edge, length in zip(axes, lengths, strict=True)])
    order = np.abs(rotation).argmax(axis=1)
    if len(set(order.tolist())) == 3:
        rotation, lengths = rotation[np.argsort(order)], lengths[np.argsort(order)]
        rotation = rotation * np.where(np.diag(rotation) < 0, -1.0, 1.0)[:, None]
    if np.linalg.det(rotation) < 0:
        rotation[2] = -rotation[2]
    local = np.abs((vertices - centre) @ rotation.T)
    if np.abs(local - lengths / 2).max() > _SQUARE * max(1.0, float(lengths.max())):
        return None
    if np.abs(rotation - np.eye(3)).max() < _SQUARE * 10:
        rotation = np.eye(3)
    x, y, z = np.round(lengths, 7).tolist()
    return Box(size=(x, y, z)), pose(np.round(centre, 7), from_matrix(rotation.T))
