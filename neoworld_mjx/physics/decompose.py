"""Convex decomposition of imported meshes by CoACD, cached by content."""

import hashlib
import importlib.util
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..cache import cache_folder
from ..errors import RunError
from ..io import file_bounds, read_arrays
from ..io.files import write_atomic
from ..io.limited_worker import call_limited
from ..quantities import count
from ..spec.convex import sphere_directions, volume_of_hull

CLOSED_LIMITS, OPEN_LIMITS = (0.03, 96), (0.08, 16)
"""Concavity threshold, relative to the mesh's size, and largest number of pieces, of closed meshes
and of open meshes. An open mesh is first split into connected components. CoACD wraps the open
components, so more pieces would take longer without being thinner.
"""
SIMPLIFICATION_TOLERANCE = 0.004
"""Largest displacement of the surface when a closed mesh is simplified, relative to the mesh's
size. Meshes are simplified since CoACD's time grows with the number of faces."""
MAX_HOLE_AREA = 0.05
"""Largest area of the holes that are filled, relative to the mesh's area. Larger holes are kept,
such as the opening of a drawer."""
MAX_CORNERS = 48
CACHE_VERSION = "7"
SHEET_M = 0.002
"""Thickness of the pieces of flat sheets."""
CONVEX_SHARE = 0.97
"""Least volume of a convex mesh, relative to the volume of its hull."""


def coacd_installed() -> bool:
    """Return whether CoACD is installed. Without it, a mesh is replaced by its convex hull."""
    return importlib.util.find_spec("coacd") is not None


@dataclass
class Budget:
    """Time in which the meshes of an asset may be decomposed.

    A mesh may use a quarter of the time that is left or, if there are fewer than four, its equal
    share, so a mesh that takes too long leaves time to the others.
    """

    meshes: int
    """Number of meshes that are not decomposed yet."""
    left_s: float
    """Time for these meshes [s]."""

    @classmethod
    def of(cls, meshes: int) -> "Budget":
        """Return the budget of a number of meshes, `files.decompose_s`."""
        return cls(meshes, file_bounds().decompose_s)

    @contextmanager
    def share(self) -> Iterator[float]:
        """Yield the time for the next mesh [s]; what it does not need is left to the others."""
        share, start = self.left_s / max(min(self.meshes, 4), 1), time.monotonic()
        yield share
        self.meshes -= 1
        # Processor time is limited, so a mesh may take longer on a busy machine.
        self.left_s -= min(time.monotonic() - start, share)


class Decomposition(NamedTuple):
    """Convex pieces of a mesh, and where they come from."""

    pieces: list[NDArray]
    """Points of each piece [m], each of shape [n, 3]."""
    method: str | None = None
    """Description of how the pieces approximate the mesh; None if it is flat or convex."""


def convex_pieces(vertices: NDArray, faces: NDArray, time_s: float | None = None) -> Decomposition:
    """Split a mesh, whose closed components face outwards, into convex pieces.

    The convex hull of the mesh is the only piece if

    - the mesh is flat or convex, or
    - CoACD is not installed, fails, or needs more than `files.memory_mib` or `time_s`.

    Args:
        vertices: vertices of the mesh [m], shape [v, 3].
        faces: triangles of the mesh, shape [f, 3].
        time_s: limit of the time [s]; if None, `files.decompose_s`.
    """
    vertices, faces = np.ascontiguousarray(vertices, float), np.ascontiguousarray(faces, np.int64)
    hull_only = [hull_points(vertices)]
    if is_flat(vertices) or is_convex(vertices, faces):
        return Decomposition(hull_only)
    if not coacd_installed():
        return Decomposition(hull_only, "its convex hull, as CoACD is not installed")
    key = hashlib.sha256()
    for value in (f"{CACHE_VERSION}:{CLOSED_LIMITS}:{OPEN_LIMITS}:{MAX_CORNERS}", vertices, faces):
        key.update(value.encode() if isinstance(value, str) else value.tobytes())
    path = cache_folder() / "coacd" / f"{key.hexdigest()}.npz"
    try:
        stored = [np.asarray(p, float) for p in read_arrays(path, RunError).values()]
        if stored and all(_is_piece(points) for points in stored):
            return Decomposition(stored, _by_coacd(stored))
    except (RunError, TypeError, ValueError):
        pass  # A missing or invalid entry is recomputed.
    limit_s = file_bounds().decompose_s if time_s is None else time_s
    try:
        mesh = Path(f"a mesh of {len(faces)} faces")
        pieces = call_limited(
            *(_coacd, mesh, vertices, faces),
            error=RunError,
            time_option="decompose_s",
            timeout_s=limit_s,
        )
    except RunError as error:
        return Decomposition(hull_only, f"its convex hull, as CoACD fails ({error})")
    pieces = pieces or hull_only
    _store(path, pieces)
    return Decomposition(pieces, _by_coacd(pieces))


def _by_coacd(pieces: list[NDArray]) -> str:
    return f"{count(len(pieces), 'convex piece')} by CoACD"


def outward(vertices: NDArray, faces: NDArray) -> NDArray:
    """Return the triangles of a mesh, turned so that its closed components face outwards.

    A component inside another keeps its orientation relative to the other, as it may be a cavity.
    Open components are not changed, because they have no inside.

    Args:
        vertices: vertices of the mesh [m], shape [v, 3].
        faces: triangles of the mesh, shape [f, 3].

    Returns:
        The triangles in the same order, shape [f, 3].
    """
    import trimesh

    mesh = _merge_vertices(vertices, faces)
    if len(mesh.faces) != len(faces):
        return faces
    pairs, edges = mesh.face_adjacency, mesh.face_adjacency_edges
    labels = trimesh.graph.connected_component_labels(pairs, node_count=len(faces))
    number = int(labels.max()) + 1
    # Each edge of a closed component belongs to two triangles.
    closed = 2 * np.bincount(labels[pairs[:, 0]], minlength=number) == 3 * np.bincount(labels)
    sign = _consistent_signs(mesh.faces, pairs, edges)
    corners = mesh.vertices[mesh.faces] - mesh.vertices.mean(axis=0)
    volumes = np.einsum("fi,fi->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) * sign
    inverted = np.bincount(labels, volumes) < 0
    rows = mesh.vertices[mesh.faces].reshape(-1, 3)
    low, high = np.full((number, 3), np.inf), np.full((number, 3), -np.inf)
    np.minimum.at(low, np.repeat(labels, 3), rows)
    np.maximum.at(high, np.repeat(labels, 3), rows)
    turned = closed & inverted
    for k in np.argsort(-np.prod(high - low, axis=1)):  # Outer components come first.
        around = np.all((low < low[k]) & (high > high[k]), axis=1) & closed
        if around.any() and closed[k]:
            outer = np.flatnonzero(around)[np.argmin(np.prod((high - low)[around], axis=1))]
            turned[k] = turned[outer]
    flip = ((sign < 0) ^ turned[labels]) & closed[labels]
    return np.where(flip[:, None], np.asarray(faces)[:, ::-1], faces)


def _consistent_signs(faces: NDArray, pairs: NDArray, edges: NDArray) -> NDArray:
    """Return 1 or -1 for each triangle, so that signed neighbors have the same orientation, [f].

    Args:
        faces: triangles, shape [f, 3].
        pairs: adjacent triangles, shape [n, 2].
        edges: vertices of the edge of each pair, shape [n, 2].
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import breadth_first_order

    def forward(side: int) -> NDArray:
        own = faces[pairs[:, side]]
        return np.any((own == edges[:, :1]) & (np.roll(own, -1, axis=1) == edges[:, 1:]), axis=1)

    sign = np.ones(len(faces), int)
    same = forward(0) != forward(1)
    if same.all():
        return sign
    relation = np.where(same, 1, -1)
    rows, columns = np.concatenate([pairs, pairs[:, ::-1]]).T
    graph = coo_matrix((np.tile(relation, 2), (rows, columns)), (len(faces),) * 2).tocsr()
    left = np.ones(len(faces), bool)
    while left.any():
        start = int(np.argmax(left))
        order, before = breadth_first_order(abs(graph), start, directed=False)
        for face in order[1:]:
            sign[face] = sign[before[face]] * graph[face, before[face]]
        # The first triangle of a component keeps its orientation only if most others do.
        sign[order] *= 1 if sign[order].sum() >= 0 else -1
        left[order] = False
    return sign


def _is_piece(points: NDArray) -> bool:
    return points.ndim == 2 and points.shape[1] == 3 and bool(np.isfinite(points).all())


def is_flat(vertices: NDArray) -> bool:
    """Return whether a mesh is a flat sheet."""
    spread = np.linalg.svd(vertices - vertices.mean(axis=0), full_matrices=False)
    return float(np.ptp((vertices - vertices.mean(axis=0)) @ spread[2].T, axis=0).min()) < SHEET_M


def is_convex(vertices: NDArray, faces: NDArray) -> bool:
    """Return whether a mesh is closed and fills its convex hull."""
    mesh = _merge_vertices(vertices, faces)
    if not mesh.is_watertight:
        return False
    hull_volume = volume_of_hull(vertices)
    return hull_volume > 0 and abs(float(mesh.volume)) > CONVEX_SHARE * hull_volume


def _merge_vertices(vertices: NDArray, faces: NDArray) -> Any:
    import trimesh

    return trimesh.Trimesh(vertices, faces, process=True)


def hull_points(vertices: NDArray) -> NDArray:
    """Return a few points [n, 3] whose convex hull approximates that of a mesh and is never flat.

    If there are more than MAX_CORNERS points, only the extreme points in evenly spread directions
    are kept. A flat sheet is thickened along its normal.
    """
    points = np.unique(np.round(vertices, 9), axis=0)
    centre = points.mean(axis=0)
    axes = np.linalg.svd(points - centre, full_matrices=False)[2]
    local = (points - centre) @ axes.T
    thin = np.ptp(local, axis=0) < SHEET_M
    if thin.any():
        shift = np.array(np.meshgrid(*[(-1, 1) if t else (0,) for t in thin])).reshape(3, -1).T
        flat = np.where(thin, 0.0, local)
        flat = flat[_extreme_rows(flat)]
        local = (flat[:, None] + shift[None] * SHEET_M / 2).reshape(-1, 3)
        return np.unique(local @ axes + centre, axis=0)
    return points[_extreme_rows(points)]


def _extreme_rows(points: NDArray) -> NDArray:
    if len(points) <= MAX_CORNERS:
        return np.arange(len(points))
    return np.unique((_directions() @ (points - points.mean(axis=0)).T).argmax(axis=1))


@lru_cache(maxsize=1)
def _directions() -> NDArray:
    """Return unit vectors [n, 3], evenly spread and to the faces, edges and corners of a box."""
    box = np.array([[x, y, w] for x in (-1, 0, 1) for y in (-1, 0, 1) for w in (-1, 0, 1)], float)
    box = box[np.abs(box).sum(axis=1) > 0]
    box = box / np.linalg.norm(box, axis=1, keepdims=True)
    return np.vstack([sphere_directions(120), box])


def _coacd(_: Path, vertices: NDArray, faces: NDArray) -> list[NDArray]:
    import coacd

    coacd.set_log_level("error")
    mesh = _merge_vertices(vertices, faces)
    # Wrapping would turn an open mesh into a thick shell, although most components may be closed.
    components = [mesh]
    if not mesh.is_watertight:
        components = _bodies(mesh)
        if len(components) > CLOSED_LIMITS[1]:
            components = [mesh]
    components = [_fill_small_holes(component) for component in components]
    sizes = np.array([np.ptp(component.vertices, axis=0).max() for component in components])
    return [
        points
        for component, size in zip(components, sizes, strict=True)
        for points in _pieces(component, sizes.max() / size, size / sizes.sum())
    ]


def _bodies(mesh: Any) -> list[Any]:
    """Return the connected components of a mesh; bodies that touch at edges are separate."""
    import trimesh

    corners = np.asarray(mesh.faces)
    directed = corners[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    key = np.sort(directed, axis=1)
    _, edge = np.unique(key, axis=0, return_inverse=True)
    edge, owner = edge.reshape(-1), np.repeat(np.arange(len(corners)), 3)
    order = np.argsort(edge, kind="stable")
    runs = np.split(order, np.flatnonzero(np.diff(edge[order])) + 1)
    pairs = [owner[run] for run in runs if len(run) == 2]
    for run in runs:
        if len(run) > 2:
            pairs += _around_edge(mesh, key[run[0]], directed[run], owner[run])
    rows = trimesh.graph.connected_components(
        np.reshape(pairs, (-1, 2)), nodes=np.arange(len(corners)), min_len=1
    )
    return mesh.submesh(rows, append=False, only_watertight=False, repair=False)


def _around_edge(mesh: Any, edge: NDArray, directed: NDArray, owner: NDArray) -> list[NDArray]:
    """Pair the triangles at an edge that bound the same body, in their order around the edge.

    Args:
        mesh: the mesh; its triangles face outwards.
        edge: indices of the edge's vertices, shape [2].
        directed: vertices of the edge in the order of each triangle, shape [n, 2].
        owner: indices of the triangles, shape [n].
    """
    start, end = mesh.vertices[edge]
    along = (end - start) / np.linalg.norm(end - start)
    out = mesh.triangles[owner].sum(axis=1) - start - end - start
    out -= np.outer(out @ along, along)
    side = np.cross(along, out[0])
    across, ahead = out @ side / np.linalg.norm(side), out @ out[0] / np.linalg.norm(out[0])
    angle = np.round(np.arctan2(across, ahead) % (2 * np.pi), 6)
    angle[angle >= round(2 * np.pi, 6)] = 0.0
    opens = directed[:, 0] != edge[0]
    """True for triangles behind which, by increasing angle, their body lies."""
    order = np.lexsort((opens, angle))
    order = np.roll(order, -int(np.argmax(opens[order])))
    pairs, open_triangles = [], list[int]()
    for k in order.tolist():
        if opens[k]:
            open_triangles.append(k)
        elif open_triangles:
            pairs.append(owner[[open_triangles.pop(), k]])
    return pairs


def _fill_small_holes(mesh: Any) -> Any:
    """Fill the holes of a mesh if they are small and this closes the mesh; return the mesh."""
    filled = mesh.copy()
    filled.fill_holes()
    small = filled.is_watertight and filled.area < (1 + MAX_HOLE_AREA) * mesh.area
    return filled if small else mesh


def _pieces(mesh: Any, relative: float, share: float) -> list[NDArray]:
    """Split a connected mesh.

    Args:
        mesh: the mesh.
        relative: size of the largest component divided by the size of this component.
        share: fraction of the pieces into which this component may be split.
    """
    import coacd

    # Closed meshes need no wrapping, which thickens walls by a fiftieth of the size. Without
    # wrapping, CoACD does not end if the triangles of a mesh face inwards.
    closed = bool(mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0)
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    concavity, max_pieces = CLOSED_LIMITS if closed else OPEN_LIMITS
    concavity, max_pieces = concavity * relative, round(max_pieces * share)
    if concavity >= 1 or max_pieces < 2 or is_flat(vertices) or is_convex(vertices, faces):
        return [hull_points(vertices)]
    if closed:
        vertices, faces = _simplify(mesh)
    parts = coacd.run_coacd(
        coacd.Mesh(vertices, faces),
        threshold=concavity,
        max_convex_hull=max_pieces,
        preprocess_mode="off" if closed else "auto",
        preprocess_resolution=50,
        mcts_iterations=10,
        mcts_nodes=10,
        mcts_max_depth=2,
        resolution=500,
        decimate=True,
        max_ch_vertex=MAX_CORNERS,
    )
    # Wrapping enlarges open meshes, so pieces are clipped to the mesh's bounds.
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    return [
        hull_points(np.clip(np.asarray(points, float), low, high))
        for points, _ in parts
        if len(points) >= 4
    ]


def _simplify(mesh: Any) -> tuple[NDArray, NDArray]:
    """Return a closed mesh with fewer faces, or the unchanged mesh if simplification fails."""
    import manifold3d

    solid = manifold3d.Manifold(
        manifold3d.Mesh(
            vert_properties=np.asarray(mesh.vertices, np.float32),
            tri_verts=np.asarray(mesh.faces, np.uint32),
        )
    )
    coarse = solid.simplify(
        SIMPLIFICATION_TOLERANCE * float(np.ptp(mesh.vertices, axis=0).max())
    ).to_mesh()
    if solid.status() != manifold3d.Error.NoError or not len(coarse.tri_verts):
        return np.asarray(mesh.vertices), np.asarray(mesh.faces)
    # Manifold keeps one vertex for each set of properties. CoACD needs one for each position.
    merged = _merge_vertices(
        coarse.vert_properties[:, :3].astype(float), coarse.tri_verts.astype(np.int64)
    )
    if not merged.is_watertight:
        return np.asarray(mesh.vertices), np.asarray(mesh.faces)
    return np.asarray(merged.vertices), np.asarray(merged.faces)


def _store(path: Path, pieces: list[NDArray]) -> None:
    import io

    buffer = io.BytesIO()
    np.savez_compressed(
        buffer, allow_pickle=False, **{f"p{k:03d}": p for k, p in enumerate(pieces)}
    )
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(path, buffer.getvalue())
    except OSError:
        pass  # The next run decomposes the mesh again.
